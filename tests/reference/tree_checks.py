"""Properties of every tree, whatever its triangles: its structure, what its leaves list (by exact clipping) and its hits.

Also scenes on which builders break: random bits, few integers, slivers as wide as float64's cos(pi/2).
"""

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from rtrace.rays import Rays, make_rays
from rtrace.scenes.shapes import rectangle
from rtrace.traverse import trace, trace_all
from rtrace.trees.bvh import build_bvh
from rtrace.trees.kdtree import build_kdtree
from rtrace.trees.strays import SLACK, make_room
from rtrace.trees.tree import LEAF_AXIS, Tree, triangle_boxes
from rtrace.trees.tree_cache import build_tree

Builder = Callable[[np.ndarray], Tree]

BUILDERS: dict[str, Builder] = {
    "kd-tree": build_kdtree,
    "kd-tree, cheap nodes": partial(build_kdtree, c_trav=0.1, max_level=24),
    "kd-tree, free nodes, bonus": partial(build_kdtree, c_trav=0.0, empty_bonus=0.8, max_level=12),
    "kd-tree, 3 levels": partial(build_kdtree, max_level=3),
    "kd-tree, few references": lambda triangles: build_kdtree(triangles, c_trav=0.2, max_refs=2 * len(triangles)),
    "BVH": build_bvh,
    "BVH, binned": partial(build_bvh, builder="binned"),
    "BVH, 64-byte nodes": partial(build_tree, kind="bvh64"),
}

# --- scenes ----------------------------------------------------------------------------------------------------------


def any_bits(rng: np.random.Generator) -> np.ndarray:
    """Return triangles of any bit patterns; of 20 scenes one keeps what is no number."""
    bits = rng.integers(0, 2**32, (rng.integers(1, 16), 3, 3), dtype=np.uint32)
    if rng.random() < 0.95:
        bits &= np.where(bits >> 23 & 255 == 255, np.uint32(0xFF7FFFFF), np.uint32(0xFFFFFFFF))
    return bits.view(np.float32)


def few_numbers(rng: np.random.Generator) -> np.ndarray:
    """Return triangles, at times none, of small whole numbers, zeros of both signs and copies among them."""
    size = int(rng.integers(0, 4))
    triangles = rng.integers(-size, size, (rng.integers(0, 25), 3, 3), endpoint=True) * rng.choice([1.0, -1.0], (1, 3, 3))
    return np.repeat(triangles, rng.integers(1, 4), axis=0).astype(np.float32)


#: Cosines and sines of eighths of a turn, twice around: 0 and 1 among them, and what should be 0.
_TURNS = np.arange(16) * np.pi / 4
_POOL = np.unique(np.concatenate([np.cos(_TURNS), np.sin(_TURNS), [0.0, -1.0, 1.0, 0.5]]).astype(np.float32))


def slivers(rng: np.random.Generator) -> np.ndarray:
    """Return triangles, at times none, with corners 1e-17 apart; mostly beside a floor of strips that end where they begin."""
    pool = rng.choice(_POOL, rng.integers(2, len(_POOL)))
    triangles = rng.choice(pool, (rng.integers(0, 12), 3, 3))
    if len(triangles) and rng.random() < 0.8:
        if rng.random() < 0.7:
            triangles[..., 0] = rng.choice(_POOL[np.abs(_POOL) < 1e-15], triangles.shape[:2]).clip(0.0)
        floor = rectangle((-1, 0, 0), (1, 0, 0), (0, 0, 1), 1, int(rng.integers(1, 30)))
        triangles = np.roll(np.concatenate([floor, triangles]), rng.integers(3), axis=2)
    return triangles.astype(np.float32)


SCENES = {"any bits": any_bits, "few numbers": few_numbers, "slivers": slivers}


def rays_at(triangles: np.ndarray, n: int, rng: np.random.Generator) -> Rays:
    """Return up to n rays towards points of triangles: from anywhere, from vertices, along axes, and some that miss."""
    corners = triangles.reshape(-1, 3)
    pick = triangles[rng.integers(0, len(triangles), n)].astype(np.float64)
    weights = rng.choice([0.0, 1.0, 2.0, 3.0], (n, 3))
    weights[~weights.any(axis=1)] = 1.0
    target = (pick * weights[..., None]).sum(axis=1) / weights.sum(axis=1)[:, None]
    scale = np.abs(corners.max(axis=0).astype(np.float64) - corners.min(axis=0)) + np.abs(corners).max() * 2.0**-10
    origin = corners[rng.integers(0, len(corners), n)] + scale * rng.choice([0.0, 0.0, 1.0, -1.0, 0.3], (n, 3))
    origin = origin.clip(-3e38, 3e38).astype(np.float32)
    with np.errstate(over="ignore"):
        direction = (target - origin).astype(np.float32)
    direction[::4, rng.integers(3)] = rng.choice([0.0, -0.0])
    good = np.isfinite(direction).all(axis=1) & direction.any(axis=1)
    return make_rays(origin[good], direction[good])


