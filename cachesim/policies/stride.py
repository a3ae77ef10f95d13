"""A stride prefetcher, trained for every ray and across rays (after Lee et al., MICRO 2010: many-thread-aware prefetching).

A slot whose last two strides between the lines of its reads are equal requests the next line at that stride: the stride
is confirmed. The stride confirmed last, by any slot, is also requested by a slot that has seen it once. A read of the
same line again is no stride.
"""

from typing import NamedTuple

import numpy as np

from cachesim.policies import Facts, Policy, no_options
from cachesim.policies.hooks import NOTHING, as_line
from cachesim.policies.machine import Machine
from cachesim.policies.next_line import forget, replace

FORM = "stride"
HELP = "the line at the stride of the last reads, of this ray or of another (after many-thread-aware prefetching, 2010)"


class Stride(NamedTuple):
    """The last line and stride of every ray.

    Attributes
    ----------
    line, last, stride : (n_slots,) int64
        The line to request (-1: none), the last line read (-1: none yet) and the stride to it.
    shared : (1,) int64
        The stride confirmed last by any slot; 0: none yet.
    """

    line: np.ndarray
    last: np.ndarray
    stride: np.ndarray
    shared: np.ndarray

    def on_start(self, machine, slot):
        self.line[slot] = -1
        self.last[slot] = -1
        self.stride[slot] = 0

    def on_visit(self, machine, slot, line, outcome):
        if self.last[slot] >= 0:
            stride = line - self.last[slot]
            if stride != 0:
                is_own = stride == self.stride[slot]
                if is_own or stride == self.shared[0]:
                    replace(self, machine, slot, line + stride)
                if is_own:
                    self.shared[0] = stride
                self.stride[slot] = stride
        self.last[slot] = line

    def on_end(self, machine, slot):
        forget(self, machine, slot)

    def request(self, machine, slot):
        return as_line(self.line[slot]) if self.line[slot] >= 0 else np.int64(NOTHING)

    def requested(self, machine, slot):
        self.line[slot] = -1


def make_unit(machine: Machine, facts: Facts) -> Stride:
    """Return the unit of a machine."""
    n_slots = machine.sp.size
    return Stride(
        np.full(n_slots, -1, np.int64), np.full(n_slots, -1, np.int64), np.zeros(n_slots, np.int64), np.zeros(1, np.int64)
    )


POLICY = Policy("stride", FORM, no_options, make_unit, needs_clock=True)
