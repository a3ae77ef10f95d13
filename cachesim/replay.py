"""Replay: a source and cache configurations in, one exact Result per configuration out. The trace is decoded once for all."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
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
    POLLUTION,
    USEFUL,
    USELESS,
    n_resident_unused,
)
from cachesim.cache_counts import CacheCounts
from cachesim.config import CacheConfig
from cachesim.fast_lru import LruCounts
from cachesim.filter import DirectFilter, filter_sets
from cachesim.layout import Layout
from cachesim.lines import Lines
from cachesim.next_use import NextUse
from cachesim.parts import count
from cachesim.prefetch import Prefetch, parse_prefetch
from cachesim.result import Result
from cachesim.source import Source, as_source, demand_only
from cachesim.summary import About, Step, of_prefix, prefixed
from nptrace_base.engines import Engine
from nptrace_base.errors import NptraceError
from traces.reader import Run

#: Sets of the smallest filter that saves time: a smaller one keeps most accesses.
LEAST_FILTER = 16


class _Piece(NamedTuple):
    """Some accesses of one stream at one line size, as ``CacheCounts.step`` takes them."""

    lines: np.ndarray
    access_types: np.ndarray
    ids: np.ndarray
    next_ids: np.ndarray  # of the lines that a sequential prefetcher would request; otherwise equal to ids
    n_ids: int
    next_use: np.ndarray | None  # for opt: number of the next access to the same line
    n_before: int  # number of the first access here


def _is_countable(config: CacheConfig) -> bool:
    return config.policy == "lru" and config.ways <= fast_lru.MAX_WAYS


class _Job:
    """One configuration: its cache with prefetches and, for coverage, the same cache without them."""

    def __init__(self, config: CacheConfig, asked: "Replay") -> None:
        self.config, self._asked = config, asked
        prefetch, none = asked.policy, parse_prefetch("none")
        has_full = prefetch.kind != "none" or asked.three_c
        self._full = CacheCounts(config, prefetch, three_c=asked.three_c) if has_full else None
        self._alone: LruCounts | CacheCounts | None = None
        if prefetch.kind != "none" or not has_full:
            self._alone = LruCounts(config) if _is_countable(config) else CacheCounts(config, none, three_c=False)

    @property
    def needs_ids(self) -> bool:
        return self._full is not None or isinstance(self._alone, CacheCounts)

    def steps(self, demand: _Piece, everything: _Piece) -> list[Step]:
        """Return the caches to step, each with a piece of its stream."""
        steps: list[Step] = [] if self._full is None else [(self._full.step, *everything)]
        if isinstance(self._alone, LruCounts):
            steps.append((self._alone.step, demand.lines, demand.access_types))
        elif self._alone is not None:
            steps.append((self._alone.step, *demand))
        return steps

    def then(self, later: "_Job") -> "_Job":
        """Return the job over both parts."""
        whole = _Job(self.config, self._asked)
        its = later.caches()
        joined = {name: cache.then(its[name]) for name, cache in self.caches().items()}
        whole._full, whole._alone = joined.get("full"), joined.get("alone")
        return whole

    def caches(self) -> dict[str, Any]:
        """Return the caches by name."""
        return {name: each for name, each in (("full", self._full), ("alone", self._alone)) if each is not None}

    def fill(self, result: Result, totals: np.ndarray) -> None:
        """Write the counts into a result; ``totals`` are the accesses of its stream per access type."""
        main, alone, full = self._full or self._alone, self._alone or self._full, self._full
        assert main is not None and alone is not None
        result.accesses = totals.copy()
        result.misses = main.misses.copy()
        result.demand_misses_without = int(alone.misses[:PREFETCH].sum())
        if full is None:
            return
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
    source : Source, optional
        None for a group that takes no events.
    """

    def __init__(self, asked: "Replay", configs: list[CacheConfig], filter_of: int, source: Source | None) -> None:
        self._asked = asked, configs, filter_of
        self.jobs = [_Job(config, asked) for config in configs]
        self.totals = np.zeros(N_ACCESS_TYPES, np.int64)
        self.needs_future = any(config.policy == "opt" for config in configs)
        self._futures = NextUse(), NextUse()  # of all accesses, and of the demand accesses alone
        self.n_splits = 0
        self._ahead = asked.policy.distance
        self._needs_ids = any(job.needs_ids for job in self.jobs)
        self._has_requests = asked.policy.has_requests
        self._lines: Lines | None = source.lines(configs[0].line_bytes, self._ahead) if source else None
        # With first uses kept, the remaining demand accesses are also exact for the demand stream alone.
        self._filter = DirectFilter(filter_of, keep_first_use=self._has_requests) if filter_of else None

    @property
    def lines(self) -> Lines:
        """The lines of the source."""
        assert self._lines is not None
        return self._lines

    def look_ahead(self, events: Any, access_types: np.ndarray) -> None:
        """Take a batch of events in the first of two passes, which finds the next use of each line."""
        lines, line_types = self.lines.accesses(events, access_types)
        ids = self.lines.ids(lines)
        self._futures[0].add(ids, self.lines.n_ids)
        if self._has_requests:
            self._futures[1].add(demand_only(ids, line_types)[0], self.lines.n_ids)

    def steps(self, events: Any, access_types: np.ndarray) -> list[Step]:
        """Take a batch of events; return the caches to step."""
        n_before = int(self.totals.sum())
        lines, line_types = self.lines.counted(events, access_types, self._filter, self.totals)
        self.n_splits += int(self.totals.sum()) - n_before - access_types.size
        everything = demand = self._piece(lines, line_types, self._futures[0])
        if self._has_requests:
            demand = self._piece(*demand_only(lines, line_types), self._futures[1])
        return [step for job in self.jobs for step in job.steps(demand, everything)]

    def _piece(self, lines: np.ndarray, access_types: np.ndarray, future: NextUse) -> _Piece:
        ids = next_ids = self.lines.ids(lines) if self._needs_ids else lines
        if self._ahead:
            next_ids = self.lines.ids(lines + np.uint32(self._ahead))
        n_before = future.n_taken
        next_use = future.take(lines.size) if self.needs_future else None
        return _Piece(lines, access_types, ids, next_ids, self.lines.n_ids, next_use, n_before)

    def then(self, later: "_Group") -> "_Group":
        """Return the group over both parts, which takes no more events."""
        whole = _Group(*self._asked, None)
        whole.totals, whole.n_splits = self.totals + later.totals, self.n_splits + later.n_splits
        whole.jobs = [mine.then(its) for mine, its in zip(self.jobs, later.jobs, strict=True)]
        return whole

    def arrays(self) -> dict[str, np.ndarray]:
        """Return what was counted."""
        arrays = {"totals": self.totals, "n_splits": np.array([self.n_splits])}
        for i, job in enumerate(self.jobs):
            for name, cache in job.caches().items():
                arrays |= prefixed(f"{i}.{name}", cache.arrays())
        return arrays

    def load(self, arrays: dict[str, np.ndarray]) -> None:
        """Become the group that counted this."""
        self.totals, self.n_splits = arrays["totals"].copy(), int(arrays["n_splits"][0])
        for i, job in enumerate(self.jobs):
            for name, cache in job.caches().items():
                cache.load(of_prefix(f"{i}.{name}", arrays))


