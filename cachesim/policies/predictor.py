"""The ray predictor (Liu et al., MICRO 2021: Intersection Prediction) as a prefetcher.

A table maps the key of a ray, its quantised origin and direction, to a node above the leaf that a ray of this key has hit.
With the first read of a ray the table is looked up, and the nodes on the path to the stored node are requested, from the top
down. When a ray that hits has ended and the stored node is not above its leaf, the table learns the node ``up`` levels above.

As published: the key (a grid for the origin, xor theta and phi of the direction), the set (the key, folded by xor), 1024
entries in 4 ways with LRU and one node each, 3 levels up, no entry from rays that miss. Different here: the original starts
the ray at the stored node and reads nothing above it; the grid spans the points where shadow rays start, since a run has no
box of the scene; looking up takes no time; the leaf of a hit is the one whose triangles were tested last, which for most, but
not all, closest hits in a BVH is the leaf of the triangle hit.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from cachesim.policies import Facts, Policy, whole
from cachesim.policies.hooks import NOTHING
from cachesim.policies.machine import ONE, Machine, drop, drop_demanded, offer, stop_waiting
from nptrace_base.errors import NptraceError
from nptrace_base.jit import inlined
from traces.rays import TracedRays

FORM = "predictor[:entries=N][:ways=W][:origin=B][:direction=B][:up=L]"
HELP = (
    "the ray predictor (2021): at a ray's start the path to the node L = 3 levels above the leaf that a ray of like origin "
    "(B = 5 bits an axis) and direction (B = 3, and 4, bits) has hit, from a table of N = 1024 entries in W = 4 ways"
)

#: Options: their defaults, and the least and most of each.
_OPTIONS = {"entries": (1024, 1, 1 << 20), "ways": (4, 1, 64), "origin": (5, 0, 10), "direction": (3, 0, 8), "up": (3, 0, 99)}


class Predictor(NamedTuple):
    """The table, what is known of the rays, and the path that every ray in flight requests.

    Attributes
    ----------
    keys, sets : (n_rays,) int64
        Key and set of every ray.
    is_hit : (n_rays,) bool
    tags, nodes : (n_sets, n_ways) int64
        Keys, most recently used first, -1 for none; and the node stored with each.
    path : (n_slots, depth) int64
        Nodes to request.
    at, end : (n_slots,) int64
        The next of them and the end of them.
    predicted : (n_slots,) int64
        Node that the table had for the ray; -1 for none, -2 if it has not been looked up.
    leaf : (n_slots,) int64
        Leaf tested last, -1 for none.
    up : int
    """

    keys: np.ndarray
    sets: np.ndarray
    is_hit: np.ndarray
    tags: np.ndarray
    nodes: np.ndarray
    path: np.ndarray
    at: np.ndarray
    end: np.ndarray
    predicted: np.ndarray
    leaf: np.ndarray
    up: int

    def on_start(self, machine, slot):
        self.at[slot], self.end[slot] = 0, 0
        self.predicted[slot], self.leaf[slot] = -2, -1

    def on_visit(self, machine, slot, line, outcome):
        if self.predicted[slot] == -2:  # not before: the origin of a shadow ray that waits is not known
            self.predicted[slot] = look_up(self, machine.ray[slot])
            if self.predicted[slot] >= 0:
                offer(machine, slot, walk(self, machine, slot))
        elif self.at[slot] < self.end[slot]:
            node = self.path[slot, self.at[slot]]
            first = np.int64(machine.tree.first_line[node])
            if first <= line < first + machine.tree.n_lines[node]:
                drop_demanded(machine, ONE)
                machine.lines_asked[slot] = 0
                self.at[slot] += 1
                if self.at[slot] == self.end[slot]:
                    stop_waiting(machine, slot)

    def on_leaf(self, machine, slot, node):
        self.leaf[slot] = node

    def on_end(self, machine, slot):
        drop(machine, slot, self.end[slot] - self.at[slot])
        stop_waiting(machine, slot)
        ray, node = machine.ray[slot], self.leaf[slot]
        if node <= 0 or not self.is_hit[ray]:
            return
        above = node
        while above > self.predicted[slot] and above > 0:  # a parent has a smaller number
            above = np.int64(machine.tree.parent[above])
        if above != self.predicted[slot]:
            left = self.up
            while left > 0 and machine.tree.level[node] > 1:
                node = np.int64(machine.tree.parent[node])
                left -= 1
            learn(self, ray, node)

    def request(self, machine, slot):
        return self.path[slot, self.at[slot]] if self.at[slot] < self.end[slot] else np.int64(NOTHING)

    def requested(self, machine, slot):
        self.at[slot] += 1


@inlined
def find(unit, ray):
    """Return the way of a ray's key; if it is in none, the last, which is replaced next."""
    way, of = np.int64(0), unit.sets[ray]
    while way + 1 < unit.tags.shape[1] and unit.tags[of, way] != unit.keys[ray]:
        way += 1
    return way


