"""Many LRU caches in one pass: a source and a grid of configurations in, one exact SweepRow per configuration out.

All caches of one line size share the trace, decoded once, and one walk over the numbers of sets from few to many (Mattson
1970, Hill and Smith 1989). Each set keeps its lines newest first, so the place where a line is found says which numbers of
ways hit. A line that is the newest of its set is the newest in its smaller set of every larger number of sets, where it is
found first and nothing moves: the walk stops there. (Every number of sets is thus the exact filter of ``cachesim.filter`` for
the next; a filter in front drops what the first step stops at, and did not pay.) With a single set, the fully associative
caches, the stack distances of ``cachesim.stack_distance`` serve all sizes at once.

Prefetches that come with the trace act like reads, so what a cache holds does not depend on who asked: one pass counts demand
accesses and prefetches apart (B of the paper), and a second over the demand accesses alone gives A. This is not so for FIFO
and random replacement, which have no such order, nor for prefetchers that react to hits and misses: both are refused.
"""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cachesim.access import PREFETCH
from cachesim.all_associativity import SetCounts
from cachesim.config import CacheConfig
from cachesim.layout import Layout
from cachesim.prefetch import Prefetch, parse_prefetch
from cachesim.result import ratio
from cachesim.source import Source, as_source, demand_only
from cachesim.stack_distance import StackDistances, check_one_pass
from nptrace_base.errors import NptraceError
from nptrace_base.pools import thread_pool
from traces.identity import RunIdentity
from traces.reader import Run


@dataclass(frozen=True, slots=True)
class SweepRow:
    """Counts of one LRU cache, with the names that ``npcache replay`` uses.

    ``demand_misses`` and ``prefetch_misses`` are those with prefetching (B), ``demand_misses_without`` those of the demand
    accesses alone (A).
    """

    identity: RunIdentity
    config: CacheConfig
    prefetch: str
    layout: str
    demand_accesses: int
    demand_misses: int
    prefetch_accesses: int
    prefetch_misses: int
    demand_misses_without: int

    def to_dict(self) -> dict[str, Any]:
        """Return the counts and rates as JSON values; a rate with a denominator of 0 is None."""
        config, misses = self.config, self.demand_misses + self.prefetch_misses
        coverage = ratio(self.demand_misses, self.demand_misses_without)
        return {
            **self.identity.to_dict(),
            "size_bytes": config.size_bytes,
            "sets": config.n_sets,
            "ways": config.ways,
            "line_bytes": config.line_bytes,
            "policy": config.policy,
            "prefetch": self.prefetch,
            "layout": self.layout,
            "demand_accesses": self.demand_accesses,
            "demand_misses": self.demand_misses,
            "prefetch_accesses": self.prefetch_accesses,
            "prefetch_misses": self.prefetch_misses,
            "total_misses": misses,
            "demand_misses_without": self.demand_misses_without,
            "bytes_from_memory": misses * config.line_bytes,
            "demand_miss_rate": ratio(self.demand_misses, self.demand_accesses),
            "demand_miss_rate_without": ratio(self.demand_misses_without, self.demand_accesses),
            "paper_miss_rate": ratio(misses, self.demand_accesses + self.prefetch_accesses),
            "coverage": None if coverage is None else 1.0 - coverage,
            "traffic_ratio": ratio(misses, self.demand_misses_without),
        }


