"""Table I of the paper beside ours: the runs of the four scenes and two trees -> one row per tree, scene and cache.

The paper's metric counts prefetches as accesses: its miss rate is all misses / all accesses, its bandwidth all fills. Its
ACPR is N ((1 - R) 1 + R 100) with that miss rate R and one N for all scenes of a tree (``PAPER_N``, derived from the table:
ACPR / (1 + 99 R) is the same in every row). The demand metric stands beside it.
"""

import csv
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

from cachesim.clock.parameters import PRESETS
from cachesim.clock.timing import Timing, time_run
from cachesim.config import CacheConfig
from cachesim.replay import replay
from cachesim.result import Result, ratio
from cachesim.source import as_source
from nptrace_base.errors import NptraceError
from traces.identity import STAND_IN, RunIdentity
from traces.reader import Run

TREES = {"kdtree": "kd-tree", "bvh": "BVH"}
SCENES = ("bunny", "conference", "sibenik", "sponza")

#: The paper's average number of node accesses per ray, by tree.
PAPER_N = {"kdtree": 15.77, "bvh": 27.00}
HIT_CYCLES, MISS_CYCLES = 1, 100


@dataclass(frozen=True)
class Equation:
    """The numbers of the paper's equation 1.

    Attributes
    ----------
    hit, miss : int
        Cycles of a node access that hits, and of one that misses.
    n : mapping
        Accesses per ray, by tree; a tree that is missing has the measured number.
    """

    hit: int = HIT_CYCLES
    miss: int = MISS_CYCLES
    n: Mapping[str, float] = field(default_factory=lambda: PAPER_N)

    def acpr(self, n: float | None, miss_rate: float | None) -> float | None:
        """Return the average cycles a ray spends on node accesses."""
        if n is None or miss_rate is None:
            return None
        return n * ((1 - miss_rate) * self.hit + miss_rate * self.miss)


def parse_n(text: str) -> Mapping[str, float]:
    """Return N by tree: ``paper``, ``measured``, or two numbers, the kd-tree's and the BVH's, as in ``15.77,27``."""
    if text in ("paper", "measured"):
        return PAPER_N if text == "paper" else {}
    try:
        values = [float(word) for word in text.split(",")]
    except ValueError:
        values = []
    if len(values) != len(TREES) or not all(0 < value < math.inf for value in values):
        raise NptraceError(f"{text!r} is not N; write paper, measured, or the kd-tree's and the BVH's, e.g. 15.77,27")
    return dict(zip(TREES, values, strict=True))


#: The paper's columns: miss rate in per cent, bandwidth in KB, ACPR in cycles; ratios are b/a in per cent.
NAMES = ("miss_a", "miss_b", "miss_ratio", "kb_a", "kb_b", "kb_ratio", "acpr_a", "acpr_b", "acpr_ratio")

#: Our additional columns: counts, and per cent.
DEMAND_NAMES = (
    "demand_accesses", "prefetches", "demand_miss_a", "demand_miss_b", "demand_ratio", "coverage", "accuracy"
)  # fmt: skip

Key = tuple[str, str, int, int]  # tree, scene, size_bytes, ways


@dataclass(frozen=True)
class Table1Row:
    """One row: ``ours`` and ``paper`` by the names above.

    ``nodes_per_ray`` is the measured N (accesses per ray), ``timing`` the same cache on the machine ``paper`` of the clock,
    None where it was not timed, and ``equation`` that of the ACPR. ``policy`` to ``reads`` are those of the replay.
    """

    tree: str
    scene: str
    identity: RunIdentity
    size_bytes: int
    ways: int
    policy: str
    layout: str
    prefetch: str
    reads: str
    ours: dict[str, float | None]
    paper: Mapping[str, float]
    nodes_per_ray: float | None
    timing: Timing | None = None
    equation: Equation = field(default_factory=Equation)

    @property
    def n(self) -> float | None:
        """The N of the ACPR."""
        return self.equation.n.get(self.tree, self.nodes_per_ray)

    @property
    def is_stand_in(self) -> bool:
        """Whether the scene is not the paper's."""
        return bool(self.identity.stand_in)

    @property
    def scene_title(self) -> str:
        """The scene's name, with ``(stand-in)`` when it is one."""
        return self.scene + (" (stand-in)" if self.is_stand_in else "")

    def measured_acpr(self, name: str) -> float | None:
        """Return ``acpr_a`` or ``acpr_b`` with the measured N."""
        ours = self.ours[name]
        if ours is None or self.nodes_per_ray is None:
            return None
        return ours / self.n * self.nodes_per_ray if self.n else None


