"""The trees in memory: the node layouts, and Tree, a NamedTuple of flat arrays that every kernel walks.

Both layouts are Manta's (2013): root 0, sibling pairs from number 1 on, so the sibling of node ``i`` is ``((i - 1) ^ 1) + 1``;
a pair is numbered when its parent is split, then the left subtree, then the right (depth-first).
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from nptrace_base.errors import NptraceError
from nptrace_base.jit import kernel
from traces.node_formats import CHILD_BOXES, NODE_FORMATS, stored_addresses

#: Low two bits of ``meta``: the split axis 0, 1, 2 of an inner node, or LEAF_AXIS. The upper 30 bits are the number of
#: primitives of a leaf, or, in an inner kd node, the number of its lower child.
AXIS_BITS, AXIS_MASK = 2, 3
LEAF_AXIS = 3

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


#: A pair of siblings as kernels of the format ``bvh64`` read it. For each axis the lower faces of both boxes, the upper ones,
#: and the lower ones again: the four from the first or from the third on are the nearer faces and then the farther ones, for
#: a ray of either direction, so that one test is made of both boxes. Then ``child`` and ``meta`` of both. The format itself
#: has every face once, in 64 bytes.
BVH_PAIR = np.dtype([("faces", "<f4", (3, 6)), ("links", "<u4", (2, 2)), ("room", "<u4", 2)])

#: The fields of a node as kernels see them: words of 4 bytes, counted from the node's first.
KD_WORDS, BVH_WORDS = KD_NODE.itemsize // 4, BVH_NODE.itemsize // 4
SPLIT, FIRST, KD_META = 0, 0, 1
LOWER, UPPER, CHILD, META = 0, 3, 6, 7
#: The same of a pair: where the faces of an axis and the links of a sibling begin, and how many words they have.
PAIR_WORDS, FACE_WORDS, LINKS, LINK_WORDS = BVH_PAIR.itemsize // 4, 6, 18, 2
LINK_CHILD, LINK_META = 0, 1

#: Most nodes of a tree, whose numbers have 30 bits in an access as in a node, and its deepest level, a uint16.
MOST_NODES, MOST_LEVEL = 1 << 30, 65535


class Tree(NamedTuple):
    """One acceleration structure over triangles; the arrays are C-contiguous and must not be modified.

    Attributes
    ----------
    kind : str
        Which tree it is and in which format its nodes are read: a name in ``traces.node_formats``. The arrays are those of
        the format's ``tree``, so that another format of that tree is the same arrays under its name.
    nodes : (n_nodes,) KD_NODE or BVH_NODE
    prims : (n_refs,) int32
        Triangle numbers, leaf by leaf, ascending inside a leaf.
    corners : (n_refs, 3, 3) float32
        The triangles of ``prims``, in that order: a leaf's lie side by side.
    triangles : (n_triangles, 3, 3) float32
        The scene's triangles, in their own order.
    bounds : (2, 3) float32
        Lower and upper corner of the box of all triangles, with the margins of strays.
    core : (2, 3) float32
        The same of the triangles that are not strays (``rtrace.trees.strays``); margins are a share of it.
    max_level : int
        Level of the deepest node, root 0: also the most entries a traversal stack can hold.
    params : dict
        The builder's parameters, as in a run's footer.
    pairs : (n_pairs,) BVH_PAIR or None
        In the format ``bvh64``: the nodes as kernels read them. Nodes 2k - 1 and 2k are pair k, the root is alone in pair 0.
    cheaper : (n_nodes,) uint8 or None
        The child that shadow rays search first, where they are asked to (``rtrace.trees.rtsah``).
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
    pairs: np.ndarray | None = None
    cheaper: np.ndarray | None = None


def check_numbers(n_nodes: int, max_level: int) -> None:
    """Raise NptraceError for a tree whose nodes or levels are more than their numbers can tell apart."""
    if n_nodes > MOST_NODES or max_level > MOST_LEVEL:
        raise NptraceError(
            f"a tree of {n_nodes:,} nodes and {max_level:,} levels is too large: the most are {MOST_NODES:,} and "
            f"{MOST_LEVEL:,}; raise min_leaf, or split the scene"
        )


def in_format(tree: Tree, kind: str) -> Tree:
    """Return a tree in a node format of its kind of tree."""
    if NODE_FORMATS[kind].boxes != CHILD_BOXES:
        return tree._replace(kind=kind, pairs=None)
    padded = np.zeros(tree.nodes.size + 1, BVH_NODE)
    padded[1:] = tree.nodes
    siblings = padded.reshape(-1, 2)
    pairs = np.zeros(len(siblings), BVH_PAIR)
    pairs["faces"][:, :, :2] = siblings["lower"].swapaxes(1, 2)
    pairs["faces"][:, :, 2:4] = siblings["upper"].swapaxes(1, 2)
    pairs["faces"][:, :, 4:] = pairs["faces"][:, :, :2]
    pairs["links"][:, :, 0], pairs["links"][:, :, 1] = siblings["child"], siblings["meta"]
    return tree._replace(kind=kind, pairs=pairs)


