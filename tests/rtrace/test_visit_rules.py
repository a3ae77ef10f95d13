"""What a visit does not depend on: the sign of a zero, how chunks are cut; and invalid rays hit nothing."""

import itertools

import numpy as np
import pytest

from rtrace.rays import Rays, make_rays
from rtrace.scenes.shapes import box, boxes, icosphere
from rtrace.traverse import trace, trace_all, trace_recorded
from rtrace.trees.bvh import build_bvh
from rtrace.trees.kdtree import build_kdtree
from tests.reference.traversal import events_of, traverse

BUILDERS = {
    "kdtree": build_kdtree,
    "bvh sweep": build_bvh,
    "bvh binned": lambda triangles: build_bvh(triangles, builder="binned"),
}
ROW = np.concatenate([box((x, 0, 0), (x + 1, 1, 1)) for x in (0, 3, 6, 9)]).astype(np.float32)


@pytest.mark.parametrize("builder", BUILDERS)
@pytest.mark.parametrize("any_hit", [False, True])
def test_visits_do_not_depend_on_the_sign_of_a_zero(builder, any_hit):
    rng = np.random.default_rng(5)
    for triangles in (ROW, boxes(2)):
        tree = BUILDERS[builder](triangles)
        origin = rng.integers(-2, 11, (300, 3)).astype(np.float32)
        origin[::2] += np.float32(0.3)
        # An origin exactly the margin below a plane: there the moved plane is at a distance of 0.
        origin[5::10, 0] = -np.float32(2.0**-40)
        for axes in itertools.product((0, 1), repeat=3):
            if all(axes):
                continue
            direction = rng.choice(np.float32([1, -1, 2]), (300, 3))
            direction[:, np.flatnonzero(axes)] = 0.0
            minus = direction.copy()
            minus[:, np.flatnonzero(axes)] = -0.0
            plus, other = (trace_recorded(tree, make_rays(origin, d), any_hit=any_hit) for d in (direction, minus))
            np.testing.assert_array_equal(plus[2], other[2])
            np.testing.assert_array_equal(plus[1], other[1])
            np.testing.assert_array_equal(plus[0].prim, other[0].prim)
            assert plus[0].t.tobytes() == other[0].t.tobytes()


@pytest.mark.parametrize("builder", BUILDERS)
def test_a_zero_goes_with_the_positive_directions(builder):
    """The lower child first, as the reference has it."""
    tree = BUILDERS[builder](ROW)
    for zero in (0.0, -0.0):
        rays = make_rays([[0.3, 0.5, -5]], [[zero, zero, 1]])
        _, _, events = trace_recorded(tree, rays)
        assert events_of(events) == traverse(tree, rays.origin[0], rays.direction[0])[2]


def no_rays():
    """Every kind of ray that ``make_rays`` refuses, as the kernels get it."""
    good, bad = np.float32([0.1, 0.2, -3]), [np.nan, np.inf, -np.inf]
    rows = []
    for value, axis in itertools.product(bad, range(3)):
        for which in (0, 1):
            one = [good.copy(), np.float32([0.1, -0.1, 1])]
            one[which][axis] = value
            rows.append((*one, 0.0, np.inf))
    rows += [(good, np.zeros(3), 0.0, np.inf), (good, np.float32([-0.0, 0, -0.0]), 0.0, np.inf)]
    rows += [(good, [np.inf, np.inf, np.inf], 0.0, np.inf), ([np.inf] * 3, [np.nan] * 3, 0.0, 1.0)]
    rows += [(good, [0, 0, 1], np.nan, np.inf), (good, [0, 0, 1], 0.0, np.nan), (good, [0, 0, 1], np.nan, np.nan)]
    origin, direction, t_min, t_max = zip(*rows, strict=True)
    return Rays(np.float32(origin), np.float32(direction), np.array(t_min), np.array(t_max))


@pytest.mark.parametrize("builder", BUILDERS)
@pytest.mark.parametrize("any_hit", [False, True])
def test_what_is_no_ray_hits_nothing_and_visits_the_root_at_most(builder, any_hit):
    triangles, rays = icosphere(3), no_rays()
    tree = BUILDERS[builder](triangles)
    hits, count, events = trace_recorded(tree, rays, any_hit=any_hit)
    assert (hits.prim == -1).all() and np.isinf(hits.t).all()
    assert (count == (1 if tree.kind == "bvh" else 0)).all() and not events.any()
    plain = trace(tree, rays, any_hit=any_hit)
    assert (plain.prim == -1).all()
    assert (trace_all(triangles, rays).prim == -1).all()
    for i in range(len(count)):
        given = rays.origin[i], rays.direction[i], float(rays.t_min[i]), float(rays.t_max[i])
        assert traverse(tree, *given, any_hit)[0] == -1
