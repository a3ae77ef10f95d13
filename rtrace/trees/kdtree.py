"""Triangles -> kd-tree: the exact surface area heuristic in O(N log N), every triangle clipped to its cell ("perfect splits").

A cell has, for each axis, the sorted *events* of its triangles: where each one starts, ends, or lies flat. One sweep over
them finds the cheapest plane (``kd_sweep``). The events of triangles on one side of it are already sorted; only those of
triangles that it cuts are computed again, sorted and merged in (``kd_events``). ``kd_cells`` splits cell after cell; threads
share the subtrees of a large scene (``subtrees``).

Notes
-----
After Wald & Havran 2006 (events, planar triangles, perfect splits) and Manta's KDTree (costs 1.5 and 2, no empty bonus).
Unlike Manta, which drops a triangle whose clipped part is degenerate, a triangle stays on both sides of every plane that
its bounds straddle, so that rounding loses none.
"""

import numpy as np

from nptrace_base.errors import NptraceError
from nptrace_base.jit import kernel
from rtrace.trees.kd_cells import Cell, Limits, Subtree, subtree
from rtrace.trees.kd_events import BOX, TRIANGLE, UPPER, first_events
from rtrace.trees.kd_sweep import half_area_of
from rtrace.trees.leaf_rules import leaf_rules, limits_given
from rtrace.trees.strays import make_room
from rtrace.trees.subtrees import TreePart, build_in_parts, part_limit, placed
from rtrace.trees.tree import (
    AXIS_BITS,
    AXIS_MASK,
    KD_META,
    KD_NODE,
    KD_WORDS,
    LEAF_AXIS,
    SPLIT,
    Tree,
    check_finite,
    check_numbers,
    triangle_boxes,
    words,
)

_MAX_REFS = 2**31 - 1  # a leaf's n_prims has 30 bits, its first primitive 32


def _check_options(n, empty_bonus, max_level, max_refs):
    """Raise NptraceError for the first option that is out of range; ``leaf_rules`` checks costs and leaf sizes."""
    rules = (
        ("the number of triangles", n, 1 <= n <= TRIANGLE, "1 to 2**30 - 1; split the scene"),
        ("empty_bonus", empty_bonus, 0 < empty_bonus <= 1, "above 0 and at most 1; 1 is no bonus"),
        ("max_level", max_level, 0 <= max_level <= 65535, "0 to 65535, e.g. 511"),
        ("max_refs", max_refs, n <= max_refs <= _MAX_REFS, f"from the number of triangles, {n}, to 2**31 - 1"),
    )
    for name, given, is_kept, rule in rules:
        if not is_kept:
            raise NptraceError(f"{name} must be {rule}; got {given}")


def _joined(root: TreePart[Subtree]) -> Subtree:
    """Put the parts of a tree together."""
    if not root.children:
        return root.built
    parts = list(placed(root))
    nodes = np.empty(1 + sum(len(part.built.nodes) - 1 for part, *_ in parts), KD_NODE)
    n_refs, bits = 0, np.uint32(AXIS_BITS)
    for part, at, n in parts:
        built = part.built
        below = nodes[n : n + len(built.nodes) - 1]
        below[:], nodes[at] = built.nodes[1:], built.nodes[0]
        for array in (nodes[at : at + 1], below[:0] if part.children else below):
            is_leaf = array["meta"] & AXIS_MASK == LEAF_AXIS
            array["first"][is_leaf] += np.uint32(n_refs)
            array["meta"][~is_leaf] += np.uint32(n - 1) << bits
        n_refs += len(built.prims)
    subtrees = [part.built for part, *_ in parts]
    prims = np.concatenate([each.prims for each in subtrees])
    return Subtree(nodes, prims, max(each.level for each in subtrees), any(each.is_cut for each in subtrees))


