"""One triangle far from a scene: no hit is lost near it or far from it, and rays near the scene visit few more nodes."""

import numpy as np
import pytest

from rtrace.rays import make_rays
from rtrace.scenes.shapes import icosphere
from rtrace.traverse import trace, trace_all, trace_recorded
from rtrace.trees.bvh import build_bvh
from rtrace.trees.clip import POLYGON, PartBounds, rank, split_bounds, value
from rtrace.trees.kdtree import build_kdtree
from rtrace.trees.strays import FAR, SLACK, find_limit, make_room, margin_note
from rtrace.trees.tree import triangle_boxes

BUILDERS = {
    "kdtree": build_kdtree,
    "kdtree level 5": lambda triangles: build_kdtree(triangles, max_level=5),
    "bvh sweep": build_bvh,
    "bvh binned": lambda triangles: build_bvh(triangles, builder="binned"),
}


def with_stray(triangles, size):
    far = np.float32([[[1, 0, 0], [1, 1, 0], [1, 0, 1]]]) * np.float32(size)
    return np.concatenate([triangles, far])


def rays_at(triangles, n, seed):
    rng = np.random.default_rng(seed)
    targets = rng.normal(size=(n, 3)) * 0.7
    return make_rays([2.5, 1.5, 1.5], targets - np.array([2.5, 1.5, 1.5]))


@pytest.mark.parametrize("size", [1e9, 1e12, 1e13, 1e14, 1e20, 1e30, 1e38])
@pytest.mark.parametrize("builder", BUILDERS)
def test_a_stray_costs_a_few_nodes_a_ray(builder, size):
    """At 1e14, with the margin of the whole scene, every ray had visited every node."""
    ball = icosphere(3)
    rays = rays_at(ball, 300, seed=1)
    _, alone, _ = trace_recorded(BUILDERS[builder](ball), rays)
    hits, count, _ = trace_recorded(BUILDERS[builder](with_stray(ball, size)), rays)
    truth = trace_all(with_stray(ball, size), rays)
    np.testing.assert_array_equal(hits.prim, truth.prim)
    np.testing.assert_array_equal(hits.t, truth.t)
    assert count.mean() < alone.mean() + 12  # measured: 2 for a BVH, 5 to 8 for a kd-tree


def scene_with_strays(rng):
    """A small scene, and triangles of which none, one, two or three corners are far, or whose plane cuts the scene."""
    near = rng.uniform(-1, 1, (24, 1, 3)) + rng.uniform(-0.3, 0.3, (24, 3, 3))
    far = rng.uniform(-1, 1, (5, 3, 3)) * 10.0 ** rng.uniform(6, 37.5, (5, 1, 1))
    far[1, 0], far[2, :2] = near[3, 0], near[4, :2]
    far[3, :, rng.integers(3)] = rng.uniform(-1, 1)
    triangles = np.concatenate([near, far]).astype(np.float32)
    return triangles[rng.permutation(len(triangles))]


@pytest.mark.parametrize("seed", range(40))
def test_hits_equal_brute_force_near_strays_and_on_them(seed):
    rng = np.random.default_rng([seed, 8])
    triangles = scene_with_strays(rng)
    weights = rng.dirichlet([1, 1, 1], 800)
    weights[:250] = [1, 0, 0]  # corners
    weights[250:400, 0] = 0.0  # edges
    weights /= weights.sum(axis=1, keepdims=True)
    targets = (triangles[rng.integers(len(triangles), size=800)].astype(float) * weights[..., None]).sum(axis=1)
    origin = rng.uniform(-3, 3, (800, 3)).astype(np.float32)
    origin[::5] = triangles[rng.integers(len(triangles), size=160), 0] * np.float32(0.7)
    direction = np.clip(targets - origin.astype(float), -3e38, 3e38)
    direction = (direction / np.abs(direction).max(axis=1, keepdims=True)).astype(np.float32)
    rays = make_rays(origin, direction)
    truth = trace_all(triangles, rays)
    assert (truth.prim >= 0).sum() > 300
    for build in BUILDERS.values():
        tree = build(triangles)
        assert not np.array_equal(tree.core, tree.bounds)
        hits, any_ = trace(tree, rays), trace(tree, rays, any_hit=True)
        np.testing.assert_array_equal(hits.prim, truth.prim)
        np.testing.assert_array_equal(hits.t, truth.t)
        np.testing.assert_array_equal(any_.prim >= 0, truth.prim >= 0)


