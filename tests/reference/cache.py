"""Slow, simple models of what cachesim computes with kernels: the cache, the prefetch unit, 3C and the account."""

from collections import OrderedDict

READ, WRITE, IFETCH, MISC, PREFETCH = 0, 1, 2, 3, 8


class SplitMix:
    """The generator of the random policy (Steele, Lea and Flood 2014)."""

    def __init__(self, seed):
        self.state = seed

    def way(self, ways):
        mask = (1 << 64) - 1
        self.state = (self.state + 0x9E3779B97F4A7C15) & mask
        z = self.state
        z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9 & mask
        z = (z ^ (z >> 27)) * 0x94D049BB133111EB & mask
        z ^= z >> 31
        return (z >> 32) * ways >> 32


class Contents:
    """Which lines a cache holds: one ordered dict per set, the next victim first."""

    def __init__(self, n_sets, ways, policy, seed=0):
        self.sets = [OrderedDict() for _ in range(n_sets)]
        self.slots = [[] for _ in range(n_sets)]  # random: the line in each way
        self.ways, self.policy, self.random = ways, policy, SplitMix(seed)

    def access(self, line):
        """Return (hit, the line evicted or None)."""
        number = line % len(self.sets)
        held = self.sets[number]
        if line in held:
            if self.policy == "lru":
                held.move_to_end(line)
            return True, None
        victim = None
        if self.policy == "random":
            slots = self.slots[number]
            if len(slots) < self.ways:
                slots.append(line)
            else:
                way = self.random.way(self.ways)
                victim, slots[way] = slots[way], line
                del held[victim]
        elif len(held) == self.ways:
            victim, _ = held.popitem(last=False)
        held[line] = True
        return False, victim


class Foreseeing:
    """Which lines a cache holds that knows every line to come (Belady 1966): it looks ahead at every eviction."""

    def __init__(self, n_sets, ways, future):
        self.sets = [[] for _ in range(n_sets)]  # of each set, the line longest not accessed first
        self.ways, self.future, self.now = ways, future, 0

    def access(self, line):
        """Return (hit, the line evicted or None)."""
        assert self.future[self.now] == line
        self.now += 1
        held, victim = self.sets[line % len(self.sets)], None
        hit = line in held
        if hit:
            held.remove(line)
        elif len(held) == self.ways:
            to_come = self.future[self.now :]
            distance = [to_come.index(other) if other in to_come else len(to_come) for other in held]
            victim = held.pop(distance.index(max(distance)))  # of several that never come, the one accessed longest ago
        held.append(line)
        return hit, victim


class Cache:
    """One cache with everything that is counted, in the words of the account; ``opt`` needs the lines to come."""

    def __init__(self, config, future=None):
        if config.policy == "opt":
            self.contents = Foreseeing(config.n_sets, config.ways, future)
            self.shadow = Foreseeing(1, config.n_lines, future)
        else:
            self.contents = Contents(config.n_sets, config.ways, config.policy, config.seed)
            self.shadow = Contents(1, config.n_lines, config.policy, config.seed ^ 0x5DEECE66D)
        self.touched = set()
        self.unused = set()  # resident, filled by a prefetch, not demanded yet
        self.pushed_out = set()  # evicted by a prefetch and not filled since
        self.counts = {name: [0] * 16 for name in ("accesses", "misses", "compulsory", "capacity", "conflict")}
        self.useful = self.useless = self.pollution = 0

    def access(self, line, label):
        """Return (missed, first demand of a prefetched line)."""
        is_prefetch = label >= PREFETCH
        self.counts["accesses"][label] += 1
        shadow_hit, _ = self.shadow.access(line)
        is_first_touch = line not in self.touched
        self.touched.add(line)
        hit, victim = self.contents.access(line)
        first_use = hit and not is_prefetch and line in self.unused
        if first_use:
            self.useful += 1
            self.unused.remove(line)
        if hit:
            return False, first_use
        self.counts["misses"][label] += 1
        kind = "conflict" if shadow_hit else "compulsory" if is_first_touch else "capacity"
        self.counts[kind][label] += 1
        if not is_prefetch and line in self.pushed_out:
            self.pollution += 1
        self.pushed_out.discard(line)
        if victim is not None:
            if victim in self.unused:
                self.useless += 1
                self.unused.remove(victim)
            if is_prefetch:
                self.pushed_out.add(victim)
        if is_prefetch:
            self.unused.add(line)
        return True, False

    def replay(self, accesses, trigger=None, distance=1):
        """Replay (line, label) pairs; ``trigger`` is None, "always", "miss" or "tagged"."""
        for line, label in accesses:
            missed, first_use = self.access(line, label)
            wants = {None: False, "always": True, "miss": missed, "tagged": missed or first_use}[trigger]
            if wants and label in (READ, IFETCH):
                self.access(line + distance, label | PREFETCH)
        return self


def pieces(events, line_bytes):
    """Return (line, label) for every line that an (address, size, label) event touches."""
    return [
        (line, label)
        for address, size, label in events
        for line in range(address // line_bytes, (address + size - 1) // line_bytes + 1)
    ]


class Unit:
    """The prefetch unit: a stack of [node, requested before?] entries and the prefetch pointer.

    ``absent`` are the nodes that are nowhere in memory, so that there is nothing to request.
    """

    def __init__(self, absent=()):
        self.stack, self.pointer, self.absent = [], 0, absent

    def push(self, node):
        self.stack.append([node, False])
        self.pointer = len(self.stack)

    def pop(self):
        node, _ = self.stack.pop()
        self.pointer = min(self.pointer, len(self.stack))
        return node

    def leaf(self, budget, once=False):
        """Return the nodes requested at a leaf; a budget of None is unlimited."""
        requests = []
        while self.pointer > 0 and (budget is None or len(requests) < budget):
            self.pointer -= 1
            entry = self.stack[self.pointer]
            if not (once and entry[1]) and entry[0] not in self.absent:
                entry[1] = True
                requests.append(entry[0])
        return requests


def derive(rows, tree_kind, n_prims, budget=None, per_triangle=False, once=False, empty=False):
    """Return the (node, is_request) events of the demand rows (node, kind) under a policy of the prefetch unit.

    In the kind ``bvh64`` leaves, which have triangles, are nowhere in memory.
    """
    absent = {node for node, n in enumerate(n_prims) if n and tree_kind == "bvh64"}
    unit, last_kind, events = Unit(absent), None, []
    for node, kind in rows:
        if kind == 3:
            continue
        if node == 0:
            unit = Unit(absent)
        elif last_kind == 1:
            unit.push(((node - 1) ^ 1) + 1)
        elif last_kind == 2 or tree_kind == "bvh" or (tree_kind == "bvh64" and [node] in [each[:1] for each in unit.stack]):
            while unit.pop() != node:
                assert tree_kind != "bvh"
        if node not in absent:
            events.append((node, False))
        if kind == 2 and (empty or n_prims[node]):
            limit = budget * n_prims[node] if per_triangle else budget
            events += [(request, True) for request in unit.leaf(limit, once)]
        last_kind = kind
    return events
