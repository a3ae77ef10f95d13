"""What a prefetch policy sees and changes: the tree, the stacks of the rays in flight, the lines, and who wants the port."""

from typing import NamedTuple

import numpy as np

from nptrace_base.jit import inlined, kernel

#: What became of a demand read's line, for ``on_visit``.
HIT, FIRST_USE, MISS = range(3)

#: One candidate, as NumPy's: kernels are compiled for each literal.
ONE = np.int64(1)

# Status of a line, one bit each.
RESIDENT = 1  # in the cache
IN_FLIGHT = 2  # requested from memory
UNUSED = 4  # requested by a prefetch and not demanded since
PUSHED_OUT = 8  # a prefetch evicted it, and nothing has requested it since
LOST = 16  # a prefetch brought it, it was evicted unused, and nothing has requested it since

#: The port, and the account of candidates: nodes that a policy wants, until the port takes them. int64 each.
PORT = np.dtype(
    [
        (name, np.int64)
        for name in ("now", "blocked", "offered", "no_time", "port_busy", "mshr_full", "demanded_first", "issued")
    ]
)


class NodeColumns(NamedTuple):
    """Columns of the nodes.

    Attributes
    ----------
    n_prims : (n_nodes,) uint32
        Triangles in the leaf.
    level : (n_nodes,) uint16
        Steps from the root.
    parent : (n_nodes,) int32
    first_line : (n_nodes,) uint32
        Lowest line of the node.
    n_lines : (n_nodes,) uint32
        Lines that a read of the node touches; 0 if visiting it reads nothing. uint8 in a replay without a clock: 1 or 0.
    """

    n_prims: np.ndarray
    level: np.ndarray
    parent: np.ndarray
    first_line: np.ndarray
    n_lines: np.ndarray


class Machine(NamedTuple):
    """State that all policies share; the arrays are updated in place. A slot is the place of one ray in flight.

    Attributes
    ----------
    tree : NodeColumns
    stack : (n_slots, depth) int64
        Nodes on the stack of each slot, bottom first.
    pushed_at : (n_slots, depth) int64
        Row of the trace whose visit pushed each of them, counted over demand rows.
    sp : (n_slots,) int64
        Entries on each stack.
    ray : (n_slots,) int64
        Number of the ray of each slot, counted over the rays that read nodes; -1 in a replay without a clock.
    status : (n_lines,) uint8
        The bits above; empty in a replay without a clock.
    waiting : (2, n_slots + 2) int64
        Next and previous of each slot in the ring of those that wait for the port, oldest first, through the last column; the
        one before it is that of a unit shared by all rays. -1: does not wait.
    lines_asked : (n_slots + 1,) int64
        Lines that have been requested of the node that each slot waits to request.
    last_issue : (n_slots + 1,) int64
        Cycle in which the port last took a request of each slot.
    port : (1,) PORT
        ``now``, the cycle; ``blocked``, the slot whose prefetch waits for an MSHR (-1: none); and the account of candidates:
        ``offered`` by the policy; ``issued`` to the port; or dropped, for want of time, of the port or of an MSHR, or
        because the ray came first.
    """

    tree: NodeColumns
    stack: np.ndarray
    pushed_at: np.ndarray
    sp: np.ndarray
    ray: np.ndarray
    status: np.ndarray
    waiting: np.ndarray
    lines_asked: np.ndarray
    last_issue: np.ndarray
    port: np.ndarray


def lowest_on_lines(tree: NodeColumns, values: np.ndarray, n_lines: int, none: int) -> np.ndarray:
    """Return for each line the lowest of its nodes' values, (n_nodes,) int64; ``none`` where no node lies that is read."""
    lowest = np.full(n_lines, none, np.int64)
    enter_lowest(tree.first_line, tree.n_lines, values, lowest)
    return lowest


@kernel
def enter_lowest(first_line, n_lines, values, lowest):
    """Lower what is known of each line to the values of the nodes that lie on it."""
    for node in range(values.size):
        for piece in range(np.uint64(n_lines[node])):
            line = np.uint64(first_line[node]) + piece
            lowest[line] = min(lowest[line], values[node])


def make_machine(tree: NodeColumns, n_slots: int, n_lines: int = 0) -> Machine:
    """Return a machine in which nothing has happened; without a clock, ``n_lines`` is 0."""
    depth = max(int(tree.level.max()), 1)  # at most one entry per level above
    waiting = np.full((2, n_slots + 2), -1, np.int64)
    waiting[:, -1] = n_slots + 1
    port = np.zeros(1, PORT).view(np.recarray)
    port[0].blocked = -1
    return Machine(
        tree=tree,
        stack=np.zeros((n_slots, depth), np.int64),
        pushed_at=np.zeros((n_slots, depth), np.int64),
        sp=np.zeros(n_slots, np.int64),
        ray=np.full(n_slots, -1, np.int64),
        status=np.zeros(n_lines, np.uint8),
        waiting=waiting,
        lines_asked=np.zeros(n_slots + 1, np.int64),
        last_issue=np.full(n_slots + 1, -2, np.int64),
        port=port,
    )


@inlined
def first_waiting(machine):
    """Return the slot that has waited longest for the port, -1 if none waits."""
    ring = machine.sp.size + 1
    first = machine.waiting[0, ring]
    return first if first != ring else np.int64(-1)


@inlined
def stop_waiting(machine, slot):
    """Take a slot out of the ring, if it is there."""
    after, before = machine.waiting[0], machine.waiting[1]
    if after[slot] < 0:
        return
    machine.lines_asked[slot] = 0
    after[before[slot]] = after[slot]
    before[after[slot]] = before[slot]
    after[slot] = -1


@inlined
def offer(machine, slot, n):
    """Note ``n`` further candidates of a slot, which waits for the port from now on."""
    machine.port[0].offered += n
    after, before = machine.waiting[0], machine.waiting[1]
    ring = machine.sp.size + 1
    if n == 0 or after[slot] >= 0:
        return
    after[slot], before[slot] = ring, before[ring]
    after[before[ring]] = slot
    before[ring] = slot


@inlined
def drop(machine, slot, n):
    """Drop ``n`` candidates of a slot, for what it waited for last: an MSHR, the port, or time for more than one request."""
    port = machine.port[0]
    if port.blocked == slot:
        port.mshr_full += n
    elif machine.last_issue[slot] == port.now - 1:
        port.no_time += n
    else:
        port.port_busy += n


@inlined
def drop_demanded(machine, n):
    """Drop ``n`` candidates because their ray reads them now, or has passed them."""
    machine.port[0].demanded_first += n