def sweep(
    source: Source | Run | Path | str,
    configs: Sequence[CacheConfig],
    *,
    prefetch: Prefetch | str = "traced",
    layout: Layout | str = "stored",
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> list[SweepRow]:
    """Count the misses of every cache, exactly, in one pass per line size; return one row each, in the order of ``configs``.

    Parameters
    ----------
    source : Source, Run or path
        A path is a run's directory or a DineroIV trace. ``layout`` is that of a Run or path.
    configs : sequence of CacheConfig
        LRU, each with a power of two as its number of sets; ``grid`` makes them from ranges.
    prefetch : Prefetch or str
        Any policy whose requests do not depend on the cache.
    threads : int, optional
        Passes run at a time, of which each line size has two, with prefetches and without; as many as there are cores when
        None. The counts do not depend on it.
    progress : callable, optional
        Called with the number of events done after each batch.
    """
    prefetch = parse_prefetch(prefetch) if isinstance(prefetch, str) else prefetch
    check_one_pass(prefetch)
    for config in configs:
        check(config)
    source = as_source(source, layout)
    by_line: dict[int, list[CacheConfig]] = {}
    for config in configs:
        by_line.setdefault(config.line_bytes, []).append(config)
    groups = {line_bytes: _Group(source, line_bytes, members, prefetch) for line_bytes, members in by_line.items()}
    running: list[Future[None]] = []
    with thread_pool(threads or os.cpu_count() or 1) as pool:
        for events, access_types in source.events(prefetch):
            # The next batch is decoded and looked up while the passes over the last one run.
            steps = [step for group in groups.values() for step in group.steps(events, access_types)]
            for step in running:
                step.result()
            running = [pool.submit(*step) for step in steps]
            if progress is not None:
                progress(access_types.size)
        for step in running:
            step.result()
    return [groups[config.line_bytes].row(source, config, prefetch) for config in configs]


def check(config: CacheConfig) -> None:
    """Raise a ValueError for a cache that one pass cannot count."""
    if config.policy != "lru":
        raise NptraceError(
            f"{config} cannot be swept: one pass can count only lru, where a larger cache holds all lines of a smaller one; "
            "use lru, or npcache replay"
        )
    if config.n_sets & (config.n_sets - 1):
        raise NptraceError(
            f"{config} has {config.n_sets} sets; a sweep needs a power of two; choose another size, or use npcache replay"
        )
    if config.line_bytes < 2:
        raise NptraceError(f"{config}: a sweep needs lines of at least 2 B; choose a longer line")


class _Group:
    """All caches of one line size: they share the line numbers of a batch."""

    def __init__(self, source: Source, line_bytes: int, configs: Sequence[CacheConfig], prefetch: Prefetch) -> None:
        self._lines = source.lines(line_bytes, 0)
        self._needs_ids = any(config.n_sets == 1 for config in configs)
        self._streams = [_Stream(configs) for _ in range(1 if prefetch.kind == "none" else 2)]

    def steps(self, events: Any, access_types: np.ndarray) -> list[tuple[Any, ...]]:
        """Take a batch of events; return the calls that count it, which may run at the same time."""
        lines, access_types = self._lines.accesses(events, access_types)
        ids = self._lines.ids(lines) if self._needs_ids else lines
        steps = self._streams[0].steps(lines, ids, access_types, self._lines.n_ids)
        for demand in self._streams[1:]:
            own, own_types = demand_only(lines, access_types)
            own_ids = own if ids is lines else demand_only(ids, access_types)[0]
            steps += demand.steps(own, own_ids, own_types, self._lines.n_ids)
        return steps

    def row(self, source: Source, config: CacheConfig, prefetch: Prefetch) -> SweepRow:
        """Return what was counted for one cache."""
        everything, demand = self._streams[0], self._streams[-1]
        demand_misses, prefetch_misses = everything.misses(config)
        return SweepRow(
            identity=source.identity,
            config=config,
            prefetch=str(prefetch),
            layout=str(source.layout),
            demand_accesses=everything.n_demand,
            demand_misses=demand_misses,
            prefetch_accesses=everything.n_prefetches,
            prefetch_misses=prefetch_misses,
            demand_misses_without=demand.misses(config)[0],
        )


class _Stream:
    """One stream of accesses, with prefetches or without, and what counts it: one set apart from several."""

    def __init__(self, configs: Sequence[CacheConfig]) -> None:
        several = [config for config in configs if config.n_sets > 1]
        self._set_counts = SetCounts(several) if several else None
        self._distances = StackDistances() if len(several) < len(configs) else None
        self.n_demand = self.n_prefetches = 0

    def steps(self, lines: np.ndarray, ids: np.ndarray, access_types: np.ndarray, n_ids: int) -> list[tuple[Any, ...]]:
        """Return the calls that count a batch."""
        n_prefetches = int(np.count_nonzero(access_types >= PREFETCH))
        self.n_prefetches += n_prefetches
        self.n_demand += access_types.size - n_prefetches
        steps: list[tuple[Any, ...]] = []
        if self._set_counts is not None:
            steps.append((self._set_counts.step, lines, access_types))
        if self._distances is not None:
            steps.append((self._distances.step, ids, access_types, n_ids))
        return steps

    def misses(self, config: CacheConfig) -> tuple[int, int]:
        """Return the misses of demand accesses and of prefetches in one cache."""
        if config.n_sets == 1 and self._distances is not None:
            return self._distances.misses(config.ways)
        assert self._set_counts is not None
        return self._set_counts.misses(config)
