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
from cachesim.fast_lru import empty_tags, set_mask, set_of
from cachesim.filter import DirectFilter, filter_sets
from cachesim.source import demand_only
from nptrace_base.errors import NptraceError
from nptrace_base.jit import kernel

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
        self._caches = [
            (config.n_sets, set_mask(config.n_sets), config.ways, empty_tags(config.n_sets, config.ways),
             empty_tags(config.n_sets, config.ways))
            for config in configs
        ]  # fmt: skip
        self._filter = DirectFilter(filter_sets(configs), keep_first_use=True)
        self._from_start = from_start

    def step(self, lines: np.ndarray, access_types: np.ndarray, pool: Executor | None = None) -> Counts:
        """Take the next (line uint32, access type uint8) pairs; return their counts. A pool steps several caches at a time."""
        n_prefetches = int(np.count_nonzero(access_types >= PREFETCH))
        kept, kept_types = self._filter.accesses(lines, access_types)
        demand, demand_types = demand_only(kept, kept_types)
        found = np.zeros((len(self._caches), N_MISSES, 2), np.int64)

        def one(k: int) -> None:
            n_sets, mask, ways, alone, both = self._caches[k]
            count_known(demand, demand_types, n_sets, mask, ways, alone, found[k, ALONE], found[k, REQUESTS])
            count_known(kept, kept_types, n_sets, mask, ways, both, found[k, DEMAND], found[k, REQUESTS])

        for _ in (pool.map if pool else map)(one, range(len(self._caches))):
            pass
        misses, unknown = found[:, :, 0], found[:, :, 1]
        if self._from_start:
            misses, unknown = misses + unknown, np.zeros_like(unknown)
        return Counts(lines.size - n_prefetches, n_prefetches, misses, unknown)


@kernel
def count_known(lines, access_types, n_sets, mask, ways, tags, demand, requests):
    """Replay lines through an LRU cache; count known (entry 0) and unknown (1) misses of demand accesses and of requests.

    ``tags`` is ``fast_lru.empty_tags``, updated in place.
    """
    for i in range(lines.size):
        line = np.int64(lines[i])
        first = set_of(line, n_sets, mask) * ways
        carried = tags[first]
        if carried == line:
            continue
        tags[first] = line
        found = False
        for at in range(first + 1, first + ways):
            here = tags[at]
            tags[at] = carried
            carried = here
            if here == line:
                found = True
                break
        if not found:
            counts = requests if access_types[i] >= PREFETCH else demand
            counts[1 if carried < 0 else 0] += 1
