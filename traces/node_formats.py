"""The formats of a tree's nodes in memory: what one read brings, and so what the rows of a run mean and where nodes lie.

A run's footer names its format as the kind of its tree. What another module has to know about a format is asked here; a new
format is an entry of ``NODE_FORMATS``, a kernel in ``rtrace.traversers`` and its slow twin in the tests.
"""

from typing import NamedTuple

import numpy as np

#: Which boxes a read brings, and so what the row after a read without a push (kind 0) is.
#: A split plane and no box: one child is followed, the row after. What is popped beyond the nearest hit is not read.
NO_BOX = 0
#: The node's own box, which was missed: the row after is popped. All that is popped is read.
OWN_BOX = 1
#: The boxes of its children: one is followed, or none is hit and the row after is popped. What is popped beyond the nearest
#: hit is not read. A leaf is no read: its box and the place of its triangles came with the parent.
CHILD_BOXES = 2

#: The address of a leaf that is no node in memory, as ``nodes.parquet`` has it.
NO_ADDRESS = np.uint64(2**64 - 1)


class NodeFormat(NamedTuple):
    """One format.

    Attributes
    ----------
    name : str
        The kind of tree in a footer, and the end of a run's name.
    title : str
        As printed.
    tree : str
        Which tree is built, ``"kdtree"`` or ``"bvh"``: formats of one tree have the same nodes, with the same numbers.
    node_bytes : int
        Bytes of a read.
    n_children : int
        Children of an inner node. A node with two pushes one at most, so a row of kind 1 tells which: the sibling of the next.
    boxes : int
        ``NO_BOX``, ``OWN_BOX`` or ``CHILD_BOXES``.
    version : int
        The first version of the format of runs that knows it.
    """

    name: str
    title: str
    tree: str
    node_bytes: int
    n_children: int
    boxes: int
    version: int

    @property
    def reads_leaves(self) -> bool:
        """Whether a leaf is a node in memory, so that rows of kind 2 are node accesses."""
        return self.boxes != CHILD_BOXES

    @property
    def takes_packets(self) -> bool:
        """Whether packets of rays walk the nodes, and shadow rays search them as Manta does: the formats that Manta has."""
        return self.boxes != CHILD_BOXES

    @property
    def address_rule(self) -> str:
        """What ``stored_addresses`` gives, in words."""
        if self.reads_leaves:
            return "an address is node number x node size"
        return "an inner node's address is the number of its pair of children, from 0, x node size, and a leaf's is 2^64 - 1"


#: Every format by its name. The 8-byte kd-tree and the 32-byte BVH are Manta's (2013); both boxes in the parent, in 64 bytes,
#: are Aila and Laine's (2009).
NODE_FORMATS = {
    each.name: each
    for each in (
        NodeFormat("kdtree", "kd-tree", "kdtree", 8, 2, NO_BOX, 1),
        NodeFormat("bvh", "BVH", "bvh", 32, 2, OWN_BOX, 1),
        NodeFormat("bvh64", "BVH, 64-byte nodes", "bvh", 64, 2, CHILD_BOXES, 2),
    )
}


def formats_of(tree: str) -> dict[int, NodeFormat]:
    """Return the formats of one tree by the bytes of a node; the first is the default."""
    return {each.node_bytes: each for each in NODE_FORMATS.values() if each.tree == tree}


def stored_slots(parent: np.ndarray, node_format: NodeFormat) -> np.ndarray:
    """Return the place of every node among those in memory, as stored: (n_nodes,) int64, -1 for a leaf that is none.

    ``parent`` is the column of ``nodes.parquet``. Where leaves are no nodes, the inner ones lie in the order of their pairs of
    children, which is depth-first: a pair gets its numbers when its parent is split.
    """
    if node_format.reads_leaves:
        return np.arange(parent.size, dtype=np.int64)
    slots = np.full(parent.size, -1, np.int64)
    slots[parent[1::2]] = np.arange(parent.size // 2)
    return slots


def stored_addresses(parent: np.ndarray, node_format: NodeFormat, node_bytes: int) -> np.ndarray:
    """Return the column ``address`` of ``nodes.parquet``, (n_nodes,) uint64."""
    if node_format.reads_leaves:
        return np.arange(0, parent.size * node_bytes, node_bytes, dtype=np.uint64)
    slots = stored_slots(parent, node_format)
    return np.where(slots < 0, NO_ADDRESS, slots.astype(np.uint64) * np.uint64(node_bytes))
