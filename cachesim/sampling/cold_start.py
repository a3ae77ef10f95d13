"""LRU caches from an unknown start: pieces of a trace in, for every cache the misses that are certain and those that are not.

A sample of a trace starts in the middle, where nobody knows what the cache holds. For LRU that ignorance is exact: lines found
since the start lie at the same depth of their set as in the whole run, because what the set held before only lies deeper. So

- a hit is a hit of the whole run;
- a miss in a set that holds as many lines as it has ways, all seen since the start, is a miss of the whole run;
- any other miss is *open*: a hit of the whole run if the line was still there from before (Wood, Hill and Kessler 1991).

Certain and open misses bracket those of the whole run, reference by reference; no warm-up has to be trusted. At the start of
the trace itself the caches are known to be empty and nothing is open.
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
    """What one piece of a trace counted.

    Attributes
    ----------
    accesses, prefetches : int
        Lines touched by demand accesses and by prefetch requests.
    misses, open_ : (n_caches, 3) int64
        Certain and open misses, by the columns above.
    """

    accesses: int
    prefetches: int
    misses: np.ndarray
    open_: np.ndarray


def check_lru(configs: Sequence[CacheConfig]) -> None:
    """Raise a ValueError for caches that cannot be replayed from an unknown start, or not together."""
    for config in configs:
        if config.policy != "lru":
            raise NptraceError(
                f"{config} cannot be estimated: under {config.policy} what a cache held before decides for ever after; "
                "estimate lru, or render the scene and use npcache replay"
            )
        if config.line_bytes != configs[0].line_bytes:
            raise NptraceError(f"{config} and {configs[0]} have different lines; estimate one line size at a time")


class KnownReplay:
    """Every cache of some configurations over one stretch of a trace, with prefetches (B) and without (A).

    Parameters
    ----------
    configs : sequence of CacheConfig
        LRU, of one line size.
    from_start : bool
        The stretch begins with the trace: the caches are empty, no miss is open.
    """

    def __init__(self, configs: Sequence[CacheConfig], *, from_start: bool = False) -> None:
        self._caches = [
            (config.n_sets, set_mask(config.n_sets), config.ways, empty_tags(config.n_sets, config.ways),
             empty_tags(config.n_sets, config.ways))
            for config in configs
        ]  # fmt: skip
        self._filter = DirectFilter(filter_sets(configs), keep_first_use=True)
        self._from_start = from_start

    def step(self, lines: np.ndarray, labels: np.ndarray, pool: Executor | None = None) -> Counts:
        """Take the next (line uint32, label uint8) pairs and return what they counted; a pool steps caches side by side."""
        n_prefetches = int(np.count_nonzero(labels >= PREFETCH))
        kept, kept_labels = self._filter.accesses(lines, labels)
        demand, demand_labels = demand_only(kept, kept_labels)
        found = np.zeros((len(self._caches), N_MISSES, 2), np.int64)

        def one(k: int) -> None:
            n_sets, mask, ways, alone, both = self._caches[k]
            count_known(demand, demand_labels, n_sets, mask, ways, alone, found[k, ALONE], found[k, REQUESTS])
            count_known(kept, kept_labels, n_sets, mask, ways, both, found[k, DEMAND], found[k, REQUESTS])

        for _ in (pool.map if pool else map)(one, range(len(self._caches))):
            pass
        misses, open_ = found[:, :, 0], found[:, :, 1]
        if self._from_start:
            misses, open_ = misses + open_, np.zeros_like(open_)
        return Counts(lines.size - n_prefetches, n_prefetches, misses, open_)


@kernel
def count_known(lines, labels, n_sets, mask, ways, tags, demand, requests):
    """Replay lines through an LRU cache; count certain (entry 0) and open (1) misses of demand accesses and of requests.

    ``tags`` is ``lru.empty_tags``, updated in place.
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
            counts = requests if labels[i] >= PREFETCH else demand
            counts[1 if carried < 0 else 0] += 1
