"""The BVH builders: invariants, an O(n^2) reference, and inputs on which a builder can hang or break."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtrace.scenes.shapes import boxes, height_field, icosphere, soup
from rtrace.trees.bvh import build_bvh
from rtrace.trees.strays import make_room
from rtrace.trees.tree import LEAF_AXIS, node_table, triangle_boxes

coordinate = st.integers(-8, 8).map(float)
triangle_lists = st.lists(st.lists(coordinate, min_size=9, max_size=9), min_size=1, max_size=40)


def half_area(lower, upper):
    d = np.maximum(upper.astype(np.float64) - lower, 0.0)
    return d[..., 0] * d[..., 1] + d[..., 1] * d[..., 2] + d[..., 2] * d[..., 0]


def sah_cost(tree):
    """Cost of the tree in triangle tests per ray that meets the root: 1 a node visited, 1 a triangle tested."""
    is_leaf = (tree.nodes["meta"] & 3) == LEAF_AXIS
    work = np.where(is_leaf, tree.nodes["meta"] >> 2, 1)
    area = half_area(tree.nodes["lower"], tree.nodes["upper"])
    return float((area * work).sum() / area[0])


def check_invariants(tree):
    nodes, n = tree.nodes, len(tree.nodes)
    is_leaf = (nodes["meta"] & 3) == LEAF_AXIS
    lower, upper = triangle_boxes(tree.triangles)
    make_room(tree.triangles, lower, upper)
    seen, expected_pair, todo = np.zeros(len(tree.triangles), int), 1, [0]
    while todo:  # depth-first: a pair is numbered when its parent is split
        i = todo.pop()
        if is_leaf[i]:
            first, count = int(nodes["child"][i]), int(nodes["meta"][i] >> 2)
            ids = tree.prims[first : first + count]
            assert count > 0 and (np.diff(ids) > 0).all()
            seen[ids] += 1
            corners = np.concatenate([lower[ids], upper[ids]])
        else:
            child = int(nodes["child"][i])
            assert child == expected_pair
            expected_pair += 2
            todo += [child + 1, child]
            corners = np.concatenate([nodes["lower"][child : child + 2], nodes["upper"][child : child + 2]])
        np.testing.assert_array_equal(nodes["lower"][i], corners.min(axis=0))
        np.testing.assert_array_equal(nodes["upper"][i], corners.max(axis=0))
    assert (seen == 1).all() and expected_pair == n
    assert node_table(tree)["level"].max() == tree.max_level
    np.testing.assert_array_equal(tree.bounds, [nodes["lower"][0], nodes["upper"][0]])


def reference_tree(triangles, cheapest, trav=1.0, min_leaf=0, max_leaf=None):
    """Return nodes as (n triangles, axis or None, triangles) in depth-first pair order.

    ``cheapest`` is a function of (ids, lower, upper, centre) -> the best (cost, axis, left, right), or None.
    """
    lower, upper = triangles.min(axis=1), triangles.max(axis=1)
    centre = lower.astype(np.float64) + upper
    nodes = [None]

    def split(slot, ids):
        n = len(ids)
        low, high = lower[ids].min(axis=0), upper[ids].max(axis=0)
        area = half_area(low, high)
        best = cheapest(ids, lower, upper, centre) if n > min_leaf else None
        pays = best is not None and trav * area + best[0] < area * n
        if not pays and (max_leaf is None or n <= max_leaf):
            nodes[slot] = (n, None, sorted(ids))
            return
        if best is None or not best[0] < area * n:  # no cut makes the children smaller: halves, by number
            best = None, int(np.argmax(high - low)), sorted(ids)[: n // 2], sorted(ids)[n // 2 :]
        nodes[slot] = (n, best[1], sorted(ids))
        at = len(nodes)
        nodes.extend([None, None])
        split(at, best[2])
        split(at + 1, best[3])

    split(0, list(range(len(triangles))))
    return nodes


def cost_of(parts, lower, upper):
    return sum(half_area(lower[ids].min(axis=0), upper[ids].max(axis=0)) * len(ids) for ids in parts)


def cheapest_cut(ids, lower, upper, centre):
    """Every cut of the three orders of centroids, a pair's along its longest axis only."""
    n, best = len(ids), None
    axes = range(3)
    if n == 2:
        axes = [int(np.argmax(upper[ids].max(axis=0) - lower[ids].min(axis=0)))]
    for axis in axes:
        order = sorted(ids, key=lambda i, axis=axis: (centre[i, axis], i))
        for k in range(1, n):
            cost = cost_of((order[:k], order[k:]), lower, upper)
            if best is None or cost < best[0]:
                best = cost, axis, order[:k], order[k:]
    return best


