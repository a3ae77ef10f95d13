"""Replay: a source and cache configurations in, one exact Result per configuration out. The trace is decoded once for all."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from cachesim import lru
from cachesim.account import Result
from cachesim.config import CacheConfig
from cachesim.exact import (
    CAPACITY,
    COMPULSORY,
    CONFLICT,
    GENERATED,
    MISSES,
    N_LABELS,
    POLLUTION,
    PREFETCH,
    USEFUL,
    USELESS,
    grow_cache,
    make_cache,
    n_resident_unused,
    replay_exact,
    replay_optimal,
    replay_sequential,
)
from cachesim.layout import Layout
from cachesim.nextuse import NextUse
from cachesim.prefetch import Prefetch, parse_prefetch
from cachesim.source import Lines, RunSource, Source, demand_only, open_source
from jit import kernel
from traces.format import Run


@kernel
def tally(labels, totals):
    """Count the labels into totals."""
    for label in labels:
        totals[label] += 1


class _Stream:
    """One stream of accesses, demand only (A) or with pre-fetches (B), at one line size, piece by piece."""

    def __init__(self, lines: Lines, *, needs_ids: bool, ahead: int) -> None:
        self._source, self._needs_ids, self._ahead = lines, needs_ids, ahead
        self.totals = np.zeros(N_LABELS, np.int64)
        self.n_ids = self.n_before = 0
        self.lines = self.labels = self.ids = self.next_ids = self.next_use = np.empty(0, np.uint32)
        self._future: NextUse | None = None

    def look_ahead(self, lines: np.ndarray) -> None:
        """Take the next piece of the first of two passes, which finds when each line is used next."""
        self._future = self._future or NextUse()
        self._future.add(self._source.ids(lines), self._source.n_ids)

    def set(self, lines: np.ndarray, labels: np.ndarray) -> None:
        """Take the next piece."""
        self.lines, self.labels = lines, labels
        tally(labels, self.totals)
        if self._needs_ids:
            self.ids = self.next_ids = self._source.ids(lines)
            if self._ahead:
                self.next_ids = self._source.ids(lines + np.uint32(self._ahead))
            self.n_ids = self._source.n_ids
        if self._future is not None:
            self.next_use, self.n_before = self._future.take(lines.size), self._future.n_taken - lines.size


class _Counting:
    """A cache of which only misses are asked, LRU with one way or two."""

    def __init__(self, config: CacheConfig) -> None:
        self._config = config
        self._mask = lru.set_mask(config.n_sets)
        self._tags = lru.empty_tags(config.n_sets, config.ways)
        self.misses = np.zeros(N_LABELS, np.int64)

    def step(self, stream: _Stream) -> None:
        """Replay the stream's current piece."""
        config, where = self._config, (stream.lines, stream.labels, self._config.n_sets, self._mask)
        kernel_of_ways = lru.direct_mapped if config.ways == 1 else lru.two_way
        kernel_of_ways(*where, self._tags, self.misses)


class _Exact:
    """A cache of which everything is asked."""

    def __init__(self, config: CacheConfig, prefetch: Prefetch, *, three_c: bool) -> None:
        self.cache = make_cache(config, 0, three_c=three_c)
        self._trigger, self._distance = prefetch.trigger, prefetch.distance
        self._is_optimal = config.policy == "opt"

    def step(self, stream: _Stream) -> None:
        """Replay the stream's current piece."""
        if stream.n_ids > self.cache.facts.size:
            self.cache = grow_cache(self.cache, max(stream.n_ids, 2 * self.cache.facts.size))
        piece = (stream.lines, stream.ids)
        if self._is_optimal:
            replay_optimal(*piece, stream.labels, stream.next_use, stream.n_before, self.cache)
        elif self._trigger:
            replay_sequential(*piece, stream.next_ids, stream.labels, self.cache, self._trigger, self._distance)
        else:
            replay_exact(*piece, stream.labels, self.cache)

    def row(self, which: int) -> np.ndarray:
        """Return one row of the counts, per label."""
        return self.cache.counts[which * N_LABELS : (which + 1) * N_LABELS]

    @property
    def misses(self) -> np.ndarray:
        """Misses per label."""
        return self.row(MISSES)


def _is_countable(config: CacheConfig) -> bool:
    return config.policy == "lru" and config.ways <= lru.MAX_WAYS


