"""Where the counts of a cache fall: a run, caches, and pixel, level, node or ray type in; the counts of each group out.

The sums over the groups are the counts of ``cachesim.replay``. In memory are the counts of the groups and a batch of accesses,
whatever the length of the trace.

Of a prefetch, the request and what becomes of the line that it fills are of one group: by pixel and ray type that of the ray
for which it is made, by level and node that of the node requested. A sequential prefetcher's is of the group of the access
that triggers it.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from cachesim.cache import make_cache
from cachesim.config import CacheConfig
from cachesim.group_counts import (
    COUNTED,
    Accesses,
    count_events,
    groups_of_rays,
    make_groups,
    replay_groups,
    resident_by_group,
)
from cachesim.layout import Layout
from cachesim.lines import NodeLines, look_up, read_only
from cachesim.next_use import NextUse
from cachesim.prefetch import Prefetch, parse_prefetch
from cachesim.replay import check_foreseeable
from cachesim.result import ratio
from cachesim.source import RunSource, Source, as_source, demand_only
from nptrace_base.errors import NptraceError
from nptrace_base.pools import thread_pool
from traces.format import PRIMARY
from traces.identity import RunIdentity
from traces.reader import Run

#: By what counts can be kept.
BY = ("pixel", "level", "node", "ray-type")

#: The kinds of misses, in ``GroupedResult.counts`` only if they were asked for.
THREE_C = ("compulsory", "capacity", "conflict")


@dataclass(frozen=True)
class GroupedResult:
    """The counts of one cache by group.

    Attributes
    ----------
    identity : RunIdentity
    config : CacheConfig
    prefetch, layout, by : str
    groups : dict
        What tells the groups apart, (n,) arrays: ``x`` and ``y``; ``level``; ``node`` and its ``level``; or ``ray_type``.
    counts : dict
        (n,) int64 arrays, under the names of ``cachesim.result.Result``.
    """

    identity: RunIdentity
    config: CacheConfig
    prefetch: str
    layout: str
    by: str
    groups: dict[str, np.ndarray]
    counts: dict[str, np.ndarray]

    @property
    def shown(self) -> np.ndarray:
        """The numbers of the groups that have a row, (m,) int64: every pixel, and what is accessed of all else."""
        if self.by == "pixel":
            return np.arange(len(self.groups["x"]))
        return np.flatnonzero(self.counts["demand_accesses"] + self.counts["prefetch_accesses"])

    def rows(self) -> Iterator[dict[str, Any]]:
        """Yield the row of each group in ``shown`` as JSON values; a rate with a denominator of 0 is None."""
        config, shown = self.config, self.shown
        head = {
            **self.identity.to_dict(),
            "size_bytes": config.size_bytes, "ways": config.ways, "line_bytes": config.line_bytes, "policy": config.policy,
            "policy_seed": config.seed if config.policy == "random" else None,
            "prefetch": self.prefetch, "layout": self.layout, "by": self.by,
        }  # fmt: skip
        columns = {name: column[shown].tolist() for name, column in (self.groups | self.counts).items()}
        for values in zip(*columns.values(), strict=True):
            row = dict(zip(columns, values, strict=True))
            remaining = ratio(row["demand_misses"], row["demand_misses_without"])
            yield head | row | {
                "demand_miss_rate": ratio(row["demand_misses"], row["demand_accesses"]),
                "accuracy": ratio(row["useful"], row["filled"]),
                "coverage": None if remaining is None else 1.0 - remaining,
            }  # fmt: skip


class GroupedRecords(Sequence[dict[str, Any]]):
    """The rows of results, made when they are asked for: a picture of a million pixels has as many."""

    def __init__(self, results: Sequence[GroupedResult]) -> None:
        self._results = results

    def __len__(self) -> int:
        return sum(len(result.shown) for result in self._results)

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return chain.from_iterable(result.rows() for result in self._results)

    def __getitem__(self, index: Any) -> Any:
        return list(self)[index]


class Grouping:
    """The groups of a run, and the group of each of its events."""

    def __init__(self, source: RunSource, by: str) -> None:
        run = source.run
        self._by, self._path, self._n_begun = by, run.path, 0
        self._of: np.ndarray = np.empty(0, np.uint32)  # the group of each ray that reads nodes, or of each node
        if by in ("pixel", "ray-type"):
            rays = run.columns("rays", ["x", "y", "type", "count"])
            reads = rays["count"] > 0
        if by == "pixel" and run.footer.packet > 1:
            raise NptraceError(
                f"{run.path} has packets of {run.footer.packet} rays, whose reads are of no single pixel; keep counts by "
                f"{', '.join(BY[1:-1])} or {BY[-1]}, or render with --packet 1"
            )
        if by == "pixel":
            width, height = run.footer.width, run.footer.height
            number = np.arange(width * height)
            self.columns = {"x": number % width, "y": number // width}
            self._of = rays["y"][reads].astype(np.uint32) * np.uint32(width) + rays["x"][reads]
        elif by == "ray-type":
            self.columns = {"ray_type": np.array(["primary", "shadow"])}
            self._of = (rays["type"][reads] != PRIMARY).astype(np.uint32)
        elif by in ("level", "node"):
            self._of = run.columns("nodes", ["level"])["level"].astype(np.uint32)
            levels = self._of.astype(np.int64)
            nodes = {"node": np.arange(levels.size), "level": levels}
            self.columns = nodes if by == "node" else {"level": np.arange(levels.max() + 1)}
        else:
            raise NptraceError(f"{by!r} is nothing to keep counts by; choose one of {', '.join(BY)}")
        self.n = len(next(iter(self.columns.values())))

    def of(self, nodes: np.ndarray, access_types: np.ndarray) -> np.ndarray:
        """Return the group, (n,) uint32, of each of the next events."""
        nodes = read_only(nodes)
        if self._by == "node":
            return nodes.astype(np.uint32)
        if self._by == "level":
            return look_up(self._of, nodes)
        groups = np.empty(nodes.size, np.uint32)
        self._n_begun = groups_of_rays(nodes, read_only(access_types), self._of, self._n_begun, groups)
        if self._n_begun < 0:
            self._refuse()
        return groups

    def end(self, n_events: int) -> None:
        """Check, after the last event, that every ray was seen."""
        if self._by in ("pixel", "ray-type") and n_events and self._n_begun != self._of.size:
            self._refuse()

    def _refuse(self) -> None:
        raise NptraceError(
            f"{self._path}: not every ray reads the root, node 0, first and once, so its accesses cannot be told apart by "
            f"{self._by}; render the run again"
        )


def run_source(source: Source | Run | Path | str, layout: Layout | str, by: str) -> RunSource:
    """Return a source that has rays and nodes; NptraceError for a trace of addresses."""
    found = as_source(source, layout)
    if not isinstance(found, RunSource):
        raise NptraceError(
            f"{found.identity.run} has addresses alone, and no rays and nodes to count by {by}; name a run of nptrace render"
        )
    return found


def events_by(source: Source | Run | Path | str, by: str, prefetch: Prefetch | str = "traced") -> np.ndarray:
    """Return the node reads and the requests of each group, (n_groups, 2) int64; no cache is needed for that."""
    found = run_source(source, "stored", by)
    grouping = Grouping(found, by)
    counts = np.zeros((grouping.n, 2), np.int64)
    for nodes, access_types in found.events(parse_prefetch(prefetch) if isinstance(prefetch, str) else prefetch):
        count_events(grouping.of(nodes, access_types), read_only(access_types), counts)
    grouping.end(int(counts.sum()))
    return counts


class _Counted:
    """One cache of one stream."""

    def __init__(self, config: CacheConfig, prefetch: Prefetch, n_groups: int, n_ids: int, *, three_c: bool) -> None:
        self._cache, self._groups = make_cache(config, n_ids, three_c=three_c), make_groups(n_groups, n_ids)
        self._trigger, self._distance = prefetch.trigger, prefetch.distance
        self._is_optimal = config.policy == "opt"

    def step(self, accesses: Accesses) -> None:
        """Replay some accesses."""
        if not self._is_optimal:
            accesses = accesses._replace(next_use=_NO_FUTURE)
        replay_groups(accesses, self._cache, self._groups, self._trigger, self._distance)

    def counts(self) -> dict[str, np.ndarray]:
        """Return the counts by group."""
        found = {name: self._groups.counts[:, i] for i, name in enumerate(COUNTED)}
        resident = resident_by_group(self._cache, self._groups)
        return found | {
            "redundant": found["prefetch_accesses"] - found["filled"],
            "useless": found["filled"] - found["useful"] - resident,
            "resident": resident,
        }


_NO_FUTURE = np.empty(0, np.uint32)

#: The counts of a row, in order.
_COLUMNS = (
    "demand_accesses", "demand_misses", "prefetch_accesses", "redundant", "filled", "useful", "useless", "resident",
    "pollution",
)  # fmt: skip


class _OfLine:
    """The caches of one line size: they share the lines of a batch."""

    def __init__(
        self, source: RunSource, line_bytes: int, configs: Sequence[CacheConfig], prefetch: Prefetch, n_groups: int, *,
        three_c: bool,
    ) -> None:  # fmt: skip
        self.configs = configs
        self._ahead, self._three_c, self._splits_streams = prefetch.distance, three_c, prefetch.has_requests
        self._lines: NodeLines = source.lines(line_bytes, self._ahead)
        self.needs_future = any(config.policy == "opt" for config in configs)
        self._futures = NextUse(), NextUse()  # of all accesses, and of the demand accesses alone
        n_ids, none = self._lines.n_ids, parse_prefetch("none")
        self._full = [_Counted(each, prefetch, n_groups, n_ids, three_c=three_c) for each in configs]
        self._alone = self._full
        if prefetch.kind != "none":
            self._alone = [_Counted(each, none, n_groups, n_ids, three_c=False) for each in configs]

    def look_ahead(self, nodes: np.ndarray, access_types: np.ndarray) -> None:
        """Take a batch of events in the first of two passes, which finds the next use of each line."""
        lines, line_types = self._lines.accesses(nodes, access_types)
        self._futures[0].add(lines, self._lines.n_ids)
        if self._splits_streams:
            self._futures[1].add(demand_only(lines, line_types)[0], self._lines.n_ids)

    def steps(
        self, nodes: np.ndarray, access_types: np.ndarray, groups: np.ndarray
    ) -> list[tuple[Callable[[Accesses], None], Accesses]]:
        """Take a batch of events; return the calls that count it."""
        lines, line_types = self._lines.accesses(nodes, access_types)
        n_of = self._lines.n_of(nodes)
        groups = groups if n_of is None else np.repeat(groups, n_of)
        everything = demand = self._accesses(lines, line_types, groups, self._futures[0])
        if self._splits_streams:
            kept_lines, kept_types = demand_only(lines, line_types)
            demand = self._accesses(kept_lines, kept_types, demand_only(groups, line_types)[0], self._futures[1])
        steps = [(each.step, everything) for each in self._full]
        return steps + [(each.step, demand) for each in self._alone if self._alone is not self._full]

    def _accesses(self, lines: np.ndarray, types: np.ndarray, groups: np.ndarray, future: NextUse) -> Accesses:
        n_before = future.n_taken
        next_use = future.take(lines.size) if self.needs_future else _NO_FUTURE
        next_ids = lines + np.uint32(self._ahead) if self._ahead else lines
        return Accesses(lines, lines, next_ids, types, groups, next_use, n_before)

    def counts(self) -> Iterator[tuple[CacheConfig, dict[str, np.ndarray]]]:
        """Yield the counts of each cache."""
        for config, full, alone in zip(self.configs, self._full, self._alone, strict=True):
            found = full.counts()
            names = (*_COLUMNS, *(THREE_C if self._three_c else ()))
            yield config, {name: found[name] for name in names} | {"demand_misses_without": alone.counts()["demand_misses"]}


def replay_by(
    source: Source | Run | Path | str,
    configs: Sequence[CacheConfig],
    by: str,
    *,
    prefetch: Prefetch | str = "traced",
    layout: Layout | str = "stored",
    three_c: bool = False,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> list[GroupedResult]:
    """Replay a run through every cache, as ``cachesim.replay`` does, and return the counts of each by group.

    Parameters
    ----------
    source : Source, Run or path
        A run; ``layout`` is that of a Run or path.
    by : str
        One of ``BY``.
    prefetch, three_c, threads, progress
        As for ``cachesim.replay.replay``.

    Raises
    ------
    NptraceError
        The source is a trace without rays and nodes; opt is to foresee what a cache requests.
    """
    prefetch = parse_prefetch(prefetch) if isinstance(prefetch, str) else prefetch
    run = run_source(source, layout, by)
    grouping = Grouping(run, by)
    by_line: dict[int, list[CacheConfig]] = {}
    for config in dict.fromkeys(configs):
        by_line.setdefault(config.line_bytes, []).append(config)
    parts = [_OfLine(run, line, members, prefetch, grouping.n, three_c=three_c) for line, members in by_line.items()]
    foreseeing = [part for part in parts if part.needs_future]
    if foreseeing:
        check_foreseeable(prefetch)
        for nodes, access_types in run.events(prefetch):
            for part in foreseeing:
                part.look_ahead(nodes, access_types)
    n_events = 0
    with thread_pool(threads or os.cpu_count() or 1) as pool:
        for nodes, access_types in run.events(prefetch):
            groups = grouping.of(nodes, access_types)
            n_events += nodes.size
            steps = [step for part in parts for step in part.steps(nodes, access_types, groups)]
            list(pool.map(lambda step: step[0](step[1]), steps))
            if progress is not None:
                progress(access_types.size)
    grouping.end(n_events)
    found = dict(pair for part in parts for pair in part.counts())
    return [
        GroupedResult(run.identity, config, str(prefetch), str(run.layout), by, grouping.columns, found[config])
        for config in configs
    ]
