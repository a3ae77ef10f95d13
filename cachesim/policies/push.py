"""Request the far child when it is pushed: the earliest that a stack prefetcher can ask. Not published."""

from typing import NamedTuple

import numpy as np

from cachesim.policies import Facts, Policy, no_options
from cachesim.policies.hooks import NOTHING
from cachesim.policies.machine import ONE, Machine, drop, drop_demanded, offer, stop_waiting

FORM = "push"
HELP = "the pushed sibling, from the push on"


class Push(NamedTuple):
    """One register a ray: the entry pushed last, until it is requested, popped, or replaced by the next push.

    Attributes
    ----------
    entry : (n_slots,) int64
        Its place on the stack, -1 for none.
    """

    entry: np.ndarray

    def on_start(self, machine, slot):
        self.entry[slot] = -1

    def on_push(self, machine, slot):
        if self.entry[slot] >= 0:
            drop(machine, slot, ONE)
            stop_waiting(machine, slot)
        self.entry[slot] = -1
        if machine.tree.n_lines[machine.stack[slot, machine.sp[slot] - 1]] > 0:
            self.entry[slot] = machine.sp[slot] - 1
            offer(machine, slot, ONE)

    def on_pop(self, machine, slot):
        if self.entry[slot] >= machine.sp[slot]:
            drop_demanded(machine, ONE)
            stop_waiting(machine, slot)
            self.entry[slot] = -1

    def on_end(self, machine, slot):
        if self.entry[slot] >= 0:
            drop(machine, slot, ONE)
            stop_waiting(machine, slot)
            self.entry[slot] = -1

    def request(self, machine, slot):
        return machine.stack[slot, self.entry[slot]] if self.entry[slot] >= 0 else np.int64(NOTHING)

    def requested(self, machine, slot):
        self.entry[slot] = -1


def make_unit(machine: Machine, facts: Facts) -> Push:
    """Return the unit of a machine."""
    return Push(np.full(machine.sp.size, -1, np.int64))


POLICY = Policy("push", FORM, no_options, make_unit, begins_anew=True)
