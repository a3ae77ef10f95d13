"""Strays: triangles far out of the scene."""

import numpy as np

from rtrace.checks.cases.case import INSIDE, OUTSIDE, Cases, aimed, corners_and_middles, exact_case
from rtrace.rays import Rays, make_rays
from rtrace.scenes.shapes import icosphere

CASES = Cases()


def _stray_case(size, long):
    """A ball seen from inside and past it, and two triangles far away, one of them with a corner at the ball."""
    ball = icosphere(1)
    far = np.float32(size) * np.float32([[[1, 0, 0], [1, 1, 0], [1, 0, 1]], [[-1, -0.5, 0], [0, 0, 0], [-1, 0, -0.5]]])
    far[1, 1] = 0, 4, 0
    triangles = np.concatenate([ball, far])
    points = corners_and_middles(ball)
    near = aimed(INSIDE if long else INSIDE[1:2], points), aimed(OUTSIDE, points[:: 1 if long else 4])
    weights = np.random.default_rng(50).dirichlet([1, 1, 1], (60, 2))
    inner = (far * weights[..., None]).sum(axis=2).reshape(-1, 3)
    to_far = aimed(OUTSIDE, inner), aimed(OUTSIDE, corners_and_middles(far))
    rays = Rays(*(np.concatenate(parts) for parts in zip(*near, *to_far, strict=True)))
    shrunk = rays.direction / np.maximum(np.abs(rays.direction).max(axis=1, keepdims=True), np.float32(1))
    return exact_case(triangles, make_rays(rays.origin, shrunk))


for _size in (1e9, 1e12, 1e13, 1e14, 1e20, 1e30, 1e38):
    CASES.enter(f"strays: two triangles {_size:g} away", _size)(_stray_case)


@CASES.enter("strays: triangles of sizes from 1 to 1e37 in one another")
def _strays_in_one_another(long):
    rng = np.random.default_rng(51)
    size = 10.0 ** np.concatenate([np.zeros(20), rng.uniform(5, 37, 20)])[:, None, None]
    soup = (rng.uniform(-1, 1, (40, 3, 3)) * size).astype(np.float32)
    soup[::7, 0] = rng.uniform(-1, 1, (6, 3))
    n = 1200 if long else 300
    inner = (soup[rng.integers(0, 40, n)].astype(float) * rng.dirichlet([1, 1, 1], n)[..., None]).sum(axis=1)
    origin = rng.uniform(-2, 2, (n, 3)).astype(np.float32)
    direction = inner - origin
    return exact_case(soup, make_rays(origin, direction / np.abs(direction).max(axis=1, keepdims=True)))