def test_usual_scenes_have_no_strays_and_tight_boxes():
    for triangles in (icosphere(2), with_stray(icosphere(2), 40000.0), icosphere(0) * np.float32(1e38), icosphere(0)[:1] * 0):
        lower, upper = triangle_boxes(triangles)
        before = lower.copy(), upper.copy()
        extent = make_room(triangles, lower, upper)
        assert extent.limit == np.inf and not len(extent.strays)
        np.testing.assert_array_equal((lower, upper), before)
        np.testing.assert_array_equal(extent.core, extent.bounds)


def test_the_room_around_a_stray():
    triangles = with_stray(icosphere(1), 1e13)
    lower, upper = triangle_boxes(triangles)
    near = lower[:-1].copy(), upper[:-1].copy()
    extent = make_room(triangles, lower, upper)
    assert extent.strays.tolist() == [80] and FAR / 2 < extent.limit < FAR
    np.testing.assert_array_equal((lower[:-1], upper[:-1]), near)
    np.testing.assert_array_equal(extent.core, [near[0].min(axis=0), near[1].max(axis=0)])
    far, slack = np.float32(1e13), SLACK * float(np.float32(1e13))
    ulp = 1.0 + 2.0**-22
    assert (
        lower[-1, 0] < far < upper[-1, 0] and slack <= -lower[-1, 1] <= slack * ulp and slack <= -lower[-1, 2] <= slack * ulp
    )
    np.testing.assert_array_equal(extent.bounds, [lower.min(axis=0), upper.max(axis=0)])


def test_no_room_beyond_float32():
    """A box cannot be larger than float32's largest number: then all rays have the margin of the whole scene."""
    triangles = with_stray(icosphere(1), np.finfo(np.float32).max)
    assert find_limit(triangles, np.stack([triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))])) == np.inf
    rays = rays_at(triangles, 100, seed=2)
    truth = trace_all(triangles, rays)
    for build in BUILDERS.values():
        tree = build(triangles)
        assert np.isfinite(tree.bounds).all()
        np.testing.assert_array_equal(trace(tree, rays).prim, truth.prim)


def test_parts_of_a_stray_reach_as_far_around_it():
    """A triangle nearly in the plane x = 0, cut there: with slack, either part holds what lies within it of the plane."""
    triangle = np.float32([[-1, 0, 0], [1, 8, 0], [1, 8, 4]])
    ranks = np.array([rank(np.float32(x)) for x in (-4, -4, -4, 4, 12, 8)], np.int32)
    cell = np.array([-4, -4, -4, 4, 12, 8], np.float64)
    below, above = np.zeros(6, np.int32), np.zeros(6, np.int32)
    for slack, ys in ((0.0, ((0, 4), (4, 8))), (0.5, ((-0.5, 6.5), (1.5, 8.5)))):
        plane, parts = (0, rank(np.float32(0))), PartBounds(ranks, below, above)
        split_bounds(triangle.reshape(9), 0, (cell, 0), plane, parts, 0, np.empty(3 * POLYGON), slack)
        assert ((value(below[1]), value(below[4])), (value(above[1]), value(above[4]))) == ys


def note_of(triangles, eye):
    return margin_note(triangles, np.stack([triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))]), eye)


def test_a_margin_that_is_not_small_is_reported():
    ball = icosphere(3)
    assert note_of(ball, (2, 1, 1)) is None
    assert note_of(with_stray(ball, 1e14), (2, 1, 1)) is None  # it has its own room
    far = note_of(ball, (1e12, 1, 1))
    assert far is not None and "margin of up to 0.114" in far
    # As many triangles near as far: the core is that of the far ones, unless a sixteenth is near.
    few = np.concatenate([ball[:50], np.tile(with_stray(ball, 1e14)[-1:], (1000, 1, 1)) * np.float32(1.5)])
    many = np.concatenate([ball[:100], few[50:]])
    few[50:, 1:] = few[50:, :1] + np.float32(1e-3)
    assert note_of(few, (2, 1, 1)) is not None and note_of(many, (2, 1, 1)) is None
