"""A run in memory and settings of a replay -> rows of counts, one per setting and cache of Table I."""

from collections.abc import Callable, Iterable, Iterator
from itertools import groupby
from typing import Any

import numpy as np

from cachesim.config import CacheConfig
from cachesim.flush import FlushedSource, emptied
from cachesim.reads import reads_of
from cachesim.replay import replay
from cachesim.report.table1 import caches
from cachesim.result import Result
from nptrace.table1_study.knobs import Setting
from nptrace.table1_study.traced import TracedRun

#: The counts of a row.
COUNTS = ("demand_accesses", "prefetches", "misses_a", "demand_misses", "prefetch_misses", "useful", "useless", "resident",
          "pollution")  # fmt: skip


def measured(run: TracedRun, settings: Iterable[Setting]) -> Iterator[tuple[Setting, int, list[Result]]]:
    """Yield each setting with the lines that its demand accesses touch and the results of the four caches."""

    def place(setting: Setting) -> tuple[str, ...]:
        return setting.layout, setting.reads, setting.flush, setting.policy

    for (layout, reads, flush, policy), group in groupby(sorted(settings, key=place), key=place):
        configs = [CacheConfig(each.size_bytes, each.ways, each.line_bytes, policy) for each in caches()]
        placed = run.source(layout)
        n_lines = lines_touched(run, placed.lines(configs[0].line_bytes, 0).of_nodes())
        source = reads_of(placed, reads, configs[0].line_bytes, flush)
        if flush == "ray":
            source = FlushedSource(source, configs)
        for setting in group:
            results = replay(source, configs, prefetch=setting.prefetch, threads=1)
            for result in results:
                result.reads, result.flush = reads, flush
            yield setting, n_lines, emptied(results) if flush == "ray" else results


def lines_touched(run: TracedRun, lines: tuple[np.ndarray, np.ndarray]) -> int:
    """Return how many lines the visits touch: no cache fetches fewer; ``lines``: of each node the lowest, and how many."""
    first, n_lines = lines
    visited = np.zeros(run.n_nodes, bool)
    visited[run.rows[0]] = True
    low, high = first[visited].astype(np.int64), first[visited].astype(np.int64) + n_lines[visited]
    edges = np.zeros(int(first.max()) + 258, np.int64)
    np.add.at(edges, low, 1)
    np.add.at(edges, high, -1)
    return int(np.count_nonzero(np.cumsum(edges)))


def counts_of(result: Result) -> dict[str, int]:
    """Return the counts of a row."""
    values = (
        result.demand_accesses, result.prefetch_accesses, result.demand_misses_without, result.demand_misses,
        result.prefetch_misses, result.useful, result.useless, result.resident, result.pollution,
    )  # fmt: skip
    return dict(zip(COUNTS, values, strict=True))


def rows_of(
    run: TracedRun, settings: Iterable[Setting], of_run: dict[str, Any], advance: Callable[[], object]
) -> Iterator[dict[str, Any]]:
    """Yield the rows of a run: ``of_run``, the knobs, the cache and the counts."""
    for setting, n_lines, results in measured(run, settings):
        for result in results:
            cache = {"size_bytes": result.config.size_bytes, "ways": result.config.ways}
            rays = {"rays": run.footer.n_rays, "lines_touched": n_lines}
            yield {**of_run, **setting.columns(), **cache, **rays, **counts_of(result)}
        advance()
