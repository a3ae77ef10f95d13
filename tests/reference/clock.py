"""The clock as slow as can be: every cycle of every slot is stepped through, and counted as it passes.

Nothing is shared with ``cachesim.clock``: the cache is a list of lines per set, what is in flight a list in the order of
arrival, and a cycle is counted by what its slot is doing when it ends.
"""

from collections import Counter
from dataclasses import dataclass, field

HIT, FIRST_USE, MISS = "hit", "first use", "miss"


@dataclass
class Visit:
    """One demand row of a ray: what the ray did to come here, and what it finds."""

    node: int
    row: int
    lines: list
    is_leaf: bool
    n_prims: int
    pushes: int | None = None  # the sibling pushed on the way here
    pops: int = 0  # entries taken off the stack on the way here


@dataclass
class Entry:
    """An entry of a stack."""

    node: int
    row: int
    asked: bool = False


@dataclass
class Slot:
    """The place of one ray in flight."""

    number: int
    ray: int = -1
    state: str = "idle"
    until: int = 0  # the cycle in which the state ends
    visits: list = field(default_factory=list)
    at: int = 0
    stack: list = field(default_factory=list)
    lines_done: int = 0
    data_at: int = 0
    data_from: str = ""
    after: str = ""
    started: int = -1

    @property
    def visit(self):
        return self.visits[self.at]


def visits_of(rows, parent, n_prims, lines, first_row=0):
    """Return the visits of one ray from its (node, kind) demand rows."""
    made, stack, last = [], [], None
    for i, (node, kind) in enumerate(rows):
        visit = Visit(node, first_row + i, lines[node], kind == 2, n_prims[node])
        if last is not None:
            last_node, last_kind = last
            if parent[node] == last_node:
                if last_kind == 1:
                    visit.pushes = ((node - 1) ^ 1) + 1
                    stack.append(visit.pushes)
            else:
                while True:
                    visit.pops += 1
                    if stack.pop() == node:
                        break
        made.append(visit)
        last = node, kind
    return made