def _built(
    vertices: np.ndarray, extent: tuple[np.ndarray, np.ndarray, np.ndarray], limits: Limits, threads: int
) -> Subtree:  # fmt: skip
    """Return the nodes over all triangles; ``extent``: lower and upper corners of their boxes, and the box of all.

    Parts cannot share a ceiling of references. Below half of it, it has no effect, so the tree is that of one part.
    """
    lower, upper, bounds = extent
    n, max_refs = len(lower), limits.max_refs

    def first_cell() -> Cell:
        events, counts = first_events(lower, upper)
        return Cell(events, counts, bounds.reshape(6).astype(np.float64), 0, n)

    def tree_of(ceiling: int, threads: int) -> Subtree:
        def step(cell: Cell, is_one_step: bool) -> tuple[Subtree, list[Cell]]:
            return subtree(vertices, cell, limits, ceiling, is_one_step)

        # The events are nobody's but the parts', which let them go.
        return _joined(build_in_parts(step, first_cell(), lambda cell: cell.n_refs, threads))

    if part_limit(n, threads) < n:
        built = tree_of(max_refs // 2, threads)
        if not built.is_cut and len(built.prims) <= max_refs // 2:
            return built
    return tree_of(max_refs, 1)


def build_kdtree(
    triangles, *, c_trav=1.5, c_isect=2.0, empty_bonus=1.0, max_level=511, max_refs=None, min_leaf=0, max_leaf=None,
    threads=1,
) -> Tree:  # fmt: skip
    """Build the kd-tree that a greedy surface area heuristic finds.

    A cell of area A with n triangles is split where ``c_trav + c_isect * (A_below * n_below + A_above * n_above) / A``,
    times ``empty_bonus`` if a side is empty, is least, over all planes where a triangle's part begins or ends, on all
    axes. Ties go to the lowest axis, then the lowest plane, then to planar triangles below it. When no plane costs less
    than ``c_isect * n``, or the cell has no area, it becomes a leaf.

    Parameters
    ----------
    triangles : (n, 3, 3) float32
        Finite; n from 1 to 2**30 - 1. A triangle of no area is listed like any other.
    c_trav, c_isect : float
        Cost of visiting an inner node (not negative) and of testing a triangle (positive).
    empty_bonus : float
        Above 0, at most 1; 1 is no bonus.
    max_level : int
        A cell at this level is a leaf (root 0), whatever it holds; 0 to 65535.
    max_refs : int, optional
        The leaves hold at most so many references in all (at least n); by default 16 n + 1000, usual scenes need 5 n to
        7 n. It bounds the memory that scenes such as a fan of slivers take. The first half is free to all, what is left
        of the second is shared between the two children by their triangles.
    min_leaf, max_leaf : int
        A cell with up to ``min_leaf`` triangles is a leaf. One with more than ``max_leaf`` is split at the cheapest plane,
        also where that does not pay, if the plane parts the triangles or cuts off empty space. None: no limit.
    threads : int
        For large scenes; the tree does not depend on it.

    Returns
    -------
    Tree
        A triangle is listed in every leaf whose closed cell its interior overlaps; one that lies in a split plane is
        listed on one side of it, so a ray in the plane must visit both.

    Examples
    --------
    >>> one = np.eye(3, dtype=np.float32)
    >>> tree = build_kdtree(np.stack([one, one + 9, one, one + 9]))
    >>> len(tree.nodes), tree.prims.tolist()
    (13, [0, 2, 1, 3])
    """
    if not isinstance(triangles, np.ndarray) or triangles.dtype != np.float32 or triangles.shape[1:] != (3, 3):
        got = f"{triangles.dtype} {triangles.shape}" if isinstance(triangles, np.ndarray) else type(triangles).__name__
        raise NptraceError(f"triangles must be float32 (n, 3, 3), got {got}; use vertices.astype(np.float32)[faces]")
    n = len(triangles)
    if max_refs is None:
        max_refs = min(16 * n + 1000, _MAX_REFS)
    leaf = leaf_rules(c_trav, c_isect, min_leaf, max_leaf)
    _check_options(n, empty_bonus, max_level, max_refs)
    triangles = np.ascontiguousarray(triangles)
    check_finite(triangles)
    lower, upper = triangle_boxes(triangles)
    extent = make_room(triangles, lower, upper)

    vertices = triangles.reshape(-1)
    limits = Limits(leaf.trav, float(empty_bonus), int(max_level), int(max_refs), extent.limit, leaf.min_leaf, leaf.max_leaf)

    built = _built(vertices, (lower, upper, extent.bounds), limits, threads)
    del lower, upper
    params = {
        "builder": "sah",
        "c_trav": float(c_trav),
        "c_isect": float(c_isect),
        "empty_bonus": float(empty_bonus),
        "max_level": int(max_level),
        "max_refs": int(max_refs),
        **limits_given(min_leaf, max_leaf),
    }
    check_numbers(len(built.nodes), built.level)
    corners = np.take(triangles, built.prims, axis=0)
    return Tree("kdtree", built.nodes, built.prims, corners, triangles, extent.bounds, extent.core, built.level, params)


@kernel
def _sah(floats, uints, boxes, stack, c_trav, c_isect):
    """Return the sum of every node's cost x half its area; boxes[:6] is the root's."""
    waiting, total = 1, 0.0
    stack[0] = 0
    while waiting > 0:
        cell = waiting - 1
        node, half_area = stack[cell], half_area_of(boxes, cell)
        meta = uints[KD_WORDS * node + KD_META]
        axis, count = meta & AXIS_MASK, np.int64(meta >> AXIS_BITS)
        if axis == LEAF_AXIS:
            total += c_isect * count * half_area
            waiting -= 1
        else:
            total += c_trav * half_area
            for k in range(BOX):
                boxes[BOX * (cell + 1) + k] = boxes[BOX * cell + k]
            boxes[BOX * cell + axis] = boxes[BOX * (cell + 1) + UPPER + axis] = floats[KD_WORDS * node + SPLIT]
            stack[cell], stack[cell + 1] = count + 1, count
            waiting += 1
    return total


def sah_cost(tree: Tree, c_trav: float, c_isect: float) -> float:
    """Return the expected cost of a random ray through a kd-tree's bounds (MacDonald & Booth 1990).

    The sum over inner nodes of ``c_trav`` and over leaves of ``c_isect * n_prims``, each x its cell's area / the root's.
    Where the root has no area (then it is a leaf) every ray counts as meeting it.
    """
    if tree.kind != "kdtree":
        raise NptraceError(f"sah_cost is for a kdtree, got a {tree.kind}")
    boxes = np.zeros(6 * (tree.max_level + 2))
    boxes[:6] = tree.bounds.reshape(6)
    half_area = half_area_of(boxes, 0)
    if half_area == 0.0:
        return float(c_isect) * len(tree.prims)
    stack = np.zeros(tree.max_level + 2, np.int64)
    return _sah(*words(tree), boxes, stack, float(c_trav), float(c_isect)) / half_area
