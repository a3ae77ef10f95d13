"""An exact filter before a replay: accesses in, those that may change a cache out, and counts of the others.

A direct-mapped filter of F sets remembers the line last used in each of its sets and drops an access to that very line. For
every cache with the same line size whose number of sets is a multiple of F, a dropped access is a hit that changes nothing:

    Lines that share a set of the cache share a set of the filter, because F divides the number of sets. So since the last
    access to line x, no other line of x's set was used. That access left x in the cache, nothing could evict it since, and x
    is the most recent line of its set. So this access hits. LRU would move to the front what is in front; FIFO and random
    replacement do nothing on a hit (ours draws no random number then). A prefetch fills and refreshes as a read does, so it
    filters as a read does.

The next access then finds the same state with the access or without, whatever other accesses were dropped: by induction every
access that is kept hits or misses as before, and all misses are kept. Where F does not divide the number of sets, x's set may
hold lines of other filter sets, and one of them may have evicted x.

What still holds of the account of prefetches: a dropped prefetch is a redundant one. A dropped demand access may have been
the first use of a line that a prefetch filled. With ``keep_first_use`` a demand access is dropped only if a demand access
came before it since another line of its filter set was used, so the line had its first use then, and every count of the
account is exact. Then the demand accesses kept also serve the demand stream alone (A of the paper): between the two no other
line of the filter set was used, so none in the demand stream. Without it, A needs a filter of its own.

What does not hold: the fully associative cache beside the real one in a 3C classification no longer sees which line is older,
and a sequential prefetcher is triggered by accesses that hit.
"""

from collections.abc import Iterable, Iterator, Sequence
from math import gcd
from typing import NamedTuple

import numpy as np

from cachesim.access import PREFETCH
from cachesim.config import CacheConfig
from cachesim.fast_lru import set_mask, set_of
from cachesim.prefetch import Prefetch
from nptrace_base.errors import NptraceError
from nptrace_base.jit import inlined, kernel

ONE = np.uint64(1)
_NONE = np.uint64(0xFFFFFFFFFFFFFFFF)  # no line: lines are below 2^32


def filter_sets(configs: Sequence[CacheConfig]) -> int:
    """Return the largest number of filter sets that is exact for every one of these caches, 1 at least."""
    return gcd(*(config.n_sets for config in configs)) or 1


def check_exact(
    n_sets: int, line_bytes: int, configs: Iterable[CacheConfig], *, prefetch: Prefetch | None = None, three_c: bool = False
) -> None:
    """Raise a ValueError unless a filter of ``n_sets`` sets and ``line_bytes`` lines changes no count of these replays."""
    if n_sets < 1:
        raise NptraceError(f"a filter needs at least 1 set, got {n_sets}; use filter_sets(configs)")
    for config in configs:
        if config.line_bytes != line_bytes:
            raise NptraceError(
                f"a filter for lines of {line_bytes} B is not exact for {config}: the line sizes must be equal; "
                f"use one of {config.line_bytes} B"
            )
        if config.n_sets % n_sets:
            raise NptraceError(
                f"a filter of {n_sets} sets is not exact for {config}: its {config.n_sets} sets are not a multiple; "
                f"the most that is exact is {config.n_sets}"
            )
    if three_c and n_sets > 1:
        raise NptraceError(f"a filter of {n_sets} sets hides from the 3C classification which lines are old; use 1 or none")
    if prefetch is not None and prefetch.trigger:
        raise NptraceError(f"{prefetch} is triggered by accesses that a filter drops; replay without the filter")


class Newest(NamedTuple):
    """What a filter remembers: of each of its sets, the line last used.

    Attributes
    ----------
    tags : (n_sets,) uint64
        2 * line, plus 1 unless ``keep_first_use`` waits for the line's first demand access; updated in place.
    n_sets, mask : int
        As ``set_of`` takes them.
    keep_first_use : bool
        Whether the account of prefetches needs the first demand access to a line.
    """

    tags: np.ndarray
    n_sets: int
    mask: int
    keep_first_use: bool


