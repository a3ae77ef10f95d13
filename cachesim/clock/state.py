"""The state of the clock: the parts of the machine of the paper's Figure 1, and the accounts of its cycles."""

from typing import NamedTuple

import numpy as np

from cachesim.clock.calendar import Calendar, make_calendar
from cachesim.config import CacheConfig
from cachesim.policies.machine import Machine
from cachesim.replacement import Lists, make_lists

#: What a ray in flight does in a cycle; every cycle of every slot is one of them.
BOX, TRIANGLE, HIT, MISS, LATE, PORT, MSHR, UNIT, IDLE = range(9)
CYCLES = ("box test", "triangle test", "hit", "demand miss", "late prefetch", "port", "MSHR full", "unit busy", "idle")

#: Entries of the account of lines.
DEMAND_HITS, DEMAND_MISSES, DEMAND_JOINED, REDUNDANT, JOINED, FILLED, TIMELY, LATE_USED, SAVED, WAITED, EVICTED, WANTED_AGAIN, POLLUTION = (
    range(13)
)  # fmt: skip
N_LINES_ACCOUNT = 13

#: What the next event of a slot is.
VISIT, LEAF, TEST, FREE = range(4)

#: Entries of ``Progress.numbers``.
NEXT_RAY, N_QUEUED, QUEUE_HEAD, IN_FLIGHT, OLDEST, BUS_FREE, N_RUNNING, LAST_CYCLE, IS_STARTED, N_LOGGED = range(10)


class Parameters(NamedTuple):
    """The numbers of a machine, in cycles where nothing else is said; ``clock.parameters.Clock`` has their meanings."""

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
    mask: int  # of fast_lru.set_of


class Slots(NamedTuple):
    """The rays in flight: (n_slots,) int64 each.

    ``event`` is what is due; ``row`` and ``end`` are rows of the demand stream, ``ray`` a ray of it, ``waiter`` the slot whose
    shadow ray waits for this ray's end. Of the read in progress: since when it has been ready or granted, its lines done, and
    when and why its data comes. ``seen``: cycle in which it first was first in the queue with a port free.
    """

    event: np.ndarray
    row: np.ndarray
    end: np.ndarray
    ray: np.ndarray
    last_kind: np.ndarray
    last_node: np.ndarray
    waiter: np.ndarray
    started: np.ndarray
    since: np.ndarray
    seen: np.ndarray
    lines_done: np.ndarray
    data_at: np.ndarray
    data_from: np.ndarray


class ClockState(NamedTuple):
    """Everything that changes, updated in place."""

    slots: Slots
    calendar: Calendar
    lists: Lists  # the cache's replacement
    arrival: np.ndarray  # (n_lines,) int64: of a line in flight
    flight: np.ndarray  # (mshrs,) int64: lines in flight, a ring, in the order of their arrival
    queue: np.ndarray  # (n_slots,) int64: slots that wait for the port with a demand read, a ring
    units_free: np.ndarray  # (n_units,) int64: cycle in which each intersection unit takes the next leaf
    numbers: np.ndarray  # (10,) int64
    cycles: np.ndarray  # (9,) int64
    lines: np.ndarray  # (N_LINES_ACCOUNT,) int64
    log: np.ndarray  # (n, 6) int64: events of the timeline; none are kept if it is empty


class Rows(NamedTuple):
    """A stretch of the demand stream. Row and ray numbers count from the beginning of the run.

    ``waits_for``: for a ray, -1: nothing; -2: it follows the ray before it in the same slot; else the ray it waits for.
    """

    nodes: np.ndarray  # (n,) uint32
    kinds: np.ndarray  # (n,) uint8
    first: np.ndarray  # (n_rays + 1,) int64: row of each ray's first visit
    waits_for: np.ndarray  # (n_rays,) int64
    first_row: int
    first_ray: int
    is_last: bool


def make_state(config: CacheConfig, machine: Machine, parameters: Parameters, n_logged: int = 0) -> ClockState:
    """Return the state before the first cycle; the timeline keeps ``n_logged`` events."""
    n_slots, n_lines = machine.sp.size, machine.status.size
    return ClockState(
        slots=Slots(*(np.full(n_slots, -1, np.int64) for _ in Slots._fields)),
        calendar=make_calendar(n_slots),
        lists=make_lists(config, n_lines),
        arrival=np.zeros(n_lines, np.int64),
        flight=np.zeros(parameters.mshrs, np.int64),
        queue=np.zeros(n_slots, np.int64),
        units_free=np.zeros(parameters.n_units, np.int64),
        numbers=np.zeros(10, np.int64),
        cycles=np.zeros(len(CYCLES), np.int64),
        lines=np.zeros(N_LINES_ACCOUNT, np.int64),
        log=np.zeros((n_logged, 6), np.int64),
    )
