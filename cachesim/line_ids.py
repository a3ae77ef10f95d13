"""Line numbers of any size -> dense ids 0, 1, 2 ... in order of first sight, so that facts about lines are plain arrays.

The lines of a run need none of this: a layout packs them. A DineroIV trace may use any of 2^32 addresses.
"""

import numpy as np

from nptrace_base.errors import NptraceError
from nptrace_base.jit import kernel

_MULTIPLIER = 0x9E3779B97F4A7C15  # 2^64 / golden ratio: Fibonacci hashing
#: Slots of the largest table: ids, which fill half of it, are int32.
MOST_SLOTS = 1 << 32


class DenseIds:
    """A growing table from line numbers to ids. Memory follows the number of different lines, not the trace's length."""

    def __init__(self) -> None:
        self.n_ids = 0
        self._make(1 << 12)

    def _make(self, size: int) -> None:
        self._keys = np.zeros(size, np.uint32)
        self._values = np.full(size, -1, np.int32)

    def ids(self, lines: np.ndarray) -> np.ndarray:
        """Return the id of each line (uint32 in, uint32 out), giving new lines the next free ids."""
        ids = np.empty(lines.size, np.uint32)
        done = 0
        while True:
            done, self.n_ids = number(lines, done, self._keys, self._values, self.n_ids, ids)
            if done == lines.size:
                return ids
            keys, values = self._keys, self._values
            if keys.size == MOST_SLOTS:
                raise NptraceError(f"the trace touches more than {self.n_ids:,} lines, which is the most; use longer lines")
            self._make(4 * keys.size)
            move(keys, values, self._keys, self._values)


@kernel
def slot_of(key, keys, values):
    """Return the slot that holds a key, or the free one where it belongs; keys.size is a power of two."""
    shift = np.uint64(32)
    slot = np.int64((np.uint64(key) * np.uint64(_MULTIPLIER)) >> shift) & (keys.size - 1)
    while values[slot] >= 0 and keys[slot] != key:
        slot = (slot + 1) & (keys.size - 1)
    return slot


@kernel
def number(lines, done, keys, values, n_ids, ids):
    """Number lines[done:] until all are or the table is half full; return (lines done, ids given)."""
    for i in range(done, lines.size):
        slot = slot_of(lines[i], keys, values)
        if values[slot] < 0:
            if 2 * n_ids >= keys.size:
                return i, n_ids
            keys[slot] = lines[i]
            values[slot] = n_ids
            n_ids += 1
        ids[i] = values[slot]
    return lines.size, n_ids


@kernel
def move(keys, values, new_keys, new_values):
    """Enter every key of one table into a larger one."""
    for i in range(keys.size):
        if values[i] >= 0:
            slot = slot_of(keys[i], new_keys, new_values)
            new_keys[slot] = keys[i]
            new_values[slot] = values[i]
