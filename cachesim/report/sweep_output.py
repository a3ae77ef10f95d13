"""A sweep for people: rows of ``cachesim.sweep`` -> a table, and a plot of miss rate over size and ways."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cachesim.config import format_bytes
from cachesim.report.pictures import PICTURES, check_plot, ending_of
from cachesim.report.replay_tables import RATES
from cachesim.result import ratio
from cachesim.sweep import SweepRow
from nptrace_base.atomic import whole_file
from nptrace_base.tables import Table, number, percent
from traces.identity import RunIdentity, labels


def tables(rows: Sequence[SweepRow]) -> tuple[list[Table], list[str]]:
    """Return the table, with a key column for all that varies, and the notes below it."""
    names = labels(row.identity for row in rows)
    keys = {
        "run": [names[row.identity] for row in rows],
        "prefetch": [row.prefetch for row in rows],
        "layout": [row.layout for row in rows],
        "cache": [str(row.config) for row in rows],
    }
    shown = [name for name, cells in keys.items() if name in ("run", "cache") or len(set(cells)) > 1]
    header = [*shown, "demand\naccesses", "demand\nmisses", "demand\nmiss rate %", "paper\nmiss rate %", "KB from\nmemory"]
    lines = [
        [
            *(keys[name][i] for name in shown), number(row.demand_accesses), number(row.demand_misses),
            percent(ratio(row.demand_misses, row.demand_accesses)), percent(row.to_dict()["paper_miss_rate"]),
            number(row.to_dict()["bytes_from_memory"] / 1024),
        ]
        for i, row in enumerate(rows)
    ]  # fmt: skip
    extra = ("demand\naccesses", "KB from\nmemory", "demand\nmisses")
    return [Table("", header, lines, n_left=len(shown), extra=extra)], list(RATES)


def plot(rows: Sequence[SweepRow], path: Path) -> None:
    """Draw the demand miss rate over size, a curve per number of ways, as a PNG, SVG or PDF file by the ending of its name.

    One panel for each run, prefetch policy, layout and line size; in it, a curve for each number of ways, of more than six
    for the powers of two. Solid: with prefetching; dashed: without, where there is any.
    """
    check_plot(path)
    ending = ending_of(path, PICTURES)
    with whole_file(path) as temporary:
        from matplotlib import rc_context
        from matplotlib.figure import Figure

        with rc_context({"svg.hashsalt": "npcache", "svg.fonttype": "none", "pdf.fonttype": 42, "font.size": 9}):
            names = labels(row.identity for row in rows)
            runs = list(dict.fromkeys(map(_panel_of, rows)))
            line_sizes = sorted({row.config.line_bytes for row in rows})
            figure = Figure(figsize=(1.4 + 3.1 * len(line_sizes), 0.6 + 2.6 * len(runs)), layout="constrained")
            panels = figure.subplots(len(runs), len(line_sizes), sharex=True, sharey="row", squeeze=False)
            styles = _styles(rows)
            for run, panel_row in zip(runs, panels, strict=True):
                for line_bytes, panel in zip(line_sizes, panel_row, strict=True):
                    shown = [row for row in rows if _panel_of(row) == run and row.config.line_bytes == line_bytes]
                    _draw_panel(panel, shown, styles)
                    panel.set_title(_title(run, names, line_bytes), fontsize=9)
            figure.supxlabel("cache size (bytes, K = 1024)", fontsize=9)
            figure.supylabel("demand misses / demand accesses (%)", fontsize=9)
            _draw_legend(figure, styles, has_prefetch=any(row.prefetch_accesses for row in rows))
            # No time stamp: the same rows give the same file.
            stamps: dict[str, Any] = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
            figure.savefig(temporary, dpi=200, metadata=stamps.get(ending), format=ending[1:])


def _panel_of(row: SweepRow) -> tuple[RunIdentity, str, str]:
    """Return what tells the curves of a panel row from others: the run, the prefetches and the layout."""
    return row.identity, row.prefetch, row.layout


def _title(of: tuple[RunIdentity, str, str], names: Mapping[RunIdentity, str], line_bytes: int) -> str:
    run, prefetch, layout = of
    settings = [f"{format_bytes(line_bytes)} B lines", f"prefetch {prefetch}"] + [layout] * (layout != "stored")
    return f"{names[run]}\n{', '.join(settings)}"


def _ways_of(row: SweepRow) -> int | str:
    return "full" if row.config.n_sets == 1 else row.config.ways


def _styles(rows: Sequence[SweepRow]) -> dict[int | str, dict[str, Any]]:
    """Return colour and marker for every number of ways that is drawn: light to dark, so that a grey print keeps the order."""
    from matplotlib import colormaps

    ways = sorted({way for row in rows if isinstance(way := _ways_of(row), int)})
    if len(ways) > 6:
        ways = [way for way in ways if way & (way - 1) == 0]
    shades = colormaps["viridis"](np.linspace(0.9, 0.0, max(len(ways), 2)))
    styles: dict[int | str, dict[str, Any]] = {
        way: {"color": tuple(shade), "marker": marker}
        for way, shade, marker in zip(ways, shades, "osD^vPX*<>" * 4, strict=False)
    }
    if any(_ways_of(row) == "full" for row in rows):
        styles["full"] = {"color": "black", "marker": "x"}
    return styles


def _draw_panel(panel: Any, rows: Sequence[SweepRow], styles: dict[int | str, dict[str, Any]]) -> None:
    """Draw the curves of one run and line size."""
    from matplotlib.ticker import FuncFormatter, NullLocator

    for ways, style in styles.items():
        curve = sorted((row for row in rows if _ways_of(row) == ways), key=lambda row: row.config.size_bytes)
        sizes = [row.config.size_bytes for row in curve]
        dicts = [row.to_dict() for row in curve]
        kinds = {"-": "demand_miss_rate"}
        if any(row.prefetch_accesses for row in curve):
            kinds["--"] = "demand_miss_rate_without"
        for line_style, rate in kinds.items():
            rates = [100.0 * (values[rate] or 0.0) for values in dicts]
            marker = style["marker"] if line_style == "-" else ""
            panel.plot(sizes, rates, line_style, color=style["color"], marker=marker, markersize=3.5, linewidth=1.1)
    panel.set_xscale("log", base=2)
    panel.xaxis.set_major_formatter(FuncFormatter(lambda size, _: format_bytes(round(size))))
    panel.xaxis.set_minor_locator(NullLocator())
    if any(row.demand_misses for row in rows):
        panel.set_yscale("log")
        panel.yaxis.set_major_formatter(FuncFormatter(lambda rate, _: f"{rate:g}"))
        panel.yaxis.set_minor_formatter(FuncFormatter(lambda rate, _: f"{rate:g}" if f"{rate:e}"[0] in "25" else ""))
    panel.grid(which="major", color="0.88", linewidth=0.6)
    panel.tick_params(which="both", labelsize=8)
    panel.spines[["top", "right"]].set_visible(False)


def _draw_legend(figure: Any, styles: dict[int | str, dict[str, Any]], *, has_prefetch: bool) -> None:
    from matplotlib.lines import Line2D

    keys = [Line2D([], [], markersize=4, label=str(ways), **style) for ways, style in styles.items()]
    figure.legend(handles=keys, title="ways (LRU)", loc="outside right upper", frameon=False, fontsize=8)
    if has_prefetch:
        keys = [
            Line2D([], [], color="0.3", linestyle="-", label="with\nprefetching"),
            Line2D([], [], color="0.3", linestyle="--", label="without"),
        ]
        figure.legend(handles=keys, loc="outside right lower", frameon=False, fontsize=8)
