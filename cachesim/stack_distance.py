"""Exact LRU stack distances: line ids and access types in, the misses of every fully associative cache out.

The stack distance of an access is the number of different lines used since the last access to its line, that line included:
1 for an immediate repeat. A fully associative LRU cache of n lines hits exactly the accesses whose distance is at most n.

Time is cut into slots, one for each access. A slot is *live* while its access is the last one to its line, so there are as
many live slots as lines, and the distance of an access is the number of live slots from its line's slot on. Live slots are
bits of 64-bit words. For the 97 to 99 % of accesses that come back within the newest words, these are counted directly.
Beyond them, sums say how many live slots lie before a word: ``in_group`` from the start of its group of 64 words, and
``to_group`` from the start to that group. When the slots are used up, the live ones are moved together.

The distances of a stream of demand accesses and prefetches are exact for both, because a prefetch refreshes as a read does.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from cachesim.access import PREFETCH
from cachesim.layout import Layout
from cachesim.prefetch import Prefetch, parse_prefetch
from cachesim.source import Source, as_source, demand_only
from nptrace_base.errors import NptraceError
from nptrace_base.jit import kernel
from traces.reader import Run

ZERO, ONE = np.uint64(0), np.uint64(1)  # indices are unsigned: a signed one is tested for wrap-around at every access
#: A word holds 64 slots and a group 64 words: ``slot >> SHIFT`` is the word, ``slot & MASK`` the bit in it, and so on.
SHIFT, MASK = np.uint64(6), np.uint64(63)
ALL_LIVE = np.uint64(0xFFFFFFFFFFFFFFFF)
_WORD_SLOTS, _GROUP_SLOTS = 64, 64 * 64

#: Columns of the counts: demand accesses, prefetches.
COLUMNS = np.uint64(2)

#: Words that are counted directly besides the current one. Measured: 4 and 8 took 1.03 times the time.
_NEAR = 6
NEAR = np.uint64(_NEAR)

_SLOTS_PER_LINE = 8  # more would be moved together less often: twice as many changed the time by less than 2 %
_MOST_SLOTS = 1 << 31  # slots are numbered with 32 bits

# Entries of the state.
NEXT, LIVE, LAST_ID = range(3)


class Slots(NamedTuple):
    """The slots of one stream."""

    of_line: np.ndarray  # (n_ids,) uint32: 1 + slot of the last access to each line; 0: none
    live: np.ndarray  # (n_words + _NEAR,) uint64; the last words stay 0
    in_group: np.ndarray  # (n_words,) uint16
    to_group: np.ndarray  # (n_groups,) uint32
    state: np.ndarray  # (3,) int64
    first_ids: np.ndarray  # (n_ids,) uint32: every line accessed, in the order of first accesses
    first_types: np.ndarray  # (n_ids,) uint8: the access types of those


class StackDistances:
    """The stack distances of one stream, batch by batch: a summary, as ``cachesim.summary`` describes.

    Attributes
    ----------
    counts : (n, 2) int64
        ``counts[d]``: demand accesses and prefetches at distance d; ``counts[0]``: first accesses to a line.
    """

    def __init__(self) -> None:
        self.counts = np.zeros((1, 2), np.int64)
        self._slots = _slots(np.zeros(0, np.uint32), 0, np.array([0, 0, -1], np.int64))

    def _make_room(self, n_ids: int) -> None:
        """Grow to room for line ids below ``n_ids``."""
        n_slots = -(-min(_SLOTS_PER_LINE * n_ids, _MOST_SLOTS) // _GROUP_SLOTS) * _GROUP_SLOTS
        if n_slots < 2 * n_ids:
            raise NptraceError(f"the trace touches {n_ids} lines; stack distances are limited to 2^30 lines; use longer lines")
        renumber(self._slots)
        counts, of_line = np.zeros((n_ids + 1, 2), np.int64), np.zeros(n_ids, np.uint32)
        counts[: len(self.counts)], of_line[: self._slots.of_line.size] = self.counts, self._slots.of_line
        self.counts, before = counts, self._slots
        self._slots, n = _slots(of_line, n_slots, before.state), before.first_ids.size
        self._slots.first_ids[:n], self._slots.first_types[:n] = before.first_ids, before.first_types
        pack(self._slots)

    def step(self, ids: np.ndarray, access_types: np.ndarray, n_ids: int) -> None:
        """Take the next (id uint32, access type uint8) pairs; ids are dense and below ``n_ids``."""
        if n_ids > self._slots.of_line.size:
            self._make_room(max(n_ids, 2 * self._slots.of_line.size, 1024))
        self._count(ids, access_types, self.counts)

    def _count(self, ids: np.ndarray, access_types: np.ndarray, counts: np.ndarray) -> None:
        done = count_distances(ids, access_types, 0, self._slots, counts.reshape(-1))
        while done < ids.size:
            renumber(self._slots)
            pack(self._slots)
            done = count_distances(ids, access_types, done, self._slots, counts.reshape(-1))

    def misses(self, n_lines: int) -> tuple[int, int]:
        """Return the misses of demand accesses and of prefetches in the fully associative LRU cache of ``n_lines`` lines."""
        demand, prefetch = self.counts[0] + self.counts[n_lines + 1 :].sum(axis=0)
        return int(demand), int(prefetch)

    def then(self, later: "StackDistances") -> "StackDistances":
        """Return the summary of this part and the one that follows, whose ids are the same lines'; neither changes."""
        whole, arrays = StackDistances(), later.arrays()
        whole.load(self.arrays())
        whole.step(arrays["first_ids"], arrays["first_types"], later._slots.of_line.size)
        n_demand = int(np.count_nonzero(arrays["first_types"] < PREFETCH))
        whole.counts[: len(arrays["counts"])] += arrays["counts"]
        whole.counts[0] -= n_demand, arrays["first_types"].size - n_demand
        whole._use(arrays["order"])
        return whole

    def _use(self, ids: np.ndarray) -> None:
        """Access lines without counting."""
        self._count(ids, np.zeros(ids.size, np.uint8), np.zeros_like(self.counts))

    def arrays(self) -> dict[str, np.ndarray]:
        """Return all that the summary is; equal summaries have equal arrays. ``order``: the ids by last access."""
        slots, n = self._slots, int(self._slots.state[LIVE])
        used = np.flatnonzero(slots.of_line)
        return {
            "counts": self.counts[: 1 + int(np.flatnonzero(self.counts.any(axis=1)).max(initial=-1))],
            "order": used[np.argsort(slots.of_line[used])].astype(np.uint32),
            "first_ids": slots.first_ids[:n], "first_types": slots.first_types[:n],
            "n_ids": np.array([slots.of_line.size]),
        }  # fmt: skip

    def load(self, arrays: dict[str, np.ndarray]) -> None:
        """Become the summary that has these arrays; this one is new."""
        n_ids, n = int(arrays["n_ids"][0]), arrays["first_ids"].size
        if n_ids == 0:
            return
        self._make_room(n_ids)
        self._use(arrays["order"])
        self._slots.first_ids[:n], self._slots.first_types[:n] = arrays["first_ids"], arrays["first_types"]
        self.counts[: len(arrays["counts"])] = arrays["counts"]


