"""Sequential prefetchers in the cache (Smith 1982; DineroIV's always, miss and tagged): a line further on."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from cachesim.cache import ALWAYS, ON_MISS, TAGGED
from cachesim.policies import Facts, Policy, whole
from cachesim.policies.hooks import NOTHING, as_line
from cachesim.policies.machine import HIT, MISS, ONE, Machine, drop, offer, stop_waiting
from nptrace_base.errors import NptraceError
from nptrace_base.jit import inlined

FORM = "next-line:always|miss|tagged[:DISTANCE]"
HELP = "the line after each read, each miss, or each miss and first use of a prefetched line"

TRIGGERS = {"always": ALWAYS, "miss": ON_MISS, "tagged": TAGGED}


class NextLine(NamedTuple):
    """One register a ray: the line to request, until it is requested or replaced.

    Attributes
    ----------
    line : (n_slots,) int64
        -1 for none.
    trigger, distance : int
    """

    line: np.ndarray
    trigger: int
    distance: int

    def on_start(self, machine, slot):
        self.line[slot] = -1

    def on_visit(self, machine, slot, line, outcome):
        if self.trigger == ALWAYS or outcome == MISS or (self.trigger == TAGGED and outcome != HIT):
            replace(self, machine, slot, line + self.distance)

    def on_end(self, machine, slot):
        forget(self, machine, slot)

    def request(self, machine, slot):
        return as_line(self.line[slot]) if self.line[slot] >= 0 else np.int64(NOTHING)

    def requested(self, machine, slot):
        self.line[slot] = -1


@inlined
def replace(unit, machine, slot, line):
    """Request a line instead of the one that still waits; lines outside the tree are not requested."""
    forget(unit, machine, slot)
    if 0 <= line < machine.status.size:
        unit.line[slot] = line
        offer(machine, slot, ONE)


@inlined
def forget(unit, machine, slot):
    """Drop the line that still waits."""
    if unit.line[slot] >= 0:
        drop(machine, slot, ONE)
        stop_waiting(machine, slot)
        unit.line[slot] = -1


def parse(options: Sequence[str]) -> dict[str, Any]:
    """Return trigger and distance."""
    if not 1 <= len(options) <= 2 or options[0] not in TRIGGERS:
        raise NptraceError(f"its first option is when it requests: {', '.join(TRIGGERS)}")
    return {"trigger": TRIGGERS[options[0]], "distance": whole(options[1], "distance", 1, 999_999) if options[1:] else 1}


def shown(values: dict[str, Any]) -> list[str]:
    """Return the options as they are printed."""
    name = next(name for name, trigger in TRIGGERS.items() if trigger == values["trigger"])
    return [name] + ([str(values["distance"])] if values["distance"] != 1 else [])


def make_unit(machine: Machine, facts: Facts, *, trigger: int, distance: int) -> NextLine:
    """Return the unit of a machine."""
    return NextLine(np.full(machine.sp.size, -1, np.int64), trigger, distance)


POLICY = Policy("next-line", FORM, parse, make_unit, shown=shown, begins_anew=True)
