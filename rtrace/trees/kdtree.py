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
from rtrace.trees.clip import POLYGON, split_bounds, value
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

# An event is one int64: rank of the position << 32 | kind << 30 | triangle. Sorted, what ends at a position comes before
# what lies in it, and that before what starts there.
_END, _PLANAR, _START = 0, 1 << 30, 2 << 30
_KIND = 3 << 30
_TRIANGLE = (1 << 30) - 1
_PLACE = -1 << 32

# A cell's box, or a triangle's bounds: a lower, then an upper corner.
_BOX, _UPPER = 6, 3

_BELOW, _ABOVE, _BOTH = 1, 2, 3

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
    """Room for one split. A *straddler* is a triangle that the plane cuts; its slot is its place in the list of them."""

    side: np.ndarray  # (n_triangles,) uint8
    slot: np.ndarray  # (n_triangles,) int32
    straddlers: np.ndarray  # (n_triangles,) int32
    bounds: np.ndarray  # (6 n_triangles,) int32, their ranks in the cell ...
    below: np.ndarray  # ... and in its two parts
    above: np.ndarray
    kept: np.ndarray  # (3, 2 n_triangles) int64, the events of the lower child
    cut: np.ndarray  # (3, 2 n_triangles) int64, the events of straddlers
    fresh: np.ndarray  # (2 n_triangles,) int64
    spare: np.ndarray  # (2 n_triangles,) int64
    counts: np.ndarray  # (9,) int64: of kept and cut events, and the upper child's end, for each axis
    points: np.ndarray  # (3 POLYGON,) float64


@kernel
def _half_area(boxes, cell):
    """Return half the surface area of a cell, in float64: no product of float32 lengths is lost at either end."""
    lower = _BOX * cell
    upper = lower + _UPPER
    dx, dy, dz = boxes[upper] - boxes[lower], boxes[upper + 1] - boxes[lower + 1], boxes[upper + 2] - boxes[lower + 2]
    return dx * dy + dy * dz + dz * dx


@inlined
def _plane_at(event, first_above):
    """Return the plane through an event's position; ``first_above`` is the least kind of events there that are above it.

    _PLANAR puts the triangles that lie in the plane above it, _START below.
    """
    return (event & _PLACE) + first_above


@kernel
def _sweep(events, axis, span, boxes, cell, n, costs, best):
    """Return the cheapest plane across one axis, (cost, plane), or ``best`` when that is as cheap.

    Costs are in intersections x half the cell's area; half a child's area is linear in the position: cap + rim * length.
    ``plane`` is the least event above the plane, so it tells the position and the side of the triangles lying in it.

    A plane is tried at *every* event. In a run of events at one position the counts are not final and so too high, never
    too low: the least cost is that of the final ones, without a branch on the kind of event. But counts too high may cost as
    little, by rounding, so those of the plane found are left to ``_classify``.
    """
    (begin, end), (trav, empty_bonus), (cost, plane) = span, costs, best
    lo, hi = boxes[_BOX * cell + axis], boxes[_BOX * cell + _UPPER + axis]
    y, z = _BOX * cell + (axis + 1) % 3, _BOX * cell + (axis + 2) % 3
    dy, dz = boxes[y + _UPPER] - boxes[y], boxes[z + _UPPER] - boxes[z]
    cap, rim = dy * dz, dy + dz
    fixed = trav * (cap + (hi - lo) * rim)
    below, above = np.int64(0), n
    first, last = value(events[axis, begin] >> 32), value(events[axis, end - 1] >> 32)

    # Only the first and the last plane can leave a child empty.
    trial = empty_bonus * (fixed + (cap + (hi - first) * rim) * n)
    if trial < cost and first > lo:
        cost, plane = trial, _plane_at(events[axis, begin], _PLANAR)
    i, stop = np.uint64(begin), np.uint64(end)  # unsigned: no test for a negative index, 15 % of a sweep
    while i < stop:
        event = events[axis, i]
        kind = event & _KIND
        x = value(event >> 32)
        area_below, area_above = cap + (x - lo) * rim, cap + (hi - x) * rim
        if kind != _PLANAR:
            above -= kind == _END
            trial = fixed + (area_below * below + area_above * above)
            if trial < cost and lo < x < hi:
                cost, plane = trial, _plane_at(event, _PLANAR if kind == _END else _START)
            below += kind == _START
            i += np.uint64(1)
        else:
            planar = np.int64(0)
            while i < stop and events[axis, i] >> 30 == event >> 30:
                planar += 1
                i += np.uint64(1)
            # At the cell's border only the flat side is of use: it takes the planar triangles out of the cell.
            trial = fixed + (area_below * (below + planar) + area_above * (above - planar))
            if x < hi and (trial < cost or (trial == cost < best[0] and plane >> 32 == event >> 32)):
                cost, plane = trial, _plane_at(event, _START)
            trial = fixed + (area_below * below + area_above * above)
            if trial < cost and x > lo:
                cost, plane = trial, _plane_at(event, _PLANAR)
            below += planar
            above -= planar
    trial = empty_bonus * (fixed + (cap + (last - lo) * rim) * n)
    if last < hi and (trial < cost or (trial == cost < best[0] and plane >> 32 == events[axis, end - 1] >> 32)):
        cost, plane = trial, _plane_at(events[axis, end - 1], _START)
    return cost, plane


