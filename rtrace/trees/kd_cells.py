"""The cells of a kd-tree's build: a stack of them, and the kernel that splits the top one or makes it a leaf.

Cells wait in one arena of events, the lower child on top, so nodes are numbered depth-first.
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from nptrace_base.jit import inlined, kernel
from rtrace.trees.clip import POLYGON, PartBounds, split_bounds, value
from rtrace.trees.kd_events import (
    BOX,
    TRIANGLE,
    UPPER,
    Parted,
    Straddlers,
    classify,
    list_triangles,
    merge,
    partition,
    renew,
)
from rtrace.trees.kd_sweep import half_area_of, sweep
from rtrace.trees.merge_sort import sort
from rtrace.trees.strays import slack_of
from rtrace.trees.tree import AXIS_BITS, FIRST, KD_META, KD_NODE, KD_WORDS, LEAF_AXIS, SPLIT

# The state of a build, and the arrays that may be too short. _CUT: cells that are leaves because of their ceiling.
_WAITING, _NODES, _REFS, _PENDING, _DEEPEST, _CUT = range(6)
_DONE, _OUT_OF_NODES, _OUT_OF_PRIMS, _OUT_OF_EVENTS = range(4)


class _Cells(NamedTuple):
    """The stack of cells that wait to be split, flat arrays. The top one's events are the last in the arena."""

    node: np.ndarray  # (room,) int64
    level: np.ndarray
    n_refs: np.ndarray
    ceiling: np.ndarray  # the most references when its whole subtree is built
    begin: np.ndarray  # (3 room,) int64: its events are events[axis, begin:end]
    end: np.ndarray
    box: np.ndarray  # (6 room,) float64: lower and upper corner


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
def _build(vertices, events, tree, cells, scratch, limits, state, is_one_step):
    """Split cells until none waits (_DONE) or an array is too short for the next step: let it grow and call again.

    Costs are counted in intersections; ``limits`` is a ``Limits``. ``is_one_step``: split one cell and leave its children
    waiting.
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
            state[_CUT] += np.int64(axis != LEAF_AXIS)
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
        # Beyond the first half, the children share what may be added: else a fan uses it up on one side only.
        share = np.int64((ceiling[cell] - n_refs) * (n_below / (n_below + n_above)))
        ceiling[cell + 1] = max(n_refs + share, min(ceiling[cell], max_refs // 2))
        state[_PENDING] = n_refs
        state[_DEEPEST] = max(state[_DEEPEST], level + 1)
        if is_one_step:
            break
    return _DONE


def _make_scratch(n: int, n_refs: int) -> _Scratch:
    """Return scratch for cells of up to n_refs of n triangles."""
    int64, int32 = partial(np.empty, dtype=np.int64), partial(np.empty, dtype=np.int32)
    bounds = PartBounds(whole=int32(6 * n_refs), below=int32(6 * n_refs), above=int32(6 * n_refs))
    straddlers = Straddlers(slot=int32(n), listed=int32(n_refs), bounds=bounds)
    parted = Parted(
        kept=int64((3, 2 * n_refs)), cut=int64((3, 2 * n_refs)), n_kept=int64(3), n_cut=int64(3), end_above=int64(3)
    )  # fmt: skip
    return _Scratch(np.empty(n, np.uint8), straddlers, parted, int64(2 * n_refs), int64(2 * n_refs), np.empty(3 * POLYGON))


def _grown(array):
    """Return a copy with twice the room along the last axis."""
    return np.concatenate((array, np.empty_like(array)), axis=-1)


class Cell(NamedTuple):
    """What a subtree is built from."""

    events: np.ndarray  # (3, room) int64
    counts: np.ndarray  # (3,) int64
    box: np.ndarray  # (6,) float64
    level: int
    n_refs: int


class Limits(NamedTuple):
    """What the builder weighs and may not exceed, as the kernel takes it; costs are in intersections.

    Attributes
    ----------
    trav : float
        c_trav / c_isect.
    empty_bonus : float
    max_level, max_refs : int
    far : float
        The limit of ``strays``.
    min_leaf, max_leaf : int
    """

    trav: float
    empty_bonus: float
    max_level: int
    max_refs: int
    far: float
    min_leaf: int
    max_leaf: int


class Subtree(NamedTuple):
    """What is built of a cell."""

    nodes: np.ndarray  # KD_NODE, the root first
    prims: np.ndarray  # of its leaves, in order
    level: int  # of the deepest node
    is_cut: bool  # the ceiling made leaves


def subtree(
    vertices: np.ndarray, cell: Cell, limits: Limits, ceiling: int, is_one_step: bool
) -> tuple[Subtree, list[Cell]]:  # fmt: skip
    """Build the subtree of a cell, or split it once; return what is built and the children of a cell that was split once.

    A split node has its children's places, and nothing in them.
    """
    n = len(vertices) // 9
    events, counts, box, level, n_refs = cell
    room = limits.max_level + 2 - level
    int64 = partial(np.empty, dtype=np.int64)
    cells = _Cells(
        node=int64(room), level=int64(room), n_refs=int64(room), ceiling=int64(room),
        begin=int64(3 * room), end=int64(3 * room), box=np.empty(6 * room),
    )  # fmt: skip
    cells.node[0], cells.level[0], cells.n_refs[0], cells.ceiling[0] = 0, level, n_refs, ceiling
    cells.begin[:3], cells.end[:3], cells.box[:6] = 0, counts, box
    scratch = _make_scratch(n, n_refs)
    nodes, prims = np.empty(16 * n_refs + 64, np.uint32), np.empty(8 * n_refs + 64, np.int32)
    state = np.array([1, 1, 0, n_refs, level, 0], np.int64)
    while (
        lacks := _build(
            vertices, events, _Nodes(nodes.view(np.float32), nodes, prims), cells, scratch, limits, state, is_one_step
        )
    ) != _DONE:
        if lacks == _OUT_OF_NODES:
            nodes = _grown(nodes)
        elif lacks == _OUT_OF_PRIMS:
            prims = _grown(prims)
        else:
            events = _grown(events)
    children = []
    for child in (1, 0)[: state[_WAITING]]:  # the lower one is on top
        begin, end = cells.begin[3 * child : 3 * child + 3], cells.end[3 * child : 3 * child + 3]
        own = np.empty((3, 2 * int((end - begin).max()) + 64), np.int64)
        for k in range(3):
            own[k, : end[k] - begin[k]] = events[k, begin[k] : end[k]]
        box = cells.box[6 * child : 6 * child + 6].copy()
        children.append(Cell(own, end - begin, box, int(cells.level[child]), int(cells.n_refs[child])))
    own_nodes, own_prims = nodes[: KD_WORDS * state[_NODES]].copy().view(KD_NODE), prims[: state[_REFS]].copy()
    return Subtree(own_nodes, own_prims, int(state[_DEEPEST]), bool(state[_CUT])), children