def _slots(of_line: np.ndarray, n_slots: int, state: np.ndarray) -> Slots:
    n_words, n_groups = n_slots // _WORD_SLOTS, n_slots // _GROUP_SLOTS
    live, in_group = np.zeros(n_words + _NEAR, np.uint64), np.zeros(n_words, np.uint16)
    first_ids, first_types = np.empty(of_line.size, np.uint32), np.empty(of_line.size, np.uint8)
    return Slots(of_line, live, in_group, np.zeros(n_groups, np.uint32), state, first_ids, first_types)


def stack_distances(
    source: Source | Run | Path | str,
    line_bytes: int = 32,
    *,
    prefetch: Prefetch | str = "traced",
    layout: Layout | str = "stored",
) -> tuple[StackDistances, StackDistances]:
    """Return the stack distances of a trace with its prefetches and of its demand accesses alone (B and A of the paper).

    Parameters
    ----------
    source : Source, Run or path
        A path is a run's directory or a DineroIV trace. ``layout`` is that of a Run or path.
    line_bytes : int
    prefetch : Prefetch or str
        Any policy whose requests do not depend on the cache.
    """
    prefetch = parse_prefetch(prefetch) if isinstance(prefetch, str) else prefetch
    check_one_pass(prefetch)
    source = as_source(source, layout)
    lines_of = source.lines(line_bytes, 0)
    everything, demand = StackDistances(), StackDistances()
    for events, access_types in source.events(prefetch):
        lines, line_types = lines_of.accesses(events, access_types)
        ids = lines_of.ids(lines)
        everything.step(ids, line_types, lines_of.n_ids)
        demand.step(*demand_only(ids, line_types), lines_of.n_ids)
    return everything, demand


def check_one_pass(prefetch: Prefetch) -> None:
    """Raise NptraceError if the prefetches depend on hits and misses: one pass cannot serve caches that differ in these."""
    if prefetch.trigger:
        raise NptraceError(
            f"the prefetches of {prefetch} depend on hits and misses, so one pass cannot serve several caches; "
            "use none, traced or stack:..., or use npcache replay"
        )


