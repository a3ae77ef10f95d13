"""Fully associative curves from part of the lines: stack distances of the lines whose hash is small, scaled up.

SHARDS (Waldspurger, Park, Garthwaite and Ahmad 2015): a line is followed always or never, by a hash of its number, so between
two uses of a followed line the followed part of the other lines was used, and the distance is that part of the true one. The
number of accesses to followed lines differs from its expectation when much used lines are followed by chance, or not;
these hit, so the difference is added to the smallest distance (SHARDS-adj, Sec. 3.4 there).
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
    """Stack distances of one stream, from part of its lines.

    Parameters
    ----------
    rate : float
        Part of the lines to follow, 0 < rate <= 1; 1 is exact.
    seed : int
        Decides which lines.
    """

    def __init__(self, rate: float, seed: int = 0) -> None:
        if not 0.0 < rate <= 1.0:
            raise NptraceError(f"a rate of {rate} of the lines cannot be followed; take more than 0 and at most 1")
        self._threshold = max(round(rate * _HASHES), 1)
        self._rate = self._threshold / _HASHES
        # Far apart for neighbouring seeds: ids are dense, so a small offset would follow nearly the same lines.
        self._offset = np.random.SeedSequence(seed).generate_state(1, np.uint64)[0]
        self._distances = StackDistances()
        self.n_accesses = self.n_followed = 0

    def step(self, ids: np.ndarray, labels: np.ndarray, n_ids: int) -> None:
        """Take the next (id uint32, label uint8) pairs; ids are dense and below ``n_ids``."""
        kept, kept_labels = np.empty(ids.size, np.uint32), np.empty(ids.size, np.uint8)
        n = keep_hashed(ids, labels, self._offset, self._threshold, kept, kept_labels)
        self.n_accesses += ids.size
        self.n_followed += int(n)
        self._distances.step(kept[:n], kept_labels[:n], n_ids)

    def misses(self, n_lines: int) -> float:
        """Return the misses, of demand accesses and requests together, of an LRU cache of ``n_lines`` lines."""
        counts = self._distances.counts.sum(axis=1)
        followed_lines = n_lines * self._rate
        whole = min(int(followed_lines), counts.size - 1)
        hits = float(counts[1 : whole + 1].sum())
        if whole + 1 < counts.size:  # a cache of a part of a line more hits that part of the next distance
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
    for events, event_labels in source.events(policy):
        lines, labels = lines_of.accesses(events, event_labels)
        ids = lines_of.ids(lines)
        everything.step(ids, labels, lines_of.n_ids)
        demand.step(*demand_only(ids, labels), lines_of.n_ids)
    return everything, demand


@kernel
def keep_hashed(ids, labels, offset, threshold, kept, kept_labels):
    """Copy the pairs whose id has a small hash; return how many."""
    n = 0
    for i in range(ids.size):
        # The finaliser of SplitMix64 (Steele, Lea and Flood 2014).
        z = (np.uint64(ids[i]) + offset) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z = z ^ (z >> np.uint64(31))
        kept[n] = ids[i]
        kept_labels[n] = labels[i]
        n += (z >> np.uint64(40)) < np.uint64(threshold)
    return n