@cache
def paper_table() -> Mapping[Key, Mapping[str, float]]:
    """Return the 32 rows of the paper, in its order."""
    with open(Path(__file__).with_name("table1_paper.csv"), encoding="ascii", newline="") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    return {
        (row["tree"], row["scene"], int(row["size_bytes"]), int(row["ways"])): {name: float(row[name]) for name in NAMES}
        for row in rows
    }


def caches() -> list[CacheConfig]:
    """Return the four caches of the table, in its order."""
    return [CacheConfig(size, ways, 32) for size, ways in dict.fromkeys((size, ways) for _, _, size, ways in paper_table())]


def acpr(n: float, miss_rate: float | None) -> float | None:
    """Return the average cycles a ray spends on node accesses, the paper's equation 1 with its numbers."""
    return Equation().acpr(n, miss_rate)


def choose_runs(runs: Iterable[Run]) -> dict[tuple[str, str], Run]:
    """Return the run of every (tree, scene) of the table; others are left out.

    Of several runs the one with every default is chosen, by its name ``<scene>-<tree>``, or ``<scene>-standin-<tree>`` if
    there is none of the real scene; without one of these names, NptraceError.
    """
    found: dict[tuple[str, str], list[Run]] = {}
    for run in runs:
        scene = run.footer.scene.name.lower()
        if scene in SCENES and run.footer.tree.kind in TREES:
            found.setdefault((run.footer.tree.kind, scene), []).append(run)
    chosen = {}
    for (tree, scene), candidates in found.items():
        usual = (f"{scene}-{tree}", f"{scene}-{STAND_IN}-{tree}")
        named = next(filter(None, ([run for run in candidates if run.name == name] for name in usual)), candidates)
        if len(named) > 1:
            names = " and ".join(str(run.path) for run in named)
            raise NptraceError(
                f"{names} are both {scene} as a {TREES[tree]}; name the runs to use, or call one of them {scene}-{tree}"
            )
        chosen[tree, scene] = named[0]
    return chosen


