"""Triangles -> kd-tree: the exact surface area heuristic in O(N log N), every triangle clipped to its cell ("perfect splits").

A cell holds, for each axis, the sorted *events* of its triangles: where each one starts, ends, or lies flat. One sweep
over them finds the cheapest plane. The events of triangles on one side of it are already sorted; only those of triangles
cut by it are made anew, sorted and merged in. Cells wait on a stack in one arena, the lower child on top, so nodes are
numbered depth-first and nothing is ever sorted again.

Notes
-----
After Wald & Havran 2006 (events, planar triangles, perfect splits) and Manta's KDTree (costs 1.5 and 2, no empty bonus).
Unlike Manta, which drops a triangle whose clipped part is degenerate, a triangle stays on both sides of every plane that
its bounds straddle, so that rounding loses none.
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from nptrace_base.errors import NptraceError
from nptrace_base.jit import inlined, kernel
from rtrace.trees.clip import POLYGON, PartBounds, split_bounds, value
from rtrace.trees.kd_events import (
    BOX,
    TRIANGLE,
    UPPER,
    Parted,
    Straddlers,
    classify,
    first_events,
    list_triangles,
    merge,
    partition,
    renew,
)
from rtrace.trees.kd_sweep import half_area_of, sweep
from rtrace.trees.leaf_rules import leaf_rules, limits_given
from rtrace.trees.merge_sort import sort
from rtrace.trees.strays import make_room, slack_of
from rtrace.trees.tree import (
    AXIS_BITS,
    AXIS_MASK,
    FIRST,
    KD_META,
    KD_NODE,
    KD_WORDS,
    LEAF_AXIS,
    SPLIT,
    Tree,
    check_finite,
    triangle_boxes,
    words,
)

_MAX_REFS = 2**31 - 1  # a leaf's n_prims has 30 bits, its first primitive 32

# The state of a build, and what it may run out of.
_WAITING, _NODES, _REFS, _PENDING, _DEEPEST = range(5)
_DONE, _OUT_OF_NODES, _OUT_OF_PRIMS, _OUT_OF_EVENTS = range(4)


class _Cells(NamedTuple):
    """The stack of cells that wait to be split, flat arrays. The top one's events are the last in the arena."""

    node: np.ndarray  # int64, (room,)
    level: np.ndarray
    n_refs: np.ndarray
    ceiling: np.ndarray  # the references there may be when all of its subtree is built
    begin: np.ndarray  # int64, (3 room,): its events are events[axis, begin:end]
    end: np.ndarray
    box: np.ndarray  # float64, (6 room,): lower and upper corner


class _Scratch(NamedTuple):
    """Room for one split."""

    side: np.ndarray  # (n_triangles,) uint8
    straddlers: Straddlers
    parted: Parted
    fresh: np.ndarray  # (2 n_triangles,) int64
    spare: np.ndarray  # (2 n_triangles,) int64
    points: np.ndarray  # (3 POLYGON,) float64


class _Nodes(NamedTuple):
    """The tree that is built: its nodes as words of two types in the same memory, and the triangles leaf by leaf."""

    floats: np.ndarray
    uints: np.ndarray
    prims: np.ndarray


# The kernels below do not count references (_nrt=False, inlined): they take arrays out of tuples, which would count one each
# time. The two steps of a build are inlined: to pass so many arrays takes 5 % of its time.
@inlined
def _write_leaf(events, cells, cell, tree, scratch, state):
    """Write the leaf that a cell becomes, its triangles in ascending order."""
    n_listed = list_triangles(events, cells.begin[3 * cell], cells.end[3 * cell], scratch.fresh)
    sort(scratch.fresh, n_listed, scratch.spare)
    n, first, node = cells.n_refs[cell], state[_REFS], cells.node[cell]
    for i in range(n):
        tree.prims[first + i] = scratch.fresh[i]
    tree.uints[KD_WORDS * node + FIRST] = first
    tree.uints[KD_WORDS * node + KD_META] = n << AXIS_BITS | LEAF_AXIS
    state[_REFS] += n