class SlowClock:
    """``machine``: hit, miss, mshrs, ports, transfer, box, triangle, every, n_units; ``rays``: lists of visits."""

    def __init__(self, machine, n_sets, ways, n_slots, rays, waits_for, policy, *, fifo=False, is_perfect=False):
        self.machine, self.n_sets, self.ways, self.fifo, self.is_perfect = machine, n_sets, ways, fifo, is_perfect
        self.rays, self.waits_for, self.next_ray = rays, waits_for, 0
        self.slots = [Slot(i) for i in range(n_slots)]
        self.sets = [[] for _ in range(n_sets)]  # most recent first
        self.flight = []  # (arrival, line)
        self.bus_free = 0
        self.unused, self.pushed_out, self.lost = set(), set(), set()
        self.units = [0] * machine["n_units"]
        self.queue, self.waiting, self.blocked = [], [], None
        self.last_issue, self.partly = Counter(), Counter()
        self.cycles, self.lines, self.candidates = Counter(), Counter(), Counter()
        self.now, self.last_cycle, self.n_ended = 0, 0, 0
        self.events = []  # (what, line, facts): every look-up, and what became of the lines that prefetches filled
        self.policy = policy
        policy.clock = self

    def run(self):
        """Step until all rays have ended; return self."""
        while True:
            self._arrivals()
            for slot in self.slots:
                while slot.until <= self.now and self._act(slot):
                    pass
            if self.n_ended == len(self.rays):
                break
            self._port()
            self.policy.clock_ticks()
            for slot in self.slots:
                self.cycles["idle" if slot.state in ("waits", "starts") else slot.state] += 1
            self.now += 1
        self.policy.finish()
        return self

    def _arrivals(self):
        while self.flight and self.flight[0][0] <= self.now:
            _, line = self.flight.pop(0)
            held = self.sets[line % self.n_sets]
            if len(held) == self.ways:
                victim = held.pop()
                if victim in self.unused:
                    self.unused.remove(victim)
                    self.lost.add(victim)
                    self.lines["evicted"] += 1
                    self.events.append(("evicted", victim, None))
                if line in self.unused:
                    self.pushed_out.add(victim)
            held.insert(0, line)

    def _act(self, slot):
        """Let a slot whose state has ended enter the next; return whether that may have ended too."""
        machine = self.machine
        if slot.state == "idle":
            return self._start(slot)
        if slot.state in ("port", "MSHR full", "waits"):
            return False
        if slot.state == "starts":
            return self._enter(slot)
        if slot.state in ("hit", "demand miss", "late prefetch"):
            slot.state, slot.until = "box test", self.now + machine["box"]
        elif slot.state == "box test":
            return self._after_box(slot)
        elif slot.state == "unit busy":
            n = slot.visit.n_prims
            slot.state, slot.until = "triangle test", self.now + (n - 1) * machine["every"] + machine["triangle"]
            self.policy.leaf(slot)
        elif slot.state == "triangle test":
            return self._next_visit(slot)
        return True

    def _after_box(self, slot):
        if not (slot.visit.is_leaf and slot.visit.n_prims):
            return self._next_visit(slot)
        start = self.now
        if self.units:
            best = min(range(len(self.units)), key=lambda i: self.units[i])
            start = max(self.now, self.units[best])
            self.units[best] = start + slot.visit.n_prims * self.machine["every"]
        slot.state, slot.until = "unit busy", start
        return True

    def _next_visit(self, slot):
        if slot.visit.is_leaf:
            self.policy.leaf_end(slot)
        slot.at += 1
        return self._enter(slot)

    def _end(self, slot):
        self.policy.end(slot)
        self.last_cycle = self.now
        self.n_ended += 1
        slot.state = "idle"
        for other in self.slots:
            if other.state == "waits" and self.waits_for[other.ray] == slot.ray:
                other.state, other.until = "starts", self.now + 1
        slot.until = self.now + (slot.started == self.now)
        return True

    def _start(self, slot):
        after = slot.ray + 1
        if slot.ray >= 0 and after < len(self.rays) and self.waits_for[after] == -2:
            ray = after
        else:
            while self.next_ray < len(self.rays) and self.waits_for[self.next_ray] == -2:
                self.next_ray += 1
            if self.next_ray == len(self.rays):
                return False
            ray = self.next_ray
            self.next_ray += 1
        slot.ray, slot.visits, slot.at, slot.stack, slot.started = ray, self.rays[ray], 0, [], self.now
        self.policy.start(slot)
        primary = self.waits_for[ray]
        if primary >= 0 and any(s is not slot and s.ray == primary and s.state != "idle" for s in self.slots):
            slot.state = "waits"
            return False
        return self._enter(slot)

    def _enter(self, slot):
        """Come to the next visit, or to the end of the ray."""
        if slot.at == len(slot.visits):
            return self._end(slot)
        visit = slot.visit
        if visit.pushes is not None:
            slot.stack.append(Entry(visit.pushes, visit.row - 1))
            self.policy.push(slot)
        elif visit.pops:
            del slot.stack[len(slot.stack) - visit.pops :]
            self.policy.pop(slot)
        if visit.lines:
            slot.lines_done, slot.data_at, slot.state = 0, 0, "port"
            self.queue.append(slot)
            return False
        slot.state, slot.until = "box test", self.now
        return True

    def _port(self):
        free = self.machine["ports"]
        while free and self.queue:
            if not self._demand(self.queue[0]):
                self.queue[0].state, self.blocked = "MSHR full", None
                return
            free -= 1
        self.blocked = None
        while free and self._prefetch():
            free -= 1

    def _demand(self, slot):
        line = slot.visit.lines[slot.lines_done]
        found = self._look_up(line)
        if found is None:
            return False
        ready, cause, outcome = found
        facts = {"ray": slot.ray, "node": slot.visit.node, "place": 0, "n_prims": 0}
        self.events.append(("missed" if cause == "demand miss" else "read", line, facts))
        if ready > slot.data_at:
            slot.data_at, slot.data_from = ready, cause
        self.policy.visit(slot, line, outcome)
        slot.lines_done += 1
        slot.state = "port"
        if slot.lines_done == len(slot.visit.lines):
            self.queue.pop(0)
            slot.state, slot.until = slot.data_from, slot.data_at
        return True

    def _look_up(self, line):
        hit, miss = self.now + self.machine["hit"], self.now + self.machine["miss"]
        if self.is_perfect:
            self.lines["hits"] += 1
            return hit, "hit", HIT
        held = self.sets[line % self.n_sets]
        arrival = dict((line, arrival) for arrival, line in self.flight).get(line)
        if line in held or arrival is not None:
            if line in held and not self.fifo:
                held.remove(line)
                held.insert(0, line)
            ready = hit if arrival is None else max(hit, arrival)
            is_first = line in self.unused
            if is_first:
                self.unused.remove(line)
                self.lines["saved"] += miss - ready
                self.lines["waited"] += ready - hit
                self.lines["late" if ready > hit else "timely"] += 1
                self.events.append(("late" if ready > hit else "timely", line, None))
            outcome = FIRST_USE if is_first else HIT
            if ready == hit:
                self.lines["hits"] += 1
                return hit, "hit", outcome
            if is_first:
                return ready, "late prefetch", outcome
            self.lines["joined by demand"] += 1
            return ready, "demand miss", outcome
        if len(self.flight) == self.machine["mshrs"]:
            return None
        self.lines["pollution"] += line in self.pushed_out
        self.lines["misses"] += 1
        return self._ask(line), "demand miss", MISS

    def _ask(self, line):
        self.lines["wanted again"] += line in self.lost
        self.lost.discard(line)
        self.pushed_out.discard(line)
        self.bus_free = max(self.now + self.machine["miss"], self.bus_free + self.machine["transfer"])
        self.flight.append((self.bus_free, line))
        return self.bus_free

    def _prefetch(self):
        """Give the port to the slot that has waited longest; return whether anything took it."""
        while self.waiting:
            slot = self.waiting[0]
            lines = self.policy.request(slot)
            if lines is None:
                self.stop_waiting(slot)
                continue
            line = lines[self.partly[slot]]
            before = dict(self.lines)
            if not self._look_up_for_prefetch(line):
                self.blocked = slot
                return False
            found = next(name for name in ("redundant", "joined", "filled") if self.lines[name] > before.get(name, 0))
            self.events.append((found, line, self.policy.facts(slot)))
            self.last_issue[slot] = self.now
            self.partly[slot] += 1
            if self.partly[slot] == len(lines):
                self.partly[slot] = 0
                self.candidates["issued"] += 1
                self.policy.requested(slot)
            return True
        return False

    def _look_up_for_prefetch(self, line):
        held = self.sets[line % self.n_sets]
        if self.is_perfect or line in held:
            if not (self.fifo or self.is_perfect):
                held.remove(line)
                held.insert(0, line)
            self.lines["redundant"] += 1
        elif any(line == other for _, other in self.flight):
            self.lines["joined"] += 1
        elif len(self.flight) == self.machine["mshrs"]:
            return False
        else:
            self.lines["filled"] += 1
            self._ask(line)
            self.unused.add(line)
        return True

    def offer(self, slot, n):
        """A policy has ``n`` more candidates for a slot (a number)."""
        self.candidates["offered"] += n
        if n and slot not in self.waiting:
            self.waiting.append(slot)

    def stop_waiting(self, slot):
        """Take a slot (a number) off the list of those that wait for the port."""
        self.partly[slot] = 0
        if slot in self.waiting:
            self.waiting.remove(slot)

    def drop(self, slot, n):
        """A policy gives up ``n`` candidates of a slot (a number)."""
        why = "no time" if self.last_issue.get(slot, -2) == self.now - 1 else "port busy"
        self.candidates["MSHR full" if self.blocked == slot else why] += n