# --- structure -------------------------------------------------------------------------------------------------------

Cell = tuple[list[float], list[float]]


def leaves(tree: Tree) -> Iterator[tuple[Cell, list[int]]]:
    """Check a kd-tree's structure; yield (cell, triangles listed) of every leaf, depth-first."""
    splits, firsts, metas = (tree.nodes[name].tolist() for name in ("split", "first", "meta"))
    prims, first, pair, deepest = tree.prims.tolist(), 0, 1, 0
    todo = [(0, (tree.bounds[0].tolist(), tree.bounds[1].tolist()), 0)]
    while todo:
        node, (lower, upper), level = todo.pop()
        axis, count, split = metas[node] & 3, metas[node] >> 2, splits[node]
        deepest = max(deepest, level)
        if axis == LEAF_AXIS:
            assert firsts[node] == first, "leaves fill prims in their own order"
            listed = prims[first : first + count]
            assert listed == sorted(set(listed)), f"a leaf lists {listed}"
            first += count
            yield (lower, upper), listed
            continue
        assert count == pair, "a pair is numbered when its parent is split"
        assert lower[axis] <= split <= upper[axis] and lower[axis] < upper[axis], "a plane outside its cell"
        pair += 2
        top, bottom = upper.copy(), lower.copy()
        top[axis] = bottom[axis] = split
        todo += [(count + 1, (bottom, upper), level + 1), (count, (lower, top), level + 1)]
    assert (pair, first, deepest) == (len(metas), len(prims), tree.max_level)
    assert set(prims) == set(range(len(tree.triangles))), "not every triangle is listed"


def check_bvh(tree: Tree) -> None:
    """Check that every triangle is in one leaf, boxes are exact (larger around strays) and pairs are numbered depth-first."""
    children, metas = tree.nodes["child"].tolist(), tree.nodes["meta"].tolist()
    boxes = np.concatenate([tree.nodes["lower"], tree.nodes["upper"]], axis=1).tolist()
    lower, upper = triangle_boxes(tree.triangles)
    make_room(tree.triangles, lower, upper)
    of_triangles = np.concatenate((lower, upper), axis=1).tolist()
    prims, pair, deepest = tree.prims.tolist(), 1, 0
    todo = [(0, 0)]
    while todo:
        node, level = todo.pop()
        deepest = max(deepest, level)
        at, count = children[node], metas[node] >> 2
        if metas[node] & 3 == LEAF_AXIS:
            listed = prims[at : at + count]
            assert listed and listed == sorted(set(listed)), f"a leaf lists {listed}"
            inner = [of_triangles[i] for i in listed]
        else:
            assert at == pair, "a pair is numbered when its parent is split"
            pair += 2
            todo += [(at + 1, level + 1), (at, level + 1)]
            inner = boxes[at : at + 2]
        columns = list(zip(*inner, strict=True))
        assert boxes[node] == [*map(min, columns[:3]), *map(max, columns[3:])], "a box that does not fit"
    assert (pair, deepest) == (len(metas), tree.max_level)
    assert sorted(prims) == list(range(len(tree.triangles))), "a triangle is lost or listed twice"


# --- what leaves list, in whole numbers ------------------------------------------------------------------------------

#: Clipping rounds by no more than this share of a triangle's largest coordinate along an axis: a few units of float64.
ROUNDING_BITS = 50
_UNIT_BITS = 149 + ROUNDING_BITS  # every float32, and this share of it, is a whole number of 2**-199

Point = tuple[int, int, int, int]  # x, y, z over w


def _whole(x: float) -> int:
    numerator, denominator = x.as_integer_ratio()
    return (numerator << _UNIT_BITS) // denominator


def _cut(polygon: list[Point], axis: int, plane: int, side: int) -> list[Point]:
    """Return the part of a polygon on one side of a plane, exactly; what touches it stays."""
    beyond = [side * (point[axis] - plane * point[3]) for point in polygon]
    kept: list[Point] = []
    for a, b, here, there in zip(polygon, polygon[1:] + polygon[:1], beyond, beyond[1:] + beyond[:1], strict=True):
        if here >= 0:
            kept.append(a)
        if here < 0 < there or there < 0 < here:
            x, y, z, w = (p * abs(there) + q * abs(here) for p, q in zip(a, b, strict=True))
            kept.append((x, y, z, w))
    return kept


def reaches(triangle: list[list[int]], lower: list[int], upper: list[int]) -> bool:
    """Return whether a triangle and a closed box have a point in common."""
    polygon: list[Point] = [(x, y, z, 1) for x, y, z in triangle]
    for k in range(3):
        for plane, side in ((lower[k], 1), (upper[k], -1)):
            if any(side * (corner[k] - plane) < 0 for corner in triangle):
                polygon = _cut(polygon, k, plane, side)
    return bool(polygon)