@inlined
def _split_cell(vertices, events, cells, cell, plane, scratch, far):
    """Give a cell's events and box to its children: the upper one takes the cell's place, the lower one the place above it."""
    begin, end, boxes = cells.begin, cells.end, cells.box
    straddlers, parted, fresh, spare = scratch.straddlers, scratch.parted, scratch.fresh, scratch.spare
    bounds, (axis, place) = straddlers.bounds, plane
    n_straddlers = np.int64(0)
    for k in range(3):
        span = begin[3 * cell + k], end[3 * cell + k]
        n_straddlers = partition(events, k, span, scratch.side, straddlers, n_straddlers, parted)
    for i in range(n_straddlers):
        triangle = straddlers.listed[i]
        slack = slack_of(vertices, triangle, far) if far < np.inf else 0.0
        split_bounds(vertices, triangle, (boxes, BOX * cell), plane, bounds, BOX * i, scratch.points, slack)
    for k in range(3):
        at, n_kept, n_cut = 3 * cell + k, parted.n_kept[k], parted.n_cut[k]
        n_fresh = renew(parted.cut, k, n_cut, straddlers.slot, bounds.above, fresh)
        sort(fresh, n_fresh, spare)
        middle = merge(events, k, begin[at], parted.end_above[k], fresh, n_fresh)
        for i in range(n_kept):
            events[k, middle + i] = parted.kept[k, i]
        end[at], begin[at + 3] = middle, middle
        n_fresh = renew(parted.cut, k, n_cut, straddlers.slot, bounds.below, fresh)
        sort(fresh, n_fresh, spare)
        end[at + 3] = merge(events, k, middle, middle + n_kept, fresh, n_fresh)
        boxes[BOX * (cell + 1) + k] = boxes[BOX * cell + k]
        boxes[BOX * (cell + 1) + UPPER + k] = boxes[BOX * cell + UPPER + k]
    boxes[BOX * cell + axis] = boxes[BOX * (cell + 1) + UPPER + axis] = value(place)


