"""Where each node lies in memory: columns of nodes.parquet and a layout's name -> one byte address per node.

Every layout is a permutation of the slots of ``stored``, apart from the padding that ``LAYOUTS`` names. ``+BYTES`` after a
name moves all nodes: with ``stored+8``, the sibling pairs of an 8-byte kd-tree start at multiples of 16 bytes, so no pair
crosses a line boundary.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cachesim.config import format_bytes, parse_bytes
from nptrace_base.errors import NptraceError
from nptrace_base.jit import kernel

#: The layouts, and what each does with nodes and sibling pairs.
LAYOUTS = {
    "stored": "in the order of the node numbers: pairs adjacent, depth-first, left subtree first",
    "bfs": "level by level, pairs adjacent",
    "dfs": "every left child directly after its parent; pairs are not adjacent",
    "veb": "van Emde Boas: the upper half of the levels, then each subtree below, recursively; pairs adjacent",
    "treelet:BYTES": "blocks of BYTES, each filled with a subtree from its root down; pairs adjacent and aligned to their "
    "size, so one node of padding after the root; a block whose subtree ends early is filled with the next subtree",
}


@dataclass(frozen=True, slots=True)
class Layout:
    """A parsed layout: its name, the bytes of a treelet's block (0 for the others) and the address of the first node."""

    name: str
    block_bytes: int = 0
    base: int = 0

    def __str__(self) -> str:
        block = f":{format_bytes(self.block_bytes)}" if self.block_bytes else ""
        return f"{self.name}{block}" + (f"+{format_bytes(self.base)}" if self.base else "")


def parse_layout(text: str) -> Layout:
    """Return the layout that a text such as ``veb``, ``treelet:256`` or ``stored+8`` names."""
    name, plus, base = text.strip().lower().partition("+")
    name, colon, block = name.partition(":")
    known = ", ".join(LAYOUTS)
    if name not in {each.partition(":")[0] for each in LAYOUTS}:
        raise NptraceError(f"{text!r} is not a layout; choose one of {known}; +BYTES moves it")
    if (name == "treelet") != bool(colon):
        raise NptraceError(f"{text!r} is not a layout: only treelet has a block size, and needs it; write e.g. treelet:256")
    layout = Layout(name, parse_bytes(block) if colon else 0, parse_bytes(base) if plus else 0)
    if colon and layout.block_bytes < 1:
        raise NptraceError(f"{text!r}: a treelet of 0 B holds no node; write e.g. treelet:256")
    if layout.base >= 1 << 62:
        raise NptraceError(f"{text!r}: {base} is beyond the largest address, 2^62; move the nodes by less")
    return layout


def addresses(nodes: Mapping[str, np.ndarray], node_bytes: int, layout: Layout | str, reads_leaves: bool = True) -> np.ndarray:
    """Return the byte address of every node, (n_nodes,) int64; -1 for a leaf where leaves are no nodes in memory.

    Parameters
    ----------
    nodes : mapping
        The columns ``parent`` (-1 for the root) and ``level`` of ``nodes.parquet``. Siblings are (1, 2), (3, 4) ... and
        have larger numbers than their parent.
    node_bytes : int
    layout : Layout or str
    reads_leaves : bool
        As the node format has it. Without them the inner nodes alone are placed, by the same rules.
    """
    if isinstance(layout, str):
        layout = parse_layout(layout)
    if not reads_leaves:
        parents = _parents(nodes)
        addresses = np.full(parents.size, -1, np.int64)
        inner = parents[1::2]  # by the number of their pair of children, which is how they are stored
        addresses[inner] = layout.base + node_bytes * _inner_slots(nodes, parents, node_bytes, layout)
        return addresses
    if layout.name == "stored":
        return addresses_in_order(nodes["level"].size, node_bytes, layout)
    if layout.name == "bfs":
        slots = _positions(np.argsort(nodes["level"], kind="stable"))
    elif layout.name == "dfs":
        slots = np.empty(nodes["parent"].size, np.int64)
        dfs_slots(first_children(_parents(nodes)), np.empty(slots.size + 1, np.int64), slots)
    else:
        slots = _pair_slots(_parents(nodes), node_bytes, layout)
    return layout.base + node_bytes * slots


def addresses_in_order(n_nodes: int, node_bytes: int, layout: Layout) -> np.ndarray:
    """Return the byte address of every node in the order of the node numbers, (n_nodes,) int64."""
    return layout.base + node_bytes * np.arange(n_nodes, dtype=np.int64)