class _Job:
    """One configuration: its cache with pre-fetches and, for coverage, the same cache without."""

    def __init__(self, config: CacheConfig, prefetch: Prefetch, *, three_c: bool) -> None:
        self.config = config
        self._has_prefetch = prefetch.kind != "none"
        none = Prefetch("none")
        alone: _Counting | _Exact = _Counting(config) if _is_countable(config) else _Exact(config, none, three_c=False)
        self._alone = alone
        self._full = _Exact(config, prefetch, three_c=three_c) if self._has_prefetch or three_c else None

    @property
    def needs_ids(self) -> bool:
        return self._full is not None or isinstance(self._alone, _Exact)

    def tasks(self, demand: _Stream, everything: _Stream) -> list[tuple[Any, _Stream]]:
        """Return the caches to step, each with its stream."""
        tasks: list[tuple[Any, _Stream]] = []
        if self._full is not None:
            tasks.append((self._full, everything))
        if self._has_prefetch or self._full is None:
            tasks.append((self._alone, demand))
        return tasks

    def fill(self, result: Result, everything: _Stream) -> None:
        """Write the counts into a result."""
        main = self._full or self._alone
        result.accesses = everything.totals.copy()
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
    """All configurations of one line size: they share the line numbers of a batch."""

    def __init__(self, source: Source, line_bytes: int, prefetch: Prefetch, jobs: list[_Job]) -> None:
        ahead = prefetch.distance
        needs_ids = any(job.needs_ids for job in jobs)
        self._lines = source.lines(line_bytes, ahead)
        self.jobs = jobs
        self.needs_future = any(job.config.policy == "opt" for job in jobs)
        self.everything = _Stream(self._lines, needs_ids=needs_ids, ahead=ahead)
        self._demand = self.everything
        if prefetch.kind in ("traced", "stack"):
            self._demand = _Stream(self._lines, needs_ids=needs_ids, ahead=0)
        self.n_splits = 0

    def look_ahead(self, events: Any, labels: np.ndarray) -> None:
        """Take a batch of events of the first of two passes."""
        lines, line_labels = self._lines.accesses(events, labels)
        self.everything.look_ahead(lines)
        if self._demand is not self.everything:
            self._demand.look_ahead(demand_only(lines, line_labels)[0])

    def tasks(self, events: Any, labels: np.ndarray) -> list[tuple[Any, _Stream]]:
        """Take a batch of events; return the caches to step."""
        lines, line_labels = self._lines.accesses(events, labels)
        self.n_splits += lines.size - labels.size
        self.everything.set(lines, line_labels)
        if self._demand is not self.everything:
            self._demand.set(*demand_only(lines, line_labels))
        return [task for job in self.jobs for task in job.tasks(self._demand, self.everything)]


def check_foreseeable(prefetch: Prefetch) -> None:
    """Raise a ValueError for a pre-fetcher in the cache: what it requests is not known before the replay."""
    if prefetch.trigger:
        raise ValueError(
            f"opt has to know all accesses beforehand, and {prefetch} requests lines during the replay; use none, traced or "
            "stack:..., or another policy"
        )


def replay(
    source: Source | Run | Path | str,
    configs: Sequence[CacheConfig],
    *,
    prefetch: Prefetch | str = "traced",
    layout: Layout | str = "stored",
    three_c: bool = False,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> list[Result]:
    """Replay a trace through every cache and return one result each, in the order of ``configs``.

    Parameters
    ----------
    source : Source, Run or path
        A path is a run's directory or a DineroIV trace. ``layout`` is that of a Run or path.
    configs : sequence of CacheConfig
    prefetch : Prefetch or str
        See ``cachesim.prefetch.parse_prefetch``.
    three_c : bool
        Classify misses as compulsory, capacity or conflict.
    threads : int, optional
        Caches replayed at a time; as many as there are cores when None. The counts do not depend on it.
    progress : callable, optional
        Called with the number of events done after each batch.
    """
    if isinstance(prefetch, str):
        prefetch = parse_prefetch(prefetch)
    if isinstance(source, Run):
        source = RunSource(source, layout)
    elif isinstance(source, (str, Path)):
        source = open_source(source, layout)
    jobs = [_Job(config, prefetch, three_c=three_c) for config in configs]
    by_line: dict[int, list[_Job]] = {}
    for job in jobs:
        by_line.setdefault(job.config.line_bytes, []).append(job)
    groups = [_Group(source, line_bytes, prefetch, members) for line_bytes, members in by_line.items()]
    foreseeing = [group for group in groups if group.needs_future]
    if foreseeing:
        check_foreseeable(prefetch)
        for events, labels in source.events(prefetch):
            for group in foreseeing:
                group.look_ahead(events, labels)
    with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        for events, labels in source.events(prefetch):
            tasks = [task for group in groups for task in group.tasks(events, labels)]
            for _ in pool.map(lambda task: task[0].step(task[1]), tasks):
                pass
            if progress is not None:
                progress(labels.size)
    results = {}
    for group in groups:
        for job in group.jobs:
            result = Result(
                run=source.name, config=job.config, prefetch=str(prefetch),
                layout=str(source.layout), has_3c=three_c, n_rays=source.n_rays, n_splits=group.n_splits,
            )  # fmt: skip
            job.fill(result, group.everything)
            results[id(job)] = result
    return [results[id(job)] for job in jobs]