def missing(chosen: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
    """Return the (tree, scene) pairs of the table that have no run."""
    have = set(chosen)
    return [(tree, scene) for tree in TREES for scene in SCENES if (tree, scene) not in have]


def in_order(chosen: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
    """Return (tree, scene) pairs in the order of the paper."""
    return sorted(chosen, key=lambda key: (list(TREES).index(key[0]), key[1]))


def table1(
    chosen: Mapping[tuple[str, str], Run], *, policy: str = "lru", layout: str = "stored", equation: Equation | None = None,
    threads: int | None = None, progress: Callable[[int], None] | None = None,
) -> list[Table1Row]:  # fmt: skip
    """Return the rows of Table I for the runs that ``choose_runs`` found, in the paper's order.

    ``policy`` is the caches' replacement, which the clock must know too (lru, fifo or random), ``layout`` that of the nodes,
    and ``equation`` that of the ACPR and of the clock; the paper's numbers beside them are of its own.
    """
    equation = equation or Equation()
    clock = PRESETS["paper"].clock.with_numbers(hit=equation.hit, miss=equation.miss)
    rows = []
    for tree, scene in in_order(chosen):
        run = chosen[tree, scene]
        configs = [replace(config, policy=policy) for config in caches()]
        source = as_source(run, layout)
        results = replay(source, configs, threads=threads, progress=progress)
        timings: Sequence[Timing | None] = [None] * len(configs)
        if run.footer.packet == 1:  # on the clock every ray reads for itself
            timings = time_run(source, configs, [clock], threads=threads, progress=progress)
        rows += [
            row_of(tree, scene, result, equation, timing) for result, timing in zip(results, timings, strict=True)
        ]  # fmt: skip
    return rows


def row_of(tree: str, scene: str, result: Result, equation: Equation, timing: Timing | None = None) -> Table1Row:
    """Return the row of a replay of one of the four caches, and of its timing."""
    size_bytes, ways = result.config.size_bytes, result.config.ways
    paper = paper_table()[tree, scene, size_bytes, ways]
    miss_a = ratio(result.demand_misses_without, result.demand_accesses)
    per_ray = ratio(result.demand_accesses, result.n_rays or 0)
    miss_b, n = result.paper_miss_rate, equation.n.get(tree, per_ray)
    ours: dict[str, float | None] = {"miss_a": _percent(miss_a), "miss_b": _percent(miss_b)}
    ours["kb_a"] = result.demand_misses_without * result.config.line_bytes / 1024
    ours["kb_b"] = result.bytes_from_memory / 1024
    ours["acpr_a"], ours["acpr_b"] = equation.acpr(n, miss_a), equation.acpr(n, miss_b)
    for name in ("miss", "kb", "acpr"):
        a, b = ours[f"{name}_a"], ours[f"{name}_b"]
        ours[f"{name}_ratio"] = None if a is None or b is None else _percent(ratio(b, a))
    demand: dict[str, float | None] = {
        "demand_accesses": result.demand_accesses,
        "prefetches": result.prefetch_accesses,
        "demand_miss_a": _percent(miss_a),
        "demand_miss_b": _percent(result.demand_miss_rate),
        "demand_ratio": _percent(ratio(result.demand_misses, result.demand_misses_without)),
        "coverage": _percent(result.coverage),
        "accuracy": _percent(result.accuracy),
    }
    figures = {n: ours[n] for n in NAMES} | demand
    asked = result.config.policy, result.layout, result.prefetch, result.reads
    return Table1Row(tree, scene, result.identity, size_bytes, ways, *asked, figures, paper, per_ray, timing, equation)


def _percent(fraction: float | None) -> float | None:
    return None if fraction is None else 100 * fraction


#: The columns of a record that come from ``NAMES`` and ``DEMAND_NAMES``: the name that all results use, and what divides ours
#: to give fractions and bytes.
_RECORD: dict[str, tuple[str, float]] = {
    "miss_a": ("demand_miss_rate_without", 100), "miss_b": ("paper_miss_rate", 100), "miss_ratio": ("paper_ratio", 100),
    "kb_a": ("bytes_from_memory_without", 1 / 1024), "kb_b": ("bytes_from_memory", 1 / 1024),
    "kb_ratio": ("traffic_ratio", 100),
    "acpr_a": ("acpr_without", 1), "acpr_b": ("acpr", 1), "acpr_ratio": ("acpr_ratio", 100),
    "demand_accesses": ("demand_accesses", 1), "prefetches": ("prefetch_accesses", 1),
    "demand_miss_b": ("demand_miss_rate", 100), "demand_ratio": ("demand_ratio", 100), "coverage": ("coverage", 100),
    "accuracy": ("accuracy", 100),
}  # fmt: skip
_COUNTS = ("bytes_from_memory_without", "bytes_from_memory", "demand_accesses", "prefetch_accesses")


def to_dicts(rows: Iterable[Table1Row]) -> list[dict[str, Any]]:
    """Return the rows as records, in fractions and bytes; ``_paper`` is the paper's number."""
    return [_record(row) for row in rows]


def _record(row: Table1Row) -> dict[str, Any]:
    timing = row.timing
    values: dict[str, Any] = {**row.identity.to_dict(), "scene": row.scene, "size_bytes": row.size_bytes, "ways": row.ways}
    values |= {"policy": row.policy, "layout": row.layout, "prefetch": row.prefetch, "reads": row.reads}
    for name, (column, by) in _RECORD.items():
        values[column] = _divided(row.ours[name], by, column)
        if name in NAMES:
            values[f"{column}_paper"] = _divided(row.paper[name], by, column)
    return values | {
        "accesses_per_ray": row.nodes_per_ray,
        "acpr_n": row.n,
        "acpr_hit": row.equation.hit,
        "acpr_miss": row.equation.miss,
        "acpr_without_measured_n": row.measured_acpr("acpr_a"),
        "acpr_measured_n": row.measured_acpr("acpr_b"),
        "cycles_per_ray_without": timing and ratio(timing.cycles_without, timing.n_rays),
        "cycles_per_ray": timing and ratio(timing.cycles, timing.n_rays),
        "speed_up": timing and timing.speed_up,
    }


def _divided(value: float | None, by: float, column: str) -> float | int | None:
    if value is None:
        return None
    return round(value / by) if column in _COUNTS else round(value / by, 12)