def _parents(nodes: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the parents as int64, checked: the kernels below follow them without a check."""
    parents = np.ascontiguousarray(nodes["parent"], np.int64)
    lower, upper = parents[1::2], parents[2::2]
    numbers = np.arange(1, parents.size, 2)
    is_wrong = parents.size % 2 == 0 or (lower != upper).any() or (lower < 0).any() or (lower >= numbers).any()
    if is_wrong or np.bincount(lower, minlength=1).max() > 1:
        raise NptraceError("the nodes are not sibling pairs (1, 2), (3, 4), ..., each with one parent; render the run again")
    return parents


def _positions(order: np.ndarray) -> np.ndarray:
    """Return the inverse of a permutation."""
    positions = np.empty(order.size, np.int64)
    positions[order] = np.arange(order.size)
    return positions


def _inner_slots(nodes: Mapping[str, np.ndarray], parents: np.ndarray, node_bytes: int, layout: Layout) -> np.ndarray:
    """Return the slot of each inner node where they alone are in memory, in the order of their pairs of children."""
    inner = parents[1::2]
    if layout.name == "stored" or not inner.size:
        return np.arange(inner.size)
    if layout.name == "bfs":
        return _positions(np.argsort(nodes["level"][inner], kind="stable"))
    if layout.name == "dfs":
        slots = np.empty(parents.size, np.int64)
        dfs_slots(first_children(parents), np.empty(slots.size + 1, np.int64), slots)
        return _positions(np.argsort(slots[inner]))
    return _positions(_subtree_order((inner + 1) // 2 - 1, node_bytes, layout, f"{node_bytes}-byte nodes"))


def _subtree_order(parents: np.ndarray, unit_bytes: int, layout: Layout, what: str) -> np.ndarray:
    """Return the order in which ``veb`` or ``treelet`` places units of one size (``what`` names them)."""
    first, next_ = pair_children(parents)
    order = np.empty(parents.size, np.int64)
    if layout.name == "veb":
        stack, walk = np.empty((parents.size + 1, 2), np.int64), np.empty(parents.size, np.int64)
        veb_order(first, next_, heights(parents), stack, walk, order)
        return order
    per_block = layout.block_bytes // unit_bytes
    if per_block * unit_bytes != layout.block_bytes:
        raise NptraceError(
            f"a treelet of {layout.block_bytes} B is not a whole number of {what}; "
            f"write e.g. treelet:{max(per_block, 1) * unit_bytes}"
        )
    per_block = min(per_block, parents.size)  # a larger block would hold the whole tree too
    treelet_order(first, next_, per_block, np.empty(parents.size, np.int64), np.empty(per_block, np.int64), order)
    return order


def _pair_slots(parents: np.ndarray, node_bytes: int, layout: Layout) -> np.ndarray:
    """Return the slot of each node where whole pairs are ordered (pair 0 is the root alone, pair k nodes 2k - 1 and 2k)."""
    n_pairs = (parents.size + 1) // 2
    pair_parents = np.full(n_pairs, -1, np.int64)
    pair_parents[1:] = (parents[1::2] + 1) // 2
    first_slots = 2 * _positions(_subtree_order(pair_parents, 2 * node_bytes, layout, f"pairs of {node_bytes}-byte nodes"))
    if layout.name == "veb":
        first_slots -= 1  # the root has no sibling: its pair is one slot
    slots = np.empty(parents.size, np.int64)
    slots[0] = 0
    slots[1::2] = first_slots[1:]
    slots[2::2] = first_slots[1:] + 1
    return slots


@kernel
def first_children(parents):
    """Return the lower child of every node, 0 for a leaf."""
    children = np.zeros(parents.size, np.int64)
    for node in range(1, parents.size, 2):
        children[parents[node]] = node
    return children


@kernel
def dfs_slots(children, stack, slots):
    """Number the nodes depth-first, left child right after its parent."""
    stack[0] = 0
    n_stack, n = 1, 0
    while n_stack:
        n_stack -= 1
        node = stack[n_stack]
        slots[node] = n
        n += 1
        if children[node]:
            stack[n_stack] = children[node] + 1
            stack[n_stack + 1] = children[node]
            n_stack += 2


@kernel
def pair_children(parents):
    """Return (first child, next sibling) of every pair, -1 for none; a pair has up to two children, in ascending order."""
    first = np.full(parents.size, -1, np.int64)
    next_ = np.full(parents.size, -1, np.int64)
    for pair in range(parents.size - 1, 0, -1):
        next_[pair] = first[parents[pair]]
        first[parents[pair]] = pair
    return first, next_


@kernel
def heights(parents):
    """Return the number of levels of the subtree under every pair, itself included."""
    height = np.ones(parents.size, np.int64)
    for pair in range(parents.size - 1, 0, -1):
        if height[parents[pair]] <= height[pair]:
            height[parents[pair]] = height[pair] + 1
    return height


@kernel
def veb_order(first, next_, height, stack, walk, order):
    """Order the pairs as van Emde Boas does: ``stack`` holds (subtree, levels of it), ``walk`` is scratch."""
    stack[0, 0], stack[0, 1] = 0, height[0]
    n_stack, n = 1, 0
    while n_stack:
        n_stack -= 1
        top = stack[n_stack, 0]
        levels = min(stack[n_stack, 1], height[top])
        if levels == 1:
            order[n] = top
            n += 1
            continue
        upper = levels // 2
        # The pairs `upper` levels below the top, from left to right: breadth-first, in place in `walk`.
        walk[0] = top
        start, end = 0, 1
        for _ in range(upper):
            filled = end
            for i in range(start, end):
                child = first[walk[i]]
                while child >= 0:
                    walk[filled] = child
                    filled += 1
                    child = next_[child]
            start, end = end, filled
        for i in range(end - 1, start - 1, -1):
            stack[n_stack, 0], stack[n_stack, 1] = walk[i], levels - upper
            n_stack += 1
        stack[n_stack, 0], stack[n_stack, 1] = top, upper
        n_stack += 1


@kernel
def treelet_order(first, next_, per_block, pending, queue, order):
    """Order the pairs in blocks of ``per_block``; each is filled breadth-first from the next subtree waiting."""
    pending[0] = 0
    n_pending, n = 1, 0
    while n_pending:
        taken = 0
        while taken < per_block and n_pending:
            n_pending -= 1
            queue[taken] = pending[n_pending]
            here, taken = taken, taken + 1
            while here < taken:
                pair = queue[here]
                here += 1
                order[n] = pair
                n += 1
                child = first[pair]
                while child >= 0:
                    if taken < per_block:
                        queue[taken] = child
                        taken += 1
                    else:
                        pending[n_pending] = child
                        n_pending += 1
                    child = next_[child]
