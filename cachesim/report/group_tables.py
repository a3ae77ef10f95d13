"""Counts by pixel, level, node or ray type as tables: every level and ray type, and a summary of pixels and nodes."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from cachesim.by_group import THREE_C, GroupedResult
from nptrace_base.tables import Table, number, percent
from traces.identity import labels

_TITLES = {"level": "level", "ray-type": "ray", "pixel": "pixels", "node": "nodes"}
_EXTRA = ("resident", "redundant", "useless", "pollution", "coverage\n%", "issued")
_SUMMARY_EXTRA = ("median", "hottest\n10 % have %", "mean")

#: What a summary counts.
_COUNTED = {
    "demand accesses": "demand_accesses", "demand misses": "demand_misses", "issued": "prefetch_accesses",
    "useful": "useful", "pollution": "pollution",
}  # fmt: skip

_NOTES = (
    "demand miss rate = demand misses / demand accesses; share: of all demand misses; coverage = 1 - demand misses with / "
    "without prefetching.",
    "A prefetch, and what becomes of the line that it fills, is of the {of}; issued = redundant + filled, filled = useful + "
    "useless + resident. Whether a prefetch is late depends on time: npcache time --by level.",
)
_OF = {
    "pixel": "pixel of its ray", "ray-type": "ray for which it is made",
    "level": "level of the node requested", "node": "node requested",
}  # fmt: skip
_SUMMARY_NOTE = "hottest 1 %: of the {of}; -o FILE.parquet writes a row for each of them, nptrace view a heat map of pixels."


def tables(results: Sequence[GroupedResult]) -> tuple[list[Table], list[str]]:
    """Return a table per result, and the notes below them."""
    by = results[0].by
    names = labels(result.identity for result in results)
    is_summary = by in ("pixel", "node")
    made = []
    for result in results:
        parts = [names[result.identity], str(result.config), *([result.layout] if result.layout != "stored" else [])]
        title = ", ".join([*parts, f"prefetch {result.prefetch}"])
        made.append(_summary(title, result) if is_summary else _every_group(title, result))
    notes = [_NOTES[0]] if not is_summary else []
    if any(result.counts["prefetch_accesses"].any() for result in results):
        notes.append(_NOTES[1].format(of=_OF[by]))
    return made, [*notes, *([_SUMMARY_NOTE.format(of=_TITLES[by])] if is_summary else [])]


def _every_group(title: str, result: GroupedResult) -> Table:
    has_prefetch = bool(result.counts["prefetch_accesses"].any())
    kinds = [name for name in THREE_C if name in result.counts]
    header = [_TITLES[result.by], "demand\naccesses", "demand\nmisses", "demand\nmiss rate %", "share of\nmisses %", *kinds]
    if has_prefetch:
        header += ["issued", "redundant", "filled", "useful", "useless", "resident", "accuracy\n%", "coverage\n%", "pollution"]
    total = int(result.counts["demand_misses"].sum())
    lines = []
    for row in result.rows():
        cells = [str(row[result.by.replace("-", "_")]), number(row["demand_accesses"]), number(row["demand_misses"])]
        cells += [percent(row["demand_miss_rate"], 1), percent(row["demand_misses"] / total if total else None, 1)]
        cells += [number(row[name]) for name in kinds]
        if has_prefetch:
            cells += [
                number(row[name]) for name in ("prefetch_accesses", "redundant", "filled", "useful", "useless", "resident")
            ]
            cells += [percent(row["accuracy"], 1), percent(row["coverage"], 1), number(row["pollution"])]
        lines.append(cells)
    return Table(title, header, lines, extra=_EXTRA)


def summary(counts: np.ndarray) -> dict[str, Any]:
    """Return how a count, (n_groups,) int64, is spread; shares in the hottest groups are None where nothing is counted."""
    ordered, total = np.sort(counts)[::-1], int(counts.sum())
    hottest = {share: ordered[: max(round(len(ordered) * share), 1)].sum() / total if total else None for share in (0.01, 0.1)}
    return {
        "total": total, "groups": int(np.count_nonzero(counts)), "mean": total / len(counts) if len(counts) else None,
        "median": float(np.median(counts)) if len(counts) else None, "most": int(ordered[0]) if len(counts) else None,
        "at": int(np.argmax(counts)) if total else None, "hottest_hundredth": hottest[0.01], "hottest_tenth": hottest[0.1],
    }  # fmt: skip


def _summary(title: str, result: GroupedResult) -> Table:
    """Return how the counts are spread over pixels or nodes, of those that have a row."""
    header = [
        "", "total", f"{_TITLES[result.by]}\nwith any", "mean", "median", "most", "at", "hottest\n1 % have %",
        "hottest\n10 % have %",
    ]  # fmt: skip
    lines = []
    for name, column in _COUNTED.items():
        counts = result.counts[column][result.shown]
        figures = summary(counts)
        if not figures["total"] and name != "demand misses":
            continue
        at = "-"
        if figures["at"] is not None:
            group = int(result.shown[figures["at"]])
            at = ",".join(str(column[group]) for name, column in result.groups.items() if name != "level")
        lines.append([
            name, number(figures["total"]), number(figures["groups"]), number(figures["mean"], 2),
            number(figures["median"], 1), number(figures["most"]), at, percent(figures["hottest_hundredth"], 1),
            percent(figures["hottest_tenth"], 1),
        ])  # fmt: skip
    return Table(f"{title}: {len(result.shown):,} {_TITLES[result.by]}", header, lines, extra=_SUMMARY_EXTRA)
