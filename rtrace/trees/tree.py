"""The trees in memory: the node layouts, and Tree, a NamedTuple of flat arrays that every kernel walks.

Both layouts are Manta's (2013): root 0, sibling pairs from number 1 on, so the sibling of node ``i`` is ``((i - 1) ^ 1) + 1``;
a pair is numbered when its parent is split, then the left subtree, then the right (depth-first).
"""

from typing import NamedTuple

import numpy as np

from nptrace_base.errors import NptraceError
from nptrace_base.jit import kernel

#: Low two bits of ``meta``: the split axis 0, 1, 2 of an inner node, or LEAF. The upper 30 bits are the number of
#: primitives of a leaf, or, in an inner kd node, the number of its lower child.
LEAF = 3

#: A kd-tree node in 8 bytes: four of them fill a 32-byte line.
KD_NODE = np.dtype(
    {
        "names": ["split", "first", "meta"],
        "formats": ["<f4", "<u4", "<u4"],
        "offsets": [0, 0, 4],  # split (inner) and first (leaf: where its primitives start in prims) share bytes 0-3
        "itemsize": 8,
    }
)

#: A BVH node in 32 bytes: its own box, then ``child`` (inner: the lower child; leaf: where its primitives start in prims).
BVH_NODE = np.dtype([("lower", "<f4", 3), ("upper", "<f4", 3), ("child", "<u4"), ("meta", "<u4")])


class Tree(NamedTuple):
    """One acceleration structure over triangles; the arrays are C-contiguous and not to be written to.

    Attributes
    ----------
    kind : str
        ``"kdtree"`` or ``"bvh"``.
    nodes : (n_nodes,) KD_NODE or BVH_NODE
    prims : (n_refs,) int32
        Triangle numbers, leaf by leaf, ascending inside a leaf.
    corners : (n_refs, 3, 3) float32
        The triangles of ``prims``, in that order: a leaf's lie side by side.
    triangles : (n_triangles, 3, 3) float32
        The scene's triangles, in their own order.
    bounds : (2, 3) float32
        Lower and upper corner of the box of all triangles, with the room around strays.
    core : (2, 3) float32
        The same of the triangles that are no strays (``rtrace.trees.strays``): what margins are a share of.
    max_level : int
        Level of the deepest node, root 0: also the most entries a traversal stack can hold.
    params : dict
        What the builder was asked for, as written into a run's footer.
    """

    kind: str
    nodes: np.ndarray
    prims: np.ndarray
    corners: np.ndarray
    triangles: np.ndarray
    bounds: np.ndarray
    core: np.ndarray
    max_level: int
    params: dict


def words(tree: Tree) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes as one flat float32 and one flat uint32 array over the same memory: 2 (kd) or 8 (BVH) words a node."""
    return tree.nodes.view(np.float32), tree.nodes.view(np.uint32)


def check_finite(triangles: np.ndarray) -> None:
    """Raise NptraceError if a coordinate is NaN or infinite."""
    if not np.isfinite(triangles).all():
        ends = [triangles.min(axis=(0, 1)).tolist(), triangles.max(axis=(0, 1)).tolist()]
        raise NptraceError(f"triangles must be finite, got bounds {ends}; drop the triangles with NaN or inf")


def triangle_boxes(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and upper corner of every finite triangle, each (n, 3) float32; NumPy's own took ten times the time."""
    lower, upper = np.empty((2, len(triangles), 3), np.float32)
    _boxes(triangles.reshape(-1), lower.reshape(-1), upper.reshape(-1))
    return lower, upper


@kernel
def _boxes(corners, lower, upper):
    three, six, nine = np.uint64(3), np.uint64(6), np.uint64(9)
    for i in range(np.uint64(lower.size // 3)):
        for k in range(three):
            p, q, r = corners[i * nine + k], corners[i * nine + three + k], corners[i * nine + six + k]
            low, high = (p, q) if p < q else (q, p)
            lower[i * three + k] = r if r < low else low
            upper[i * three + k] = r if r > high else high


@kernel
def _node_columns(meta, words_per_node, is_kd, parent, level, axis, n_prims):
    """Fill the columns of all nodes; children have higher numbers than their parents."""
    parent[0], level[0] = -1, 0
    for i in range(np.uint64(parent.size)):
        word = meta[(i + np.uint64(1)) * words_per_node - np.uint64(1)]
        is_leaf = word & np.uint32(3) == LEAF
        axis[i] = word & np.uint32(3)
        n_prims[i] = word >> np.uint32(2) if is_leaf else np.uint32(0)
        if not is_leaf:
            child = np.uint64(word >> np.uint32(2)) if is_kd else np.uint64(meta[i * words_per_node + np.uint64(6)])
            for c in range(child, child + np.uint64(2)):
                parent[c], level[c] = i, level[i] + np.uint16(1)


def node_table(tree: Tree) -> dict[str, np.ndarray]:
    """Return one column per fact of a node, as ``nodes.parquet`` stores them.

    ``parent`` int32 (-1 for the root), ``level`` uint16, ``axis`` uint8 (3 for a leaf), ``n_prims`` uint32 (0 for an inner
    node), ``address`` uint64 in bytes (node number x node size), and ``split`` float32 (kd-tree; NaN for a leaf) or
    ``min_x`` ... ``max_z`` float32 (BVH).
    """
    nodes, n = tree.nodes, tree.nodes.size
    parent, level = np.empty(n, np.int32), np.empty(n, np.uint16)
    axis, n_prims = np.empty(n, np.uint8), np.empty(n, np.uint32)
    _node_columns(words(tree)[1], np.uint64(nodes.itemsize // 4), tree.kind == "kdtree", parent, level, axis, n_prims)
    table: dict[str, np.ndarray] = {
        "node": np.arange(n, dtype=np.uint32),
        "parent": parent,
        "level": level,
        "axis": axis,
        "n_prims": n_prims,
        "address": np.arange(0, n * nodes.itemsize, nodes.itemsize, dtype=np.uint64),
    }
    if tree.kind == "kdtree":
        table["split"] = np.where(axis == LEAF, np.float32(np.nan), nodes["split"])
    else:
        for k, name in enumerate("xyz"):
            table[f"min_{name}"] = np.ascontiguousarray(nodes["lower"][:, k])
            table[f"max_{name}"] = np.ascontiguousarray(nodes["upper"][:, k])
    return table
