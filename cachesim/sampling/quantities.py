"""What an estimate states: the quantities of a run and of its caches, each a ratio of totals counted in sample units."""

from collections.abc import Sequence

import numpy as np

from cachesim.config import CacheConfig
from cachesim.sampling.cold_start import ALONE, DEMAND, N_MISSES, REQUESTS
from cachesim.sampling.two_phase import Ratio
from cachesim.sampling.unit_counts import ACCESSES, N_COUNTS, PREFETCHES, RAYS

#: Quantities of a cache that the target is for.
TARGETED = ("demand_miss_rate_without", "demand_miss_rate", "paper_miss_rate")
#: All quantities of a cache; the last two are bytes.
QUANTITIES = (
    *TARGETED, "demand_ratio", "paper_ratio", "traffic_ratio", "bytes_from_memory_without", "bytes_from_memory"
)  # fmt: skip
#: Quantities of the run; they precede those of the caches.
OF_THE_RUN = ("accesses_per_ray", "prefetches_per_access")

#: How many more prefetches per access than the mean an unsampled unit may have: they come in bursts, where rays run along a
#: plane of the tree.
_BURSTS = 4.0


def place_of(cache: int, quantity: str) -> int:
    """Return the place in ``ratios_of`` of one of the ``QUANTITIES`` of the cache with this number."""
    return len(OF_THE_RUN) + cache * len(QUANTITIES) + QUANTITIES.index(quantity)


def ratios_of(configs: Sequence[CacheConfig]) -> list[Ratio]:
    """Return the quantities of the run (``OF_THE_RUN``) and of every cache (``QUANTITIES``) as ratios of totals."""
    size = N_COUNTS + N_MISSES * len(configs)

    def form(*entries: int, times: float = 1.0) -> np.ndarray:
        vector = np.zeros(size)
        vector[list(entries)] = times
        return vector

    demand, everything = form(ACCESSES), form(ACCESSES, PREFETCHES)
    found = [Ratio((demand,), (form(RAYS),)), Ratio((form(PREFETCHES),), (demand,), unlike=_BURSTS)]
    for k, config in enumerate(configs):
        first = N_COUNTS + N_MISSES * k
        alone, with_, both = form(first + ALONE), form(first + DEMAND), form(first + DEMAND, first + REQUESTS)
        found += [
            Ratio((alone,), (demand,)),
            Ratio((with_,), (demand,)),
            Ratio((both,), (everything,)),
            Ratio((with_,), (alone,)),
            Ratio((both, demand), (everything, alone)),
            Ratio((both,), (alone,)),
            Ratio((config.line_bytes * alone,)),
            Ratio((config.line_bytes * both,)),
        ]
    return found
