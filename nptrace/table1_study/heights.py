"""What is on the stacks of a run in memory: a unit that requests nothing, and counts entries at leaves and at a ray's end."""

from typing import NamedTuple

import numpy as np

from cachesim.policies import Facts, Policy
from cachesim.policies.machine import Machine
from cachesim.prefetch import Prefetch, UnitReplay
from nptrace.table1_study.traced import TracedRun
from traces.format import PRIMARY, SHADOW

#: Entries that the paper says a stack has at most, usually.
FEW = 3

#: What is counted for each type of ray: leaves with triangles, those of them with at most ``FEW`` entries on the stack, the
#: sum of entries there; rays ended, and those of them with entries left.
COUNTED = ("leaves", "leaves_few", "leaf_entries", "ended", "ended_with_entries")
LEAVES, LEAVES_FEW, LEAF_ENTRIES, ENDED, ENDED_WITH_ENTRIES = range(len(COUNTED))


class Heights(NamedTuple):
    """A unit that counts.

    Attributes
    ----------
    types : (n,) uint8
        Of the rays that read nodes.
    ray : (1,) int64
    counts : (2, 5) int64
        By type of ray, in the order of ``COUNTED``.
    """

    types: np.ndarray
    ray: np.ndarray
    counts: np.ndarray

    def on_start(self, machine, slot):
        """Take the next ray."""
        self.ray[0] += 1

    def on_leaf(self, machine, slot, node):
        """Count a leaf with triangles."""
        if machine.tree.n_prims[node] == 0:
            return
        of, height = self.counts[self.types[self.ray[0]]], machine.sp[slot]
        of[LEAVES] += 1
        of[LEAVES_FEW] += np.int64(height <= FEW)
        of[LEAF_ENTRIES] += height

    def on_end(self, machine, slot):
        """Count the end of a ray."""
        of = self.counts[self.types[self.ray[0]]]
        of[ENDED] += 1
        of[ENDED_WITH_ENTRIES] += np.int64(machine.sp[slot] > 0)


def stack_counts(run: TracedRun) -> dict[str, int]:
    """Return what is on the stacks of primary and shadow rays, at leaves with triangles and when a ray ends."""
    made: list[tuple[Machine, Heights]] = []

    def make_unit(machine: Machine, facts: Facts, types: np.ndarray) -> Heights:
        made.append((machine, Heights(types, np.full(1, -1, np.int64), np.zeros((2, len(COUNTED)), np.int64))))
        return made[0][1]

    types = run.types[run.has_rows]
    policy = Policy("heights", "heights", lambda options: {}, make_unit)
    nodes = run.columns("nodes", ["n_prims", "level", "parent"])
    prefetch = Prefetch(policy, {"types": types}, "heights")
    columns = nodes["n_prims"], nodes["level"], nodes["parent"]
    UnitReplay(prefetch, run.footer.tree.node_format, *columns).events(*run.rows)
    [(machine, unit)] = made
    if types.size:
        of = unit.counts[types[-1]]  # of the last ray, which no other ends
        of[ENDED] += 1
        of[ENDED_WITH_ENTRIES] += int(machine.sp[0] > 0)
    return {
        f"{which}_{name}": int(unit.counts[type_, i])
        for type_, which in ((PRIMARY, "primary"), (SHADOW, "shadow"))
        for i, name in enumerate(COUNTED)
    }
