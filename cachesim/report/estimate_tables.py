"""Printed estimates: results of ``sampling.estimate`` -> tables with half-widths, alone or beside the paper's Table I."""

from collections.abc import Sequence
from typing import Any

from cachesim.config import format_bytes
from cachesim.report.cases import STAND_IN_NOTE
from cachesim.report.table1 import HIT_CYCLES, MISS_CYCLES, NAMES, PAPER_N, TREES, Key, acpr, paper_table
from cachesim.report.table1_tables import ACPR_NOTE
from cachesim.sampling.estimate import CONFIDENCE, OF_THE_RUN, QUANTITIES, CacheEstimate, Estimated
from cachesim.sampling.two_phase import Interval
from nptrace_base.tables import Table, number
from traces.identity import labels

NOTES = (
    f"value +-half-width: all values of a run lie within their half-widths at once in {100 * CONFIDENCE:.0f} % of the seeds; "
    "exact values have none. A: without, B: with prefetching; demand: demand misses / demand accesses; paper: all misses / "
    "all accesses; traffic: KB B / KB A.",
)

#: Columns without which a narrow terminal does, the first to go first.
_EXTRA = ("KB A", "KB B", "traffic\nB/A %", "paper\nB/A %", "demand\nB/A %")
_COST_EXTRA = ("units", "sampled", "target", "accesses\nper ray")
_TABLE1_EXTRA = ("ACPR\nA", "ACPR\nB", "ACPR\nB/A", "KB\nA", "KB\nB", "demand\nA", "KB\nB/A")

_COLUMNS = {
    "demand_miss_rate_without": "demand A\n%",
    "demand_miss_rate": "demand B\n%",
    "paper_miss_rate": "paper B\n%",
    "demand_ratio": "demand\nB/A %",
    "paper_ratio": "paper\nB/A %",
    "traffic_ratio": "traffic\nB/A %",
    "bytes_from_memory_without": "KB A",
    "bytes_from_memory": "KB B",
}


def _value(value: Interval | None, scale: float, decimals: int) -> str:
    if value is None:
        return "-"
    half = f" +-{number(_up(scale * value.half, decimals), decimals)}" if value.half else ""
    return number(scale * value.value, decimals) + half


