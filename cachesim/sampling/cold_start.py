"""LRU caches from an unknown start: pieces of a trace in; for every cache, the known and the unknown misses out.

A sample of a trace starts in the middle, where the content of the cache is unknown. For LRU, the effect of that is exact: a
line accessed since the start lies at the same depth of its set as in the whole run, because older content lies deeper. So

- a hit is a hit in the whole run;
- a miss in a set that is full of lines accessed since the start is a miss in the whole run: it is *known*;
- any other miss is *unknown*: in the whole run it is a hit if the line is still in the cache from before (Wood, Hill and
  Kessler 1991).

Known and unknown misses bracket the misses of the whole run, reference by reference, without any trust in a warm-up. At the
start of the trace itself, the caches are empty and nothing is unknown.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from typing import NamedTuple

import numpy as np

from cachesim.access import PREFETCH
from cachesim.config import CacheConfig
from cachesim.fast_lru import LruCounts
from cachesim.filter import DirectFilter, filter_sets
from cachesim.source import demand_only
from nptrace_base.errors import NptraceError

#: Columns of the counts of one cache: A (demand alone), B's demand accesses, B's prefetches.
ALONE, DEMAND, REQUESTS = range(3)
N_MISSES = 3


class Counts(NamedTuple):
    """The counts of one piece of a trace.

    Attributes
    ----------
    accesses, prefetches : int
        Lines touched by demand accesses and by prefetch requests.
    misses, unknown : (n_caches, 3) int64
        Known and unknown misses, by the columns above.
    """

    accesses: int
    prefetches: int
    misses: np.ndarray
    unknown: np.ndarray


def check_lru(configs: Sequence[CacheConfig]) -> None:
    """Raise NptraceError if the caches cannot be replayed from an unknown start, or not together."""
    for config in configs:
        if config.policy != "lru":
            raise NptraceError(
                f"{config} cannot be estimated: under {config.policy}, a cache's first content may affect all later accesses; "
                "use lru, or render the scene and use npcache replay"
            )
        if config.line_bytes != configs[0].line_bytes:
            raise NptraceError(f"{config} and {configs[0]} have different line sizes; estimate one line size at a time")


class KnownReplay:
    """Every cache of some configurations over one stretch of a trace, with prefetches (B) and without (A).

    Parameters
    ----------
    configs : sequence of CacheConfig
        LRU, of one line size.
    from_start : bool
        The stretch begins with the trace: the caches are empty, and no miss is unknown.
    """

    def __init__(self, configs: Sequence[CacheConfig], *, from_start: bool = False) -> None:
        self._caches = [(LruCounts(config), LruCounts(config)) for config in configs]  # without prefetches, and with them
        self._filter = DirectFilter(filter_sets(configs), keep_first_use=True)
        self._from_start = from_start

    def step(self, lines: np.ndarray, access_types: np.ndarray, pool: Executor | None = None) -> Counts:
        """Take the next (line uint32, access type uint8) pairs; return their counts. A pool steps several caches at a time."""
        n_prefetches = int(np.count_nonzero(access_types >= PREFETCH))
        kept, kept_types = self._filter.accesses(lines, access_types)
        demand, demand_types = demand_only(kept, kept_types)
        found = np.zeros((len(self._caches), N_MISSES, 2), np.int64)

        def one(k: int) -> None:
            alone, both = self._caches[k]
            found[k, ALONE] = _step(alone, demand, demand_types)[0]
            found[k, DEMAND], found[k, REQUESTS] = _step(both, kept, kept_types)

        for _ in (pool.map if pool else map)(one, range(len(self._caches))):
            pass
        misses, unknown = found[:, :, 0], found[:, :, 1]
        if self._from_start:
            misses, unknown = misses + unknown, np.zeros_like(unknown)
        return Counts(lines.size - n_prefetches, n_prefetches, misses, unknown)


def _step(cache: LruCounts, lines: np.ndarray, access_types: np.ndarray) -> np.ndarray:
    """Step a cache; return its known and unknown misses (columns) of demand accesses and of prefetches (rows)."""
    misses, n_open = cache.misses.copy(), cache.n_open
    cache.step(lines, access_types)
    unknown = cache.open_types(n_open)  # an open access, in the words of ``cachesim.summary``
    by_type = np.column_stack([cache.misses - misses - unknown, unknown])
    return np.array([by_type[:PREFETCH].sum(axis=0), by_type[PREFETCH:].sum(axis=0)])
