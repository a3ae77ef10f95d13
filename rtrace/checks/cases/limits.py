"""Ends of a ray's interval, distances of one ulp, magnitudes far apart, and rays that are not finite."""

import numpy as np

from rtrace.checks.cases.case import (
    AXES,
    INSIDE,
    OUTSIDE,
    QUAD,
    Cases,
    aimed,
    corners_and_middles,
    exact_case,
    known_case,
    lattice,
)
from rtrace.rays import Rays, make_rays
from rtrace.scenes.shapes import box, icosphere

CASES = Cases()


@CASES.enter("t_min and t_max at a hit, and one ulp beside")
def _t_min_and_t_max_at_a_hit(long):
    triangles = np.concatenate([QUAD + np.float32([0, 0, z]) for z in (1, 2, 2, 5)])
    ends = np.array([x for t in (0.25, 0.5, 1, 2, 5) for x in (np.nextafter(t, 0), t, np.nextafter(t, 9))])
    t_min, t_max = (a.reshape(-1) for a in np.meshgrid([0.0, *ends], [*ends, np.inf]))
    directions = np.array([[0, 0, 1], [1, -1, 2], [0, 1, 4.0]])
    rays = make_rays([0.5, 0.25, 0], np.repeat(directions, len(t_min), axis=0), np.tile(t_min, 3), np.tile(t_max, 3))
    return exact_case(triangles, rays, rounds=False)


@CASES.enter("t_min above t_max")
def _t_min_above_t_max(long):
    return known_case(QUAD, make_rays([0.5, 0.25, -1], np.resize([[0, 0, 1], [1, -1, 2]], (200, 3)), 2.0, 0.5), False)


@CASES.enter("sheets one ulp apart")
def _sheets_one_ulp_apart(long):
    z = np.float32([1, 1e6])
    z = np.concatenate([np.nextafter(z, np.float32(0)), z, np.nextafter(z, np.float32(1e9))])
    sheets = np.concatenate([QUAD * np.float32(100) + np.float32([0, 0, at]) for at in z])
    middle = (z[[0, 2, 4]] / 2)[:, None] * np.float32([0, 0, 1])
    origins = np.concatenate([middle, middle * 3, OUTSIDE])
    return exact_case(sheets, aimed(origins, sheets.reshape(-1, 3) * np.float32([0.37, 0.11, 1])))


@CASES.enter("boxes one ulp wide")
def _boxes_one_ulp_wide(long):
    ulp = 2.0**-23
    one, far = box((1, 1, 1), 3 * (1 + ulp,)), box((2, 1, 1), 3 * (2 + 2 * ulp,))
    points = 1 + lattice(37, (600, 3), -1, 2, ulp)
    direction = np.resize(AXES, points.shape)
    return exact_case(np.concatenate([one, far]), make_rays(points - 2 * direction, direction), rounds=False)


@CASES.enter("a tiny ball in a huge box")
def _tiny_ball_in_a_huge_box(long):
    triangles = np.concatenate([icosphere(1) * np.float32(1e-12), box(3 * (-1e12,), 3 * (1e12,))])
    origins = np.concatenate([INSIDE[1:] * 1e-12, OUTSIDE[:1], OUTSIDE[:1] * 1e11])
    return exact_case(triangles, aimed(origins, corners_and_middles(icosphere(1) * np.float32(1e-12))), is_closed=True)


@CASES.enter("soup of mixed magnitudes")
def _soup_mixed_magnitudes(long):
    rng = np.random.default_rng(38)
    values = np.float32([0, 1, -1, 1e-5, -1e-5, 1e-10, -1e-10, 1e-20, -1e-20])
    soup = rng.choice(values, (30, 3, 3))
    origin = rng.choice(values, (4000 if long else 800, 3))
    inner = (soup[rng.integers(0, 30, len(origin))] * rng.dirichlet([1, 1, 1], len(origin))[..., None]).sum(axis=1)
    return exact_case(soup, make_rays(origin, inner - origin))


@CASES.enter("soup of random exponents")
def _soup_random_exponents(long):
    rng = np.random.default_rng(39)
    soup, origin, direction = (
        (rng.uniform(-2, 2, shape) * np.exp2(rng.integers(-100, 100, shape))).astype(np.float32)
        for shape in ((30, 3, 3), (400, 3), (400, 3))
    )
    direction[::2] = soup[np.resize(np.arange(30), 200), 0] - origin[::2]
    return exact_case(soup, make_rays(origin, direction))


@CASES.enter("rays that are none: not finite, or without a direction")
def _rays_that_are_none(long):
    rng = np.random.default_rng(52)
    n = 2000 if long else 400
    origin, direction = rng.uniform(-2, 2, (n, 3)).astype(np.float32), rng.uniform(-1, 1, (n, 3)).astype(np.float32)
    bad, axis = rng.choice(np.float32([np.nan, np.inf, -np.inf]), n), rng.integers(0, 3, n)
    for part, which in ((origin, slice(0, n, 3)), (direction, slice(1, n, 3))):
        part[np.arange(n)[which], axis[which]] = bad[which]
    direction[2::3] = 0.0
    return known_case(icosphere(1), Rays(origin, direction, np.zeros(n), np.full(n, np.inf)), False)
