"""The kd-tree builder: the same tree as a plain O(n^2) builder, invariants by exact clipping, inputs that could hang it."""

import itertools
import math
import os
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from rtrace.scenes.stand_ins import boxes, height_field, icosphere, soup
from rtrace.trees import kd_cells, kdtree
from rtrace.trees.clip import POLYGON, PartBounds, rank, split_bounds, value
from rtrace.trees.kdtree import build_kdtree, sah_cost
from rtrace.trees.tree import LEAF_AXIS, node_table


def float32(x):
    return float(np.float32(x))


def next_float32(x, up):
    return float(np.nextafter(np.float32(x), np.float32(np.inf if up else -np.inf)))


def outward(lo, hi):
    """The narrowest float32 interval around [lo, hi]."""
    down, up = float32(lo), float32(hi)
    return down if down <= lo else next_float32(down, up=False), up if up >= hi else next_float32(up, up=True)


# --- the slow builder ------------------------------------------------------------------------------------------------


def cut(polygon, axis, plane, above):
    """Sutherland-Hodgman against one plane. The arithmetic is rtrace.trees.clip's: from the lower end of an edge upwards."""
    kept = []
    for a, b in zip(polygon, polygon[1:] + polygon[:1], strict=True):
        if a[axis] >= plane if above else a[axis] <= plane:
            kept.append(a)
        if min(a[axis], b[axis]) < plane < max(a[axis], b[axis]):
            low, high = (a, b) if a[axis] < b[axis] else (b, a)
            t = (plane - low[axis]) / (high[axis] - low[axis])
            crossing = [p + (q - p) * t for p, q in zip(low, high, strict=True)]
            crossing[axis] = plane
            kept.append(crossing)
    return kept


def part(triangle, cell, bounds, axis, plane, above):
    """Bounds [(lo, hi)] * 3 of a reference's part on one side of a plane through its cell."""
    limits = list(bounds)
    limits[axis] = (max(plane, limits[axis][0]), limits[axis][1]) if above else (limits[axis][0], min(plane, limits[axis][1]))
    polygon = [list(map(float, corner)) for corner in triangle]
    for k, (lo, hi) in enumerate(cell):  # a plane that the whole triangle does not cross cuts nothing, whatever the rounding
        if max(corner[k] for corner in triangle) > hi:
            polygon = cut(polygon, k, hi, above=False)
        if min(corner[k] for corner in triangle) < lo:
            polygon = cut(polygon, k, lo, above=True)
    if not polygon:
        return limits
    side = cut(polygon, axis, plane, above)
    if not side:  # the nearest points
        pick = max if above else min
        side = [p for p in polygon if p[axis] == pick(q[axis] for q in polygon)]
    result = []
    for k, (lo, hi) in enumerate(limits):
        a, b = outward(min(p[k] for p in side), max(p[k] for p in side))
        a, b = max(a, lo), min(b, hi)
        result.append((a, b) if a <= b else (lo, hi))
    return result


