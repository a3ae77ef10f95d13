"""The depth-first policy of TTP (arXiv 2605.16253, ISCA 2026): the more pops in a row, the deeper into the stack it reaches.

The first pop after a push requests the top entry, the second the next two, every further one the next sixteen; nothing twice
between two pushes. Requests wait in a queue, leave it when the ray demands their node first, and are cleared at the ray's end.
"""

from typing import NamedTuple

import numpy as np

from cachesim.policies import Facts, Policy, no_options
from cachesim.policies.hooks import NOTHING
from cachesim.policies.machine import ONE, Machine, drop, drop_demanded, offer, stop_waiting

FORM = "ttp"
HELP = "TTP (2026): 1, 2, then 16 entries from the top down at the first, second, further pop since a push"

_FIRST, _SECOND, _MORE = 1, 2, 16


class Ttp(NamedTuple):
    """The queue and the counter of every ray.

    Attributes
    ----------
    pointer, pops : (n_slots,) int64
        Entries below the pointer, and pops since the last push.
    queue : (n_slots, capacity) int64
        Nodes to request; ``n`` of them, the oldest first. It has room for a stack, and what does not fit is not queued.
    n : (n_slots,) int64
    """

    pointer: np.ndarray
    pops: np.ndarray
    queue: np.ndarray
    n: np.ndarray

    def on_start(self, machine, slot):
        self.pointer[slot] = 0
        self.pops[slot] = 0
        self.n[slot] = 0

    def on_push(self, machine, slot):
        self.pointer[slot] = machine.sp[slot]
        self.pops[slot] = 0

    def on_pop(self, machine, slot):
        demanded, kept = machine.stack[slot, machine.sp[slot]], np.int64(0)
        for i in range(self.n[slot]):
            node = self.queue[slot, i]
            if node == demanded:
                drop_demanded(machine, ONE)
                if i == 0:
                    machine.lines_asked[slot] = 0
            else:
                self.queue[slot, kept] = node
                kept += 1
        self.pops[slot] += 1
        self.pointer[slot] = min(self.pointer[slot], machine.sp[slot])
        left = _FIRST if self.pops[slot] == 1 else (_SECOND if self.pops[slot] == 2 else _MORE)
        n_new = np.int64(0)
        while left > 0 and self.pointer[slot] > 0 and kept < self.queue.shape[1]:
            self.pointer[slot] -= 1
            left -= 1
            node = machine.stack[slot, self.pointer[slot]]
            if machine.tree.n_lines[node] > 0:
                self.queue[slot, kept] = node
                kept += 1
                n_new += 1
        self.n[slot] = kept
        offer(machine, slot, n_new)
        if kept == 0:
            stop_waiting(machine, slot)

    def on_end(self, machine, slot):
        drop(machine, slot, self.n[slot])
        self.n[slot] = 0
        stop_waiting(machine, slot)

    def request(self, machine, slot):
        return self.queue[slot, 0] if self.n[slot] > 0 else np.int64(NOTHING)

    def requested(self, machine, slot):
        self.n[slot] -= 1
        for i in range(self.n[slot]):
            self.queue[slot, i] = self.queue[slot, i + 1]


def make_unit(machine: Machine, facts: Facts) -> Ttp:
    """Return the unit of a machine."""
    n_slots, depth = machine.stack.shape
    zeros = (np.zeros(n_slots, np.int64) for _ in range(3))
    return Ttp(next(zeros), next(zeros), np.zeros((n_slots, depth), np.int64), next(zeros))


POLICY = Policy("ttp", FORM, no_options, make_unit, begins_anew=True)
