"""Replay: a source and cache configurations in, one exact Result per configuration out. The trace is decoded once for all."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cachesim import fast_lru
from cachesim.access import N_ACCESS_TYPES, PREFETCH
from cachesim.cache import (
    CAPACITY,
    COMPULSORY,
    CONFLICT,
    GENERATED,
    MISSES,
    POLLUTION,
    USEFUL,
    USELESS,
    grow_cache,
    make_cache,
    n_resident_unused,
    replay_exact,
    replay_optimal,
    replay_sequential,
)
from cachesim.config import CacheConfig
from cachesim.filter import DirectFilter, filter_sets
from cachesim.layout import Layout
from cachesim.next_use import NextUse
from cachesim.prefetch import Prefetch, parse_prefetch
from cachesim.result import Result
from cachesim.source import Source, as_source, demand_only
from nptrace_base.errors import NptraceError
from nptrace_base.pools import thread_pool
from traces.reader import Run

#: Sets of the smallest filter that saves time: a smaller one keeps most accesses.
LEAST_FILTER = 16


class _Piece(NamedTuple):
    """Some accesses of one stream at one line size."""

    lines: np.ndarray
    access_types: np.ndarray
    ids: np.ndarray
    next_ids: np.ndarray  # of the lines that a sequential prefetcher would request; otherwise equal to ids
    n_ids: int
    next_use: np.ndarray | None = None  # for opt: number of the next access to the same line
    n_before: int = 0  # number of the first access here


_Task = tuple[Callable[[_Piece], None], _Piece]


class _Counting:
    """A cache for which only misses are counted: LRU with one way or two."""

    def __init__(self, config: CacheConfig) -> None:
        self._config = config
        self._mask = fast_lru.set_mask(config.n_sets)
        self._tags = fast_lru.empty_tags(config.n_sets, config.ways)
        self.misses = np.zeros(N_ACCESS_TYPES, np.int64)

    def step(self, piece: _Piece) -> None:
        """Replay a piece."""
        kernel_of_ways = fast_lru.direct_mapped if self._config.ways == 1 else fast_lru.two_way
        kernel_of_ways(piece.lines, piece.access_types, self._config.n_sets, self._mask, self._tags, self.misses)


class _Exact:
    """A cache for which everything is counted."""

    def __init__(self, config: CacheConfig, prefetch: Prefetch, *, three_c: bool) -> None:
        self.cache = make_cache(config, 0, three_c=three_c)
        self._trigger, self._distance = prefetch.trigger, prefetch.distance
        self._is_optimal = config.policy == "opt"

    def step(self, piece: _Piece) -> None:
        """Replay a piece."""
        lines, access_types, ids, next_ids, n_ids, next_use, n_before = piece
        if n_ids > self.cache.facts.size:
            self.cache = grow_cache(self.cache, max(n_ids, 2 * self.cache.facts.size))
        if self._is_optimal:
            replay_optimal(lines, ids, access_types, next_use, n_before, self.cache)
        elif self._trigger:
            replay_sequential(lines, ids, next_ids, access_types, self.cache, self._trigger, self._distance)
        else:
            replay_exact(lines, ids, access_types, self.cache)

    def row(self, which: int) -> np.ndarray:
        """Return one row of the counts, per access type."""
        return self.cache.counts[which * N_ACCESS_TYPES : (which + 1) * N_ACCESS_TYPES]

    @property
    def misses(self) -> np.ndarray:
        """Misses per access type."""
        return self.row(MISSES)


def _is_countable(config: CacheConfig) -> bool:
    return config.policy == "lru" and config.ways <= fast_lru.MAX_WAYS


class _Job:
    """One configuration: its cache with prefetches and, for coverage, the same cache without them."""

    def __init__(self, config: CacheConfig, prefetch: Prefetch, *, three_c: bool) -> None:
        self.config = config
        self._has_prefetch = prefetch.kind != "none"
        none = parse_prefetch("none")
        alone: _Counting | _Exact = _Counting(config) if _is_countable(config) else _Exact(config, none, three_c=False)
        self._alone = alone
        self._full = _Exact(config, prefetch, three_c=three_c) if self._has_prefetch or three_c else None

    @property
    def needs_ids(self) -> bool:
        return self._full is not None or isinstance(self._alone, _Exact)

    def tasks(self, demand: _Piece, everything: _Piece) -> list[_Task]:
        """Return the caches to step, each with a piece of its stream."""
        tasks: list[_Task] = []
        if self._full is not None:
            tasks.append((self._full.step, everything))
        if self._has_prefetch or self._full is None:
            tasks.append((self._alone.step, demand))
        return tasks

    def fill(self, result: Result, totals: np.ndarray) -> None:
        """Write the counts into a result; ``totals`` are the accesses of its stream per access type."""
        main = self._full or self._alone
        result.accesses = totals.copy()
        result.misses = main.misses.copy()
        alone = self._alone if self._has_prefetch or self._full is None else main
        result.demand_misses_without = int(alone.misses[:PREFETCH].sum())
        if self._full is None:
            return
        full = self._full
        result.accesses += full.row(GENERATED)
        result.compulsory, result.capacity, result.conflict = (
            full.row(which).copy() for which in (COMPULSORY, CAPACITY, CONFLICT)
        )
        account = full.cache.account
        result.useful, result.useless, result.pollution = (int(account[i]) for i in (USEFUL, USELESS, POLLUTION))
        result.resident = n_resident_unused(full.cache)


class _Group:
    """Configurations of one line size: they share the lines of a batch and the filter, if any.

    Parameters
    ----------
    filter_of : int
        The number of sets of a filter that is exact for all of them; 0 for no filter.
    """

    def __init__(self, source: Source, line_bytes: int, prefetch: Prefetch, jobs: list[_Job], filter_of: int) -> None:
        self.jobs = jobs
        self.totals = np.zeros(N_ACCESS_TYPES, np.int64)
        self.needs_future = any(job.config.policy == "opt" for job in jobs)
        self._futures = NextUse(), NextUse()  # of all accesses, and of the demand accesses alone
        self.n_splits = 0
        self._ahead = prefetch.distance
        self._needs_ids = any(job.needs_ids for job in jobs)
        self._has_requests = prefetch.has_requests
        self._lines = source.lines(line_bytes, self._ahead)
        # With first uses kept, the remaining demand accesses are also exact for the demand stream alone.
        self._filter = DirectFilter(filter_of, keep_first_use=self._has_requests) if filter_of else None

    def look_ahead(self, events: Any, access_types: np.ndarray) -> None:
        """Take a batch of events in the first of two passes, which finds the next use of each line."""
        lines, line_types = self._lines.accesses(events, access_types)
        ids = self._lines.ids(lines)
        self._futures[0].add(ids, self._lines.n_ids)
        if self._has_requests:
            self._futures[1].add(demand_only(ids, line_types)[0], self._lines.n_ids)

    def tasks(self, events: Any, access_types: np.ndarray) -> list[_Task]:
        """Take a batch of events; return the caches to step."""
        n_before = int(self.totals.sum())
        lines, line_types = self._lines.counted(events, access_types, self._filter, self.totals)
        self.n_splits += int(self.totals.sum()) - n_before - access_types.size
        everything = demand = self._piece(lines, line_types, self._futures[0])
        if self._has_requests:
            demand = self._piece(*demand_only(lines, line_types), self._futures[1])
        return [task for job in self.jobs for task in job.tasks(demand, everything)]

    def _piece(self, lines: np.ndarray, access_types: np.ndarray, future: NextUse) -> _Piece:
        ids = next_ids = self._lines.ids(lines) if self._needs_ids else lines
        if self._ahead:
            next_ids = self._lines.ids(lines + np.uint32(self._ahead))
        n_before = future.n_taken
        next_use = future.take(lines.size) if self.needs_future else None
        return _Piece(lines, access_types, ids, next_ids, self._lines.n_ids, next_use, n_before)


def _groups(source: Source, jobs: list[_Job], prefetch: Prefetch, *, is_filtered: bool) -> list[_Group]:
    """Group the jobs by line size, and separate those that one exact filter serves from the others."""
    by_line: dict[int, list[_Job]] = {}
    for job in jobs:
        by_line.setdefault(job.config.line_bytes, []).append(job)
    groups = []
    for line_bytes, members in by_line.items():
        served = [job for job in members if is_filtered and job.config.n_sets >= LEAST_FILTER and job.config.policy != "opt"]
        n_sets = filter_sets([job.config for job in served])
        if n_sets < LEAST_FILTER:
            served, n_sets = [], 0
        others = [job for job in members if job not in served]
        groups += [_Group(source, line_bytes, prefetch, part, n) for part, n in ((served, n_sets), (others, 0)) if part]
    return groups


def check_foreseeable(prefetch: Prefetch) -> None:
    """Raise NptraceError for a prefetcher in the cache: its requests are not known before the replay."""
    if prefetch.trigger:
        raise NptraceError(
            f"opt needs all accesses in advance, but {prefetch} issues requests during the replay; use none, traced or "
            "stack:..., or another replacement policy"
        )


def replay(
    source: Source | Run | Path | str,
    configs: Sequence[CacheConfig],
    *,
    prefetch: Prefetch | str = "traced",
    layout: Layout | str = "stored",
    three_c: bool = False,
    is_filtered: bool = True,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> list[Result]:
    """Replay a trace through every cache and return one result for each, in the order of ``configs``.

    Parameters
    ----------
    source : Source, Run or path
        A path is a run's directory or a DineroIV trace. ``layout`` is that of a Run or path.
    configs : sequence of CacheConfig
    prefetch : Prefetch or str
        See ``cachesim.prefetch.parse_prefetch``.
    three_c : bool
        Classify misses as compulsory, capacity or conflict.
    is_filtered : bool
        Skip accesses that cannot change a cache (``cachesim.filter``), where that is exact. The counts do not depend on it.
    threads : int, optional
        The number of caches replayed at a time; by default, the number of cores. The counts do not depend on it.
    progress : callable, optional
        Called after each batch with its number of events.
    """
    if isinstance(prefetch, str):
        prefetch = parse_prefetch(prefetch)
    source = as_source(source, layout)
    jobs = [_Job(config, prefetch, three_c=three_c) for config in configs]
    is_filtered = is_filtered and not three_c and not prefetch.trigger
    groups = _groups(source, jobs, prefetch, is_filtered=is_filtered)
    foreseeing = [group for group in groups if group.needs_future]
    if foreseeing:
        check_foreseeable(prefetch)
        source.check_passes(2)
        for events, access_types in source.events(prefetch):
            for group in foreseeing:
                group.look_ahead(events, access_types)
    running: list[Future[None]] = []
    with thread_pool(threads or os.cpu_count() or 1) as pool:
        for events, access_types in source.events(prefetch):
            # The next batch is decoded and looked up while the caches step over the last one.
            tasks = [task for group in groups for task in group.tasks(events, access_types)]
            for future in running:
                future.result()
            running = [pool.submit(step, piece) for step, piece in tasks]
            if progress is not None:
                progress(access_types.size)
        for future in running:
            future.result()
    results = {}
    for group in groups:
        for job in group.jobs:
            result = Result(
                identity=source.identity, config=job.config, prefetch=str(prefetch),
                layout=str(source.layout), has_3c=three_c, n_rays=source.n_rays, n_splits=group.n_splits,
            )  # fmt: skip
            job.fill(result, group.totals)
            results[id(job)] = result
    return [results[id(job)] for job in jobs]
