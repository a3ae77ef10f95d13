"""Which line leaves a set: replacement as linked lists over dense line ids, so the cost does not grow with the ways.

Every line that can occur has an id, 0, 1, 2 ... A set is a ring of ids, newest first, through a node of its own; LRU moves a
line to the front at every access, FIFO never. Random keeps the lines of a set in numbered slots instead; OPT (Belady) has them
there as a heap, with the line that is used last of all at its root. The real cache and the fully associative one beside it
(one set) are both a ``Lists``.
"""

from typing import NamedTuple

import numpy as np

from cachesim.config import POLICIES, CacheConfig
from nptrace_base.errors import NptraceError
from nptrace_base.jit import kernel

#: Most nodes of all rings together: their numbers are int32.
MOST_NODES = (1 << 31) - 1

LRU, FIFO, RANDOM, OPT = (POLICIES.index(name) for name in ("lru", "fifo", "random", "opt"))

# These kernels are called once per access. They allocate nothing and are compiled without Numba's reference counts
# (_nrt=False), which took 60 of 65 ns per access around calls that pass a tuple of arrays.


class Lists(NamedTuple):
    """The lines of every set, in order of replacement. All arrays are state, updated in place.

    Attributes
    ----------
    links : (2 * (n_sets + n_ids),) int32
        Older and newer neighbour of each ring node: first the sets' own nodes, then one per line id. OPT: the first of the
        two is the line's place in ``slots``.
    slots : (n_sets * ways,) int32
        Random and OPT: the line id in each way; OPT: a heap per set, by ``due``.
    due : (n_ids,) int64
        OPT only: when each line is used next, written before each access; no two are equal.
    held : (n_sets,) int32
        Number of lines in each set.
    random : (1,) uint64
        State of the generator (SplitMix64).
    policy, n_sets, ways : int
    has_slots : int
        1 for random and OPT, 0 for the rings. Asking for OPT and then for random took 1.1 to 1.3 times the time of a replay.
    """

    links: np.ndarray
    slots: np.ndarray
    due: np.ndarray
    held: np.ndarray
    random: np.ndarray
    policy: int
    has_slots: int
    n_sets: int
    ways: int


def make_lists(config: CacheConfig, n_ids: int, *, fully_associative: bool = False) -> Lists:
    """Return the empty lists of a cache, or of the fully associative cache with as many lines and the same policy."""
    n_sets, ways = (1, config.n_lines) if fully_associative else (config.n_sets, config.ways)
    policy = POLICIES.index(config.policy)
    has_slots = policy in (RANDOM, OPT)
    links = _links(n_sets, n_ids)
    links[: 2 * n_sets] = np.repeat(np.arange(n_sets, dtype=np.int32), 2)  # an empty ring: the set's node alone
    # The shadow draws from a stream of its own, so that asking for 3C does not change the cache itself.
    seed = np.uint64(config.seed ^ (0x5DEECE66D if fully_associative else 0))
    return Lists(
        links=links,
        slots=np.zeros(n_sets * ways if has_slots else 1, np.int32),
        due=np.zeros(n_ids if policy == OPT else 1, np.int64),
        held=np.zeros(n_sets, np.int32),
        random=np.array([seed], np.uint64),
        policy=policy,
        has_slots=int(has_slots),
        n_sets=n_sets,
        ways=ways,
    )


def grow_lists(lists: Lists, n_ids: int) -> Lists:
    """Return the same lists with room for more line ids."""
    links = _links(lists.n_sets, n_ids)
    links[: lists.links.size] = lists.links
    if lists.policy != OPT:
        return lists._replace(links=links)
    due = np.zeros(n_ids, np.int64)
    due[: lists.due.size] = lists.due
    return lists._replace(links=links, due=due)


def _links(n_sets: int, n_ids: int) -> np.ndarray:
    if n_sets + n_ids > MOST_NODES:
        raise NptraceError(
            f"a cache of {n_sets} sets and a trace of {n_ids} lines are more than 2^31 - 1 together; take a smaller "
            "cache, more ways or longer lines"
        )
    return np.zeros(2 * (n_sets + n_ids), np.int32)


def order_of(lists: Lists) -> np.ndarray:
    """Return the line ids in the rings, (n_sets * ways,) int32: newest first in each set, -1 for an empty way."""
    order = np.full(lists.n_sets * lists.ways, -1, np.int32)
    read_rings(lists, order)
    return order


@kernel(_nrt=False)
def read_rings(lists, order):
    """Write the line ids of every ring, newest first, into its set's places."""
    for s in range(lists.n_sets):
        node, at = lists.links[2 * s], s * lists.ways
        while node != s:
            order[at] = node - lists.n_sets
            at += 1
            node = lists.links[2 * node]


