"""No prefetches: what every other policy is compared with."""

from typing import NamedTuple

from cachesim.policies import Facts, Policy, no_options
from cachesim.policies.machine import Machine

FORM = "none"
HELP = "no prefetches"


class Idle(NamedTuple):
    """A unit without hooks."""

    nothing: int


def make_unit(machine: Machine, facts: Facts) -> Idle:
    """Return the unit of a machine."""
    return Idle(0)


POLICY = Policy("none", FORM, no_options, make_unit, begins_anew=True)
