"""Slivers, triangles without area, and heaps of triangles that no plane parts."""

import numpy as np

from rtrace.checks.cases.case import (
    EXACT,
    OCTAHEDRON,
    OUTSIDE,
    QUAD,
    Case,
    Cases,
    aimed,
    exact_case,
    known_case,
    lattice,
    random_rays,
)
from rtrace.rays import make_rays
from rtrace.scenes.shapes import box, rectangle

CASES = Cases()


@CASES.enter("slivers, a hundred thousand times as long as wide and more")
def _slivers(long):
    rng = np.random.default_rng(21)
    a, along, across = rng.uniform(-1, 1, (3, 40, 3))
    width = 10.0 ** -rng.uniform(5, 7, (40, 1))
    slivers = np.stack([a, a + along, a + along / 2 + width * across], axis=1).astype(np.float32)
    inner = (slivers * rng.dirichlet([1, 1, 1], (6, 40))[..., None]).sum(axis=2).reshape(-1, 3)
    return exact_case(slivers, aimed(OUTSIDE, inner))


_ALMOST_0 = np.cos(np.pi / 2)  # 6e-17


@CASES.enter("slivers as wide as cos(pi/2) at the end of a floor")
def _slivers_at_the_end_of_a_floor(long):
    floor = rectangle((-1, 0, 0), (1, 0, 0), (0, 0, 1), 1, 200)
    floor = np.concatenate([floor, [[(0, 0, 0), (_ALMOST_0, 0, 0), (0, 0, 1)]] * 3]).astype(np.float32)
    targets = np.concatenate([floor[:: 1 if long else 6].mean(axis=1), floor[-40:, 1]])
    return exact_case(floor, aimed([[-0.25, 1, 0.5], [_ALMOST_0 / 2, 1, 0.25]], targets))


@CASES.enter("half a disc, its diameter bent by cos(pi/2)")
def _half_disc_with_a_bent_diameter(long):
    angle = np.linspace(np.pi / 2, 3 * np.pi / 2, 160 if long else 40)
    rim = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)
    disc = np.stack([0 * rim[1:], rim[:-1], rim[1:]], axis=1).astype(np.float32)
    targets = np.concatenate([disc.mean(axis=1), disc[::8, 2], [[_ALMOST_0 / 2, 0, 0.5]]])
    return exact_case(disc, aimed([[-0.25, 1, 0.5], [_ALMOST_0 / 2, 1, 0.25], [0, -2, 0]], targets))


@CASES.enter("triangles without area among others")
def _some_triangles_without_area(long):
    a, along = lattice(22, (40, 3), -3, 3), lattice(23, (40, 3), -2, 2)
    flat = np.stack([a, a + along, a - along], axis=1)
    flat[::3, 1:] = flat[::3, :1]
    triangles = np.concatenate([flat, OCTAHEDRON])[np.random.default_rng(24).permutation(48)]
    steps = np.random.default_rng(25).choice(EXACT, (20, 40, 3))
    steps[~steps.any(axis=2)] = 1
    return exact_case(triangles, make_rays((a - 2 * steps).reshape(-1, 3), steps.reshape(-1, 3)), rounds=False)


@CASES.enter("only triangles without area")
def _only_triangles_without_area(long):
    a, along = lattice(41, (30, 3), -3, 3), lattice(42, (30, 3), -2, 2)
    flat = np.stack([a, a + along, a - along], axis=1)
    return exact_case(flat, random_rays(43, np.repeat(a, 10, axis=0), EXACT), rounds=False)


def _cone(apex, ring) -> np.ndarray:
    """Return the triangles from the apex to each side of a closed polygon of (n, 3) points."""
    return np.stack([np.broadcast_to(apex, ring.shape), ring, np.roll(ring, -1, axis=0)], axis=1).astype(np.float32)