def words(tree: Tree) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes as one flat float32 and one flat uint32 array over the same memory: 2 (kd) or 8 (BVH) words a node."""
    return tree.nodes.view(np.float32), tree.nodes.view(np.uint32)


class TreeArrays(NamedTuple):
    """A Tree as the traversal kernels take it: every array flat."""

    nodes: np.ndarray  # float32: the words of the nodes, or of the pairs
    meta: np.ndarray  # uint32: the same memory
    prims: np.ndarray
    corners: np.ndarray
    core: np.ndarray
    bounds: np.ndarray
    max_level: int


def tree_arrays(tree: Tree) -> TreeArrays:
    """Return a tree's arrays, flat; nothing is copied."""
    if (tree.pairs is None) != (NODE_FORMATS[tree.kind].boxes != CHILD_BOXES):
        raise ValueError(f"a tree of kind {tree.kind} is not in its format; make it with in_format")  # kernels would crash
    corners, core, bounds = tree.corners.reshape(-1), tree.core.reshape(-1), tree.bounds.reshape(-1)
    nodes, meta = words(tree)
    if tree.pairs is not None:
        nodes, meta = tree.pairs.view(np.float32), tree.pairs.view(np.uint32)
    return TreeArrays(nodes, meta, tree.prims, corners, core, bounds, tree.max_level)


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
    axes, corner_floats = np.uint64(3), np.uint64(9)
    second, third = axes, axes + axes
    for i in range(np.uint64(lower.size // 3)):
        for k in range(axes):
            v, at = i * corner_floats + k, i * axes + k
            p, q, r = corners[v], corners[v + second], corners[v + third]
            low, high = (p, q) if p < q else (q, p)
            lower[at] = r if r < low else low
            upper[at] = r if r > high else high


@kernel
def _parents_and_levels(words, words_per_node, is_kd, parent, level):
    """Fill the columns of all nodes; children have higher numbers than their parents."""
    bits, mask = np.uint32(AXIS_BITS), np.uint32(AXIS_MASK)
    meta_word, child_word = np.uint64(KD_META if is_kd else META), np.uint64(CHILD)
    parent[0], level[0] = -1, 0
    for i in range(np.uint64(parent.size)):
        first = i * words_per_node
        meta = words[first + meta_word]
        if meta & mask != LEAF_AXIS:
            child = np.uint64(meta >> bits) if is_kd else np.uint64(words[first + child_word])
            for c in range(child, child + np.uint64(2)):
                parent[c], level[c] = i, level[i] + np.uint16(1)


def node_table(tree: Tree) -> dict[str, np.ndarray]:
    """Return one column per fact of a node, as ``nodes.parquet`` stores them.

    ``parent`` int32 (-1 for the root), ``level`` uint16, ``axis`` uint8 (3 for a leaf), ``n_prims`` uint32 (0 for an inner
    node), ``address`` uint64 in bytes (``traces.node_formats``), and ``split`` float32 (kd-tree; NaN for a leaf) or
    ``min_x`` ... ``max_z`` float32 (BVH).
    """
    [table] = node_tables(tree, tree.nodes.size)
    return table


def node_tables(tree: Tree, n_rows: int) -> Iterator[dict[str, np.ndarray]]:
    """Yield ``node_table`` in pieces of ``n_rows``: a large tree's whole table takes as much memory as the tree."""
    nodes, n, node_format = tree.nodes, tree.nodes.size, NODE_FORMATS[tree.kind]
    parent, level = np.empty(n, np.int32), np.empty(n, np.uint16)
    _parents_and_levels(words(tree)[1], np.uint64(nodes.itemsize // 4), tree.kind == "kdtree", parent, level)
    node_bytes = node_format.node_bytes
    address = None if node_format.reads_leaves else stored_addresses(parent, node_format, node_bytes)
    for first in range(0, n, n_rows):
        rows = slice(first, first + n_rows)
        meta, of = nodes["meta"][rows], parent[rows]
        axis = (meta & AXIS_MASK).astype(np.uint8)
        table: dict[str, np.ndarray] = {
            "node": np.arange(first, first + of.size, dtype=np.uint32),
            "parent": of,
            "level": level[rows],
            "axis": axis,
            "n_prims": np.where(axis == LEAF_AXIS, meta >> AXIS_BITS, 0).astype(np.uint32),
        }
        if address is None:
            table["address"] = stored_addresses(of, node_format, node_bytes) + np.uint64(first * node_bytes)
        else:
            table["address"] = address[rows]
        if tree.kind == "kdtree":
            table["split"] = np.where(axis == LEAF_AXIS, np.float32(np.nan), nodes["split"][rows])
        else:
            for k, name in enumerate("xyz"):
                table[f"min_{name}"] = np.ascontiguousarray(nodes["lower"][rows, k])
                table[f"max_{name}"] = np.ascontiguousarray(nodes["upper"][rows, k])
        yield table