@kernel
def _classify(events, axis, span, plane, n, side):
    """Write on which side of the plane each of the cell's n triangles is; return how many are on it (below, above)."""
    n_below, n_above = np.int64(0), n
    i, stop = np.uint64(span[0]), np.uint64(span[1])
    while i < stop and events[axis, i] < plane:
        event = events[axis, i]
        kind = event & _KIND
        side[np.uint64(event & _TRIANGLE)] = _BOTH if kind == _START else _BELOW
        n_below += kind != _END
        n_above -= kind != _START
        i += np.uint64(1)
    while i < stop:
        event = events[axis, i]
        triangle = np.uint64(event & _TRIANGLE)
        side[triangle] = side[triangle] if event & _KIND == _END else _ABOVE
        i += np.uint64(1)
    return n_below, n_above


@kernel
def _partition(events, axis, span, n_straddlers, side, slot, straddlers, bounds, kept, cut, counts):
    """Sort the events of one axis out: the upper child's to the front, the lower one's to ``kept``, straddlers' to ``cut``.

    Return the number of straddlers; the first axis lists them, every axis writes its part of their bounds.
    """
    begin, end = np.uint64(span[0]), np.uint64(span[1])
    n_below, n_cut, n_above = np.uint64(0), np.uint64(0), begin  # unsigned as in a sweep
    for i in range(begin, end):
        event = events[axis, i]
        triangle = np.uint64(event & _TRIANGLE)
        where = side[triangle]
        kept[axis, n_below] = event
        n_below += np.uint64(where == _BELOW)
        events[axis, n_above] = event
        n_above += np.uint64(where == _ABOVE)
        if where == _BOTH:
            kind = event & _KIND
            if axis == 0 and kind != _END:
                slot[triangle] = n_straddlers
                straddlers[n_straddlers] = event & _TRIANGLE
                n_straddlers += 1
            cut[axis, n_cut] = event
            n_cut += np.uint64(1)
            at = _BOX * slot[triangle] + axis
            if kind != _END:
                bounds[at] = event >> 32
            if kind != _START:
                bounds[at + _UPPER] = event >> 32
    counts[axis], counts[3 + axis], counts[6 + axis] = n_below, n_cut, n_above
    return n_straddlers


@kernel
def _renew(cut, axis, n_cut, slot, bounds, fresh):
    """Write the straddlers' events, moved to new bounds, to ``fresh``; return their number."""
    n = np.int64(0)
    for i in range(n_cut):
        kind, triangle = cut[axis, i] & _KIND, cut[axis, i] & _TRIANGLE
        at = _BOX * slot[triangle] + axis
        lo, hi = np.int64(bounds[at]), np.int64(bounds[at + _UPPER])
        flat = lo == hi
        fresh[n] = ((hi if kind == _END else lo) << 32) | (_PLANAR if flat else kind) | triangle
        n += 0 if flat and kind == _END else 1
    return n


@kernel
def _merge(events, axis, begin, end, fresh, n):
    """Merge n sorted events into the sorted events[axis, begin:end]; return the new end."""
    i, j, out = end - 1, n - 1, end + n - 1
    while j >= 0:
        if i >= begin and events[axis, i] > fresh[j]:
            events[axis, out] = events[axis, i]
            i -= 1
        else:
            events[axis, out] = fresh[j]
            j -= 1
        out -= 1
    return end + n


@kernel
def _list_triangles(events, begin, end, fresh):
    """Write the triangles of a cell to ``fresh``; return their number."""
    n = np.int64(0)
    for i in range(begin, end):
        fresh[n] = events[0, i] & _TRIANGLE
        n += events[0, i] & _KIND != _END
    return n