def _up(half: float, decimals: int) -> float:
    """Return a half-width rounded up, so that it is never printed too small or as 0."""
    step = 10.0**-decimals
    return half if half in (0.0, float("inf")) else -(-half // step) * step


def tables(results: Sequence[Estimated]) -> tuple[list[Table], list[str]]:
    """Return one table per run, a table of costs, and the notes below them."""
    made, names = [], labels(result.identity for result in results)
    for result in results:
        rows = []
        for cell in result.cells:
            row = [str(cell.config), result.method]
            for name in _COLUMNS:
                scale, decimals = (1 / 1024, 0) if name.startswith("bytes") else (100.0, 2 if "ratio" in name else 3)
                row.append(_value(cell.values[name], scale, decimals))
            rows.append(row)
        header = ["cache", "method", *_COLUMNS.values()]
        made.append(Table(names[result.identity] + _layout(result), header, rows, n_left=2, extra=_EXTRA))
    return [*made, _cost(results)], [*NOTES, *_reasons(results)]


def _layout(result: Estimated) -> str:
    return "" if result.layout == "stored" else f", layout {result.layout}"


def _cost(results: Sequence[Estimated]) -> Table:
    names = labels(result.identity for result in results)
    header = ["run", "target", "units", "sampled", "rays\ntraced %", "seconds", "exact run,\nseconds", "accesses\nper ray"]
    rows = [
        [names[r.identity] + _layout(r), r.target, number(r.n_units), number(r.n_sampled), number(100 * r.share, 1),
         number(r.seconds, 2), ("" if r.method == "exact" else "about ") + number(r.exact_seconds, 2),
         _value(r.accesses_per_ray, 1.0, 2)]
        for r in results
    ]  # fmt: skip
    return Table("cost", header, rows, n_left=2, extra=_COST_EXTRA)


def _reasons(results: Sequence[Estimated]) -> list[str]:
    names = labels(result.identity for result in results)
    return [f"{names[r.identity]} was counted exactly: {r.reason}." for r in results if r.reason]


def table1_tables(results: Sequence[tuple[str, str, Estimated]]) -> tuple[list[Table], list[str]]:
    """Return Table I from estimates: (tree, scene, result) in; ours, our half-width and the paper's in every row."""
    paper = paper_table()
    header = ["Scene", "Cache", ""] + [
        f"{group}\n{column}" for group in ("miss", "KB", "ACPR") for column in ("A", "B", "B/A")
    ]
    header += ["demand\nA", "demand\nB", "demand\nB/A"]
    made = []
    for tree, title in TREES.items():
        lines: list[list[str]] = []
        sections = set()
        for of, scene, result in results:
            if of != tree:
                continue
            for k, cell in enumerate(result.cells):
                row = _table1_values(tree, cell)
                key: Key = (tree, scene, cell.config.size_bytes, cell.config.ways)
                name = scene.title() if k == 0 else ("(stand-in)" if k == 1 and result.identity.stand_in else "")
                cache = f"{format_bytes(cell.config.size_bytes)}({cell.config.ways})"
                decimals = [0 if n in ("kb_a", "kb_b") else 2 for n in row]
                ours = [number(v and v.value, d, group="") for v, d in zip(row.values(), decimals, strict=True)]
                halves = [number(v and _up(v.half, d), d, group="") for v, d in zip(row.values(), decimals, strict=True)]
                theirs = [
                    number(paper[key][n], 0 if n in ("kb_a", "kb_b") else 1, group="") if n in NAMES else "" for n in row
                ]
                lines.append([name, cache, "ours", *ours])
                if result.method != "exact":
                    lines.append(["", "", "+-", *halves])
                lines.append(["", "", "paper", *theirs])
            sections.add(len(lines) - 1)
        if lines:
            made.append(Table(title, header, lines, n_left=3, sections=sections, extra=_TABLE1_EXTRA))
    estimated = [result for _, _, result in results]
    stand_ins = [STAND_IN_NOTE] if any(result.identity.stand_in for result in estimated) else []
    return [*made, _cost(estimated)], [*NOTES, ACPR_NOTE, *stand_ins, *_reasons(estimated)]


def _table1_values(tree: str, cell: CacheEstimate) -> dict[str, Interval | None]:
    """Return the columns of Table I, in per cent, KB and cycles, and the demand metric behind them."""
    of = cell.values

    def scaled(name: str, by: float, add: float = 0.0) -> Interval | None:
        value = of[name]
        return value and Interval(by * value.value + add, by * value.half, by * value.bracket)

    n, first, second = PAPER_N[tree], of["demand_miss_rate_without"], of["paper_miss_rate"]
    slope = n * (MISS_CYCLES - HIT_CYCLES)
    acpr_ratio = None
    if first is not None and second is not None and of["paper_ratio"] is not None:
        below, above = acpr(n, first.value), acpr(n, second.value)
        assert below and above
        # The errors of two separate rates add up; the interval of their ratio is narrower, because the rates share errors.
        share = slope * first.value / below
        ratio = of["paper_ratio"]
        half = share * ratio.half + abs(slope * (ratio.value - above / below) / below) * first.half
        acpr_ratio = Interval(100 * above / below, 100 * half, 0.0)
    return {
        "miss_a": scaled("demand_miss_rate_without", 100),
        "miss_b": scaled("paper_miss_rate", 100),
        "miss_ratio": scaled("paper_ratio", 100),
        "kb_a": scaled("bytes_from_memory_without", 1 / 1024),
        "kb_b": scaled("bytes_from_memory", 1 / 1024),
        "kb_ratio": scaled("traffic_ratio", 100),
        "acpr_a": scaled("demand_miss_rate_without", slope, n * HIT_CYCLES),
        "acpr_b": scaled("paper_miss_rate", slope, n * HIT_CYCLES),
        "acpr_ratio": acpr_ratio,
        "demand_a": scaled("demand_miss_rate_without", 100),
        "demand_b": scaled("demand_miss_rate", 100),
        "demand_ratio": scaled("demand_ratio", 100),
    }


def records(results: Sequence[Estimated], form: str) -> list[dict[str, Any]]:
    """Return one record per run with its cells for ``json``, and flat ones for other formats."""
    return [result.to_dict() for result in results] if form == "json" else flat(results)


def flat(results: Sequence[Estimated]) -> list[dict[str, Any]]:
    """Return one flat record per run and cache, for CSV and Parquet; ``_half_width`` is that of the quantity before it."""
    records = []
    for result in results:
        of_run = {name: value for name, value in result.to_dict().items() if name != "cells"}
        of_run["flags"] = "; ".join(result.flags)
        records += [_flat({**of_run, **cell}) for cell in result.to_dict()["cells"]]
    return records


def _flat(record: dict[str, Any]) -> dict[str, Any]:
    quantities = (*OF_THE_RUN, *QUANTITIES)
    values: dict[str, Any] = {}
    for name, value in record.items():
        if name in quantities:
            values[name] = value and value["value"]
            values[f"{name}_half_width"] = value and value["half_width"]
        else:
            values[name] = value
    return values
