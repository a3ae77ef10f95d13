"""The state of the clock: the parts of the machine of the paper's Figure 1, and the accounts of its cycles."""

from typing import NamedTuple

import numpy as np

from cachesim.clock.calendar import Calendar, make_calendar
from cachesim.config import CacheConfig
from cachesim.policies.machine import Machine, lowest_on_lines
from cachesim.replacement import Lists, make_lists

#: What a ray in flight does in a cycle; every cycle of every slot is one of them.
SPENT_BOX, SPENT_TRIANGLE, SPENT_HIT, SPENT_MISS, SPENT_LATE, SPENT_PORT, SPENT_MSHR, SPENT_UNIT, SPENT_IDLE = range(9)
CYCLES = ("box test", "triangle test", "hit", "demand miss", "late prefetch", "port", "MSHR full", "unit busy", "idle")

#: What a tally is kept by, and its columns: lines looked up by reads, those that missed, and requests with what became of
#: them.
BY = ("nothing", "level", "ray", "slot", "leaf")
BY_NOTHING, BY_LEVEL, BY_RAY, BY_SLOT, BY_LEAF = range(len(BY))
TALLY = ("reads", "misses", "late", "timely", "redundant", "joined", "filled", "evicted")
T_READS, T_MISSES, T_LATE, T_TIMELY, T_REDUNDANT, T_JOINED, T_FILLED, T_EVICTED = map(np.int64, range(len(TALLY)))

#: What the next event of a slot is.
VISIT_DUE, LEAF_DUE, TEST_DUE, RAY_DUE = range(4)

#: A ray in flight. ``event`` is what is due in cycle ``due``; ``row`` and ``end`` are rows of the demand stream, ``number``
#: its ray's number, ``started`` the cycle of its start, ``waiter`` the slot whose shadow ray waits for its end.
#: ``last_kind`` and ``last_node``: of its last visit. ``since``: up to which cycle its time is accounted. Of a read:
#: ``seen``, the cycle in which it first was first at a free port; ``lines_done``; when its data comes (``data_at``) and what
#: that time counts as (``data_from``).
SLOT = np.dtype([
    (name, np.int64)
    for name in (
        "event", "due", "row", "end", "number", "type", "started", "waiter", "last_kind", "last_node", "since", "seen",
        "lines_done", "data_at", "data_from",
    )
])  # fmt: skip

#: The numbers of the machine, then the account of lines: what demand reads found, what prefetches found, and what became of
#: the lines that prefetches filled.
NUMBERS = np.dtype([
    (name, np.int64)
    for name in (
        "is_started", "next_ray", "n_queued", "queue_head", "in_flight", "oldest", "bus_free", "n_ended", "last_cycle",
        "n_logged",
        "hits", "misses", "joined_by_demand", "redundant", "joined", "filled", "timely", "late", "saved", "waited", "evicted",
        "wanted_again", "pollution",
    )
])  # fmt: skip


class Parameters(NamedTuple):
    """The numbers of a machine, in cycles unless a comment says otherwise; ``clock.parameters.Clock`` has their meanings."""

    hit: int
    miss: int
    mshrs: int
    ports: int
    transfer: int  # between two arrivals of lines
    box: int
    triangle: int
    every: int  # from the start of one triangle's test to the start of the next
    n_units: int  # 0: as many as rays
    is_perfect: bool  # every demand read hits
    skips: bool  # entries may leave the stack unread
    follows: bool  # after a read that pushed nothing, a child may be read next
    watches_leaves: bool  # the policy has a hook at leaves
    by: int  # what the tally is kept by
    mask: int  # of fast_lru.set_of


class ClockState(NamedTuple):
    """Everything that changes, updated in place."""

    slots: np.ndarray  # (n_slots,) SLOT
    numbers: np.ndarray  # (1,) NUMBERS
    calendar: Calendar
    lists: Lists  # the cache's replacement
    arrival: np.ndarray  # (n_lines,) int64: of a line in flight
    flight: np.ndarray  # (mshrs,) int64: lines in flight, a ring, in the order of their arrival
    queue: np.ndarray  # (n_slots,) int64: slots that wait for the port with a demand read, a ring
    units_free: np.ndarray  # (n_units,) int64: cycle in which each intersection unit takes the next leaf
    cycles: np.ndarray  # (9,) int64
    tally: np.ndarray  # (n_classes, len(TALLY)) int64
    class_of: np.ndarray  # (n_lines,) uint32: class of the prefetch that filled each line; empty without a tally
    level_of: np.ndarray  # (n_lines,) int64: class of a request of each line in a tally by level, else empty
    log: np.ndarray  # (n, 6) int64: events of the timeline; none are kept if it is empty
    log_from: int  # the ray whose start begins the timeline


class Rows(NamedTuple):
    """A stretch of the demand stream. Row and ray numbers count from the beginning of the run.

    ``waits_for``: for a ray, -1: nothing; -2: it follows the ray before it in the same slot; else the ray it waits for.
    """

    nodes: np.ndarray  # (n,) uint32
    kinds: np.ndarray  # (n,) uint8
    first: np.ndarray  # (n_rays + 1,) int64: row of each ray's first visit
    types: np.ndarray  # (n_rays,) uint8: primary or shadow
    waits_for: np.ndarray  # (n_rays,) int64
    first_row: int
    first_ray: int
    is_last: bool


def make_state(
    config: CacheConfig, machine: Machine, parameters: Parameters, n_logged: int = 0, log_from: int = 0
) -> ClockState:
    """Return the state before the first cycle; the timeline keeps ``n_logged`` events from the start of a ray on."""
    n_slots, n_lines = machine.sp.size, machine.status.size
    return ClockState(
        slots=np.full(n_slots, -1, np.int64).repeat(SLOT.itemsize // 8).view(SLOT).view(np.recarray),
        numbers=np.zeros(1, NUMBERS).view(np.recarray),
        calendar=make_calendar(n_slots),
        lists=make_lists(config, n_lines),
        arrival=np.zeros(n_lines, np.int64),
        flight=np.zeros(parameters.mshrs, np.int64),
        queue=np.zeros(n_slots, np.int64),
        units_free=np.zeros(parameters.n_units, np.int64),
        cycles=np.zeros(len(CYCLES), np.int64),
        tally=np.zeros((n_classes(machine, parameters.by), len(TALLY)), np.int64),
        class_of=np.zeros(n_lines if parameters.by else 0, np.uint32),
        level_of=_level_of_lines(machine, n_lines if parameters.by == BY_LEVEL else 0),
        log=np.zeros((n_logged, 6), np.int64),
        log_from=log_from,
    )


def n_classes(machine: Machine, by: int) -> int:
    """Return the classes of a tally: levels or types of rays, places on the stack from the top, leaf sizes.

    After the levels comes the class of lines without a node, after the places that of nodes that are not on the stack.
    """
    tree = machine.tree
    return (0, int(tree.level.max()) + 2, 2, machine.stack.shape[1] + 1, int(tree.n_prims.max()) + 1)[by]


def _level_of_lines(machine: Machine, n_lines: int) -> np.ndarray:
    """Return the level nearest the root of the nodes on each of the first lines, or the class of lines without a node."""
    if not n_lines:
        return np.empty(0, np.int64)
    return lowest_on_lines(machine.tree, machine.tree.level.astype(np.int64), n_lines, n_classes(machine, BY_LEVEL) - 1)