def cheapest_bins(ids, lower, upper, centre):
    """Every plane between bins: 4 + n / 20 per axis, at most 16."""
    n_bins, best = min(4 + len(ids) // 20, 16), None
    for axis in range(3):
        low = centre[ids, axis].min()
        with np.errstate(divide="ignore"):
            scale = n_bins / (centre[ids, axis].max() - low)
        if scale == np.inf:
            continue
        bins = np.minimum(((centre[ids, axis] - low) * scale).astype(int), n_bins - 1)
        for cut in range(1, n_bins):
            left = [i for i, b in zip(ids, bins, strict=True) if b < cut]
            right = [i for i, b in zip(ids, bins, strict=True) if b >= cut]
            if not left or not right:
                continue
            cost = cost_of((left, right), lower, upper)
            if best is None or cost < best[0]:
                best = cost, axis, left, right
    return best


def reference_sweep(triangles, **rules):
    return reference_tree(triangles, cheapest_cut, **rules)


def reference_binned(triangles, **rules):
    return reference_tree(triangles, cheapest_bins, **rules)


@given(triangle_lists)
@settings(max_examples=150)
def test_sweep_equals_brute_force(corners):
    triangles = np.array(corners, np.float32).reshape(-1, 3, 3)
    tree = build_bvh(triangles)
    assert_is_reference(tree, reference_sweep(triangles))


def assert_is_reference(tree, want):
    assert len(tree.nodes) == len(want)
    for node, (n, axis, ids) in zip(tree.nodes, want, strict=True):
        assert (node["meta"] & 3) == (LEAF_AXIS if axis is None else axis)
        if axis is None:
            assert tree.prims[node["child"] : node["child"] + n].tolist() == ids


@given(triangle_lists)
@settings(max_examples=150)
def test_binned_equals_brute_force(corners):
    triangles = np.array(corners, np.float32).reshape(-1, 3, 3)
    assert_is_reference(build_bvh(triangles, builder="binned"), reference_binned(triangles))


@pytest.mark.parametrize("triangles", [icosphere(2), height_field(12), boxes(), soup(600, seed=9)])
def test_binned_equals_brute_force_with_many_bins(triangles):
    assert_is_reference(build_bvh(triangles, builder="binned"), reference_binned(triangles))


@pytest.mark.parametrize("builder", ["sweep", "binned"])
def test_a_large_leaf_is_in_ascending_order(builder):
    tree = build_bvh(np.repeat(soup(1, seed=0), 80_000, axis=0), builder=builder)
    assert len(tree.nodes) == 1 and tree.prims.tolist() == list(range(80_000))


def test_zeros_have_no_sign():
    """Which of 0 and -0 is the lesser is left to the processor; a tree must not be."""
    triangles = np.where(soup(300, seed=3) < 0.5, np.float32(-0.0), np.float32(1.0))
    nodes = build_bvh(triangles, builder="binned").nodes
    for corner in ("lower", "upper"):
        assert not np.signbit(nodes[corner]).any()


@given(triangle_lists, st.sampled_from(["sweep", "binned"]))
@settings(max_examples=100)
def test_invariants_hold(corners, builder):
    check_invariants(build_bvh(np.array(corners, np.float32).reshape(-1, 3, 3), builder=builder))


@pytest.mark.parametrize("builder", ["sweep", "binned"])
@pytest.mark.parametrize("triangles", [icosphere(3), height_field(30), boxes(), soup(3000, seed=2)])
def test_scenes(triangles, builder):
    tree = build_bvh(triangles, builder=builder)
    check_invariants(tree)
    again = build_bvh(triangles, builder=builder)
    assert tree.nodes.tobytes() == again.nodes.tobytes() and tree.prims.tobytes() == again.prims.tobytes()


def test_binned_is_close_to_the_sweep():
    for triangles in (icosphere(4), soup(3000, seed=2)):
        assert sah_cost(build_bvh(triangles, builder="binned")) < 1.1 * sah_cost(build_bvh(triangles))


@pytest.mark.parametrize("builder", ["sweep", "binned"])
def test_hard_inputs_end(builder):
    one = soup(1, seed=0)
    fan = np.zeros((2000, 3, 3), np.float32)
    angle = np.linspace(0, 6, 2001)
    fan[:, 1, :2] = np.stack([np.cos(angle[:-1]), np.sin(angle[:-1])], axis=1)
    fan[:, 2, :2] = np.stack([np.cos(angle[1:]), np.sin(angle[1:])], axis=1)
    powers = np.float32(2.0) ** np.arange(-120, 120, 2, dtype=np.float32)
    inputs = {
        "one triangle": one,
        "a thousand copies": np.repeat(one, 1000, axis=0),
        "points": np.zeros((1000, 3, 3), np.float32),
        "on a line": soup(500, seed=1) * np.float32([1, 0, 0]),
        "in a plane": soup(500, seed=1) * np.float32([1, 0, 1]),
        "a fan": fan,
        "every scale": one * powers[:, None, None],
        "tiny": soup(200, seed=4) * np.float32(1e-38),
        "huge": soup(200, seed=4) * np.float32(1e37),
        "needles": np.float32([[[0, 0, i], [100, 100, i], [100, 100.01, i]] for i in range(500)]),
    }
    for name, triangles in inputs.items():
        tree = build_bvh(np.ascontiguousarray(triangles, np.float32), builder=builder)
        check_invariants(tree)
        assert tree.max_level < 200, name


@pytest.mark.parametrize(
    "triangles, builder, words",
    [
        (np.zeros((0, 3, 3), np.float32), "sweep", "non-empty"),
        (np.zeros((4, 3, 3)), "sweep", "float32"),
        (np.zeros((4, 9), np.float32), "sweep", r"\(n, 3, 3\)"),
        (np.zeros((4, 3, 3), np.float32), "median", "'sweep' or 'binned'"),
        (np.full((4, 3, 3), np.nan, np.float32), "sweep", "must be finite"),
        (np.full((4, 3, 3), np.inf, np.float32), "binned", "must be finite"),
    ],
)
def test_bad_arguments_are_named(triangles, builder, words):
    with pytest.raises(ValueError, match=words):
        build_bvh(triangles, builder=builder)
