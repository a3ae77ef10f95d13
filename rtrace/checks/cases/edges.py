"""Rays at the vertices and edges of meshes, along surfaces, and in the planes of triangles, at several scales."""

import numpy as np

from rtrace.checks.cases.case import (
    INSIDE,
    OCTAHEDRON,
    OUTSIDE,
    Cases,
    aimed,
    corners_and_middles,
    exact_case,
    known_case,
    lattice,
    random_rays,
)
from rtrace.rays import make_rays
from rtrace.scenes.shapes import boxes, height_field, icosphere, rectangle

CASES = Cases()


@CASES.enter("ball from inside, at vertices and edges")
def _ball_from_inside_vertices_edges(long):
    ball = icosphere(2 if long else 1)
    return exact_case(ball, aimed(INSIDE, corners_and_middles(ball)), is_closed=True)


@CASES.enter("ball from outside, at vertices and edges")
def _ball_from_outside_vertices_edges(long):
    ball = icosphere(1)
    return exact_case(ball, aimed(OUTSIDE, corners_and_middles(ball)))


@CASES.enter("ball from just inside, at grazing angles")
def _ball_from_just_inside_grazing_angles(long):
    ball = icosphere(1)
    origins = ball[:: 10 if long else 40, 0] * np.float32(1 - 2.0**-20)
    return exact_case(ball, aimed(origins, corners_and_middles(ball)), is_closed=True)


@CASES.enter("large ball from inside, at vertices and edges")
def _large_ball_from_inside_vertices_edges(long):
    ball = icosphere(6 if long else 3)
    return known_case(ball, aimed(INSIDE[1:2], corners_and_middles(ball)[:: 16 if long else 1]), True)


def _scaled_ball(scale, long):
    ball = icosphere(1)
    points = np.concatenate([corners_and_middles(ball), icosphere(0).mean(axis=1)])
    return exact_case(ball * np.float32(scale), aimed(INSIDE * scale, points * np.float32(scale)), is_closed=True)


for _scale in (2.0**-140, 1e-30, 1e-12, 1e12, 1e30, 1.5e38):
    CASES.enter(f"ball from inside, radius {_scale:.3g}", _scale)(_scaled_ball)


def _moved_ball(extents, long):
    # float32 moves the vertices, all triangles of one alike, by less than the distance from the origins to the surface.
    away = 2 * extents * np.array([1.0, -0.7, 0.4])
    ball = (icosphere(1) + away).astype(np.float32)
    return exact_case(ball, aimed(away + np.array([[0, 0, 0], [0.25, -0.25, 0]]), corners_and_middles(ball)), is_closed=True)


for _extents in (1e4, 1e6):
    CASES.enter(f"ball from inside, {_extents:g} extents away", _extents)(_moved_ball)


@CASES.enter("directions of length 1e-30 to 1e30")
def _directions_length_1e_30_to_1e30(long):
    ball = icosphere(1)
    rays = aimed(INSIDE[1:2], corners_and_middles(ball))
    lengths = np.resize(np.float32([1e-30, 1e-20, 1e-10, 1e10, 1e20, 1e30]), (len(rays.t_min), 1))
    return exact_case(ball, make_rays(rays.origin, rays.direction * lengths), is_closed=True)


@CASES.enter("directions with subnormal components")
def _directions_with_subnormal_components(long):
    origin = lattice(30, (1000 if long else 250, 3), -2, 12, 0.5)
    return exact_case(boxes(2), random_rays(31, origin, [0.0, 1e-40, -1e-45, 1e-45, 1.0, -1.0]))


@CASES.enter("octahedron from inside, exactly through vertices and edges")
def _octahedron_exactly_through_vertices_edges(long):
    s = np.arange(12)[:, None, None, None] / 12
    points = np.unique((OCTAHEDRON * (1 - s) + np.roll(OCTAHEDRON, 1, axis=1) * s).reshape(-1, 3), axis=0)
    return exact_case(OCTAHEDRON, aimed([[1, 2, -1], [3, -2, 5], [0, 0, 0]], points), is_closed=True)


@CASES.enter("height field, exactly through vertices and edges")
def _height_field_exactly_through_vertices_edges(long):
    field = height_field(6)
    origins = lattice(3, (30 if long else 6, 3), -7, 13) + np.float32([0, 12, 0])
    return exact_case(field, aimed(origins, corners_and_middles(field)))


@CASES.enter("flat grid at grazing angles")
def _flat_grid_grazing_angles(long):
    grid = rectangle((0, 0, 0), (8, 0, 0), (0, 0, 8), 8, 8).astype(np.float32)
    low = [[-1, 2.0**-k, 3.5] for k in ((4, 10, 16, 20) if long else (4, 20))]
    return exact_case(grid, aimed(low, corners_and_middles(grid)))


@CASES.enter("triangles almost edge-on")
def _triangles_almost_edge_on(long):
    tilt = lattice(33, (30, 3, 3), -64, 64) * np.float32([1, 1, 2.0**-23])
    origin = lattice(34, (200, 3), -128, 128, 0.5) * np.float32([1, 1, 2.0**-20])
    direction = lattice(35, (200, 3), -7, 7) * np.float32([1, 1, 2.0**-21]) + np.float32([8, 0, 0])
    return exact_case(tilt, make_rays(origin, direction))


@CASES.enter("rays in the planes of triangles, past and through them")
def _rays_in_planes_of_triangles(long):
    rng = np.random.default_rng(44)
    triangles = rng.integers(-6, 7, (15, 3, 3))
    triangles[::3, 2] = 2 * triangles[::3, 1] - triangles[::3, 0]  # without area
    u, v = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    i, j, k, m = rng.integers(-4, 5, (4, 200 if long else 40, 1, 1))
    origin, direction = triangles[:, 0] + (i * u + j * v) / 2, k * u + m * v
    there = direction.any(axis=2)
    return exact_case(triangles, make_rays(origin[there], direction[there]))
