"""Replay as a fold: what summaries and joining cost over a plain replay, and what a second core is worth for one long run."""

import os
import time

import numpy as np
import pyarrow as pa

from cachesim.access import PREFETCH
from cachesim.all_associativity import SetCounts
from cachesim.cache_counts import CacheCounts
from cachesim.config import CacheConfig
from cachesim.fast_lru import LruCounts
from cachesim.parts import LEAST_PART
from cachesim.prefetch import parse_prefetch
from cachesim.replay import replay
from tests.bench.measure import ratio, times
from traces.reader import Run

#: Accesses of a part.
PART = 1 << 20

TWO_WAY, MANY_WAYS, CORNERS = (
    CacheConfig(8192, 2), CacheConfig(65536, 8), [CacheConfig(16 * 32, 1), CacheConfig(2048 * 16 * 32, 16)]
)  # fmt: skip


class OfAll:
    """A ``CacheCounts`` without the parameters that node lines do not need."""

    def __init__(self, config: CacheConfig, n_ids: int, prefetch: str = "traced") -> None:
        self._exact, self._n_ids = CacheCounts(config, parse_prefetch(prefetch), three_c=False), n_ids

    def step(self, lines: np.ndarray, labels: np.ndarray) -> None:
        """Replay some accesses."""
        self._exact.step(lines, labels, lines, lines, self._n_ids, None, 0)

    def then(self, later: "OfAll") -> "OfAll":
        """Join two parts."""
        self._exact = self._exact.then(later._exact)
        return self


def bench_parts(run: Run, lines: np.ndarray, labels: np.ndarray, repeat: int) -> dict[str, float]:
    """Return the ratios for one run, whose accesses are given as 32-byte lines and labels."""
    demand = labels < PREFETCH
    streams = {"all": (lines, labels), "demand": (lines[demand], labels[demand])}
    n_ids = int(lines.max()) + 1
    kinds = {
        "counts": (lambda: LruCounts(TWO_WAY), "demand"),
        "counts, 64K 8-way": (lambda: LruCounts(MANY_WAYS), "demand"),
        "sweep": (lambda: SetCounts(CORNERS), "all"),
        "account": (lambda: OfAll(TWO_WAY, n_ids), "all"),
    }
    functions = {"lists, 64K 8-way": lambda: OfAll(MANY_WAYS, n_ids, "none").step(*streams["demand"])}
    for kind, (make, stream) in kinds.items():
        functions[f"{kind}, whole"] = lambda make=make, stream=stream: make().step(*streams[stream])
        functions[f"{kind}, parts"] = lambda make=make, stream=stream: in_parts(make, *streams[stream])
    taken = times(functions, repeat)
    out = {f"{kind} in parts / whole": ratio(taken[f"{kind}, parts"], taken[f"{kind}, whole"]) for kind in kinds}
    out["8 ways, move to front / linked lists"] = ratio(taken["counts, 64K 8-way, whole"], taken["lists, 64K 8-way"])
    summary = LruCounts(CacheConfig(65536, 4))
    summary.step(*streams["demand"])
    out["bytes of a summary of a line, counts alone"] = packed(summary) / 2048
    return out


def bench_long(run: Run, repeat: int) -> dict[str, float]:
    """Return what a second core is worth for the replay of one long run."""
    if run.n_accesses < 2 * LEAST_PART or not hasattr(os, "sched_setaffinity"):
        return {}
    walls = times({"one": lambda: on_one_core(run), "two": lambda: plain(run, 2)}, repeat, time.perf_counter)
    return {"one long run, one core / two": ratio(walls["one"], walls["two"])}


def plain(run: Run, threads: int) -> None:
    """Replay a run from Parquet."""
    replay(run, [TWO_WAY], prefetch="none", threads=threads)


def on_one_core(run: Run) -> None:
    """Do the same with all threads on one core."""
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    try:
        plain(run, 1)
    finally:
        os.sched_setaffinity(0, cores)


def in_parts(make, lines: np.ndarray, labels: np.ndarray) -> None:
    """Step through parts, each from nothing, and join them."""
    whole = None
    for start in range(0, lines.size, PART):
        part = make()
        part.step(lines[start : start + PART], labels[start : start + PART])
        whole = part if whole is None else whole.then(part)


def packed(summary: LruCounts) -> int:
    """Return the bytes of a summary, compressed with zstd."""
    return sum(len(pa.Codec("zstd").compress(array.tobytes(), asbytes=True)) for array in summary.arrays().values())