@kernel
def _build(vertices, events, floats, uints, prims, cells, scratch, limits, state):
    """Split cells until none waits (_DONE) or an array is too short for the next step: let it grow and call again.

    Costs are counted in intersections: ``limits`` is (c_trav / c_isect, empty_bonus, max_level, max_refs,
    the limit of ``strays``, min_leaf, max_leaf).
    """
    # Unpacked here, and handed on one by one: a kernel that takes an array out of a tuple counts references, a part of the
    # time of a build.
    trav, empty_bonus, max_level, max_refs, far, min_leaf, max_leaf = limits
    costs = trav, empty_bonus
    cell_node, cell_level, cell_refs, ceiling, begin, end, boxes = cells
    side, slot, straddlers, bounds, below, above, kept, cut, fresh, spare, counts, points = scratch
    while state[_WAITING] > 0:
        cell = state[_WAITING] - 1
        node, level, n = cell_node[cell], cell_level[cell], cell_refs[cell]
        if KD_WORDS * (state[_NODES] + 2) > uints.size:
            return _OUT_OF_NODES
        if state[_REFS] + n > prims.size:
            return _OUT_OF_PRIMS
        axis, half_area = np.int64(LEAF_AXIS), _half_area(boxes, cell)
        is_forced = n > max_leaf
        best = (np.inf if is_forced else half_area * n, np.int64(0))
        may_pay = n > min_leaf and (n > empty_bonus * trav or is_forced)
        if level < max_level and state[_NODES] < _TRIANGLE and half_area > 0.0 and may_pay:
            for k in range(3):
                trial = _sweep(events, k, (begin[3 * cell + k], end[3 * cell + k]), boxes, cell, n, costs, best)
                if trial[0] < best[0]:
                    axis, best = k, trial
        plane, n_below, n_above = best[1], np.int64(0), np.int64(0)
        if axis != LEAF_AXIS:
            n_below, n_above = _classify(events, axis, (begin[3 * cell + axis], end[3 * cell + axis]), plane, n, side)
            # A split that does not pay must at least part the triangles, or cut off empty space, which comes to an end.
            if is_forced and best[0] >= half_area * n and max(n_below, n_above) == n and min(n_below, n_above) > 0:
                axis, n_below, n_above = np.int64(LEAF_AXIS), np.int64(0), np.int64(0)
        n_refs = state[_PENDING] - n + n_below + n_above
        if axis == LEAF_AXIS or n_refs > ceiling[cell]:
            n_fresh = _list_triangles(events, begin[3 * cell], end[3 * cell], fresh)
            sort(fresh, n_fresh, spare)
            for i in range(n):
                prims[state[_REFS] + i] = fresh[i]
            uints[KD_WORDS * node + FIRST] = state[_REFS]
            uints[KD_WORDS * node + KD_META] = n << AXIS_BITS | LEAF_AXIS
            state[_REFS] += n
            state[_WAITING] -= 1
            continue
        top = max(begin[3 * cell], begin[3 * cell + 1], begin[3 * cell + 2])
        if top + 2 * (n_below + n_above) > events.shape[1]:
            return _OUT_OF_EVENTS

        # The upper child takes the cell's place, the lower one the place above it.
        n_straddlers = np.int64(0)
        for k in range(3):
            span = begin[3 * cell + k], end[3 * cell + k]
            n_straddlers = _partition(events, k, span, n_straddlers, side, slot, straddlers, bounds, kept, cut, counts)
        for i in range(n_straddlers):
            slack = slack_of(vertices, straddlers[i], far) if far < np.inf else 0.0
            split_bounds(
                vertices, straddlers[i], boxes, _BOX * cell, axis, plane >> 32, bounds, _BOX * i, below, above, points, slack
            )
        for k in range(3):
            at, n_kept, n_cut = 3 * cell + k, counts[k], counts[3 + k]
            n_fresh = _renew(cut, k, n_cut, slot, above, fresh)
            sort(fresh, n_fresh, spare)
            middle = _merge(events, k, begin[at], counts[6 + k], fresh, n_fresh)
            for i in range(n_kept):
                events[k, middle + i] = kept[k, i]
            end[at], begin[at + 3] = middle, middle
            n_fresh = _renew(cut, k, n_cut, slot, below, fresh)
            sort(fresh, n_fresh, spare)
            end[at + 3] = _merge(events, k, middle, middle + n_kept, fresh, n_fresh)
            boxes[_BOX * (cell + 1) + k] = boxes[_BOX * cell + k]
            boxes[_BOX * (cell + 1) + _UPPER + k] = boxes[_BOX * cell + _UPPER + k]
        split, child = value(plane >> 32), state[_NODES]
        boxes[_BOX * cell + axis] = split
        boxes[_BOX * (cell + 1) + _UPPER + axis] = split
        cell_node[cell], cell_level[cell], cell_refs[cell] = child + 1, level + 1, n_above
        cell_node[cell + 1], cell_level[cell + 1], cell_refs[cell + 1] = child, level + 1, n_below
        floats[KD_WORDS * node + SPLIT] = split
        uints[KD_WORDS * node + KD_META] = child << AXIS_BITS | axis
        state[_WAITING] += 1
        state[_NODES] += 2
        # Past the first half, what may be added is shared: else a fan uses it up on one side, the other stays unsplit.
        share = np.int64((ceiling[cell] - n_refs) * (n_below / (n_below + n_above)))
        ceiling[cell + 1] = max(n_refs + share, min(ceiling[cell], max_refs // 2))
        state[_PENDING] = n_refs
        state[_DEEPEST] = max(state[_DEEPEST], level + 1)
    return _DONE


def _first_events(lower, upper):
    """Return the sorted events of whole triangles, a (3, room) array, and how many there are on each axis."""
    n = len(lower)
    events = np.empty((3, 4 * n + 64), np.int64)
    counts = np.empty(3, np.int64)
    for k in range(3):
        bits = np.stack((lower[:, k], upper[:, k])).view(np.int32)
        lo, hi = np.where(bits < 0, np.int32(-(2**31)) - bits, bits)  # ranks, as clip.rank has them
        flat = lo == hi
        ends = np.flatnonzero(~flat)
        counts[k] = n + ends.size
        starts, rest = events[k, :n], events[k, n : counts[k]]
        np.left_shift(lo, 32, out=starts, dtype=np.int64)
        starts |= np.where(flat, _PLANAR, _START)
        starts |= np.arange(n)
        np.left_shift(hi[ends], 32, out=rest, dtype=np.int64)
        rest |= ends
        events[k, : counts[k]].sort()
    return events, counts


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
        ("the number of triangles", n, 1 <= n <= _TRIANGLE, "1 to 2**30 - 1; split the scene or drop it"),
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

    events, counts = _first_events(lower, upper)
    del lower, upper
    room = int(max_level) + 2
    int64, int32 = partial(np.empty, dtype=np.int64), partial(np.empty, dtype=np.int32)
    cells = _Cells(
        node=int64(room), level=int64(room), n_refs=int64(room), ceiling=int64(room),
        begin=int64(3 * room), end=int64(3 * room), box=np.empty(6 * room),
    )  # fmt: skip
    cells.node[0], cells.level[0], cells.n_refs[0], cells.ceiling[0] = 0, 0, n, max_refs
    cells.begin[:3], cells.end[:3], cells.box[:6] = 0, counts, extent.bounds.reshape(6)
    scratch = _Scratch(
        side=np.empty(n, np.uint8), slot=int32(n), straddlers=int32(n),
        bounds=int32(6 * n), below=int32(6 * n), above=int32(6 * n), kept=int64((3, 2 * n)), cut=int64((3, 2 * n)),
        fresh=int64(2 * n), spare=int64(2 * n), counts=int64(9), points=np.empty(3 * POLYGON),
    )  # fmt: skip
    limits = leaf.trav, float(empty_bonus), int(max_level), int(max_refs), extent.limit, leaf.min_leaf, leaf.max_leaf
    nodes, prims = np.empty(16 * n + 64, np.uint32), np.empty(8 * n + 64, np.int32)
    state = np.array([1, 1, 0, n, 0], np.int64)
    fixed = cells, scratch, limits, state
    while (lacks := _build(triangles.reshape(-1), events, nodes.view(np.float32), nodes, prims, *fixed)) != _DONE:
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
        node, half_area = stack[cell], _half_area(boxes, cell)
        meta = uints[KD_WORDS * node + KD_META]
        axis, count = meta & AXIS_MASK, np.int64(meta >> AXIS_BITS)
        if axis == LEAF_AXIS:
            total += c_isect * count * half_area
            waiting -= 1
        else:
            total += c_trav * half_area
            for k in range(_BOX):
                boxes[_BOX * (cell + 1) + k] = boxes[_BOX * cell + k]
            boxes[_BOX * cell + axis] = boxes[_BOX * (cell + 1) + _UPPER + axis] = floats[KD_WORDS * node + SPLIT]
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
    half_area = _half_area(boxes, 0)
    if half_area == 0.0:
        return float(c_isect) * len(tree.prims)
    stack = np.zeros(tree.max_level + 2, np.int64)
    return _sah(*words(tree), boxes, stack, float(c_trav), float(c_isect)) / half_area
