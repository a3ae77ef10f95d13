"""Which child of a node an any-hit ray should search first: the one where it is the cheaper to find any occluder.

Ize and Hansen 2011, "RTSAH Traversal Order for Occlusion Rays": the surface area heuristic with the end of a ray at its first
hit in it. Manta keeps the answer as a bit of each node; here it is an array beside the tree.
"""

import numpy as np

from nptrace_base.jit import kernel
from rtrace.trees.tree import AXIS_BITS, AXIS_MASK, CHILD, KD_META, LEAF_AXIS, META, Tree, words

#: (cost of a triangle test, cost of a node) for each tree, as Manta's (2013).
COSTS = {"kdtree": (2.0, 1.5), "bvh": (3.0, 1.0)}


def cheaper_children(tree: Tree) -> np.ndarray:
    """Return, for each node, which child is the cheaper to search first, (n_nodes,) uint8: 0 the lower, 1 the upper.

    The heuristic counts a ray that enters a leaf with triangles as stopped there. A ray through a kd node pierces both cells
    with the probability that their areas give; for the boxes of a BVH, which may overlap or leave a gap, the two are taken as
    independent.
    """
    is_kd = tree.kind == "kdtree"
    n, words_per_node = tree.nodes.size, np.uint64(tree.nodes.itemsize // 4)
    floats, whole = words(tree)
    areas = np.empty(n)
    if is_kd:
        boxes = np.empty((n, 6))
        boxes[0] = tree.bounds.reshape(-1)
        _cell_areas(floats, whole, boxes, areas)
    else:
        size = (tree.nodes["upper"].astype(np.float64) - tree.nodes["lower"]).T
        areas[:] = size[0] * size[1] + size[1] * size[2] + size[2] * size[0]
    per_triangle, per_node = COSTS["kdtree" if is_kd else "bvh"]
    cheaper, cost, passes = np.zeros(n, np.uint8), np.empty(n), np.empty(n)
    _search_costs(whole, words_per_node, is_kd, areas, per_triangle, per_node, (cheaper, cost, passes))
    return cheaper


@kernel
def _cell_areas(floats, whole, boxes, areas):
    """Write half the surface area of every kd cell; ``boxes`` holds the root's, and room for all of them."""
    for i in range(areas.size):
        x, y, z = boxes[i, 3] - boxes[i, 0], boxes[i, 4] - boxes[i, 1], boxes[i, 5] - boxes[i, 2]
        areas[i] = x * y + y * z + z * x
        meta = whole[2 * i + KD_META]
        axis = np.int64(meta & np.uint32(AXIS_MASK))
        if axis != LEAF_AXIS:
            child = np.int64(meta >> np.uint32(AXIS_BITS))
            boxes[child], boxes[child + 1] = boxes[i], boxes[i]
            boxes[child, 3 + axis] = boxes[child + 1, axis] = floats[2 * i]


@kernel
def _search_costs(whole, words_per_node, is_kd, areas, per_triangle, per_node, out):
    """Write, for each node, the cheaper child, the cost of a search below it, and the share of rays that pass unstopped."""
    cheaper, cost, passes = out
    for k in range(areas.size):
        i = areas.size - 1 - k  # children have higher numbers than their parents
        first = np.uint64(i) * words_per_node
        meta = whole[first + np.uint64(KD_META if is_kd else META)]
        n_prims = meta >> np.uint32(AXIS_BITS)
        if meta & np.uint32(AXIS_MASK) == LEAF_AXIS:
            cost[i], passes[i] = per_node + per_triangle * n_prims, 1.0 if n_prims == 0 else 0.0
            continue
        a = np.int64(n_prims) if is_kd else np.int64(whole[first + np.uint64(CHILD)])
        b = a + 1
        in_a, in_b = (areas[a] / areas[i], areas[b] / areas[i]) if areas[i] > 0.0 else (1.0, 1.0)
        both = max(in_a + in_b - 1.0, 0.0) if is_kd else in_a * in_b
        a_first, b_first = cost[a] + passes[a] * cost[b], cost[b] + passes[b] * cost[a]
        cheaper[i] = 0 if a_first < b_first else 1
        cost[i] = per_node + (in_a - both) * cost[a] + (in_b - both) * cost[b] + both * min(a_first, b_first)
        none = 1.0 - (in_a + in_b - both)
        passes[i] = (in_a - both) * passes[a] + (in_b - both) * passes[b] + both * passes[a] * passes[b] + none
