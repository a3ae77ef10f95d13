"""The prefetch policies as slow as can be, for ``SlowClock``: lists, counters and searches, written from what is published."""

import math
from collections import Counter
from itertools import pairwise

from tests.reference.clock import FIRST_USE, HIT, MISS, NoPolicy, SlowStack


class SlowPush(NoPolicy):
    """The entry pushed last waits, until it is requested, off the stack, or replaced."""

    def __init__(self, lines):
        self.lines, self.waits = lines, {}

    def push(self, slot):
        self.give_up(slot)
        if self.lines[slot.stack[-1].node]:
            self.waits[slot.number] = slot.stack[-1]
            self.clock.offer(slot.number, 1)

    def pop(self, slot):
        entry = self.waits.get(slot.number)
        if entry is not None and not any(entry is other for other in slot.stack):
            self.clock.candidates["demanded first"] += 1
            self.clock.stop_waiting(slot.number)
            del self.waits[slot.number]

    def end(self, slot):
        self.give_up(slot)

    def give_up(self, slot):
        if self.waits.pop(slot.number, None) is not None:
            self.clock.drop(slot.number, 1)
            self.clock.stop_waiting(slot.number)

    def request(self, number):
        return self.lines[self.waits[number].node] if number in self.waits else None

    def requested(self, number):
        del self.waits[number]


class SlowTtp(NoPolicy):
    """1, 2, then 16 entries from the top down at the first, second and further pops since a push; nothing twice in between."""

    def __init__(self, lines, room):
        self.lines, self.room = lines, room
        self.pointer, self.pops, self.queue = {}, {}, {}

    def start(self, slot):
        self.pointer[slot.number], self.pops[slot.number], self.queue[slot.number] = 0, 0, []

    def push(self, slot):
        self.pointer[slot.number], self.pops[slot.number] = len(slot.stack), 0

    def pop(self, slot):
        number, queue = slot.number, self.queue[slot.number]
        if queue and queue[0] == slot.visit.node:
            self.clock.partly[number] = 0
        self.clock.candidates["demanded first"] += queue.count(slot.visit.node)
        queue[:] = [node for node in queue if node != slot.visit.node]
        self.pops[number] += 1
        n_before, pointer = len(queue), min(self.pointer[number], len(slot.stack))
        for _ in range({1: 1, 2: 2}.get(self.pops[number], 16)):
            if pointer == 0 or len(queue) == self.room:
                break
            pointer -= 1
            if self.lines[slot.stack[pointer].node]:
                queue.append(slot.stack[pointer].node)
        self.pointer[number] = pointer
        self.clock.offer(number, len(queue) - n_before)
        if not queue:
            self.clock.stop_waiting(number)

    def end(self, slot):
        self.clock.drop(slot.number, len(self.queue[slot.number]))
        self.clock.stop_waiting(slot.number)
        self.queue[slot.number] = []

    def request(self, number):
        return self.lines[self.queue[number][0]] if self.queue[number] else None

    def requested(self, number):
        self.queue[number].pop(0)


class _Register(NoPolicy):
    """One line a ray waits to be requested; a new one takes its place, and one outside the tree empties it."""

    def __init__(self, n_lines):
        self.n_lines, self.line = n_lines, {}

    def replace(self, slot, line):
        self.end(slot)
        if 0 <= line < self.n_lines:
            self.line[slot.number] = line
            self.clock.offer(slot.number, 1)

    def end(self, slot):
        if self.line.pop(slot.number, None) is not None:
            self.clock.drop(slot.number, 1)
            self.clock.stop_waiting(slot.number)

    def request(self, number):
        return [self.line[number]] if number in self.line else None

    def facts(self, number):
        slot = self.clock.slots[number]
        return {
            "ray": slot.ray, "node": None, "place": None,
            "n_prims": slot.visit.n_prims if slot.state == "triangle test" else 0,
        }  # fmt: skip

    def requested(self, number):
        del self.line[number]


