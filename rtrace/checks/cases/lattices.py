"""Coordinates that floats hold exactly: rays in planes and on edges, origins on surfaces, copies of triangles."""

import itertools

import numpy as np

from rtrace.checks.cases.case import AXES, EXACT, QUAD, ROUNDING, Cases, corners_and_middles, exact_case, lattice, random_rays
from rtrace.rays import make_rays
from rtrace.scenes.shapes import boxes, height_field, rectangle

CASES = Cases()


@CASES.enter("boxes, axis-parallel rays in face planes")
def _boxes_axis_parallel_rays_face_planes(long):
    origin = lattice(5, (6000 if long else 600, 3), -4, 16, 0.5)
    return exact_case(boxes(3), make_rays(origin, np.resize(AXES, origin.shape)), rounds=False)


@CASES.enter("boxes, rays in face planes and on edges")
def _boxes_rays_face_planes_on_edges(long):
    origin = lattice(6, (6000 if long else 600, 3), -4, 16, 0.5)
    return exact_case(boxes(3), random_rays(6, origin, EXACT), rounds=False)


@CASES.enter("boxes from 2^40 away")
def _boxes_from_far_away(long):
    triangles = boxes(2)
    targets = lattice(36, (200, 3), -3, 11, 0.5)
    direction = np.resize(AXES, targets.shape)
    origin = np.where(direction == 0, targets, -direction * 2.0**40)
    return exact_case(triangles, make_rays(origin, direction), rounds=False)


@CASES.enter("height field, rays on grid lines")
def _height_field_rays_on_grid_lines(long):
    origin = lattice(7, (6000 if long else 600, 3), 0, 8)
    direction = np.concatenate([AXES, [[0, -1, 2], [1, -1, -0.0], [-4, 1, 2], [1, 2, 1], [-0.0, 1, 1], [1, 0, 1]]])
    return exact_case(height_field(8), make_rays(origin, np.resize(direction, origin.shape)), rounds=False)


@CASES.enter("checkerboard floor, rays in it and through its corners")
def _checkerboard_floor_rays_through_corners(long):
    floor = rectangle((0, 0, 0), (8, 0, 0), (0, 0, 8), 8, 8).reshape(8, 8, 6, 3)[::2, ::2].reshape(-1, 3, 3)
    origin = lattice(8, (800, 3), -1, 18, 0.5) * np.float32([1, 0.25, 1])
    return exact_case(floor, random_rays(8, origin, EXACT), rounds=False)


@CASES.enter("lattice soup, flat ones and equals among them")
def _lattice_soup_with_flat_ones_and_equals(long):
    soup = lattice(9, (80, 3, 3), -2, 2)
    return exact_case(soup, random_rays(10, lattice(10, (9000 if long else 700, 3), -6, 6, 0.5), EXACT), rounds=False)


@CASES.enter("lattice soup, slopes that round")
def _lattice_soup_slopes_that_round(long):
    soup = lattice(9, (80, 3, 3), -2, 2)
    return exact_case(soup, random_rays(11, lattice(11, (9000 if long else 700, 3), -6, 6, 0.5), ROUNDING))


@CASES.enter("lattice soup, zeros of both signs")
def _lattice_soup_zeros_both_signs(long):
    soup = lattice(12, (80, 3, 3), -1, 1)
    soup[np.random.default_rng(12).random(soup.shape) < 0.5] *= np.float32(-1)
    origin = lattice(13, (400, 3), -2, 2, 0.5)
    origin[::2] = -origin[::2]
    return exact_case(soup, random_rays(13, origin, EXACT), rounds=False)


@CASES.enter("one triangle")
def _one_triangle(long):
    one = np.float32([[[0, 0, 0], [4, 0, 0], [0, 4, 0]]])
    return exact_case(one, random_rays(14, lattice(14, (800, 3), -4, 12, 0.5), EXACT), rounds=False)


@CASES.enter("origins on faces, edges and vertices")
def _origins_on_faces_edges_vertices(long):
    points = corners_and_middles(boxes(2))[:: 1 if long else 2]
    slanted = list(itertools.product((1, -1), (2, -1), (4, -2, 0)))
    direction = np.concatenate([AXES[:: 1 if long else 4], slanted])
    origin = np.repeat(points, len(direction), axis=0)
    # At every other ray what lies at t = 0 counts, at the others only what lies beyond.
    t_min = np.resize([0.0, 5e-324], len(origin))
    return exact_case(boxes(2), make_rays(origin, np.tile(direction, (len(points), 1)), t_min), rounds=False)


@CASES.enter("origins a hair off a surface")
def _origins_hair_off_surface(long):
    rng = np.random.default_rng(15)
    origin = rng.choice(np.float32([0, 1e-20, -1e-20, 1e-40, -1e-40, 0.25, 1, 1.5]), (1500 if long else 300, 3))
    return exact_case(boxes(2), make_rays(origin, rng.uniform(-1, 1, origin.shape)))


@CASES.enter("copies: a thousand, some of them reversed")
def _thousand_copies_some_reversed(long):
    triangles = np.concatenate([QUAD - np.float32([0, 0, 3]), *[QUAD, QUAD[:, ::-1]] * 250])
    return exact_case(triangles, random_rays(16, lattice(16, (40, 3), -8, 8, 0.5), EXACT), rounds=False)


@CASES.enter("copies: a hundred thousand")
def _hundred_thousand_copies(long):
    rays = random_rays(17, lattice(17, (60, 3), -8, 8, 0.5), EXACT)
    one = exact_case(QUAD[:1], rays, rounds=False)
    return one._replace(triangles=np.repeat(QUAD[:1], 100_000, axis=0), answer=one.answer._replace(met=None))


@CASES.enter("overlapping triangles in two planes")
def _overlapping_triangles_two_planes(long):
    in_plane = lattice(18, (60, 3, 3), -3, 3) * np.float32([1, 1, 0])
    triangles = np.concatenate([in_plane, np.roll(in_plane[::-1], 1, axis=2) + np.float32([1, 0, 0])])
    return exact_case(triangles, random_rays(19, lattice(19, (600, 3), -8, 8, 0.5), EXACT), rounds=False)
