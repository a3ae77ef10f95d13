"""The calendar of the clock: in which cycle each ray in flight has its next event. One event a slot at a time."""

from typing import NamedTuple

import numpy as np

from nptrace_base.jit import inlined

#: Cycles that the calendar shows; later events are entered again on its last day.
SPAN = 1024
_WORDS = SPAN // 64

NEVER = np.int64(1) << 62

#: Position of the lowest bit of x, by the top six bits of (x & -x) * _MAGIC: a de Bruijn sequence.
_MAGIC = np.uint64(0x03F79D71B4CB0A89)
_LOWEST = np.zeros(64, np.int64)
for _bit in range(64):
    _LOWEST[((int(_MAGIC) << _bit) & (2**64 - 1)) >> 58] = _bit


class Calendar(NamedTuple):
    """Events by cycle.

    Attributes
    ----------
    slots : (SPAN, n_words) uint64
        Bit s % 64 of word s // 64: slot s has an event in this cycle, modulo SPAN.
    cycles : (SPAN // 64,) uint64
        One bit per cycle that has an event.
    """

    slots: np.ndarray
    cycles: np.ndarray


def make_calendar(n_slots: int) -> Calendar:
    """Return an empty calendar."""
    return Calendar(np.zeros((SPAN, -(-n_slots // 64)), np.uint64), np.zeros(_WORDS, np.uint64))


@inlined
def lowest_bit(word):
    """Return the position of the lowest bit set in a word that is not 0."""
    lowest = word & (~word + np.uint64(1))
    return _LOWEST[(lowest * _MAGIC) >> np.uint64(58)]


@inlined
def enter(calendar, slot, now, cycle):
    """Enter the event of a slot, later than ``now``; one beyond the calendar is shown on its last day."""
    place = min(cycle, now + SPAN - 1) & (SPAN - 1)
    calendar.slots[place, slot >> 6] |= np.uint64(1) << np.uint64(slot & 63)
    calendar.cycles[place >> 6] |= np.uint64(1) << np.uint64(place & 63)


@inlined
def next_cycle(calendar, now):
    """Return the next cycle after ``now`` in which to look, NEVER without events."""
    place = (now + 1) & (SPAN - 1)
    word = place >> 6
    bits = calendar.cycles[word] >> np.uint64(place & 63)
    if bits:
        return now + 1 + lowest_bit(bits)
    for _ in range(_WORDS):
        word = (word + 1) & (_WORDS - 1)
        bits = calendar.cycles[word]
        if bits:
            cycle = (word << 6) + lowest_bit(bits)
            return now + ((cycle - now) & (SPAN - 1))
    return NEVER


@inlined
def take_word(calendar, now, word):
    """Return one word of the slots entered for this cycle, and strike it out."""
    place = now & (SPAN - 1)
    slots = calendar.slots[place, word]
    calendar.slots[place, word] = 0
    calendar.cycles[place >> 6] &= ~(np.uint64(1) << np.uint64(place & 63))
    return slots
