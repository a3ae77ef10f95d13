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

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cachesim.access import PREFETCH
from cachesim.all_associativity import SetCounts
from cachesim.config import CacheConfig
from cachesim.layout import Layout
from cachesim.parts import count
from cachesim.prefetch import Prefetch, parse_prefetch
from cachesim.result import ratio
from cachesim.source import Source, as_source, demand_only
from cachesim.stack_distance import StackDistances, check_one_pass
from cachesim.summary import About, Step, of_prefix, prefixed
from nptrace_base.engines import Engine
from nptrace_base.errors import NptraceError
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
    engine: Engine | None = None,
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
        The number of threads, each for a part of a long run, or for one of the passes, of which each line size has two, with
        prefetches and without; by default, the number of cores. The counts do not depend on it.
    engine : Engine, optional
        Workers (``nptrace_base.engines``), each for parts of a run.
    progress : callable, optional
        Called with the number of events done after each batch.
    """
    asked = Sweep(tuple(configs), str(prefetch))
    check_one_pass(asked.policy)
    for config in configs:
        check(config)
    source = as_source(source, layout)
    return asked.finished(count(source, asked, threads=threads, engine=engine, progress=progress), About.of(source))


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

    def __init__(self, asked: "Sweep", line_bytes: int, source: Source | None) -> None:
        self._asked = asked, line_bytes
        configs = [config for config in asked.configs if config.line_bytes == line_bytes]
        self._lines = source.lines(line_bytes, 0) if source else None
        self._needs_ids = any(config.n_sets == 1 for config in configs)
        self.streams = [_Stream(configs) for _ in range(1 if asked.policy.kind == "none" else 2)]

    def steps(self, events: Any, access_types: np.ndarray) -> list[Step]:
        """Take a batch of events; return the calls that count it, which may run at the same time."""
        assert self._lines is not None
        lines, access_types = self._lines.accesses(events, access_types)
        ids = self._lines.ids(lines) if self._needs_ids else lines
        steps = self.streams[0].steps(lines, ids, access_types, self._lines.n_ids)
        for demand in self.streams[1:]:
            own, own_types = demand_only(lines, access_types)
            own_ids = own if ids is lines else demand_only(ids, access_types)[0]
            steps += demand.steps(own, own_ids, own_types, self._lines.n_ids)
        return steps

    def then(self, later: "_Group") -> "_Group":
        """Return the group over both parts, which takes no more events."""
        whole = _Group(*self._asked, None)
        whole.streams = [mine.then(its) for mine, its in zip(self.streams, later.streams, strict=True)]
        return whole

    def row(self, config: CacheConfig, prefetch: Prefetch, about: About) -> SweepRow:
        """Return what was counted for one cache."""
        everything, demand = self.streams[0], self.streams[-1]
        demand_misses, prefetch_misses = everything.misses(config)
        return SweepRow(
            identity=about.identity,
            config=config,
            prefetch=str(prefetch),
            layout=about.layout,
            demand_accesses=everything.n_demand,
            demand_misses=demand_misses,
            prefetch_accesses=everything.n_prefetches,
            prefetch_misses=prefetch_misses,
            demand_misses_without=demand.misses(config)[0],
        )


class _Stream:
    """One stream of accesses, with prefetches or without, and what counts it: one set apart from several."""

    def __init__(self, configs: Sequence[CacheConfig]) -> None:
        self._configs = configs
        several = [config for config in configs if config.n_sets > 1]
        self._set_counts = SetCounts(several) if several else None
        self._distances = StackDistances() if len(several) < len(configs) else None
        self.n_demand = self.n_prefetches = 0

    def steps(self, lines: np.ndarray, ids: np.ndarray, access_types: np.ndarray, n_ids: int) -> list[Step]:
        """Return the calls that count a batch."""
        n_prefetches = int(np.count_nonzero(access_types >= PREFETCH))
        self.n_prefetches += n_prefetches
        self.n_demand += access_types.size - n_prefetches
        steps: list[Step] = []
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

    def then(self, later: "_Stream") -> "_Stream":
        """Return the stream over both parts."""
        whole = _Stream(self._configs)
        whole.n_demand, whole.n_prefetches = self.n_demand + later.n_demand, self.n_prefetches + later.n_prefetches
        if self._set_counts is not None and later._set_counts is not None:
            whole._set_counts = self._set_counts.then(later._set_counts)
        if self._distances is not None and later._distances is not None:
            whole._distances = self._distances.then(later._distances)
        return whole

    def arrays(self) -> dict[str, np.ndarray]:
        """Return what was counted."""
        arrays = {"n": np.array([self.n_demand, self.n_prefetches])}
        for name, each in self._counting():
            arrays |= prefixed(name, each.arrays())
        return arrays

    def load(self, arrays: dict[str, np.ndarray]) -> None:
        """Become the stream that counted this."""
        self.n_demand, self.n_prefetches = map(int, arrays["n"])
        for name, each in self._counting():
            each.load(of_prefix(name, arrays))

    def _counting(self) -> "list[tuple[str, SetCounts | StackDistances]]":
        named = (("sets", self._set_counts), ("distances", self._distances))
        return [(name, each) for name, each in named if each is not None]


class _Lines:
    """All line sizes of a sweep over a part of a trace: the summary (``cachesim.summary``)."""

    def __init__(self, groups: dict[int, _Group]) -> None:
        self.groups = groups

    def steps(self, events: Any, access_types: np.ndarray) -> list[Step]:
        """Take a batch of events; return the calls that count it, which may run at the same time."""
        return [step for group in self.groups.values() for step in group.steps(events, access_types)]

    def then(self, later: "_Lines") -> "_Lines":
        """Return the summary of this part and the one that follows; neither changes."""
        return _Lines({line: group.then(later.groups[line]) for line, group in self.groups.items()})

    def arrays(self) -> dict[str, np.ndarray]:
        """Return all that the summary is; equal summaries have equal arrays."""
        return {name: array for prefix, each in self._streams() for name, array in prefixed(prefix, each.arrays()).items()}

    def load(self, arrays: dict[str, np.ndarray]) -> None:
        """Become the summary that has these arrays."""
        for prefix, each in self._streams():
            each.load(of_prefix(prefix, arrays))

    def _streams(self) -> list[tuple[str, _Stream]]:
        return [(f"{line}.{i}", each) for line, group in self.groups.items() for i, each in enumerate(group.streams)]


@dataclass(frozen=True)
class Sweep:
    """What a sweep asks of a trace, without the trace: ``configs`` and ``prefetch`` as for ``sweep``."""

    configs: tuple[CacheConfig, ...]
    prefetch: str = "traced"

    @property
    def policy(self) -> Prefetch:
        """The prefetch policy."""
        return parse_prefetch(self.prefetch)

    def begin(self, source: Source | None) -> _Lines:
        """Return the summary of no access, for the events of a source; None: for ``then`` and ``load`` alone."""
        sizes = dict.fromkeys(config.line_bytes for config in self.configs)
        return _Lines({line_bytes: _Group(self, line_bytes, source) for line_bytes in sizes})

    def finished(self, lines: _Lines, about: About) -> list[SweepRow]:
        """Return the rows, in the order of ``configs``."""
        return [lines.groups[config.line_bytes].row(config, self.policy, about) for config in self.configs]
