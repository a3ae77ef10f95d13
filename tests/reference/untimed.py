"""A replay that has all the time in the world: the slow policies, asked after every read until they want nothing."""

from collections import Counter

from tests.reference.clock import Entry, Slot, visits_of


class Untimed:
    """What the slow policies take for their clock: one slot, and a port that is always free."""

    def __init__(self, policy, absent=()):
        self.policy, self.absent = policy, absent
        self.slots, self.candidates, self.partly = [Slot(0)], Counter(), Counter()
        self.offered = False
        policy.clock = self

    def offer(self, slot, n):
        self.offered |= n > 0

    def stop_waiting(self, slot):
        self.offered = False

    def drop(self, slot, n):
        assert n == 0

    def events(self, rays):
        """Return (node, whether it is a request) of rays, given as lists of visits."""
        slot, made = self.slots[0], []
        for visits in rays:
            slot.visits, slot.at, slot.stack = visits, 0, []
            self.policy.start(slot)
            for slot.at, visit in enumerate(visits):
                if visit.pushes is not None:
                    slot.stack.append(Entry(visit.pushes, visit.row - 1))
                    self.policy.push(slot)
                elif visit.pops:
                    del slot.stack[len(slot.stack) - visit.pops :]
                    self.policy.pop(slot)
                if visit.node not in self.absent:
                    made.append((visit.node, False))
                made += self._requests()
                if visit.is_leaf and visit.n_prims:
                    self.policy.leaf(slot)
                    made += self._requests()
                    self.policy.leaf_end(slot)
            self.policy.end(slot)
        return made

    def _requests(self):
        made = []
        while self.offered and (lines := self.policy.request(0)):
            made.append((lines[0], True))
            self.policy.requested(0)
        self.offered = False
        return made


def nodes_as_lines(trace):
    """Return the line of every node, [] of one that is nowhere in memory: a node's line is its number."""
    return [[node] if address >= 0 else [] for node, address in enumerate(trace.addresses)]


def rays_of(trace, lines):
    """Return the visits of every ray of a trace, from its demand rows."""
    rows = [row for row in trace.rows if row[2] != 3]
    starts = [i for i, row in enumerate(rows) if i == 0 or row[0] != rows[i - 1][0]]
    ends = [*starts[1:], len(rows)]
    return [
        visits_of([row[1:] for row in rows[a:b]], trace.parent, trace.n_prims, lines, a)
        for a, b in zip(starts, ends, strict=True)
    ]