@CASES.enter("many triangles that share a vertex")
def _many_triangles_around_a_vertex(long):
    angle = np.linspace(0, 2 * np.pi, 1_000_000 if long else 20_000, endpoint=False)
    ring = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)
    share = np.array([0.3, 0.6, 0.9, 1.0])[:, None, None]
    on_edges = (share * np.array([0, 1, 0]) + (1 - share) * ring[:: len(ring) // 100]).reshape(-1, 3)
    in_base = lattice(26, (100, 3), -1, 1, 0.5) * [1, 0, 1]  # which is open
    rays = aimed([[0.01, 0.25, 0.02]], np.concatenate([on_edges, in_base]))
    return known_case(_cone((0, 1, 0), ring), rays, rays.direction[:, 1] > 0)


@CASES.enter("cone, exactly through its apex and edges")
def _cone_exactly_through_apex_edges(long):
    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    ring = np.round(np.stack([500 * np.cos(angle), 500 * np.sin(angle), 0 * angle], axis=1))
    cone = _cone((0, 0, 400), ring)
    points = np.concatenate([cone[:1, 0], cone[:, :2].mean(axis=1)])
    return exact_case(cone, aimed([[0, 0, 0], [7, -3, 10], [1, 2, 100]], points))


@CASES.enter("triangles with one centre")
def _triangles_with_one_centre(long):
    i, r = np.arange(1, 61)[:, None], np.random.default_rng(27).integers(-1, 2, (60, 2))
    size = np.concatenate([i, 61 - i, i], axis=1)
    third = np.concatenate([r * size[:, :2], size[:, 2:]], axis=1)
    triangles = np.stack([-size, size * [1, 1, -1], third], axis=1)
    return exact_case(triangles, aimed(lattice(28, (6 if long else 3, 3), -90, 90), triangles.mean(axis=1).round()))


@CASES.enter("needles along a diagonal")
def _needles_along_diagonal(long):
    i = np.arange(3000)
    a = np.stack([i, 0 * i, 7 * i % 11], axis=1)
    needles = np.stack([a, a + 4096, a + np.array([4096, 4097, 4096])], axis=1)
    return exact_case(needles, aimed([[-500, 3000, 900], [9000, 1, 2]], needles[:: 60 if long else 150].mean(axis=1)))


@CASES.enter("stack of sheets, the highest first")
def _stack_of_sheets(long):
    # So thin a stack that no split of a BVH pays: one leaf of all. Between sheets k and k + 1 a ray leaves for sheet k.
    n = 40_000 if long else 3_000
    sheet = np.roll(QUAD, 1, axis=2) * np.float32(2.0**32)
    sheets = np.tile(sheet, (n, 1, 1))
    sheets[:, :, 0] = np.repeat(np.arange(n)[::-1], 2)[:, None]
    k = np.linspace(0, n - 1, 60).astype(int)
    origin = lattice(29, (60, 3), -8, 8, 2.0**31) * np.float32([0, 1, 1]) + np.float32([0.5, 0, 0])
    one = exact_case(sheet, make_rays(origin, np.resize([[-1, 0.0, -0.0], [-1, -0.0, 0.0]], (60, 3))), rounds=False)
    nearest = [{2 * (n - 1 - at) + p: t for p, t in near.items()} for at, near in zip(k, one.answer.nearest, strict=True)]
    origin[:, 0] += k
    return Case(sheets, one.rays._replace(origin=origin), one.answer._replace(nearest=nearest, met=None), 0.0)


@CASES.enter("ten boxes around each other, each twice as large")
def _ten_nested_boxes(long):
    nested = np.concatenate([box(3 * (-(2.0**k),), 3 * (2.0**k,)) for k in range(-5, 5)])
    return exact_case(nested, random_rays(32, lattice(32, (600, 3), -20, 20) * np.float32(2.0**-4), EXACT), rounds=False)


@CASES.enter("a triangle at every power of two")
def _triangle_every_power_two(long):
    powers = np.exp2(np.arange(-60.0, 60))[:, None, None] * np.eye(3)
    origins = -np.exp2([[-70.0], [-1.0], [40.0], [70.0]]) * np.ones(3)
    directions = np.array([[1, 1, 1], [1, 2, 4], [4, 1, 1], [3, 5, 7], [1, 0, 0.0]])
    there = np.repeat(origins, 5, axis=0), np.tile(directions, (4, 1))
    back = -there[0], -there[1]
    return exact_case(powers, make_rays(*(np.concatenate(pair) for pair in zip(there, back, strict=True))))
