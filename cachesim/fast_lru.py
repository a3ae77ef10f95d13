"""Counts only, LRU: line numbers and access types in, misses per access type out.

Each set is an array of lines, newest first, and a line that is accessed moves to the front. Lines are uint32. A source may
number them from its lowest line: that only permutes the sets. The state is updated in place, so replaying
a trace in batches is replaying it at once, and it is a summary as ``cachesim.summary`` describes: it has what a later replay
needs to go on, and the open accesses, with which it can follow an earlier part.
"""

from typing import NamedTuple

import numpy as np

from cachesim.access import N_ACCESS_TYPES
from cachesim.config import CacheConfig
from nptrace_base.jit import inlined, kernel

#: The most ways for which moving an array costs less than the linked lists of ``replacement``: 0.4 to 0.7 of the time with
#: 4 and 8 ways, 0.4 (64K) to 1.0 (8K) with 16, 0.5 to 1.5 with 32.
MAX_WAYS = 16


class Lru(NamedTuple):
    """The state of one cache; the arrays are updated in place.

    Attributes
    ----------
    tags : (n_sets * ways,) int64
        The lines of each set, most recent first, -1 for an empty way.
    misses : (N_ACCESS_TYPES,) int64
        From the empty cache on, so the open accesses are among them.
    open_lines, open_types : (n_sets * ways,) uint32 and uint8
        The open accesses, in order: those that missed while their set had an empty way.
    n_open : (1,) int64
    n_sets, mask, ways : int
        ``mask`` is that of ``set_of``.
    """

    tags: np.ndarray
    misses: np.ndarray
    open_lines: np.ndarray
    open_types: np.ndarray
    n_open: np.ndarray
    n_sets: int
    mask: int
    ways: int


def empty_lru(config: CacheConfig) -> Lru:
    """Return an empty cache."""
    n = config.n_lines
    return Lru(
        tags=np.full(n, -1, np.int64),
        misses=np.zeros(N_ACCESS_TYPES, np.int64),
        open_lines=np.empty(n, np.uint32),
        open_types=np.empty(n, np.uint8),
        n_open=np.zeros(1, np.int64),
        n_sets=config.n_sets,
        mask=set_mask(config.n_sets),
        ways=config.ways,
    )


class LruCounts:
    """An LRU cache for which only misses are counted: the summary of a part of a trace.

    Attributes
    ----------
    misses : (N_ACCESS_TYPES,) int64
    """

    def __init__(self, config: CacheConfig) -> None:
        self._config, self._lru = config, empty_lru(config)
        self._kernel = direct_mapped if config.ways == 1 else two_way if config.ways == 2 else many_way

    @property
    def misses(self) -> np.ndarray:
        """Misses per access type."""
        return self._lru.misses

    @property
    def n_open(self) -> int:
        """Number of open accesses."""
        return int(self._lru.n_open[0])

    def open_types(self, start: int = 0) -> np.ndarray:
        """Return how many open accesses, from the one numbered ``start`` on, are of each access type."""
        return np.bincount(self._lru.open_types[start : self.n_open], minlength=N_ACCESS_TYPES)

    def step(self, lines: np.ndarray, access_types: np.ndarray) -> None:
        """Replay lines, (n,) uint32, with their access types, (n,) uint8."""
        self._kernel(lines, access_types, self._lru)

    def then(self, later: "LruCounts") -> "LruCounts":
        """Return the summary of this part and the one that follows; neither changes."""
        whole, its = LruCounts(self._config), later._lru
        for mine, own in zip(whole._lru[:5], self._lru[:5], strict=True):
            mine[:] = own
        whole.step(its.open_lines[: later.n_open], its.open_types[: later.n_open])
        whole._lru.misses[:] += its.misses - later.open_types()
        # In each set the open lines of the later part are now in front: as many as it has lines, in the order of first use.
        np.copyto(whole._lru.tags, its.tags, where=its.tags >= 0)
        return whole

    def arrays(self) -> dict[str, np.ndarray]:
        """Return all that the summary is; equal summaries have equal arrays."""
        lru, n = self._lru, self.n_open
        return {
            "misses": lru.misses, "tags": lru.tags, "open_lines": lru.open_lines[:n], "open_types": lru.open_types[:n]
        }  # fmt: skip

    def load(self, arrays: dict[str, np.ndarray]) -> None:
        """Become the summary that has these arrays."""
        lru, n = self._lru, arrays["open_lines"].size
        lru.misses[:], lru.tags[:], lru.n_open[0] = arrays["misses"], arrays["tags"], n
        lru.open_lines[:n], lru.open_types[:n] = arrays["open_lines"], arrays["open_types"]


def set_mask(n_sets: int) -> int:
    """Return n_sets - 1 for a power of two, which selects the set without a division; -1 for any other number."""
    return n_sets - 1 if n_sets & (n_sets - 1) == 0 else -1


@kernel(forceinline=True)
def set_of(line, n_sets, mask):
    """Return line mod n_sets."""
    if mask >= 0:
        return line & mask
    return line % n_sets


@inlined
def _missed(lru, line, access_type, left):
    """Count a miss, after which ``left`` is the line that leaves the set, -1 for none: then the access is open."""
    lru.misses[access_type] += 1
    if left < 0:
        k = lru.n_open[0]
        lru.open_lines[k], lru.open_types[k] = line, access_type
        lru.n_open[0] = k + 1


@kernel(_nrt=False)
def direct_mapped(lines, access_types, lru):
    """Replay lines through a direct-mapped cache."""
    tags, n_sets, mask = lru.tags, lru.n_sets, lru.mask
    for i in range(lines.size):
        line = np.int64(lines[i])
        s = set_of(line, n_sets, mask)
        left = tags[s]
        if left != line:
            tags[s] = line
            _missed(lru, lines[i], access_types[i], left)


@kernel(_nrt=False)
def two_way(lines, access_types, lru):
    """Replay lines through a two-way LRU cache."""
    tags, n_sets, mask = lru.tags, lru.n_sets, lru.mask
    for i in range(lines.size):
        line = np.int64(lines[i])
        s = 2 * set_of(line, n_sets, mask)
        first = tags[s]
        if first != line:
            left = tags[s + 1]
            tags[s + 1] = first
            tags[s] = line
            if left != line:
                _missed(lru, lines[i], access_types[i], left)


@kernel(_nrt=False)
def many_way(lines, access_types, lru):
    """Replay lines through an LRU cache of any ways."""
    tags, n_sets, mask, ways = lru.tags, lru.n_sets, lru.mask, lru.ways
    for i in range(lines.size):
        line = np.int64(lines[i])
        first = set_of(line, n_sets, mask) * ways
        carried = tags[first]
        if carried == line:
            continue
        tags[first] = line
        is_found = False
        for at in range(first + 1, first + ways):
            here = tags[at]
            tags[at] = carried
            carried = here
            if here == line:
                is_found = True
                break
        if not is_found:
            _missed(lru, lines[i], access_types[i], carried)