@kernel(_nrt=False)
def _build(vertices, events, tree, cells, scratch, limits, state):
    """Split cells until none waits (_DONE) or an array is too short for the next step: let it grow and call again.

    Costs are counted in intersections: ``limits`` is (c_trav / c_isect, empty_bonus, max_level, max_refs,
    the limit of ``strays``, min_leaf, max_leaf).
    """
    trav, empty_bonus, max_level, max_refs, far, min_leaf, max_leaf = limits
    costs = trav, empty_bonus
    begin, end, boxes, ceiling = cells.begin, cells.end, cells.box, cells.ceiling
    while state[_WAITING] > 0:
        cell = state[_WAITING] - 1
        node, level, n = cells.node[cell], cells.level[cell], cells.n_refs[cell]
        if KD_WORDS * (state[_NODES] + 2) > tree.uints.size:
            return _OUT_OF_NODES
        if state[_REFS] + n > tree.prims.size:
            return _OUT_OF_PRIMS
        axis, half_area = np.int64(LEAF_AXIS), half_area_of(boxes, cell)
        is_forced = n > max_leaf
        best = (np.inf if is_forced else half_area * n, np.int64(0))
        may_pay = n > min_leaf and (n > empty_bonus * trav or is_forced)
        if level < max_level and state[_NODES] < TRIANGLE and half_area > 0.0 and may_pay:
            for k in range(3):
                trial = sweep(events, k, (begin[3 * cell + k], end[3 * cell + k]), boxes, cell, n, costs, best)
                if trial[0] < best[0]:
                    axis, best = k, trial
        plane, n_below, n_above = best[1], np.int64(0), np.int64(0)
        if axis != LEAF_AXIS:
            span = begin[3 * cell + axis], end[3 * cell + axis]
            n_below, n_above = classify(events, axis, span, plane, n, scratch.side)
            # A split that does not pay must at least part the triangles, or cut off empty space, which comes to an end.
            if is_forced and best[0] >= half_area * n and max(n_below, n_above) == n and min(n_below, n_above) > 0:
                axis, n_below, n_above = np.int64(LEAF_AXIS), np.int64(0), np.int64(0)
        n_refs = state[_PENDING] - n + n_below + n_above
        if axis == LEAF_AXIS or n_refs > ceiling[cell]:
            _write_leaf(events, cells, cell, tree, scratch, state)
            state[_WAITING] -= 1
            continue
        top = max(begin[3 * cell], begin[3 * cell + 1], begin[3 * cell + 2])
        if top + 2 * (n_below + n_above) > events.shape[1]:
            return _OUT_OF_EVENTS

        _split_cell(vertices, events, cells, cell, (axis, plane >> 32), scratch, far)
        child = state[_NODES]
        cells.node[cell], cells.level[cell], cells.n_refs[cell] = child + 1, level + 1, n_above
        cells.node[cell + 1], cells.level[cell + 1], cells.n_refs[cell + 1] = child, level + 1, n_below
        tree.floats[KD_WORDS * node + SPLIT] = value(plane >> 32)
        tree.uints[KD_WORDS * node + KD_META] = child << AXIS_BITS | axis
        state[_WAITING] += 1
        state[_NODES] += 2
        # Past the first half, what may be added is shared: else a fan uses it up on one side, the other stays unsplit.
        share = np.int64((ceiling[cell] - n_refs) * (n_below / (n_below + n_above)))
        ceiling[cell + 1] = max(n_refs + share, min(ceiling[cell], max_refs // 2))
        state[_PENDING] = n_refs
        state[_DEEPEST] = max(state[_DEEPEST], level + 1)
    return _DONE


def _grown(array):
    """Return a copy with twice the room along the last axis."""
    return np.concatenate((array, np.empty_like(array)), axis=-1)


def build_kdtree(
    triangles, *, c_trav=1.5, c_isect=2.0, empty_bonus=1.0, max_level=511, max_refs=None, min_leaf=0, max_leaf=None
) -> Tree:
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
    rules = (
        ("the number of triangles", n, 1 <= n <= TRIANGLE, "1 to 2**30 - 1; split the scene or drop it"),
        ("empty_bonus", empty_bonus, 0 < empty_bonus <= 1, "above 0 and at most 1; 1 is no bonus"),
        ("max_level", max_level, 0 <= max_level <= 65535, "0 to 65535, e.g. 511"),
        ("max_refs", max_refs, n <= max_refs <= _MAX_REFS, f"from the number of triangles, {n}, to 2**31 - 1"),
    )
    for name, given, is_kept, rule in rules:
        if not is_kept:
            raise NptraceError(f"{name} must be {rule}; got {given}")
    triangles = np.ascontiguousarray(triangles)
    check_finite(triangles)
    lower, upper = triangle_boxes(triangles)
    extent = make_room(triangles, lower, upper)

    events, counts = first_events(lower, upper)
    del lower, upper
    room = int(max_level) + 2
    int64, int32 = partial(np.empty, dtype=np.int64), partial(np.empty, dtype=np.int32)
    cells = _Cells(
        node=int64(room), level=int64(room), n_refs=int64(room), ceiling=int64(room),
        begin=int64(3 * room), end=int64(3 * room), box=np.empty(6 * room),
    )  # fmt: skip
    cells.node[0], cells.level[0], cells.n_refs[0], cells.ceiling[0] = 0, 0, n, max_refs
    cells.begin[:3], cells.end[:3], cells.box[:6] = 0, counts, extent.bounds.reshape(6)
    bounds = PartBounds(whole=int32(6 * n), below=int32(6 * n), above=int32(6 * n))
    straddlers = Straddlers(slot=int32(n), listed=int32(n), bounds=bounds)
    parted = Parted(
        kept=int64((3, 2 * n)), cut=int64((3, 2 * n)), n_kept=int64(3), n_cut=int64(3), end_above=int64(3)
    )  # fmt: skip
    scratch = _Scratch(np.empty(n, np.uint8), straddlers, parted, int64(2 * n), int64(2 * n), np.empty(3 * POLYGON))
    limits = leaf.trav, float(empty_bonus), int(max_level), int(max_refs), extent.limit, leaf.min_leaf, leaf.max_leaf
    nodes, prims = np.empty(16 * n + 64, np.uint32), np.empty(8 * n + 64, np.int32)
    state = np.array([1, 1, 0, n, 0], np.int64)
    vertices = triangles.reshape(-1)
    while (
        lacks := _build(vertices, events, _Nodes(nodes.view(np.float32), nodes, prims), cells, scratch, limits, state)
    ) != _DONE:
        if lacks == _OUT_OF_NODES:
            nodes = _grown(nodes)
        elif lacks == _OUT_OF_PRIMS:
            prims = _grown(prims)
        else:
            events = _grown(events)

    params = {
        "builder": "sah",
        "c_trav": float(c_trav),
        "c_isect": float(c_isect),
        "empty_bonus": float(empty_bonus),
        "max_level": int(max_level),
        "max_refs": int(max_refs),
        **limits_given(min_leaf, max_leaf),
    }
    nodes = nodes[: KD_WORDS * state[_NODES]].copy().view(KD_NODE)
    prims = prims[: state[_REFS]].copy()
    corners = np.take(triangles, prims, axis=0)
    return Tree("kdtree", nodes, prims, corners, triangles, extent.bounds, extent.core, int(state[_DEEPEST]), params)


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
