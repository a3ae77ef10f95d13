"""The paper's unit with an oracle in front: of its candidates, only those that a first pass used before they were evicted."""

from typing import Any, NamedTuple

import numpy as np

from cachesim.policies import Facts, Policy, hooks, stack
from cachesim.policies.machine import FIRST_USE, Machine

FORM = "oracle[:OPTIONS OF STACK]"
HELP = "of the candidates of stack, those that a first pass has used"


class Watched(NamedTuple):
    """The paper's unit, watched: which entries of the stack did it request in time to be used?

    Attributes
    ----------
    unit : Stack
    used : (n_rows,) uint8
        Per demand row: the entry pushed there was requested, and the line was used before it was evicted.
    requested_for : (n_lines,) int64
        Demand row of the entry for which each line was requested last.
    """

    unit: stack.Stack
    used: np.ndarray
    requested_for: np.ndarray

    def on_start(self, machine, slot):
        hooks.on_start(self.unit, machine, slot)

    def on_push(self, machine, slot):
        hooks.on_push(self.unit, machine, slot)

    def on_pop(self, machine, slot):
        hooks.on_pop(self.unit, machine, slot)

    def on_leaf(self, machine, slot, node):
        hooks.on_leaf(self.unit, machine, slot, node)

    def on_leaf_end(self, machine, slot):
        hooks.on_leaf_end(self.unit, machine, slot)

    def on_end(self, machine, slot):
        hooks.on_end(self.unit, machine, slot)

    def on_visit(self, machine, slot, line, outcome):
        if outcome == FIRST_USE:
            self.used[self.requested_for[line]] = 1

    def request(self, machine, slot):
        node = hooks.request(self.unit, machine, slot)
        if node >= 0:
            line = np.int64(machine.tree.first_line[node]) + machine.lines_asked[slot]
            self.requested_for[line] = machine.pushed_at[slot, self.unit.pointer[slot] - 1]
        return node

    def requested(self, machine, slot):
        hooks.requested(self.unit, machine, slot)


def scout(machine: Machine, facts: Facts, **options: Any) -> Watched:
    """Return the unit of the first pass."""
    unit = stack.make_unit(machine, facts, **options)
    return Watched(unit, np.zeros(facts.n_rows, np.uint8), np.zeros(machine.status.size, np.int64))


def make_unit(machine: Machine, facts: Facts, *, scouted: Watched, **options: Any) -> stack.Stack:
    """Return the unit of the second pass."""
    return stack.make_unit(machine, facts, **options)._replace(wanted=scouted.used)


POLICY = Policy("oracle", FORM, stack.parse_unit, make_unit, scout, needs_clock=True, watches_leaves=True, shown=stack.shown)