@kernel(forceinline=True)
def n_bits(x):
    """Return the number of ones in a uint64; LLVM knows the idiom and makes one instruction of it where there is one."""
    x = x - ((x >> np.uint64(1)) & np.uint64(0x5555555555555555))
    x = (x & np.uint64(0x3333333333333333)) + ((x >> np.uint64(2)) & np.uint64(0x3333333333333333))
    x = (x + (x >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (x * np.uint64(0x0101010101010101)) >> np.uint64(56)


@kernel(forceinline=True)
def word_of_newest(slot):
    """Return the word of the slot before this one, the first word if there is none."""
    return (slot - ONE) >> SHIFT if slot else ZERO


@kernel(forceinline=True)
def enter_sums(word, live, in_group, to_group):
    """Set the sums of a word from those of the word before it."""
    if word == ZERO:
        return
    before = word - ONE
    n = np.uint64(in_group[before]) + n_bits(live[before])
    if word & MASK:
        in_group[word] = n
    else:
        in_group[word] = 0
        to_group[word >> SHIFT] = np.uint64(to_group[before >> SHIFT]) + n


# Without counting references (_nrt=False): the kernels take arrays out of a tuple.
@kernel(_nrt=False)
def count_distances(ids, access_types, start, slots, counts):
    """Count the distances of ids[start:] until all are done or the slots are used up; return the first not done.

    The sums hold for the words that are at least ``NEAR`` before the current one. The current word is kept in a register and
    is 0 in ``live``: a write and a read of the same word for every access took 1.2 times the time.
    """
    slot_of, live, in_group, to_group, state, first_ids, first_types = slots
    slot, n_live, last_id = np.uint64(state[NEXT]), np.uint64(state[LIVE]), state[LAST_ID]
    n_slots = np.uint64(in_group.size) << SHIFT
    here = word_of_newest(slot)
    current = live[here]
    live[here] = ZERO
    i = start
    while i < ids.size and slot < n_slots:
        line_id, is_prefetch = np.uint64(ids[i]), np.uint64(access_types[i] >= PREFETCH)
        i += 1
        if np.int64(line_id) == last_id:
            counts[COLUMNS + is_prefetch] += 1  # distance 1
            continue
        last_id = np.int64(line_id)
        if slot >> SHIFT != here:
            live[here] = current
            here, current = slot >> SHIFT, ZERO
            if here >= NEAR:
                enter_sums(here - NEAR, live, in_group, to_group)
        old = np.uint64(slot_of[line_id])
        distance = ZERO
        if old == ZERO:
            first_ids[n_live], first_types[n_live] = line_id, access_types[i - 1]
            n_live += ONE
        else:
            old -= ONE
            word, bit = old >> SHIFT, old & MASK
            # A branch for the current word, none for the others: 0.75 to 0.9 of the time of no branch or of a loop.
            if word == here:
                distance = n_bits(current >> bit)
                current ^= ONE << bit
            else:
                bits = live[word]
                live[word] = bits ^ (ONE << bit)
                if here - word <= NEAR:
                    distance = n_bits(bits >> bit) + n_bits(current)
                    for k in range(1, _NEAR):
                        distance += n_bits(live[word + np.uint64(k)])
                else:
                    group = word >> SHIFT
                    older = np.uint64(to_group[group]) + np.uint64(in_group[word]) + n_bits(bits & ((ONE << bit) - ONE))
                    distance = n_live - older
                    remove(word, here - NEAR, in_group, to_group)
        counts[COLUMNS * distance + is_prefetch] += 1
        current |= ONE << (slot & MASK)
        slot += ONE
        slot_of[line_id] = slot
    live[here] = current
    state[NEXT], state[LIVE], state[LAST_ID] = slot, n_live, last_id
    return i


@kernel(forceinline=True)
def remove(word, last, in_group, to_group):
    """Take one live slot of a word from the sums of the words after it, up to the last that has sums."""
    group, last_group = word >> SHIFT, last >> SHIFT
    end = last if group == last_group else (group << SHIFT) | MASK
    word += ONE
    while word <= end:
        in_group[word] -= 1
        word += ONE
    group += ONE
    while group <= last_group:
        to_group[group] -= 1
        group += ONE


@kernel(_nrt=False)
def renumber(slots):
    """Number the live slots 0, 1, 2 ... in order of time."""
    slot_of, live, in_group, to_group, state = slots[:5]
    here = word_of_newest(np.uint64(state[NEXT]))
    for word in range(here - NEAR + ONE if here >= NEAR else ZERO, here + ONE):
        enter_sums(word, live, in_group, to_group)
    for line_id in range(slot_of.size):
        slot = np.uint64(slot_of[line_id])
        if slot:
            word, bit = (slot - ONE) >> SHIFT, (slot - ONE) & MASK
            older = n_bits(live[word] & ((ONE << bit) - ONE))
            slot_of[line_id] = np.uint64(to_group[word >> SHIFT]) + np.uint64(in_group[word]) + older + ONE


@kernel(_nrt=False)
def pack(slots):
    """Set the bits and sums of slots that are all live, as many as there are lines."""
    _, live, in_group, to_group, state = slots[:5]
    n = np.uint64(state[LIVE])
    full = n >> SHIFT
    for word in range(np.uint64(live.size)):
        live[word] = ALL_LIVE if word < full else ZERO
    live[full] = (ONE << (n & MASK)) - ONE
    for word in range(np.uint64(in_group.size)):
        in_group[word] = (word & MASK) << SHIFT
    for group in range(np.uint64(to_group.size)):
        to_group[group] = group << (SHIFT + SHIFT)
    state[NEXT] = n