class NoPolicy:
    """No prefetches; the hooks of all policies here."""

    def start(self, slot):
        """A ray starts."""

    push = pop = leaf = leaf_end = end = start

    def finish(self):
        """All rays have ended."""

    def clock_ticks(self):
        """A cycle is over."""

    def visit(self, slot, line, outcome):
        """A line of a demand read has been looked up."""

    def request(self, slot):
        """Return the lines of the next request of a slot (a number), or None."""

    def requested(self, slot):
        """It has been issued."""

    def facts(self, slot):
        """Return the facts of the next request, for the events."""


class SlowStack(NoPolicy):
    """The paper's unit."""

    def __init__(
        self, lines, levels, n_prims, budget=None, per_triangle=False, once=False, deepest=10**6, wanted=None, reset="",
        pop=False,
    ):  # fmt: skip
        self.lines, self.levels, self.n_prims = lines, levels, n_prims
        self.budget, self.per_triangle, self.once, self.deepest, self.wanted = budget, per_triangle, once, deepest, wanted
        self.reset, self.at_pops = reset, pop
        self.pointer, self.left, self.open = Counter(), Counter(), Counter()

    def start(self, slot):
        self.pointer[slot.number] = self.left[slot.number] = self.open[slot.number] = 0

    def push(self, slot):
        if self.at_pops:
            self.close(slot.number)
        was_at_top = self.pointer[slot.number] == len(slot.stack) - 1
        if was_at_top or self.reset != "persist":
            self.pointer[slot.number] = len(slot.stack)

    def pop(self, slot):
        if self.at_pops:
            self.close(slot.number)
        self.pointer[slot.number] = min(self.pointer[slot.number], len(slot.stack))
        if self.at_pops:
            self.begin(slot, 1)

    def end(self, slot):
        if self.at_pops:
            self.close(slot.number)

    def begin(self, slot, n_triangles):
        """Offer what the budget allows."""
        if self.reset == "restart":
            self.pointer[slot.number] = len(slot.stack)
        budget = 10**9 if self.budget is None else self.budget
        self.left[slot.number] = budget * (n_triangles if self.per_triangle else 1)
        self.open[slot.number] = len(self.candidates(slot.number))
        self.clock.offer(slot.number, self.open[slot.number])

    def close(self, number):
        """Drop what is still to come."""
        self.clock.stop_waiting(number)
        self.clock.drop(number, self.open[number])
        self.open[number] = self.left[number] = 0

    def candidates(self, number):
        """Return the places of the entries that would be requested now, in order."""
        stack = self.clock.slots[number].stack
        places = [i for i in reversed(range(self.pointer[number])) if self.may_request(stack[i])]
        return places[: self.left[number]]

    def may_request(self, entry):
        """Return whether an entry may be requested at all."""
        if not self.lines[entry.node] or self.levels[entry.node] > self.deepest or (self.once and entry.asked):
            return False
        return self.wanted is None or bool(self.wanted[entry.row])

    def leaf(self, slot):
        if not self.at_pops:
            self.begin(slot, self.n_prims[slot.visit.node])

    def leaf_end(self, slot):
        if not self.at_pops:
            self.close(slot.number)

    def request(self, number):
        stack = self.clock.slots[number].stack
        while self.left[number] > 0 and self.pointer[number] > 0 and not self.may_request(stack[self.pointer[number] - 1]):
            self.pointer[number] -= 1  # it passes what it may not request, and does not come back
        places = self.candidates(number)
        return self.lines[stack[places[0]].node] if places else None

    def facts(self, number):
        slot, place = self.clock.slots[number], self.candidates(number)[0]
        return {
            "ray": slot.ray, "node": slot.stack[place].node, "place": len(slot.stack) - 1 - place,
            "n_prims": slot.visit.n_prims,
        }  # fmt: skip

    def requested(self, number):
        place = self.candidates(number)[0]
        self.clock.slots[number].stack[place].asked = True
        self.pointer[number] = place
        self.left[number] -= 1
        self.open[number] -= 1