@inlined
def look_up(unit, ray):
    """Return the node of a ray's key, which becomes the most recent; -1 for none."""
    way, of = find(unit, ray), unit.sets[ray]
    if unit.tags[of, way] != unit.keys[ray]:
        return np.int64(-1)
    node = unit.nodes[of, way]
    put_first(unit, of, way, unit.keys[ray], node)
    return node


@inlined
def learn(unit, ray, node):
    """Store a node for a ray's key, in place of what it had, or of the least recent key."""
    put_first(unit, unit.sets[ray], find(unit, ray), unit.keys[ray], node)


@inlined
def put_first(unit, of, way, key, node):
    """Write an entry as the most recent of its set, over the entry of a way."""
    while way > 0:
        unit.tags[of, way], unit.nodes[of, way] = unit.tags[of, way - 1], unit.nodes[of, way - 1]
        way -= 1
    unit.tags[of, 0], unit.nodes[of, 0] = key, node


@inlined
def walk(unit, machine, slot):
    """Note the path to the predicted node, below the root, which the ray reads already; return its length."""
    node = unit.predicted[slot]
    if machine.tree.n_lines[node] == 0:
        node = np.int64(machine.tree.parent[node])
    unit.end[slot] = machine.tree.level[node]
    for i in range(unit.end[slot]):
        unit.path[slot, unit.end[slot] - 1 - i] = node
        node = np.int64(machine.tree.parent[node])
    return unit.end[slot]


def keys_of(rays: TracedRays, origin_bits: int, direction_bits: int) -> np.ndarray:
    """Return the keys of rays, (n,) int64.

    The origin is quantised by a grid of 2^origin_bits cells an axis over the points where shadow rays start; theta and phi of
    the direction, in whole degrees, keep the upper ``direction_bits`` of 8 and one more of 9 bits.
    """
    shadows = rays.origin[rays.is_shadow].astype(np.float64)
    low, high = (shadows.min(axis=0), shadows.max(axis=0)) if len(shadows) else (np.zeros(3), np.zeros(3))
    size = np.where(high > low, high - low, 1.0)
    cell = np.clip((rays.origin - low) / size * (1 << origin_bits), 0, (1 << origin_bits) - 1).astype(np.int64)
    x, y, z = rays.direction.astype(np.float64).T
    theta = np.degrees(np.arctan2(np.hypot(x, y), z)).astype(np.int64) >> (8 - direction_bits)
    phi = (np.degrees(np.arctan2(y, x)) + 180).astype(np.int64) >> (8 - direction_bits)
    return ((cell[:, 0] << 2 * origin_bits) | (cell[:, 1] << origin_bits) | cell[:, 2]) ^ ((phi << direction_bits) | theta)


def folded(keys: np.ndarray, n_sets: int) -> np.ndarray:
    """Return the sets of keys: their groups of log2(n_sets) bits, combined by xor."""
    sets, rest = np.zeros_like(keys), keys if n_sets > 1 else keys * 0
    while rest.any():
        sets ^= rest & (n_sets - 1)
        rest = rest >> (n_sets.bit_length() - 1)
    return sets


def parse(options: Sequence[str]) -> dict[str, Any]:
    """Return the options as numbers."""
    values = {name: default for name, (default, _, _) in _OPTIONS.items()}
    for option in options:
        name = option.partition("=")[0]
        if name not in _OPTIONS:
            raise NptraceError(f"{option!r} is not one of its options")
        _, low, high = _OPTIONS[name]
        values[name] = whole(option, name, low, high)
    n_sets = values["entries"] // values["ways"]
    if n_sets * values["ways"] != values["entries"] or n_sets & (n_sets - 1):
        raise NptraceError(f"entries / ways is a power of two, and {values['entries']} / {values['ways']} is not")
    return values


def make_unit(
    machine: Machine, facts: Facts, *, entries: int, ways: int, origin: int, direction: int, up: int
) -> Predictor:  # fmt: skip
    """Return the unit of a machine."""
    if facts.rays is None:
        raise NptraceError("the predictor needs the rays of a whole run; time all of it")
    n_slots, depth = machine.stack.shape
    rays, n_sets = facts.rays(), entries // ways
    keys = keys_of(rays, origin, direction)
    return Predictor(
        keys=keys, sets=folded(keys, n_sets), is_hit=rays.is_hit,
        tags=np.full((n_sets, ways), -1, np.int64), nodes=np.zeros((n_sets, ways), np.int64),
        path=np.zeros((n_slots, depth), np.int64), at=np.zeros(n_slots, np.int64), end=np.zeros(n_slots, np.int64),
        predicted=np.full(n_slots, -1, np.int64), leaf=np.full(n_slots, -1, np.int64), up=up,
    )  # fmt: skip


POLICY = Policy("predictor", FORM, parse, make_unit, needs_clock=True, watches_leaves=True)