class _Caches:
    """All caches of a replay over a part of a trace: the summary (``cachesim.summary``)."""

    def __init__(self, groups: list[_Group]) -> None:
        self.groups = groups

    def look_ahead(self, events: Any, access_types: np.ndarray) -> None:
        """Take a batch of events in the first of two passes."""
        for group in self.groups:
            if group.needs_future:
                group.look_ahead(events, access_types)

    def steps(self, events: Any, access_types: np.ndarray) -> list[Step]:
        """Take a batch of events; return the calls that count it, which may run at the same time."""
        return [step for group in self.groups for step in group.steps(events, access_types)]

    def then(self, later: "_Caches") -> "_Caches":
        """Return the summary of this part and the one that follows; neither changes."""
        return _Caches([mine.then(its) for mine, its in zip(self.groups, later.groups, strict=True)])

    def arrays(self) -> dict[str, np.ndarray]:
        """Return all that the summary is; equal summaries have equal arrays."""
        return {name: array for i, group in enumerate(self.groups) for name, array in prefixed(str(i), group.arrays()).items()}

    def load(self, arrays: dict[str, np.ndarray]) -> None:
        """Become the summary that has these arrays."""
        for i, group in enumerate(self.groups):
            group.load(of_prefix(str(i), arrays))


@dataclass(frozen=True)
class Replay:
    """What a replay asks of a trace, without the trace.

    Attributes
    ----------
    configs : tuple of CacheConfig
    prefetch : str
    three_c, is_filtered : bool
        As for ``replay``.
    """

    configs: tuple[CacheConfig, ...]
    prefetch: str = "traced"
    three_c: bool = False
    is_filtered: bool = True

    @property
    def policy(self) -> Prefetch:
        """The prefetch policy."""
        return parse_prefetch(self.prefetch)

    def begin(self, source: Source | None) -> _Caches:
        """Return the summary of no access, for the events of a source; None: for ``then`` and ``load`` alone."""
        by_line: dict[int, list[CacheConfig]] = {}
        for config in dict.fromkeys(self.configs):
            by_line.setdefault(config.line_bytes, []).append(config)
        is_filtered = self.is_filtered and not self.three_c and not self.policy.trigger
        groups = []
        for members in by_line.values():
            served = [each for each in members if is_filtered and each.n_sets >= LEAST_FILTER and each.policy != "opt"]
            n_sets = filter_sets(served)
            if n_sets < LEAST_FILTER:
                served, n_sets = [], 0
            others = [config for config in members if config not in served]
            groups += [_Group(self, part, n, source) for part, n in ((served, n_sets), (others, 0)) if part]
        return _Caches(groups)

    def finished(self, caches: _Caches, about: About) -> list[Result]:
        """Return the results, in the order of ``configs``."""
        results = {}
        for group in caches.groups:
            for job in group.jobs:
                result = Result(
                    identity=about.identity, config=job.config, prefetch=str(self.policy), layout=about.layout,
                    has_3c=self.three_c, n_rays=about.n_rays, n_splits=group.n_splits,
                )  # fmt: skip
                job.fill(result, group.totals)
                results[job.config] = result
        return [results[config] for config in self.configs]


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
    engine: Engine | None = None,
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
        The number of threads, each for a part of a long run, or for some of the caches; by default, the number of cores. The
        counts do not depend on it.
    engine : Engine, optional
        Workers (``nptrace_base.engines``), each for parts of a run.
    progress : callable, optional
        Called after each batch with its number of events.
    """
    asked = Replay(tuple(configs), str(prefetch), three_c, is_filtered)
    source = as_source(source, layout)
    if any(config.policy == "opt" for config in configs):
        check_foreseeable(asked.policy)
    caches = count(source, asked, threads=threads, engine=engine, progress=progress)
    return asked.finished(caches, About.of(source))
