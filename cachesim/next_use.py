"""When is a line used next? A stream of dense line ids in, for each access the number of the next one to its line out.

Belady's replacement needs to know the future, so a trace is read twice: once for this, once for the replay. Kept in memory:
4 bytes per access, so the length of a trace is limited.
"""

import numpy as np

from nptrace_base.errors import NptraceError
from nptrace_base.jit import kernel

#: Most accesses of a stream whose future is kept, 4 GB.
MAX_ACCESSES = 1 << 30

#: The line is not used again.
NO_MORE = np.uint32(0xFFFFFFFF)


class NextUse:
    """The future of one stream: add all its accesses first, then take the answers in the same order."""

    def __init__(self) -> None:
        self.n_added = self.n_taken = 0
        self._next = np.empty(1 << 16, np.uint32)
        self._last = np.zeros(0, np.uint32)  # per id, the number of its latest access, counted from 1

    def add(self, ids: np.ndarray, n_ids: int) -> None:
        """Add accesses to lines with these ids (uint32, below ``n_ids``). Raises ValueError beyond MAX_ACCESSES."""
        end = self.n_added + ids.size
        if end > MAX_ACCESSES:
            raise NptraceError(
                f"opt stores the next use of every access, and this trace has more than {MAX_ACCESSES:,} accesses; render a "
                "smaller picture, or use lru"
            )
        if end > self._next.size:
            self._next.resize(max(end, 2 * self._next.size), refcheck=False)  # in place: no moment with two copies
        if n_ids > self._last.size:
            self._last.resize(max(n_ids, 2 * self._last.size), refcheck=False)
        find_next(ids, self.n_added, self._last, self._next)
        self.n_added = end

    def take(self, n: int) -> np.ndarray:
        """Return the (n,) uint32 numbers of the next accesses to the lines of the next n accesses; NO_MORE for none."""
        self.n_taken += n
        return self._next[self.n_taken - n : self.n_taken]


@kernel
def find_next(ids, start, last, next_use):
    """Enter the accesses ``start`` on as the next use of the access before them to the same line."""
    for i in range(ids.size):
        line_id, here = np.int64(ids[i]), start + i
        if last[line_id]:
            next_use[last[line_id] - 1] = here
        last[line_id] = here + 1
        next_use[here] = NO_MORE
