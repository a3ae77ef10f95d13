"""The catalogue that the tests run: all of rtrace.checks.hard_cases, and more of the random kind than a user's check needs."""

import numpy as np

from rtrace.checks.cases.case import Case, aimed, exact_case, known_case
from rtrace.checks.hard_cases import CASES as CASES_OF_CHECK
from rtrace.rays import make_rays
from rtrace.scenes.shapes import icosphere


def lattice_soup(seed: int) -> Case:
    """Few whole numbers: equal, flat, touching triangles, and rays in all their planes; slopes round at odd seeds."""
    rng = np.random.default_rng([seed, 1])
    size = int(rng.integers(1, 4))
    soup = rng.integers(-size, size, (rng.integers(2, 60), 3, 3), endpoint=True)
    origin = rng.integers(-2 * size - 2, 2 * size + 2, (300, 3), endpoint=True) / 2
    direction = rng.choice([0.0, -0.0, 1.0, -1.0, 2.0, -2.0] if seed % 2 == 0 else [0.0, -0.0, 1.0, -2.0, 3.0, -5.0], (300, 3))
    direction[~direction.any(axis=1)] = 1
    return exact_case(soup, make_rays(origin, direction), rounds=seed % 2 == 1)


def mixed_soup(seed: int) -> Case:
    """Sizes from 1 to 1e-20 beside each other, seen from as near."""
    rng = np.random.default_rng([seed, 2])
    values = np.float32([0, 1, -1, 1e-3, -1e-5, 1e-10, -1e-10, 1e-20, -1e-20])
    soup, origin = rng.choice(values, (25, 3, 3)), rng.choice(values, (300, 3))
    inner = (soup[rng.integers(0, 25, 300)] * rng.dirichlet([1, 1, 1], 300)[..., None]).sum(axis=1)
    direction = inner - origin
    direction[~direction.any(axis=1)] = 1
    return exact_case(soup, make_rays(origin, direction))


def any_bits(seed: int) -> Case:
    """Any finite float32, picked by its bits."""
    rng = np.random.default_rng([seed, 3])
    numbers = rng.integers(0, 2**32, 4000, dtype=np.uint32).view(np.float32)
    numbers = numbers[np.isfinite(numbers)]
    origin, direction = numbers[200:800].reshape(-1, 3), numbers[1000:1600].reshape(-1, 3)
    return exact_case(numbers[:180].reshape(20, 3, 3), make_rays(origin, direction))


def large_ball(frequency: int) -> Case:
    """A ball of 82 thousand triangles; from inside every ray hits."""
    ball = icosphere(frequency)
    return known_case(ball, aimed([[0.1, -0.05, 0.2]], ball[::160].reshape(-1, 3)), True)


CASES = {
    **CASES_OF_CHECK,
    **{f"random: lattice soup {seed}": lambda long, seed=seed: lattice_soup(seed) for seed in range(12)},
    **{f"random: mixed magnitudes {seed}": lambda long, seed=seed: mixed_soup(seed) for seed in range(4)},
    **{f"random: any bits {seed}": lambda long, seed=seed: any_bits(seed) for seed in range(4)},
    "random: ball of 82 thousand triangles": lambda long: large_ball(6),
}