def check_listing(tree: Tree) -> None:
    """Check that a leaf lists exactly the triangles that reach into its cell, but for ``ROUNDING_BITS`` at its faces.

    A stray may be listed beyond that by twice its room: the plane that cuts it moves, and so do the bounds of what is left.

    In a cell thinner than that, rounding may leave nothing of a triangle beside it, which then stays listed. A cell without
    volume owes nothing by itself: what lies in a plane is listed on one side of it. So it is checked too that the corners, the
    middles of the edges and the centre of every triangle lie in a leaf that lists it.
    """
    corners = tree.triangles.tolist()
    shapes = [[[_whole(x) for x in corner] for corner in triangle] for triangle in corners]
    rounding = [[max(abs(corner[k]) for corner in shape) >> ROUNDING_BITS for k in range(3)] for shape in shapes]
    lower_corners, upper_corners = triangle_boxes(tree.triangles)
    strays = set(make_room(tree.triangles, lower_corners, upper_corners).strays.tolist())
    allowed = [
        [r + (2 * _whole(SLACK * float(np.abs(corners[i]).max())) if i in strays else 0) for r in rounding[i]]
        for i in range(len(shapes))
    ]
    boxes = list(zip(*(bound.tolist() for bound in triangle_boxes(tree.triangles)), strict=True))
    homes: list[list[tuple[list[int], list[int]]]] = [[] for _ in shapes]
    for (low, high), listed in leaves(tree):
        lower, upper = [_whole(x) for x in low], [_whole(x) for x in high]
        for i in listed:
            homes[i].append((lower, upper))
            if any(all(low[k] <= corner[k] <= high[k] for k in range(3)) for corner in corners[i]):
                continue
            is_thin = any(0 < upper[k] - lower[k] <= 2 * allowed[i][k] for k in range(3))
            assert is_thin or reaches(shapes[i], *_grown(lower, upper, allowed[i])), f"a leaf lists {i}, which misses it"
        if any(low[k] == high[k] for k in range(3)):
            continue
        others = set(range(len(shapes))).difference(listed)
        for i in (i for i in others if all(boxes[i][0][k] < high[k] and boxes[i][1][k] > low[k] for k in range(3))):
            lower_in, upper_in = _grown(lower, upper, [-r - 1 for r in rounding[i]])
            if all(map(int.__le__, lower_in, upper_in)):
                assert not reaches(shapes[i], lower_in, upper_in), f"a leaf lacks triangle {i}"
    for i, (shape, cells) in enumerate(zip(shapes, homes, strict=True)):
        for weights in ((6, 0, 0), (0, 6, 0), (0, 0, 6), (3, 3, 0), (0, 3, 3), (3, 0, 3), (2, 2, 2)):
            point = [sum(w * corner[k] for w, corner in zip(weights, shape, strict=True)) for k in range(3)]
            near = [6 * r for r in rounding[i]]
            assert any(
                all(6 * low[k] - near[k] <= point[k] <= 6 * high[k] + near[k] for k in range(3)) for low, high in cells
            ), f"no leaf has triangle {i} at {weights}"


def _grown(lower: list[int], upper: list[int], by: list[int]) -> tuple[list[int], list[int]]:
    return [a - r for a, r in zip(lower, by, strict=True)], [b + r for b, r in zip(upper, by, strict=True)]


# --- hits ------------------------------------------------------------------------------------------------------------


def check_hits(tree: Tree, rays: Rays) -> int:
    """Check that hits are those of testing every triangle, to the bit; return the number of hits."""
    truth, hits, met = trace_all(tree.triangles, rays), trace(tree, rays), trace(tree, rays, any_hit=True)
    assert hits.prim.tolist() == truth.prim.tolist() and hits.t.tobytes() == truth.t.tobytes()
    assert ((met.prim >= 0) == (truth.prim >= 0)).all()
    return int((truth.prim >= 0).sum())


def check_tree(tree: Tree) -> None:
    """Check the structure of a tree of either kind."""
    if tree.kind != "kdtree":
        check_bvh(tree)
    else:
        for _ in leaves(tree):
            pass


def try_scene(kind: str, seed: int) -> None:
    """Build a scene with every builder and check the trees; a ValueError if all of them refuse it.

    One in 64 is clipped exactly too, which takes most of the time.
    """
    triangles = SCENES[kind](np.random.default_rng(seed))
    if not len(triangles) or not np.isfinite(triangles).all():
        refused = []
        for build in BUILDERS.values():
            try:
                build(triangles)
            except ValueError as error:
                refused.append(error)
        assert len(refused) == len(BUILDERS), "a builder takes what is no scene"
        raise refused[0]
    rays = rays_at(triangles, 16, np.random.default_rng([seed, 1]))
    for build in BUILDERS.values():
        tree = build(triangles)
        check_tree(tree)
        check_hits(tree, rays)
        if tree.kind == "kdtree" and seed % 64 == 0:
            check_listing(tree)