def slow_kdtree(triangles, c_trav=1.5, c_isect=2.0, empty_bonus=1.0, max_level=511, max_refs=None, min_leaf=0, max_leaf=None):
    """The builder by its definition. Return (nodes as (axis, split or triangles, lower child), number of references)."""
    triangles = triangles.tolist()
    total = len(triangles)
    max_refs = 16 * total + 1000 if max_refs is None else max_refs
    nodes = [None]

    def split(node, refs, cell, level, ceiling):
        nonlocal total
        d = [hi - lo for lo, hi in cell]
        half_area = d[0] * d[1] + d[1] * d[2] + d[2] * d[0]
        best = None
        is_forced = max_leaf is not None and len(refs) > max_leaf
        least = math.inf if is_forced else half_area * len(refs)
        for axis in range(3) if level < max_level and half_area > 0 and len(refs) > min_leaf else ():
            lo, hi = cell[axis]
            cap, rim = d[(axis + 1) % 3] * d[(axis + 2) % 3], d[(axis + 1) % 3] + d[(axis + 2) % 3]
            spans = [bounds[axis] for _, bounds in refs]
            for x in sorted({x for span in spans for x in span}):
                flat = sum(a == b == x for a, b in spans)
                below, above = sum(a < x for a, b in spans), sum(b > x for a, b in spans)
                for n_below, n_above, planar_below in ((below + flat, above, True), (below, above + flat, False)):
                    # a plane in the cell's border only cuts off what lies in it
                    if (x == lo and not (planar_below and flat and lo < hi)) or (x == hi and (planar_below or not flat)):
                        continue
                    cost = c_trav / c_isect * (cap + (hi - lo) * rim)
                    cost += (cap + (x - lo) * rim) * n_below + (cap + (hi - x) * rim) * n_above
                    if n_below == 0 or n_above == 0:
                        cost *= empty_bonus
                    if cost < least:
                        least, best = cost, (axis, x, planar_below, n_below, n_above)
        if best is not None and is_forced and least >= half_area * len(refs):
            counts = sorted(best[3:])
            if counts[1] == len(refs) and counts[0] > 0:  # it parts nothing
                best = None
        if best is None or total - len(refs) + best[3] + best[4] > ceiling:
            nodes[node] = (LEAF_AXIS, [i for i, _ in refs], None)
            return
        axis, x, planar_below, n_below, n_above = best
        sides = [], []
        for i, bounds in refs:
            lo, hi = bounds[axis]
            if lo < x < hi:
                for above in (False, True):
                    sides[above].append((i, part(triangles[i], cell, bounds, axis, x, above)))
            else:
                sides[not planar_below if lo == hi == x else lo >= x].append((i, bounds))
        assert (len(sides[0]), len(sides[1])) == (n_below, n_above)
        total += n_below + n_above - len(refs)
        child = len(nodes)
        nodes[node] = (axis, x, child)
        nodes.extend([None, None])
        fair = total + int((ceiling - total) * (n_below / (n_below + n_above)))
        lower, upper = list(cell), list(cell)
        lower[axis], upper[axis] = (cell[axis][0], x), (x, cell[axis][1])
        split(child, sides[0], lower, level + 1, max(fair, min(ceiling, max_refs // 2)))
        split(child + 1, sides[1], upper, level + 1, ceiling)

    bounds = [[(min(p[k] for p in t), max(p[k] for p in t)) for k in range(3)] for t in triangles]
    root = [(min(b[k][0] for b in bounds), max(b[k][1] for b in bounds)) for k in range(3)]
    split(0, list(enumerate(bounds)), root, 0, max_refs)
    return nodes, total


def assert_same_tree(tree, slow):
    nodes, n_refs = slow
    assert (len(tree.nodes), len(tree.prims)) == (len(nodes), n_refs)
    for got, (axis, what, child) in zip(tree.nodes, nodes, strict=True):
        assert got["meta"] & 3 == axis
        if axis == LEAF_AXIS:
            first, count = int(got["first"]), int(got["meta"] >> 2)
            assert tree.prims[first : first + count].tolist() == what
        else:
            assert (got["split"], got["meta"] >> 2) == (what, child)


# --- what must hold for every tree -----------------------------------------------------------------------------------


def leaves_of(tree):
    """Check the structure on the way; return [(cell as a (2, 3) float64 array, triangles listed)], depth-first."""
    found, deepest, pair, first = [], 0, 1, 0
    todo = [(0, tree.bounds.astype(np.float64), 0)]
    while todo:
        i, cell, level = todo.pop()
        axis, count, split = tree.nodes[i]["meta"] & 3, int(tree.nodes[i]["meta"] >> 2), float(tree.nodes[i]["split"])
        deepest = max(deepest, level)
        if axis == LEAF_AXIS:
            assert tree.nodes[i]["first"] == first  # leaves fill prims in their own order
            listed = tree.prims[first : first + count]
            assert (np.diff(listed) > 0).all()
            first += count
            found.append((cell, listed))
            continue
        assert count == pair  # depth-first: a pair is numbered when its parent is split
        pair += 2
        lower, upper = cell.copy(), cell.copy()
        lower[1, axis] = upper[0, axis] = split
        assert cell[0, axis] <= split <= cell[1, axis]
        assert cell[0, axis] < cell[1, axis]
        todo += [(count + 1, upper, level + 1), (count, lower, level + 1)]
    assert (pair, first, deepest) == (len(tree.nodes), len(tree.prims), tree.max_level)
    assert node_table(tree)["level"].max() == tree.max_level
    return found


def clipped(triangle, lower, upper, number):
    """The triangle's part in a closed box, a list of points; ``number`` is Fraction (exact) or float."""
    polygon = [[number(float(x)) for x in corner] for corner in triangle]
    for k in range(3):
        polygon = cut(polygon, k, number(float(upper[k])), above=False)
        polygon = cut(polygon, k, number(float(lower[k])), above=True)
    return polygon


def check_listing(tree, number, ulps):
    """Every leaf lists the triangles that reach into it, and none that misses it by more than rounding.

    Tolerances are in float32 steps at the scene's largest coordinate: coarse for small coordinates, so scenes that are
    tested with it are near the origin.
    """
    corners = tree.triangles.astype(np.float64)
    lower, upper = corners.min(axis=1), corners.max(axis=1)
    step = ulps * float(np.spacing(np.abs(tree.bounds).max()))
    for cell, listed in leaves_of(tree):
        near = np.flatnonzero(((lower <= cell[1] + step) & (upper >= cell[0] - step)).all(axis=1))
        assert set(listed) <= set(near)
        inset = np.where(cell[0] < cell[1], step, 0.0)
        for i in near:
            if i in listed:
                assert clipped(corners[i], cell[0] - step, cell[1] + step, number), "a leaf lists a triangle that misses it"
            elif (cell[0] < cell[1]).all() and (cell[0] + inset <= cell[1] - inset).all():
                assert not clipped(corners[i], cell[0] + inset, cell[1] - inset, number), "a leaf lacks a triangle"


def check_covering(tree, seed=0):
    """Points of triangles (corners, points on edges and inside) lie in a leaf that lists their triangle, exactly."""
    leaves = leaves_of(tree)
    cells = np.array([cell for cell, _ in leaves])
    listed = [set(ids.tolist()) for _, ids in leaves]
    rng = np.random.default_rng(seed)
    slack = 1e-13 * np.abs(tree.bounds).max()
    for i, triangle in enumerate(tree.triangles.astype(np.float64)):
        weights = np.concatenate([np.eye(3), [[0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0, 0.5]], rng.dirichlet((1, 1, 1), 20)])
        for point in weights @ triangle:
            here = np.flatnonzero(((cells[:, 0] <= point + slack) & (point - slack <= cells[:, 1])).all(axis=1))
            assert any(i in listed[leaf] for leaf in here), f"no leaf has triangle {i} at {point}"


def plain_sah(tree, c_trav, c_isect):
    """The sum over the nodes, by recursion."""

    def half_area(cell):
        x, y, z = cell[1] - cell[0]
        return x * y + y * z + z * x

    def cost(i, cell):
        axis, count = tree.nodes[i]["meta"] & 3, int(tree.nodes[i]["meta"] >> 2)
        if axis == LEAF_AXIS:
            return c_isect * count * half_area(cell)
        lower, upper = cell.copy(), cell.copy()
        lower[1, axis] = upper[0, axis] = tree.nodes[i]["split"]
        return c_trav * half_area(cell) + cost(count, lower) + cost(count + 1, upper)

    cell = tree.bounds.astype(np.float64)
    return cost(0, cell) / half_area(cell)


# --- scenes ----------------------------------------------------------------------------------------------------------


def small_soup(n, seed):
    """Triangles a fifth of the cube's size, so that they are clipped but the tree still pays."""
    rng = np.random.default_rng(seed)
    return (rng.random((n, 1, 3)) + 0.2 * rng.random((n, 3, 3))).astype(np.float32)


def fan(n):
    """Slivers around one vertex."""
    angle = np.linspace(0, 2 * np.pi, n + 1)
    rim = np.stack([np.cos(angle), np.sin(angle), 0.1 * np.sin(5 * angle)], axis=1)
    return np.stack([np.zeros((n, 3)), rim[:-1], rim[1:]], axis=1).astype(np.float32)


def needles(n, seed=3):
    """Long thin triangles along the diagonal of the cube."""
    start = 0.05 * np.random.default_rng(seed).random((n, 3, 3))
    start[:, 1:] += 1
    start[:, 2] = start[:, 1] + 1e-4
    return start.astype(np.float32)


def walls(n, seed):
    """Each triangle lies in one of a few planes."""
    rng = np.random.default_rng(seed)
    triangles = small_soup(n, seed)
    triangles[np.arange(n), :, rng.integers(0, 3, n)] = rng.choice(np.float32([0.1, 0.3, 0.7]), (n, 1))
    return triangles


def scale(triangles, factor):
    return (triangles.astype(np.float64) * factor).astype(np.float32)


coordinates = st.one_of(st.integers(0, 4).map(float), st.floats(-4, 4, width=32), st.sampled_from([-0.0, 0.1, 1e-6]))
triangle_lists = st.lists(st.lists(coordinates, min_size=9, max_size=9), min_size=1, max_size=10)
grids = st.lists(st.lists(st.integers(0, 2).map(float), min_size=9, max_size=9), min_size=1, max_size=24)


def as_triangles(rows):
    return np.array(rows, np.float32).reshape(-1, 3, 3)


# --- tests -----------------------------------------------------------------------------------------------------------


@given(
    st.one_of(triangle_lists, grids).map(as_triangles),
    st.sampled_from([0.0, 0.5, 1.5, 20.0]),
    st.sampled_from([1.0, 2.0]),
    st.sampled_from([1.0, 0.8, 0.5]),
    st.sampled_from([0, 1, 5, 40]),
    st.integers(1, 6),
)
@settings(max_examples=400)
@example(as_triangles([[0] * 9] * 4 + [[0] * 7 + [2, 0], [0, 1, 0, 0, 1, 0, 0, 1, 1]]), 0.0, 1.0, 0.8, 5, 6)  # a tie
def test_the_tree_is_that_of_the_slow_builder(triangles, c_trav, c_isect, empty_bonus, max_level, refs_per_triangle):
    options = {
        "c_trav": c_trav,
        "c_isect": c_isect,
        "empty_bonus": empty_bonus,
        "max_level": max_level,
        "max_refs": refs_per_triangle * len(triangles),
    }
    tree = build_kdtree(triangles, **options)
    assert tree.params == {"builder": "sah", **options}
    assert_same_tree(tree, slow_kdtree(triangles, **options))


@pytest.mark.parametrize(
    "triangles",
    [
        small_soup(60, seed=5),
        small_soup(50, seed=6) * np.float32([1, 1, 0]),
        boxes(1),
        icosphere(1)[:60],
        fan(24),
        needles(40),
        walls(60, seed=4),
    ],
    ids=["soup", "in a plane", "boxes", "icosphere", "fan", "needles", "walls"],
)
@pytest.mark.parametrize(
    "options", [{}, {"c_trav": 0.1, "max_level": 30}, {"c_trav": 0.0, "empty_bonus": 0.8, "max_level": 12}]
)
def test_scenes_give_the_tree_of_the_slow_builder(triangles, options):
    assert_same_tree(build_kdtree(triangles, **options), slow_kdtree(triangles, **options))


@given(st.one_of(triangle_lists, grids).map(as_triangles))
@settings(max_examples=100)
@example(as_triangles([[0, 0, 0, 1, 0, 0, 0, 1, 0], [0, 0, 0, 0, 1, 0, 0, 0, 1], [0, 0, 1, 1, 0, 0, 0, 1, 0]] * 5))
def test_leaves_list_what_an_exact_clip_finds(triangles):
    tree = build_kdtree(triangles, c_trav=0.2, max_level=8)
    check_listing(tree, Fraction, ulps=2)
    check_covering(tree)


@pytest.mark.parametrize(
    "triangles",
    [icosphere(2), height_field(8), boxes(2), soup(150, 2), small_soup(200, 1), fan(60), needles(100), walls(100, 5)],
    ids=["icosphere", "height field", "boxes", "soup", "small soup", "fan", "needles", "walls"],
)
def test_scenes(triangles):
    tree = build_kdtree(triangles)
    check_listing(tree, float, ulps=2)
    check_covering(tree)
    np.testing.assert_array_equal(tree.bounds, [triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))])
    assert sah_cost(tree, 1.5, 2.0) == pytest.approx(plain_sah(tree, 1.5, 2.0), rel=1e-12)
    assert sah_cost(tree, 0.0, 1.0) == pytest.approx(plain_sah(tree, 0.0, 1.0), rel=1e-12)
    again = build_kdtree(triangles.copy())
    assert (tree.nodes.tobytes(), tree.prims.tobytes()) == (again.nodes.tobytes(), again.prims.tobytes())


def test_a_tree_pays():
    for triangles in (icosphere(3), height_field(20), boxes()):
        tree = build_kdtree(triangles)
        assert sah_cost(tree, 1.5, 2.0) < 0.3 * 2.0 * len(triangles)
        assert sah_cost(tree, 1.5, 2.0) < sah_cost(build_kdtree(triangles, max_level=5), 1.5, 2.0)


def test_arrays_that_grow_change_nothing(monkeypatch):
    triangles = small_soup(300, seed=8)
    tree = build_kdtree(triangles)
    grown = []

    def tight(*args):
        events, counts = first_events(*args)
        return np.ascontiguousarray(events[:, : counts.max()]), counts

    def grow(array):
        grown.append(array.dtype)
        return np.concatenate((array, np.empty_like(array[..., :7])), axis=-1)

    def scant(shape, dtype=float):
        if dtype in (np.uint32, np.int32) and shape in (16 * 300 + 64, 8 * 300 + 64):
            shape = 8
        return empty(shape, dtype)

    first_events, empty = kdtree.first_events, np.empty
    monkeypatch.setattr(kdtree, "first_events", tight)
    monkeypatch.setattr(kd_cells, "_grown", grow)
    monkeypatch.setattr(kdtree.np, "empty", scant)
    again = build_kdtree(triangles)
    assert set(grown) == {np.dtype(np.uint32), np.dtype(np.int32), np.dtype(np.int64)}
    assert (tree.nodes.tobytes(), tree.prims.tobytes()) == (again.nodes.tobytes(), again.prims.tobytes())


HARD = {
    "one": small_soup(1, 0),
    "20,000 copies": np.repeat(small_soup(1, 1), 20_000, axis=0),
    "20,000 copies in a plane": np.repeat(small_soup(1, 1) * np.float32([1, 0, 1]), 20_000, axis=0),
    "two heaps of copies": np.repeat(np.concatenate([small_soup(1, 1), small_soup(1, 1) + 9]), 5000, axis=0),
    "one point": np.ones((3000, 3, 3), np.float32),
    "points": np.repeat(small_soup(3000, 2)[:, :1], 3, axis=1),
    "on an axis": small_soup(500, 3) * np.float32([0, 1, 0]),
    "on a diagonal": np.repeat(small_soup(500, 3)[:, :, :1], 3, axis=2),
    "in a plane": small_soup(1000, 4) * np.float32([1, 1, 0]) + np.float32(0.1),
    "fan": fan(5000),
    "needles": needles(3000),
    "needles from one corner": needles(3000) * np.float32([1, 1, 1]) - np.float32(0.02) * (np.arange(3)[:, None] == 0),
    "soup": soup(2000, 1),
    "1e-30": scale(small_soup(500, 5), 1e-30),
    "1e30": scale(small_soup(500, 5), 1e30),
    "largest": scale(small_soup(500, 5) - np.float32(0.6), 5e38),
    "subnormal": scale(small_soup(500, 5), 1e-43),
    "every scale": np.concatenate([scale(small_soup(5, k + 38), 10.0**k) for k in range(-38, 38)]),
    "far away": small_soup(500, 6) + np.float32(1e6),
    "integers": np.random.default_rng(7).integers(0, 4, (1000, 3, 3)).astype(np.float32),
}  # fmt: skip


@pytest.mark.parametrize("name", HARD)
@pytest.mark.parametrize("options", [{}, {"c_trav": 0.0, "max_level": 60}, {"empty_bonus": 0.5, "max_level": 60}])
def test_hard_inputs_end_within_their_limits(name, options):
    triangles = HARD[name]
    tree = build_kdtree(triangles, **options)
    leaves = leaves_of(tree)
    assert len(tree.prims) <= 16 * len(triangles) + 1000
    assert tree.max_level <= options.get("max_level", 511)
    assert set(np.concatenate([listed for _, listed in leaves])) == set(range(len(triangles)))
    assert len(leaves) < 60 * len(tree.prims) + 2


def test_copies_are_left_in_one_leaf_but_heaps_of_them_are_parted():
    assert len(build_kdtree(HARD["20,000 copies"]).nodes) == 1
    sizes = sorted(len(listed) for _, listed in leaves_of(build_kdtree(HARD["two heaps of copies"])))
    assert sizes[-2:] == [5000, 5000]
    assert sum(sizes) == 10_000


def test_the_limit_on_references_is_shared_by_both_sides():
    triangles = fan(3000)
    for max_refs in (3000, 3001, 20_000):
        tree = build_kdtree(triangles, max_refs=max_refs)
        assert len(tree.prims) <= max_refs
    biggest = max(len(listed) for _, listed in leaves_of(tree))
    assert len(tree.prims) > 15_000
    assert biggest < 1000
    small = build_kdtree(small_soup(300, seed=8))
    roomy = build_kdtree(small_soup(300, seed=8), max_refs=2**31 - 1)
    assert small.prims.tobytes() == roomy.prims.tobytes()  # below half the limit nothing is shared out


@pytest.mark.parametrize("exponent", [-100, -40, 60, 100])
def test_a_power_of_two_scales_the_tree(exponent):
    triangles = np.round(small_soup(200, seed=9) * 1024) / np.float32(1024)
    plain = build_kdtree(triangles)
    scaled = build_kdtree(np.ldexp(triangles, exponent))
    assert plain.nodes["meta"].tobytes() == scaled.nodes["meta"].tobytes()
    assert plain.prims.tobytes() == scaled.prims.tobytes()
    inner = plain.nodes["meta"] & 3 != LEAF_AXIS
    np.testing.assert_array_equal(np.ldexp(plain.nodes["split"][inner], exponent), scaled.nodes["split"][inner])
    assert sah_cost(plain, 1.5, 2.0) == sah_cost(scaled, 1.5, 2.0)


def test_both_zeros_are_one_position():
    triangles = as_triangles([[x, y, z] * 3 for x, y, z in itertools.product((0, 1, -1), repeat=3)]) + np.float32(0)
    triangles = np.concatenate([triangles, as_triangles([[0, 0, 0, 1, 0, 0, 0, 0, -1], [0, 0, 0, 0, -1, 0, 0, 0, 1]] * 4)])
    signed = np.where((triangles == 0) & (np.arange(9).reshape(3, 3) % 2 == 0), np.float32(-0.0), triangles)
    assert np.signbit(signed[signed == 0]).any()
    assert not np.signbit(triangles[triangles == 0]).any()
    plain, other = build_kdtree(triangles), build_kdtree(signed)
    assert len(plain.nodes) > 1
    assert (plain.nodes.tobytes(), plain.prims.tobytes()) == (other.nodes.tobytes(), other.prims.tobytes())


def test_a_wall_is_cut_off_into_a_flat_cell():
    """Triangles in the border of the box leave a full cell; one on each side of the split plane sees them."""
    wall = height_field(6) * np.float32([1, 1, 0])
    far = small_soup(3, seed=1) + np.float32([0, 0, 5])
    tree = build_kdtree(np.concatenate([wall, far]))
    flat = [(cell, listed) for cell, listed in leaves_of(tree) if cell[0, 2] == cell[1, 2] == 0.0]
    assert set(np.concatenate([listed for _, listed in flat])) == set(range(len(wall)))
    assert all(len(listed) < len(wall) for _, listed in flat)  # and the flat cell is split further


@given(
    st.lists(st.floats(-10, 10, width=32), min_size=9, max_size=9),
    st.lists(st.floats(-10, 10, width=32), min_size=7, max_size=7),
    st.integers(0, 2),
)
@settings(max_examples=200)
def test_split_bounds_are_the_exact_ones_rounded_outward(corners, planes, axis):
    """To the last float32 where the part is exact; never inside the part by more than float64's error."""
    triangle = as_triangles([corners])[0]
    cell = np.sort(np.array(planes[:6], np.float64).reshape(2, 3), axis=0)
    box = clipped(triangle, cell[0], cell[1], Fraction)
    if not box:
        return
    bounds = [outward(min(p[k] for p in box), max(p[k] for p in box)) for k in range(3)]
    lo, hi = bounds[axis]
    split = float32(lo + (hi - lo) * abs(planes[6]) / 10)
    if not lo < split < hi:
        return
    flat = [x for k in range(3) for x in [bounds[k][0]]] + [bounds[k][1] for k in range(3)]
    ranks = np.array([rank(np.float32(x)) for x in flat], np.int32)
    below, above = np.zeros(6, np.int32), np.zeros(6, np.int32)
    plane = axis, rank(np.float32(split))
    parts = PartBounds(ranks, below, above)
    split_bounds(triangle.reshape(9), 0, (cell.reshape(6), 0), plane, parts, 0, np.empty(3 * POLYGON))
    for got, is_above in ((below, False), (above, True)):
        side = cut(box, axis, Fraction(split), is_above)
        values = [value(int(place)) for place in got]
        for k in range(3):
            lo, hi = (split, bounds[k][1]) if is_above else (bounds[k][0], split)
            lo, hi = (lo, hi) if k == axis else bounds[k]
            assert lo <= values[k] <= values[3 + k] <= hi
            if side:
                exact = min(p[k] for p in side), max(p[k] for p in side)
                assert values[k] <= exact[0] + 1e-13
                assert values[3 + k] >= exact[1] - 1e-13
                assert values[k] >= next_float32(outward(*exact)[0], up=False) - 1e-13
                assert values[3 + k] <= next_float32(outward(*exact)[1], up=True) + 1e-13


def test_a_part_that_rounding_left_empty_stays_near_its_triangle():
    triangle = np.float32([[0, 0, 0], [1, 0.25, 0.5], [0, 5, 5]])
    one = rank(np.float32(1))
    bounds = np.array([0, 0, 0, one + 2, rank(np.float32(5)), rank(np.float32(5))], np.int32)
    below, above = np.zeros(6, np.int32), np.zeros(6, np.int32)
    cell = np.array([-9, -9, -9, 9, 9, 9], np.float64)
    split_bounds(triangle.reshape(9), 0, (cell, 0), (0, one + 1), PartBounds(bounds, below, above), 0, np.empty(3 * POLYGON))
    assert [value(int(place)) for place in below] == [0, 0, 0, 1, 5, 5]
    assert above.tolist() == [one + 1, rank(np.float32(0.25)), rank(np.float32(0.5)), one + 2, *above[1:3]]


@given(st.floats(width=32, allow_nan=False, allow_infinity=False), st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_ranks_are_in_the_order_of_the_numbers(x, y):
    assert (rank(np.float32(x)) < rank(np.float32(y))) == (x < y)
    assert value(rank(np.float32(x))) == x
    if abs(x) < np.finfo(np.float32).max:
        assert value(rank(np.float32(x)) + 1) == next_float32(x, up=True)


def test_the_cost_of_one_leaf_is_all_its_triangles():
    assert sah_cost(build_kdtree(small_soup(5, 0), max_level=0), 1.5, 2.0) == 10.0
    assert sah_cost(build_kdtree(HARD["one point"]), 1.5, 2.0) == 6000.0
    with pytest.raises(ValueError, match="got a bvh"):
        sah_cost(build_kdtree(small_soup(5, 0))._replace(kind="bvh"), 1.5, 2.0)


@pytest.mark.parametrize(
    ("triangles", "message"),
    [
        ([[[0, 0, 0]] * 3], r"got list; use vertices.astype\(np.float32\)\[faces\]"),
        (np.zeros((2, 3, 3)), r"got float64 \(2, 3, 3\)"),
        (np.zeros((2, 9), np.float32), r"got float32 \(2, 9\)"),
        (np.zeros((0, 3, 3), np.float32), "number of triangles must be 1 to .* got 0"),
        (np.full((2, 3, 3), np.inf, np.float32), "must be finite"),
        (np.full((2, 3, 3), np.nan, np.float32), "must be finite"),
    ],
)
def test_bad_triangles_are_refused(triangles, message):
    with pytest.raises(ValueError, match=message):
        build_kdtree(triangles)


@pytest.mark.parametrize(
    ("option", "bad"),
    [("c_trav", -1), ("c_trav", math.inf), ("c_isect", 0), ("c_isect", math.nan), ("empty_bonus", 0), ("empty_bonus", 1.1),
     ("max_level", -1), ("max_level", 65536), ("max_refs", 4), ("max_refs", 2**31)],
)  # fmt: skip
def test_bad_options_are_refused(option, bad):
    with pytest.raises(ValueError, match=f"{option} must be .*; got {bad}"):
        build_kdtree(small_soup(5, 0), **{option: bad})


def test_triangles_are_taken_as_they_are():
    triangles = small_soup(40, 2)
    tree = build_kdtree(np.asfortranarray(triangles))
    assert tree.kind == "kdtree"
    assert tree.triangles.flags.c_contiguous
    assert tree.params == {
        "builder": "sah",
        "c_trav": 1.5,
        "c_isect": 2.0,
        "empty_bonus": 1.0,
        "max_level": 511,
        "max_refs": 1640,
    }
    np.testing.assert_array_equal(tree.triangles, triangles)
    assert build_kdtree(triangles).nodes.tobytes() == tree.nodes.tobytes()


@pytest.mark.skipif("NPTRACE_SCENES" not in os.environ, reason="needs the benchmark scenes in $NPTRACE_SCENES")
@pytest.mark.parametrize(
    ("name", "cost", "nodes"), [("bunny", 99.5, 597_731), ("sponza", 116.1, 464_961), ("sibenik", 103.6, 428_309)]
)
def test_benchmark_scenes_are_as_good_as_manta_builds_them(name, cost, nodes):
    """Against a clone of Manta's builder. It stops at an absolute area of 1e-8, so it has fewer nodes at the same cost."""
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.load(Path(os.environ["NPTRACE_SCENES"]) / f"{name}.ply", process=False)
    tree = build_kdtree(np.ascontiguousarray(mesh.vertices.astype(np.float32)[mesh.faces]))
    assert sah_cost(tree, 1.5, 2.0) == pytest.approx(cost, rel=0.012)
    assert nodes < len(tree.nodes) < 1.25 * nodes
