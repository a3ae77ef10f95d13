"""Triangles -> BVH: full-sweep SAH over sorted centroids (Manta's builder), or binned SAH (``rtrace.trees.binned_sah``).

A split is taken when c + (A_left n_left + A_right n_right) / A < n, in units of one triangle test (c is 1, as in Manta's
DynBVH): a leaf only when no split pays. Limits to the triangles of a leaf come first (``leaf_rules``): a node with more than a
leaf may have is split at the cheapest cut, or, where no cut makes its children smaller, in halves by the triangles' numbers,
so that copies end in leaves of that size too. There is no limit on depth.
"""

from typing import Any, NamedTuple

import numpy as np

from nptrace_base.errors import NptraceError
from nptrace_base.jit import inlined, kernel
from nptrace_base.pools import thread_pool
from rtrace.trees import binned_sah
from rtrace.trees.leaf_rules import NO_SMALLER, LeafRules, leaf_rules, limits_given
from rtrace.trees.merge_sort import sort
from rtrace.trees.strays import make_room
from rtrace.trees.subtrees import build_in_parts, placed
from rtrace.trees.tree import (
    AXIS_BITS,
    AXIS_MASK,
    BVH_NODE,
    BVH_WORDS,
    CHILD,
    LEAF_AXIS,
    LOWER,
    META,
    UPPER,
    Tree,
    check_finite,
    check_numbers,
    triangle_boxes,
)

BOX_FLOATS = 6  # lower x, y, z, upper x, y, z
#: Columns of the nodes that wait: which one, its span of every order, its level.
_NODE, _START, _END, _LEVEL = range(4)
_INF = np.float32(np.inf)
#: The empty box: its union with another box is that box.
_EMPTY = (_INF, _INF, _INF, -_INF, -_INF, -_INF)


@inlined
def _half_area(box):
    """Half the surface of a box; float64, so that no scene is too small or too large."""
    x0, y0, z0, x1, y1, z1 = box
    dx, dy, dz = np.float64(x1) - x0, np.float64(y1) - y0, np.float64(z1) - z0
    return dx * dy + dy * dz + dz * dx


@inlined
def _grown(box, boxes, triangle):
    """Return the union of a box and the box of a triangle."""
    x0, y0, z0, x1, y1, z1 = box
    b = BOX_FLOATS * triangle
    lower = min(x0, boxes[b]), min(y0, boxes[b + 1]), min(z0, boxes[b + 2])
    upper = max(x1, boxes[b + 3]), max(y1, boxes[b + 4]), max(z1, boxes[b + 5])
    return lower[0], lower[1], lower[2], upper[0], upper[1], upper[2]


@kernel
def _sweep_axis(ids, start, end, boxes, right_area):
    """Return (cost, position) of the cheapest cut of ids[start:end], in the order given, without the node's own terms.

    ``position`` is the first index of the right side; among equal costs the lowest. ``right_area`` is room for end - start.
    """
    box = _EMPTY
    for i in range(end - 1, start, -1):
        box = _grown(box, boxes, ids[i])
        right_area[i - start] = _half_area(box)
    box = _EMPTY
    best, position = np.inf, -1
    for i in range(start, end - 1):
        box = _grown(box, boxes, ids[i])
        cost = _half_area(box) * (i + 1 - start) + right_area[i + 1 - start] * (end - i - 1)
        if cost < best:
            best, position = cost, i + 1
    return best, position


@kernel
def _write_box(ids, start, end, boxes, nodes, node):
    """Write the box of ids[start:end] into ``node``."""
    box = _EMPTY
    for i in range(start, end):
        box = _grown(box, boxes, ids[i])
    for k in range(BOX_FLOATS):
        nodes[BVH_WORDS * node + LOWER + k] = box[k]


@inlined
def _box_of(nodes, node):
    b, t = BVH_WORDS * node + LOWER, BVH_WORDS * node + UPPER
    return nodes[b], nodes[b + 1], nodes[b + 2], nodes[t], nodes[t + 1], nodes[t + 2]


