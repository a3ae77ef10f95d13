"""Rows of ``npcache table1`` as a plot: ours beside the paper's, cache by cache; several tables are told apart."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cachesim.config import format_bytes
from cachesim.report.cases import Row, texts_of
from cachesim.report.pictures import COLOURS, drawn
from cachesim.report.table1 import TREES

#: What each panel shows: its title, and its series with the column and the style of each.
PANELS: Any = (
    ("miss rate without prefetching (%)", {
        "paper": ("demand_miss_rate_without_paper", {"color": "black", "marker": "_", "markersize": 11, "markeredgewidth": 2}),
        "ours": ("demand_miss_rate_without", {"color": COLOURS[0], "marker": "o"}),
    }),
    ("with prefetching / without (%)", {
        "paper: miss rate": ("paper_ratio_paper", {"color": "black", "marker": "_", "markersize": 11, "markeredgewidth": 2}),
        "ours: the paper's miss rate": ("paper_ratio", {"color": COLOURS[0], "marker": "o"}),
        "ours: demand misses": ("demand_ratio", {"color": COLOURS[1], "marker": "D", "markersize": 4}),
        "ours: bytes from memory": ("traffic_ratio", {"color": COLOURS[2], "marker": "^", "markersize": 4}),
    }),
)  # fmt: skip


def draw_table1(rows: Sequence[Row], path: Path) -> None:
    """Draw Table I, a row of panels for each tree: the miss rates of the caches, and what prefetching makes of them."""
    trees = [tree for tree in TREES if any(row["tree"] == tree for row in rows)]
    most = max(sum(row["tree"] == tree for row in rows) for tree in trees)
    wide = max(1.3 + 0.24 * most, 3.6)
    with drawn(path, 2 * wide + 0.3, 2.9 * len(trees) + 0.7) as figure:
        grid = figure.subplots(len(trees), 2, squeeze=False, sharex="row", sharey="col")
        for tree, panels in zip(trees, grid, strict=True):
            members = _by_scene([row for row in rows if row["tree"] == tree])
            names = _ticks(members)
            for axes, (title, series) in zip(panels, PANELS, strict=True):
                for name, (column, style) in series.items():
                    shown = [(i, 100 * row[column]) for i, row in enumerate(members) if row[column] is not None]
                    axes.plot(*zip(*shown, strict=True), linestyle="none", label=name, **({"markersize": 5} | style))
                axes.set_title(f"{TREES[tree]}: {title}")
                axes.grid(axis="y", color="0.9", linewidth=0.6)
                axes.set_xticks(range(len(members)), names, rotation=90)
                _name_scenes(axes, members)
            panels[1].axhline(100, color="0.4", linewidth=0.8, zorder=0)
        grid[0, 0].set_ylim(bottom=0)
        for axes, column in zip(grid[0], (0, 1), strict=True):
            handles, names = axes.get_legend_handles_labels()
            figure.legend(handles, names, loc="outside lower " + ("left", "right")[column], ncols=2, frameon=False)


def _by_scene(rows: Sequence[Row]) -> list[Row]:
    """Return the rows of each scene side by side, the scenes in the order in which they come first."""
    scenes = list(dict.fromkeys((row["scene"], bool(row["stand_in"])) for row in rows))
    return sorted(rows, key=lambda row: scenes.index((row["scene"], bool(row["stand_in"]))))


def _ticks(rows: Sequence[Row]) -> list[str]:
    """Return what stands below each row: its cache, and what tells it from other rows of its scene, as a policy or a run."""
    found = [f"{format_bytes(row['size_bytes'])}({row['ways']})" for row in rows]
    for scene in dict.fromkeys((row["scene"], bool(row["stand_in"])) for row in rows):
        places = [i for i, row in enumerate(rows) if (row["scene"], bool(row["stand_in"])) == scene]
        texts = texts_of([rows[i] for i in places], without=("cache", "lines"))
        for i, text in zip(places, texts, strict=True):
            found[i] += f" {text}" if text else ""
    return found


def _name_scenes(axes: Any, members: Sequence[Row]) -> None:
    """Write the scenes along the top of a panel, and part them by lines."""
    scenes = [f"{row['scene']}{' (stand-in)' if row['stand_in'] else ''}" for row in members]
    starts = [i for i, scene in enumerate(scenes) if i == 0 or scene != scenes[i - 1]]
    for start, end in zip(starts, [*starts[1:], len(scenes)], strict=True):
        if start:
            axes.axvline(start - 0.5, color="0.8", linewidth=0.8)
        place = (start + end - 1) / 2, 1.0
        box = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
        axes.text(*place, scenes[start], ha="center", va="top", fontsize=8, bbox=box, transform=axes.get_xaxis_transform())
    axes.set_xlim(-0.6, len(members) - 0.4)
    axes.margins(y=0.14)
