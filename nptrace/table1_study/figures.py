"""Rows of counts -> the figures of Table I, the paper's and the honest ones, and what the paper's own numbers imply."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from cachesim.report.cases import Row
from cachesim.report.table1 import PAPER_N, SCENES, TREES, acpr, paper_table
from cachesim.result import ratio
from nptrace.table1_study.knobs import KNOBS, Setting

#: The caches of the table: bytes and ways.
CACHES = ((8192, 1), (8192, 2), (16384, 1), (16384, 2))
LINE_BYTES = 32

#: Half of the last printed digit of the paper's columns.
ROUNDING = {"miss_a": 0.05, "miss_b": 0.05, "miss_ratio": 0.05, "kb_a": 0.5, "kb_b": 0.5, "kb_ratio": 0.05, "acpr_a": 0.05,
            "acpr_b": 0.05, "acpr_ratio": 0.5}  # fmt: skip


def figures_of(row: Row) -> dict[str, float | None]:
    """Return the nine columns of Table I for a row of counts, by the names of ``paper_table``, and the honest figures.

    ``p`` is prefetches / demand accesses, ``demand_ratio`` demand misses with / without prefetching in per cent, ``all_ratio``
    what B/A would be if prefetches were not counted as accesses: that of the lines fetched.
    """
    accesses, prefetches, without = row["demand_accesses"], row["prefetches"], row["misses_a"]
    fills = row["demand_misses"] + row["prefetch_misses"]
    miss_a, miss_b = ratio(without, accesses), ratio(fills, accesses + prefetches)
    n = PAPER_N[row["tree"]]
    figures = {
        "miss_a": _percent(miss_a), "miss_b": _percent(miss_b), "miss_ratio": _percent(_of(miss_b, miss_a)),
        "kb_a": without * LINE_BYTES / 1024, "kb_b": fills * LINE_BYTES / 1024, "kb_ratio": _percent(ratio(fills, without)),
        "acpr_a": acpr(n, miss_a), "acpr_b": acpr(n, miss_b),
    }  # fmt: skip
    figures["acpr_ratio"] = _percent(_of(figures["acpr_b"], figures["acpr_a"]))
    return figures | {
        "p": ratio(prefetches, accesses), "demand_ratio": _percent(ratio(row["demand_misses"], without)),
        "coverage": _percent(ratio(without - row["demand_misses"], without)),
        "accuracy": _percent(ratio(row["useful"], row["prefetch_misses"])),
        "pollution": _percent(ratio(row["pollution"], row["demand_misses"])),
    }  # fmt: skip


def _percent(fraction: float | None) -> float | None:
    return None if fraction is None else 100 * fraction


def _of(a: float | None, b: float | None) -> float | None:
    return None if a is None or b is None else ratio(a, b)


class Paper(NamedTuple):
    """What the four rows of a scene and tree imply: intervals that their rounding allows.

    Attributes
    ----------
    accesses : (low, high)
        Demand accesses: bytes from memory / line bytes / miss rate.
    p : (low, high)
        Prefetches / demand accesses: B/A of the bytes / B/A of the miss rates - 1. Where no p rounds to all four rows, the
        interval that lies between theirs.
    p_gap : float
        How far the intervals of the four rows are apart; 0 if some p rounds to all of them.
    lines : int
        The fewest misses that any of the four caches has: lines that the trace touches at most.
    """

    accesses: tuple[float, float]
    p: tuple[float, float]
    p_gap: float
    lines: int


def implied(tree: str, scene: str) -> Paper:
    """Return what the paper's rows of a scene and tree imply."""
    rows = [row for key, row in paper_table().items() if key[:2] == (tree, scene)]
    low = max((row["kb_a"] - 0.5) * 1024 / LINE_BYTES / ((row["miss_a"] + 0.05) / 100) for row in rows)
    high = min((row["kb_a"] + 0.5) * 1024 / LINE_BYTES / ((row["miss_a"] - 0.05) / 100) for row in rows)
    p_low = max((row["kb_ratio"] - 0.05) / (row["miss_ratio"] + 0.05) for row in rows) - 1
    p_high = min((row["kb_ratio"] + 0.05) / (row["miss_ratio"] - 0.05) for row in rows) - 1
    p = min(p_low, p_high), max(p_low, p_high)
    return Paper((low, high), p, max(p_low - p_high, 0.0), round(min(row["kb_a"] for row in rows) * 1024 / LINE_BYTES))


@cache
def read_rows(path: Path) -> tuple[dict[str, Any], ...]:
    """Return the rows of a study, each with its figures."""
    import pyarrow.parquet as pq

    return tuple({**row, **figures_of(row)} for row in pq.read_table(path).to_pylist())


def setting_of(row: Row) -> Setting:
    """Return the setting of a row."""
    return Setting(**{each.name: row[each.name] for each in fields(Setting)})


def is_plausible(row: Row) -> bool:
    """Return whether no knob has a value that the paper's text contradicts."""
    return not any(row[knob.name] in knob.unlikely for knob in KNOBS)


def cells() -> Iterator[tuple[str, str, tuple[int, int]]]:
    """Yield the 32 rows of the table: tree, scene and cache."""
    for tree in TREES:
        for scene in SCENES:
            for each in CACHES:
                yield tree, scene, each


def span_of(rows: Sequence[Row], name: str) -> tuple[float, float]:
    """Return the least and the largest value of a figure."""
    values = [row[name] for row in rows if row[name] is not None]
    return min(values), max(values)


def is_inside(value: float, name: str, low: float, high: float) -> bool:
    """Return whether a printed value, which stands for all that round to it, may lie between two."""
    return low - ROUNDING[name] <= value <= high + ROUNDING[name]


def octaves(a: float, b: float) -> float:
    """Return how many times a must be doubled to give b, positive or negative."""
    return math.log2(b / a)