@kernel
def _longest_axis(box):
    x0, y0, z0, x1, y1, z1 = box
    dx, dy, dz = x1 - x0, y1 - y0, z1 - z0
    if dx >= dy and dx >= dz:
        return 0
    return 1 if dy >= dz else 2


@kernel
def _partition(ids, start, end, goes_right, scratch):
    """Partition ids[start:end], keeping the order: first the ones that stay left."""
    n_right, at = 0, start
    for i in range(start, end):
        if goes_right[ids[i]]:
            scratch[n_right] = ids[i]
            n_right += 1
        else:
            ids[at] = ids[i]
            at += 1
    for i in range(n_right):
        ids[at + i] = scratch[i]


@kernel
def _sort_leaves(words, n_nodes, prims, spare):
    """Bring the triangles of every leaf into ascending order."""
    for node in range(n_nodes):
        meta = words[BVH_WORDS * node + META]
        if meta & AXIS_MASK == LEAF_AXIS:
            start, count = np.int64(words[BVH_WORDS * node + CHILD]), np.int64(meta >> AXIS_BITS)
            sort(prims[start : start + count], count, spare)


@kernel
def _sweep_split(orders, n, start, end, boxes, right_area, longest):
    """Return (cost, axis, position) of the cheapest of the three sweeps; a pair is cut along the box's longest axis."""
    if end - start == 2:
        cost, position = _sweep_axis(orders[longest * n : (longest + 1) * n], start, end, boxes, right_area)
        return cost, longest, position
    best, axis, at = np.inf, 0, -1
    for k in range(3):
        cost, position = _sweep_axis(orders[k * n : (k + 1) * n], start, end, boxes, right_area)
        if cost < best:
            best, axis, at = cost, k, position
    return best, axis, at


@kernel
def _halve(orders, n, start, end, goes_right):
    """Mark the upper half of some triangles, by number; return where it begins among them."""
    numbers = orders[start:end].copy()
    numbers.sort()
    position = start + (end - start) // 2
    for i in range(start, end):
        goes_right[orders[i]] = orders[i] >= numbers[position - start]
    return position


@kernel
def _build(orders, boxes, goes_right, span, nodes, words, prims, rules, is_one_step):
    """Build the subtree of the triangles in ``span`` (first, end, level of the root); return (number of nodes, deepest level).

    Parameters
    ----------
    orders : (3 n,) int32
        The triangles sorted by centroid along x, y and z, one order after another; a subtree parts its span of each.
    boxes : (6 n,) float32
    goes_right : (n,) uint8
        Scratch, by triangle: subtrees of one tree have different ones.
    nodes, words : float32 and uint32 array
        The same memory, filled depth-first from the root on.
    prims : (n,) int32
        Filled in the span; those of a leaf are in any order.
    rules : LeafRules
    is_one_step : bool
        Split the root only, so that other threads build its children.
    """
    n, (first, stop, root_level) = goes_right.size, span
    trav, min_leaf, max_leaf = rules
    right_area = np.empty(stop - first, np.float64)
    scratch = np.empty(stop - first, np.int32)
    todo = np.empty((stop - first + 1, 4), np.int64)
    todo[0, _NODE], todo[0, _LEVEL], todo[0, _START], todo[0, _END] = 0, root_level, first, stop
    n_todo, n_nodes, max_level = 1, np.int64(1), root_level
    _write_box(orders[:n], first, stop, boxes, nodes, np.int64(0))
    while n_todo > 0:
        n_todo -= 1
        node, level = todo[n_todo, _NODE], todo[n_todo, _LEVEL]
        start, end = todo[n_todo, _START], todo[n_todo, _END]
        max_level = max(max_level, level)
        w, count = BVH_WORDS * node, end - start
        box = _box_of(nodes, node)
        area = _half_area(box)
        cost, axis, position = np.inf, 0, -1
        if count > 1 and count > min_leaf:
            cost, axis, position = _sweep_split(orders, n, start, end, boxes, right_area, _longest_axis(box))
        # Without area, all children are hit as often as the node itself, so no split pays. The comparison is also false for
        # the NaN of an infinite cost times 0.
        if not trav * area + cost < area * count and count <= max_leaf:
            prims[start:end] = orders[start:end]
            words[w + CHILD], words[w + META] = start, count << AXIS_BITS | LEAF_AXIS
            continue
        is_cut = cost < area * count * NO_SMALLER
        if not is_cut:
            axis = _longest_axis(box)
        order = orders[axis * n : (axis + 1) * n]
        if is_cut:
            for i in range(start, end):
                goes_right[order[i]] = i >= position
        else:
            position = _halve(order, n, start, end, goes_right)
        for k in range(3):
            if k != axis or not is_cut:
                _partition(orders[k * n : (k + 1) * n], start, end, goes_right, scratch)
        words[w + CHILD], words[w + META] = n_nodes, axis
        words[BVH_WORDS * n_nodes + CHILD] = position  # until the left child is built: where its triangles end
        _write_box(order, start, position, boxes, nodes, n_nodes)
        _write_box(order, position, end, boxes, nodes, n_nodes + 1)
        todo[n_todo, _NODE], todo[n_todo, _LEVEL] = n_nodes + 1, level + 1
        todo[n_todo, _START], todo[n_todo, _END] = position, end
        n_todo += 1
        todo[n_todo, _NODE], todo[n_todo, _LEVEL] = n_nodes, level + 1
        todo[n_todo, _START], todo[n_todo, _END] = start, position
        n_todo += 1
        n_nodes += 2
        if is_one_step:
            break
    return n_nodes, max_level


