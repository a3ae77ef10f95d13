"""Miss curves of fully associative caches from a share of the lines: stack distances of lines with a small hash, scaled up.

SHARDS (Waldspurger, Park, Garthwaite and Ahmad 2015): a hash of its number decides whether a line is always or never followed.
So the distance among followed lines is, in expectation, their share of the true one. The number of accesses to followed lines
differs from its expectation if frequently used lines happen to be followed, or not; these accesses hit, so the difference is
added to the smallest distance (SHARDS-adj, Sec. 3.4 there).
"""

import numpy as np

from cachesim.prefetch import parse_prefetch
from cachesim.source import Source, demand_only
from cachesim.stack_distance import StackDistances, check_one_pass
from nptrace_base.errors import NptraceError
from nptrace_base.jit import kernel

#: Hashes are compared as 24-bit numbers.
_HASHES = 1 << 24


class HashedDistances:
    """Stack distances of one stream, from a share of its lines.

    Parameters
    ----------
    rate : float
        Share of the lines to follow, 0 < rate <= 1; 1 is exact.
    seed : int
        Determines which lines are followed.
    """

    def __init__(self, rate: float, seed: int = 0) -> None:
        if not 0.0 < rate <= 1.0:
            raise NptraceError(f"the share of lines to follow must be above 0 and at most 1, got {rate}; write e.g. 0.01")
        self._threshold = max(round(rate * _HASHES), 1)
        self._rate = self._threshold / _HASHES
        # Far apart for neighbouring seeds: ids are dense, so a small offset would follow nearly the same lines.
        self._offset = np.random.SeedSequence(seed).generate_state(1, np.uint64)[0]
        self._distances = StackDistances()
        self.n_accesses = self.n_followed = 0

    def step(self, ids: np.ndarray, access_types: np.ndarray, n_ids: int) -> None:
        """Take the next (id uint32, access type uint8) pairs; ids are dense and below ``n_ids``."""
        kept, kept_types = np.empty(ids.size, np.uint32), np.empty(ids.size, np.uint8)
        n = keep_hashed(ids, access_types, self._offset, self._threshold, kept, kept_types)
        self.n_accesses += ids.size
        self.n_followed += int(n)
        self._distances.step(kept[:n], kept_types[:n], n_ids)

    def misses(self, n_lines: int) -> float:
        """Return the misses, of demand accesses and requests together, of an LRU cache of ``n_lines`` lines."""
        counts = self._distances.counts.sum(axis=1)
        followed_lines = n_lines * self._rate
        whole = min(int(followed_lines), counts.size - 1)
        hits = float(counts[1 : whole + 1].sum())
        if whole + 1 < counts.size:  # a fraction of a line hits that fraction of the next distance
            hits += (followed_lines - whole) * float(counts[whole + 1])
        hits += self.n_accesses * self._rate - self.n_followed
        return min(max(self.n_accesses - hits / self._rate, 0.0), float(self.n_accesses))

    def miss_rate(self, n_lines: int) -> float:
        """Return misses / accesses."""
        return self.misses(n_lines) / self.n_accesses if self.n_accesses else float("nan")


def hashed_distances(
    source: Source, line_bytes: int, rate: float, *, seed: int = 0, prefetch: str = "traced"
) -> tuple[HashedDistances, HashedDistances]:
    """Return the distances of a trace with its prefetches and of its demand accesses alone (B and A of the paper)."""
    policy = parse_prefetch(prefetch)
    check_one_pass(policy)
    lines_of = source.lines(line_bytes, 0)
    everything, demand = HashedDistances(rate, seed), HashedDistances(rate, seed)
    for events, event_types in source.events(policy):
        lines, access_types = lines_of.accesses(events, event_types)
        ids = lines_of.ids(lines)
        everything.step(ids, access_types, lines_of.n_ids)
        demand.step(*demand_only(ids, access_types), lines_of.n_ids)
    return everything, demand


@kernel
def keep_hashed(ids, access_types, offset, threshold, kept, kept_types):
    """Copy the pairs whose id has a small hash; return how many."""
    n = 0
    for i in range(ids.size):
        # The finaliser of SplitMix64 (Steele, Lea and Flood 2014).
        z = (np.uint64(ids[i]) + offset) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z = z ^ (z >> np.uint64(31))
        kept[n] = ids[i]
        kept_types[n] = access_types[i]
        n += (z >> np.uint64(40)) < np.uint64(threshold)
    return n