class DirectFilter:
    """A filter and what it remembers between batches.

    Parameters
    ----------
    n_sets : int
        Any number; ``filter_sets`` gives the best one.
    keep_first_use : bool
        Also keep the accesses that the account of prefetches needs.

    Attributes
    ----------
    n_dropped_demand, n_dropped_prefetches : int
        Accesses dropped so far. All of them hit; the prefetches among them are redundant.
    """

    def __init__(self, n_sets: int, *, keep_first_use: bool = False) -> None:
        self._newest = Newest(np.full(n_sets, _NONE, np.uint64), n_sets, set_mask(n_sets), keep_first_use)
        self.n_dropped_demand = self.n_dropped_prefetches = 0

    def accesses(self, lines: np.ndarray, access_types: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the (line uint32, access type uint8) pairs that are kept, in order."""
        kept, kept_types = np.empty(lines.size, np.uint32), np.empty(lines.size, np.uint8)
        n = drop_repeats(lines, access_types, self._newest, kept, kept_types)
        kept, kept_types = kept[:n], kept_types[:n]
        self._note(int(np.count_nonzero(access_types >= PREFETCH)), lines.size, kept_types)
        return kept, kept_types

    def looked_up(
        self, table: np.ndarray, rows: np.ndarray, access_types: np.ndarray, totals: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Add the accesses to lines table[rows] to ``totals``, per access type; return the (line, access type) pairs to keep.

        In one pass: looking up, counting and filtering one after the other took 1.3 to 1.7 times as long.
        """
        kept, kept_types = np.empty(rows.size, np.uint32), np.empty(rows.size, np.uint8)
        counted = np.zeros(totals.size, np.int64)
        n = look_up_and_drop(table, rows, access_types, self._newest, counted, kept, kept_types)
        totals += counted
        kept, kept_types = kept[:n], kept_types[:n]
        self._note(int(counted[PREFETCH:].sum()), rows.size, kept_types)
        return kept, kept_types

    def _note(self, n_prefetches: int, n: int, kept_types: np.ndarray) -> None:
        """Count what was dropped of n accesses."""
        n_prefetches -= int(np.count_nonzero(kept_types >= PREFETCH))
        self.n_dropped_prefetches += n_prefetches
        self.n_dropped_demand += n - kept_types.size - n_prefetches


def filtered(
    batches: Iterable[tuple[np.ndarray, np.ndarray]], direct: DirectFilter
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the batches of (lines, access types) without the accesses that the filter drops and counts."""
    for lines, access_types in batches:
        yield direct.accesses(lines, access_types)


@inlined
def _is_kept(line, access_type, newest):
    """Return whether a filter keeps an access, which is then the newest of its set."""
    s = np.uint64(set_of(np.int64(line), newest.n_sets, newest.mask))
    tag, before = (np.uint64(line) << ONE) | ONE, newest.tags[s]
    if before == tag:
        return False
    if newest.keep_first_use and access_type >= PREFETCH:
        tag ^= ONE
        if before == tag:
            return False
    newest.tags[s] = tag
    return True


@kernel
def drop_repeats(lines, access_types, newest, kept, kept_types):
    """Copy the accesses that a filter keeps; return how many."""
    n = np.uint64(0)
    for i in range(lines.size):
        line, access_type = lines[i], access_types[i]
        # A branch: copying always and advancing by 0 or 1 took 0.65 to 3.5 times the time (mean 1.4), as each access then
        # waits for the one before it in its set.
        if _is_kept(line, access_type, newest):
            kept[n] = line
            kept_types[n] = access_type
            n += ONE
    return n


@kernel
def look_up_and_drop(table, rows, access_types, newest, totals, kept, kept_types):
    """As ``drop_repeats`` for the lines table[rows]; count the access types into totals."""
    n = np.uint64(0)
    for i in range(rows.size):
        line, access_type = table[rows[i]], access_types[i]
        totals[access_type] += 1
        if _is_kept(line, access_type, newest):
            kept[n] = line
            kept_types[n] = access_type
            n += ONE
    return n