def _orders(boxes: np.ndarray, threads: int) -> np.ndarray:
    """Return the triangles sorted by centroid along x, y and z, one order after another: (3 n,) int32."""
    orders = np.empty((3, len(boxes)), np.int32)

    def fill(k: int) -> None:
        # Twice the centre of the box, in float64: the sum of two float32 does not overflow there.
        orders[k] = np.argsort(boxes[:, k].astype(np.float64) + boxes[:, 3 + k], kind="stable")

    with thread_pool(threads) as pool:
        list(pool.map(fill, range(3)))
    return orders.reshape(-1)


class _Span(NamedTuple):
    """The triangles of a subtree, a stretch of every order, and the level of its root."""

    first: int
    stop: int
    level: int


class _Subtree(NamedTuple):
    nodes: np.ndarray  # BVH_NODE, the root first
    level: int  # of the deepest


def _build_on_threads(
    orders: np.ndarray, boxes: np.ndarray, prims: np.ndarray, rules: LeafRules, threads: int
) -> tuple[np.ndarray, int]:  # fmt: skip
    """Return the nodes, and the deepest level."""
    goes_right = np.zeros(prims.size, np.uint8)

    def step(span: _Span, is_one_step: bool) -> tuple[_Subtree, list[_Span]]:
        nodes = np.zeros(3 if is_one_step else max(2 * (span.stop - span.first) - 1, 1), BVH_NODE)
        flat, words = nodes.view(np.float32), nodes.view(np.uint32)
        n_nodes, deepest = _build(orders, boxes, goes_right, tuple(span), flat, words, prims, rules, is_one_step)
        built, level = _Subtree(nodes[:n_nodes].copy(), int(deepest)), span.level + 1
        if not is_one_step or n_nodes == 1:
            return built, []
        middle = int(nodes["child"][1])
        return built, [_Span(span.first, middle, level), _Span(middle, span.stop, level)]

    root = build_in_parts(step, _Span(0, prims.size, 0), lambda span: span.stop - span.first, threads)
    if not root.children:
        return root.built
    parts = list(placed(root))
    nodes = np.zeros(1 + sum(len(part.built.nodes) - 1 for part, *_ in parts), BVH_NODE)
    nodes[0] = root.built.nodes[0]
    for part, at, n in parts:
        built = part.built
        below = nodes[n : n + len(built.nodes) - 1]
        below[:] = built.nodes[1:]
        # A root's box is its parent's, which has the same faces; zeros of another sign would be other bytes.
        nodes["child"][at], nodes["meta"][at] = built.nodes["child"][0], built.nodes["meta"][0]
        for array in (nodes[at : at + 1], below):
            is_inner = array["meta"] & AXIS_MASK != LEAF_AXIS
            array["child"][is_inner] += np.uint32(n - 1)
    return nodes, max(part.built.level for part, *_ in parts)