@kernel(_nrt=False)
def write_rings(order, lists):
    """Make the rings whose ``order_of`` is given."""
    links = lists.links
    for s in range(lists.n_sets):
        links[2 * s] = links[2 * s + 1] = s
        lists.held[s] = 0
        for way in range(lists.ways - 1, -1, -1):
            line_id = order[s * lists.ways + way]
            if line_id >= 0:
                _push_front(links, 2 * s, 2 * (lists.n_sets + line_id))
                lists.held[s] += 1


@kernel(_nrt=False, forceinline=True)
def split_mix(state):
    """Return the next 64 random bits (SplitMix64, Steele, Lea and Flood 2014)."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@kernel(_nrt=False, forceinline=True)
def refresh(lists, s, line_id):
    """Note an access to a line that set ``s`` holds: LRU moves it to the front."""
    links = lists.links
    if lists.policy != LRU:
        if lists.policy == OPT:
            _sift_up(lists, s * lists.ways, np.int64(links[2 * (lists.n_sets + line_id)]), line_id)
        return
    node, ring = 2 * (lists.n_sets + line_id), 2 * s
    if links[ring] == lists.n_sets + line_id:
        return
    older, newer = links[node], links[node + 1]
    links[2 * older + 1] = newer
    links[2 * newer] = older
    _push_front(links, ring, node)


@kernel(_nrt=False, forceinline=True)
def _push_front(links, ring, node):
    """Put a node at the front of a ring. Both are given as twice their number."""
    front = links[ring]
    links[ring] = node >> 1
    links[node] = front
    links[node + 1] = ring >> 1
    links[2 * front + 1] = node >> 1


@kernel(_nrt=False)
def _sift_up(lists, root, slot, line_id):
    """Put a line into a free slot of the heap at ``root``, or above it: its next use is later than that of what was there."""
    slots, due = lists.slots, lists.due
    while slot > root:
        parent = root + (slot - root - 1) // 2
        if due[slots[parent]] > due[line_id]:
            break
        slots[slot] = slots[parent]
        lists.links[2 * (lists.n_sets + slots[slot])] = slot
        slot = parent
    slots[slot] = line_id
    lists.links[2 * (lists.n_sets + line_id)] = slot


@kernel(_nrt=False)
def _sift_down(lists, root, line_id):
    """Put a line at the root of a full heap, or below it, in place of the line there.

    The lines that rise keep a stale place: an access is to the line of its set that is used soonest, which has none below it.
    """
    slots, due, end = lists.slots, lists.due, root + lists.ways
    slot = root
    while True:
        child = root + 2 * (slot - root) + 1
        if child >= end:
            break
        if child + 1 < end and due[slots[child + 1]] > due[slots[child]]:
            child += 1
        if due[line_id] > due[slots[child]]:
            break
        slots[slot] = slots[child]
        slot = child
    slots[slot] = line_id
    lists.links[2 * (lists.n_sets + line_id)] = slot


@kernel(_nrt=False)
def _insert_by_next_use(lists, s, line_id):
    """Put a line into the heap of set ``s``; return the id of the line it replaces, or -1."""
    root = s * lists.ways
    if lists.held[s] < lists.ways:
        lists.held[s] += 1
        _sift_up(lists, root, root + lists.held[s] - 1, line_id)
        return np.int64(-1)
    victim = np.int64(lists.slots[root])
    _sift_down(lists, root, line_id)
    return victim


@kernel(_nrt=False, forceinline=True)
def insert(lists, s, line_id):
    """Put a line into set ``s``, which does not hold it; return the id of the line it replaces, or -1."""
    victim = np.int64(-1)
    if lists.has_slots:
        if lists.policy == OPT:
            return _insert_by_next_use(lists, s, line_id)
        slot = s * lists.ways
        if lists.held[s] < lists.ways:
            slot += lists.held[s]
            lists.held[s] += 1
        else:
            high = split_mix(lists.random) >> np.uint64(32)
            slot += np.int64((high * np.uint64(lists.ways)) >> np.uint64(32))
            victim = np.int64(lists.slots[slot])
        lists.slots[slot] = line_id
        return victim
    links, ring = lists.links, 2 * s
    if lists.held[s] < lists.ways:
        lists.held[s] += 1
    else:
        oldest = links[ring + 1]
        newer = links[2 * oldest + 1]
        links[2 * newer] = s
        links[ring + 1] = newer
        victim = np.int64(oldest - lists.n_sets)
    _push_front(links, ring, 2 * (lists.n_sets + line_id))
    return victim
