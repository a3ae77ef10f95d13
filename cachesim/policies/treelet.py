"""The treelet vote (Chou, Nowicki and Aamodt, MICRO 2023): the treelet that most rays in flight are in is requested whole.

Treelets are connected: filled breadth-first from their root until their bytes are used up. A vote is held at the first
read that is ``every`` cycles after the last; of treelets with as many rays, the one grown first wins. The winner's nodes are
requested by number, unless they are what was requested last, or its share of the rays is below ``share`` per cent.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from cachesim.policies import Facts, Policy, whole
from cachesim.policies.hooks import NOTHING
from cachesim.policies.machine import Machine, drop, lowest_on_lines, offer, stop_waiting
from nptrace_base.jit import inlined, kernel

FORM = "treelet[:bytes=B][:every=N][:share=P]"
HELP = "the treelet of most rays in flight (2023), of B = 512 bytes, every N = 200 cycles, with P = 0 % of the rays at least"


class Treelet(NamedTuple):
    """The vote.

    Attributes
    ----------
    treelet : (n_nodes,) int64
        Treelet of every node.
    first : (n_treelets + 1,) int64
        Where each begins in ``nodes``.
    nodes : (n_nodes,) int64
        The nodes of every treelet, its root first.
    of_line : (n_lines,) int64
        The treelet of the lowest node in each line.
    votes : (n_treelets,) int64
        Rays in flight in each.
    current : (n_slots,) int64
        Treelet of every ray, -1 for none.
    vote : (4,) int64
        Cycle of the last vote, its winner, the next of its nodes to request and the end of them.
    every, share : int
    """

    treelet: np.ndarray
    first: np.ndarray
    nodes: np.ndarray
    of_line: np.ndarray
    votes: np.ndarray
    current: np.ndarray
    vote: np.ndarray
    every: int
    share: int

    def on_visit(self, machine, slot, line, outcome):
        treelet = self.of_line[line]
        if self.current[slot] >= 0:
            self.votes[self.current[slot]] -= 1
        self.current[slot] = treelet
        self.votes[treelet] += 1
        now = machine.port[0].now
        if now - self.vote[0] < self.every:
            return
        self.vote[0] = now
        winner, n_rays = treelet, np.int64(0)
        for other in range(self.current.size):
            there = self.current[other]
            if there >= 0:
                n_rays += 1
                if self.votes[there] > self.votes[winner] or (self.votes[there] == self.votes[winner] and there < winner):
                    winner = there
        if winner == self.vote[1] or 100 * self.votes[winner] < self.share * n_rays:
            return
        drop_rest(self, machine)
        self.vote[1], self.vote[2], self.vote[3] = winner, self.first[winner], self.first[winner + 1]
        offer(machine, np.int64(self.current.size), self.vote[3] - self.vote[2])

    def on_end(self, machine, slot):
        if self.current[slot] >= 0:
            self.votes[self.current[slot]] -= 1
            self.current[slot] = -1

    def on_finish(self, machine):
        drop_rest(self, machine)

    def request(self, machine, slot):
        return self.nodes[self.vote[2]] if self.vote[2] < self.vote[3] else np.int64(NOTHING)

    def requested(self, machine, slot):
        self.vote[2] += 1


@inlined
def drop_rest(unit, machine):
    """Drop the nodes of the last winner that still wait; they wait in the place that all rays share."""
    shared = np.int64(unit.current.size)
    drop(machine, shared, unit.vote[3] - unit.vote[2])
    stop_waiting(machine, shared)
    unit.vote[2] = unit.vote[3]


@kernel
def grow_treelets(parent, n_lines, capacity):
    """Return (treelet of every node, how many there are): each is filled breadth-first with ``capacity`` nodes that are read.

    Of the roots that are left over, the one found last is grown next.
    """
    n_nodes = parent.size
    child = np.zeros(n_nodes, np.int64)
    for node in range(1, n_nodes):
        if child[parent[node]] == 0:
            child[parent[node]] = node
    treelet = np.full(n_nodes, -1, np.int64)
    roots, queue = np.empty(n_nodes, np.int64), np.empty(n_nodes, np.int64)
    roots[0], n_roots, n_treelets = 0, 1, 0
    while n_roots > 0:
        n_roots -= 1
        queue[0], head, tail, n_taken = roots[n_roots], 0, 1, 0
        while head < tail:
            node = queue[head]
            head += 1
            if n_lines[node] > 0 and n_taken == capacity:
                roots[n_roots] = node
                n_roots += 1
                continue
            n_taken += n_lines[node] > 0
            treelet[node] = n_treelets
            if child[node]:
                queue[tail], queue[tail + 1] = child[node], child[node] + 1
                tail += 2
        n_treelets += 1
    return treelet, n_treelets


def parse(options: Sequence[str]) -> dict[str, Any]:
    """Return bytes, every and share."""
    limits = {"bytes": (1, 1 << 20), "every": (1, 1_000_000), "share": (0, 100)}
    values = {"bytes": 512, "every": 200, "share": 0}
    for option in options:
        name = option.partition("=")[0]
        low, high = limits.get(name, (0, 0))
        values[name] = whole(option, name, low, high)
    return {"block_bytes": values["bytes"], "every": values["every"], "share": values["share"]}


def make_unit(machine: Machine, facts: Facts, *, block_bytes: int, every: int, share: int) -> Treelet:
    """Return the unit of a machine."""
    tree, n_slots = machine.tree, machine.sp.size
    treelet, n_treelets = grow_treelets(tree.parent, tree.n_lines, max(block_bytes // facts.node_bytes, 1))
    read = np.flatnonzero(tree.n_lines)
    nodes = read[np.argsort(treelet[read], kind="stable")]
    n_nodes = tree.n_lines.size
    lowest = lowest_on_lines(tree, np.arange(n_nodes), machine.status.size, n_nodes - 1)
    return Treelet(
        treelet=treelet,
        first=np.concatenate([[0], np.cumsum(np.bincount(treelet[read], minlength=n_treelets))]).astype(np.int64),
        nodes=nodes.astype(np.int64), of_line=treelet[lowest], votes=np.zeros(n_treelets, np.int64),
        current=np.full(n_slots, -1, np.int64), vote=np.array([0, -1, 0, 0], np.int64), every=every, share=share,
    )  # fmt: skip


POLICY = Policy("treelet", FORM, parse, make_unit, needs_clock=True)
