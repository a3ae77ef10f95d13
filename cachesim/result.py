"""The counts of a replay: one Result per source and configuration, with every metric under its exact name."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cachesim.access import N_ACCESS_TYPES, PREFETCH
from cachesim.config import CacheConfig
from traces.identity import RunIdentity


def _per_type() -> np.ndarray:
    return np.zeros(N_ACCESS_TYPES, np.int64)


def ratio(numerator: float, denominator: float) -> float | None:
    """Return numerator / denominator, None when the denominator is 0."""
    return numerator / denominator if denominator else None


@dataclass
class Result:
    """Counts of one replay. Arrays are (16,) int64, one entry per access type; the type's bit 8 marks a prefetch.

    Attributes
    ----------
    identity : RunIdentity
        Of what was replayed.
    n_rays : int or None
        None for a trace without rays.
    accesses, misses : array
        Every line touched counts: an event across a line boundary is two accesses; ``n_splits`` counts the additional ones.
    compulsory, capacity, conflict : array
        Of the misses; only with ``has_3c``. A miss that the fully associative cache of the same size and policy has is a
        conflict; otherwise it is compulsory at the first touch of its line, otherwise capacity.
    useful, useless, resident : int
        Of the lines that prefetches filled: demanded later, evicted before that, or neither by the end.
    pollution : int
        Demand misses on lines that a prefetch had evicted.
    demand_misses_without : int
        Demand misses of the same trace without its prefetches (the paper's configuration A).
    reads, flush : str
        What a visit reads (``cachesim.reads``), and when the cache is emptied (``cachesim.flush``).
    """

    identity: RunIdentity
    config: CacheConfig
    prefetch: str
    layout: str
    has_3c: bool
    n_rays: int | None = None
    accesses: np.ndarray = field(default_factory=_per_type)
    misses: np.ndarray = field(default_factory=_per_type)
    compulsory: np.ndarray = field(default_factory=_per_type)
    capacity: np.ndarray = field(default_factory=_per_type)
    conflict: np.ndarray = field(default_factory=_per_type)
    n_splits: int = 0
    useful: int = 0
    useless: int = 0
    resident: int = 0
    pollution: int = 0
    demand_misses_without: int = 0
    reads: str = "own"
    flush: str = "never"

    @property
    def demand_accesses(self) -> int:
        """Reads, instruction fetches and misc accesses."""
        return int(self.accesses[:PREFETCH].sum())

    @property
    def demand_misses(self) -> int:
        """Misses of demand accesses."""
        return int(self.misses[:PREFETCH].sum())

    @property
    def prefetch_accesses(self) -> int:
        """Prefetch requests issued."""
        return int(self.accesses[PREFETCH:].sum())

    @property
    def prefetch_misses(self) -> int:
        """Prefetch requests that filled a line."""
        return int(self.misses[PREFETCH:].sum())

    @property
    def bytes_from_memory(self) -> int:
        """Fills, by demand and by prefetch, times the line size."""
        return (self.demand_misses + self.prefetch_misses) * self.config.line_bytes

    @property
    def demand_miss_rate(self) -> float | None:
        """Demand misses / demand accesses."""
        return ratio(self.demand_misses, self.demand_accesses)

    @property
    def paper_miss_rate(self) -> float | None:
        """All misses / all accesses, prefetches included in both."""
        return ratio(self.demand_misses + self.prefetch_misses, self.demand_accesses + self.prefetch_accesses)

    @property
    def accuracy(self) -> float | None:
        """Useful / filled."""
        return ratio(self.useful, self.prefetch_misses)

    @property
    def coverage(self) -> float | None:
        """1 - demand misses with / without prefetching."""
        remaining = ratio(self.demand_misses, self.demand_misses_without)
        return None if remaining is None else 1.0 - remaining

    @property
    def traffic_ratio(self) -> float | None:
        """Bytes from memory with / without prefetching."""
        return ratio(self.bytes_from_memory, self.demand_misses_without * self.config.line_bytes)

    def to_dict(self) -> dict[str, Any]:
        """Return the counts and rates as JSON values; a rate with a denominator of 0 is None."""
        config = self.config
        values: dict[str, Any] = {
            **self.identity.to_dict(),
            "size_bytes": config.size_bytes,
            "ways": config.ways,
            "line_bytes": config.line_bytes,
            "policy": config.policy,
            "policy_seed": config.seed if config.policy == "random" else None,
            "prefetch": self.prefetch,
            "layout": self.layout,
            "reads": self.reads,
            "flush": self.flush,
            "demand_accesses": self.demand_accesses,
            "demand_misses": self.demand_misses,
            "prefetch_accesses": self.prefetch_accesses,
            "prefetch_misses": self.prefetch_misses,
        }
        if self.has_3c:
            for name in ("compulsory", "capacity", "conflict"):
                values[name] = int(getattr(self, name)[:PREFETCH].sum())
        values |= {
            "redundant": self.prefetch_accesses - self.prefetch_misses,
            "filled": self.prefetch_misses,
            "useful": self.useful,
            "useless": self.useless,
            "resident": self.resident,
            "pollution": self.pollution,
            "demand_misses_without": self.demand_misses_without,
            "bytes_from_memory": self.bytes_from_memory,
        }
        for name in ("demand_miss_rate", "paper_miss_rate", "accuracy", "coverage", "traffic_ratio"):
            values[name] = getattr(self, name)
        return values