def build_bvh(
    triangles: np.ndarray, *, builder: str = "sweep", c_trav: float = 1.0, c_isect: float = 1.0, min_leaf: int = 0,
    max_leaf: int | None = None, threads: int = 1,
) -> Tree:  # fmt: skip
    """Build a BVH.

    Parameters
    ----------
    triangles : (n, 3, 3) float32
        Finite; n from 1 to 2^29.
    builder : {"sweep", "binned"}
        Exact SAH over all centroid orders, or the cheapest plane between up to 16 bins per axis (``rtrace.trees.binned_sah``).
    c_trav, c_isect : float
        Cost of visiting an inner node (not negative) and of testing a triangle (positive).
    min_leaf, max_leaf : int
        A node with up to ``min_leaf`` triangles is a leaf; one with more than ``max_leaf`` is not, whatever it costs. None: no
        limit.
    threads : int
        Of the builder ``sweep``, for large scenes; the tree does not depend on it.

    Raises
    ------
    ValueError
        Another shape or dtype, a coordinate that is NaN or infinite, an unknown builder, or a cost or limit that cannot be.

    Notes
    -----
    Manta's DynBVH (2012): costs 1 and 1, a pair is split along the longest axis, leaves list ascending numbers.
    """
    if triangles.dtype != np.float32 or triangles.ndim != 3 or triangles.shape[1:] != (3, 3) or not len(triangles):
        raise NptraceError(
            f"triangles must be a non-empty (n, 3, 3) float32 array, got {triangles.shape} {triangles.dtype}; "
            "use vertices.astype(np.float32)[faces]"
        )
    check_finite(triangles)
    rules = leaf_rules(c_trav, c_isect, min_leaf, max_leaf)
    n = len(triangles)
    triangles = np.ascontiguousarray(triangles)
    prims = np.empty(n, np.int32)
    if builder == "sweep":
        boxes = np.concatenate(triangle_boxes(triangles), axis=1)
        extent = make_room(triangles, boxes[:, :3], boxes[:, 3:])
        nodes, max_level = _build_on_threads(_orders(boxes, threads), boxes.reshape(-1), prims, rules, threads)
        del boxes
    elif builder == "binned":
        nodes = np.zeros(2 * n, BVH_NODE)
        records, box = np.empty(binned_sah.WORDS * n, np.float32), np.empty(binned_sah.WORDS, np.float32)
        binned_sah.make_records(triangles.reshape(-1), records, records.view(np.uint32), box)
        extent = binned_sah.make_room(triangles, records, box)
        flat, words = nodes.view(np.float32), nodes.view(np.uint32)
        n_nodes, max_level = binned_sah.build_binned(records, records.view(np.uint32), box, flat, words, prims, rules)
        nodes = nodes[:n_nodes].copy()
    else:
        raise NptraceError(f"builder must be 'sweep' or 'binned', got {builder!r}")
    check_numbers(len(nodes), int(max_level))
    _sort_leaves(nodes.view(np.uint32), len(nodes), prims, np.empty(n, np.int32))
    corners = np.take(triangles, prims, axis=0)  # a third of the time of triangles[prims]
    params: dict[str, Any] = {"builder": builder}
    if (c_trav, c_isect) != (1.0, 1.0):
        params |= {"c_trav": float(c_trav), "c_isect": float(c_isect)}
    params |= limits_given(min_leaf, max_leaf)
    return Tree("bvh", nodes, prims, corners, triangles, extent.bounds, extent.core, int(max_level), params)