class SlowNextLine(_Register):
    """The line ``distance`` further on: of every read, of a miss, or of a miss and of the first use of a prefetched line."""

    def __init__(self, n_lines, trigger, distance):
        super().__init__(n_lines)
        self.outcomes = {"always": (HIT, FIRST_USE, MISS), "miss": (MISS,), "tagged": (FIRST_USE, MISS)}[trigger]
        self.distance = distance

    def visit(self, slot, line, outcome):
        if outcome in self.outcomes:
            self.replace(slot, line + self.distance)


class SlowStride(_Register):
    """Of every ray all lines; the last two strides equal, or the last one that which any ray confirmed last."""

    def __init__(self, n_lines):
        super().__init__(n_lines)
        self.read, self.confirmed = {}, None

    def start(self, slot):
        self.read[slot.number] = []

    def visit(self, slot, line, outcome):
        read = self.read[slot.number]
        if read and read[-1] == line:
            return
        read.append(line)
        strides = [b - a for a, b in pairwise(read)]
        is_confirmed = len(strides) > 1 and strides[-1] == strides[-2]
        if strides and (is_confirmed or strides[-1] == self.confirmed):
            self.replace(slot, line + strides[-1])
        if is_confirmed:
            self.confirmed = strides[-1]


class SlowTreelet(NoPolicy):
    """All nodes of the treelet that most rays in flight read last, by a vote every some cycles."""

    def __init__(self, lines, parent, node_bytes, block_bytes, every, share):
        self.lines, self.every, self.share = lines, every, share
        self.treelets = treelets(lines, parent, max(block_bytes // node_bytes, 1))
        self.where, self.voted_at, self.last, self.waits = {}, 0, None, []

    def visit(self, slot, line, outcome):
        node = min(node for node, lines in enumerate(self.lines) if line in lines)
        self.where[slot.number] = next(i for i, nodes in enumerate(self.treelets) if node in nodes)
        if self.clock.now - self.voted_at < self.every:
            return
        self.voted_at = self.clock.now
        votes = Counter(self.where.values())
        winner = min(votes, key=lambda treelet: (-votes[treelet], treelet))
        if winner == self.last or votes[winner] / votes.total() < self.share / 100:
            return
        self.finish()
        self.last = winner
        self.waits = sorted(node for node in self.treelets[winner] if self.lines[node])
        self.clock.offer(self.number, len(self.waits))

    @property
    def number(self):
        return len(self.clock.slots)  # the treelet waits in nobody's place

    def end(self, slot):
        self.where.pop(slot.number, None)

    def finish(self):
        self.clock.drop(self.number, len(self.waits))
        self.clock.stop_waiting(self.number)
        self.waits = []

    def request(self, number):
        return self.lines[self.waits[0]] if self.waits else None

    def requested(self, number):
        self.waits.pop(0)


def treelets(lines, parent, capacity):
    """Return the nodes of each treelet: breadth-first from its root, until ``capacity`` of them are read."""
    found, roots = [], [0]
    while roots:
        nodes, queue = [], [roots.pop()]
        while queue:
            node = queue.pop(0)
            if lines[node] and sum(bool(lines[other]) for other in nodes) == capacity:
                roots.append(node)
                continue
            nodes.append(node)
            queue += [child for child in range(len(parent)) if parent[child] == node]
        found.append(nodes)
    return found


def slow_key(ray, rays, origin_bits, direction_bits):
    """Return the key of a ray: cells of a grid over the origins of shadow rays, xor angles in whole degrees."""
    starts = [[float(c) for c in origin] for origin, is_shadow in zip(rays.origin, rays.is_shadow, strict=True) if is_shadow]
    key = 0
    for axis in range(3):
        low, high = min((s[axis] for s in starts), default=0.0), max((s[axis] for s in starts), default=0.0)
        share = (float(rays.origin[ray][axis]) - low) / (high - low if high > low else 1.0)
        key = key << origin_bits | min(max(int(share * 2**origin_bits), 0), 2**origin_bits - 1)
    x, y, z = map(float, rays.direction[ray])
    theta, phi = math.degrees(math.acos(z / math.hypot(x, y, z))), math.degrees(math.atan2(y, x)) + 180
    return key ^ (int(phi) >> 8 - direction_bits << direction_bits | int(theta) >> 8 - direction_bits)


class SlowPredictor(NoPolicy):
    """A list of (key, node) for every set, the most recent first; the path of a ray is written down when it reads first."""

    def __init__(self, lines, parent, rays, entries, ways, origin, direction, up):
        self.lines, self.parent, self.rays, self.ways, self.up = lines, parent, rays, ways, up
        self.keys = [slow_key(ray, rays, origin, direction) for ray in range(len(rays.is_hit))]
        self.table, self.bits = [[] for _ in range(entries // ways)], (entries // ways).bit_length() - 1
        self.stored, self.waits, self.tested = {}, {}, {}

    def entries_of(self, key):
        number, rest = 0, key
        while rest and self.bits:
            number, rest = number ^ rest % 2**self.bits, rest // 2**self.bits
        return self.table[number]

    def above(self, node):
        """Return the node and all above it, without the root, from the top down."""
        return [*self.above(self.parent[node]), node] if node > 0 else []

    def start(self, slot):
        self.stored.pop(slot.number, None)
        self.waits[slot.number], self.tested[slot.number] = [], None

    def visit(self, slot, line, outcome):
        waits = self.waits[slot.number]
        if slot.number in self.stored:
            if waits and line in self.lines[waits[0]]:
                del waits[0]
                self.clock.candidates["demanded first"] += 1
                self.clock.partly[slot.number] = 0
                if not waits:
                    self.clock.stop_waiting(slot.number)
            return
        key = self.keys[slot.ray]
        entries = self.entries_of(key)
        found = [entry for entry in entries if entry[0] == key]
        self.stored[slot.number] = found[0][1] if found else None
        if found:
            entries.sort(key=lambda entry: entry[0] != key)
            waits += [node for node in self.above(found[0][1]) if self.lines[node]]
            self.clock.offer(slot.number, len(waits))

    def leaf(self, slot):
        self.tested[slot.number] = slot.visit.node

    def end(self, slot):
        self.clock.drop(slot.number, len(self.waits[slot.number]))
        self.clock.stop_waiting(slot.number)
        path = self.above(self.tested[slot.number] or 0)
        if not path or not self.rays.is_hit[slot.ray] or self.stored.get(slot.number) in path:
            return
        key = self.keys[slot.ray]
        entries = self.entries_of(key)
        entries[:] = [entry for entry in entries if entry[0] != key]
        entries.insert(0, (key, path[max(len(path) - 1 - self.up, 0)]))
        del entries[self.ways :]

    def request(self, number):
        return self.lines[self.waits[number][0]] if self.waits.get(number) else None

    def requested(self, number):
        del self.waits[number][0]


class SlowScout(SlowStack):
    """The paper's unit, which notes the rows whose entries it requested in time: used before they were evicted."""

    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        self.entry_of, self.used = {}, Counter()

    def visit(self, slot, line, outcome):
        if outcome == FIRST_USE:
            self.used[self.entry_of[line].row] = 1

    def request(self, number):
        lines = super().request(number)
        if lines:
            entry = self.clock.slots[number].stack[self.candidates(number)[0]]
            self.entry_of[lines[self.clock.partly[number]]] = entry
        return lines


def rows_read(rays):
    """Return the rows whose pushed entries are read when they leave the stack, from the visits of all rays."""
    read = Counter()
    for visits in rays:
        stack = []
        for visit in visits:
            if visit.pushes is not None:
                stack.append(visit.row - 1)
            for _ in range(visit.pops):
                row = stack.pop()
            if visit.pops:
                read[row] = 1
    return read
