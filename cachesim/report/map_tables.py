"""The break-even map as a table, in sentences, and as a plot."""

from collections.abc import Sequence
from math import isnan, nan
from pathlib import Path
from statistics import median
from typing import Any

from cachesim.clock.sampled_rays import PIECES
from cachesim.report.cases import STAND_IN_NOTE, Row
from cachesim.report.pictures import drawn
from nptrace_base.tables import Table, number

#: What a policy is called in a sentence.
TITLES = {"stack:unlimited": "the paper's unit", "push": "asking at the push"}
TREES = {"kdtree": "kd-tree, 8-byte nodes", "bvh": "BVH, 32-byte nodes", "bvh64": "BVH, 64-byte nodes"}

#: A speed-up within this of 1 makes no difference.
NO_DIFFERENCE = 0.005

NOTES = (
    "speed-up = cycles without prefetching / with, the same cache and machine: median (least to most) over scenes, leaf "
    "sizes, triangle tests, miss latencies and caches; pays % and costs %: cells above 1.005 and below 0.995.",
)


def tables(rows: Sequence[Row]) -> tuple[list[Table], list[str]]:
    """Return the table by tree, policy and rays in flight, and the notes below it."""
    header = ["tree", "prefetch", "rays", "speed-up", "least", "most", "pays\n%", "costs\n%", "cells"]
    lines, sections = [], set()
    for tree in _distinct(rows, "tree"):
        for prefetch in _distinct(rows, "prefetch"):
            for rays in _distinct(rows, "rays"):
                cells = cells_of(rows, tree=tree, prefetch=prefetch, rays=rays)
                if cells:
                    lines.append([tree, prefetch, str(rays), *_summary(cells)])
            sections.add(len(lines) - 1)
    return [Table("", header, lines, n_left=2, sections=sections, extra=("cells", "least"))], [
        *NOTES,
        *_stand_ins(rows),
        *_doubt(rows),
        *verdict(rows),
    ]


def scene_of(row: Row) -> str:
    """Return the scene's name, with ``(stand-in)`` when it is one."""
    return f"{row['scene']}{' (stand-in)' if row.get('stand_in') else ''}"


def _stand_ins(rows: Sequence[Row]) -> list[str]:
    """Return the usual note on stand-ins, and which scenes of the map are some."""
    found = dict.fromkeys(scene_of(row) for row in rows if row.get("stand_in"))
    return [f"{STAND_IN_NOTE} In this map: {', '.join(found)}."] if found else []


def _doubt(rows: Sequence[Row]) -> list[str]:
    """Return how far the speed-ups of a map from a sample of the rays may be off."""
    widths = [row["speed_up_half_width"] for row in rows if row.get("speed_up_half_width") is not None]
    if not widths:
        return []
    return [
        f"from one in {rows[0]['one_in']} of the {PIECES} pieces of the rays: a speed-up is within its half-width of that of "
        f"all rays in 95 % of the cells; it is {number(median(widths), 3)} in the middle and {number(max(widths), 3)} at "
        "most. A cell pays or costs only if all of its interval lies above 1.005 or below 0.995."
    ]


def _summary(cells: Sequence[Row]) -> list[str]:
    values = [row["speed_up"] for row in cells]
    return [
        number(median(values), 3), number(min(values), 3), number(max(values), 3),
        number(100 * sum(map(pays, cells)) / len(cells)), number(100 * sum(map(costs, cells)) / len(cells)),
        number(len(cells)),
    ]  # fmt: skip


def _half(row: Row) -> float:
    return float(row.get("speed_up_half_width") or 0)


def least(row: Row) -> float:
    """Return the lower end of a cell's interval, which is the speed-up itself where all rays were timed."""
    return float(row["speed_up"]) - _half(row)


def most(row: Row) -> float:
    """Return the upper end of a cell's interval."""
    return float(row["speed_up"]) + _half(row)


def pays(row: Row) -> bool:
    """Whether prefetching makes a cell faster, beyond doubt."""
    return least(row) > 1 + NO_DIFFERENCE


def costs(row: Row) -> bool:
    """Whether prefetching makes a cell slower, beyond doubt."""
    return most(row) < 1 - NO_DIFFERENCE


def _distinct(rows: Sequence[Row], name: str) -> list[Any]:
    return list(dict.fromkeys(row[name] for row in rows))


def cells_of(rows: Sequence[Row], **wanted: Any) -> list[Row]:
    """Return the cells that have these values, and a speed-up."""
    return [row for row in rows if row["speed_up"] and all(row[name] == value for name, value in wanted.items())]


def verdict(rows: Sequence[Row]) -> list[str]:
    """Return, for each tree, where each policy pays, where it costs, and by how much."""
    found = []
    for tree in _distinct(rows, "tree"):
        for prefetch in _distinct(rows, "prefetch"):
            cells = cells_of(rows, tree=tree, prefetch=prefetch)
            if not cells:
                continue
            best, worst = max(cells, key=least), min(cells, key=most)
            middle = median(row["speed_up"] for row in cells)
            text = f"{TREES.get(tree, tree)}: {TITLES.get(prefetch, prefetch)} gives {middle:.3f}x in the middle, "
            text += f"{_speed_up(best)} at best ({_where(best)})" if pays(best) else "and pays in no cell"
            if costs(worst):
                text += f", and costs up to {100 * (1 / worst['speed_up'] - 1):.1f} % more cycles ({_where(worst)})"
            found.append(text + ".")
    return found


def _speed_up(row: Row) -> str:
    half = f" +- {_half(row):.2f}" if _half(row) else ""
    return f"{row['speed_up']:.2f}{half}x"


def _where(row: Row) -> str:
    cache = f"{row['size_bytes'] // 1024}K {row['ways']}-way"
    return f"{scene_of(row)}, leaf {row['leaf']}, {cache}, triangle {row['triangle']}, miss {row['miss']}, rays {row['rays']}"


def _middle(rows: Sequence[Row], **wanted: Any) -> float:
    """Return the median speed-up of the cells that have these values; NaN, which is drawn as nothing, if none has one."""
    return median([row["speed_up"] for row in cells_of(rows, **wanted)] or [nan])


def plot(rows: Sequence[Row], path: Path) -> None:
    """Draw the median speed-up over scenes and caches, a panel per tree and policy: leaf and test by rays and miss."""
    trees, policies = _distinct(rows, "tree"), _distinct(rows, "prefetch")
    across = sorted({(row["rays"], row["miss"]) for row in rows})
    down = sorted({(row["leaf"], row["triangle"]) for row in rows})
    with drawn(path, 1.0 + 4.2 * len(policies), 0.8 + 2.6 * len(trees)) as figure:
        from matplotlib.colors import TwoSlopeNorm

        panels = figure.subplots(len(trees), len(policies), squeeze=False, sharex=True, sharey=True)
        norm = TwoSlopeNorm(1.0, 0.9, 1.7)
        image = None
        for tree, panel_row in zip(trees, panels, strict=True):
            for prefetch, panel in zip(policies, panel_row, strict=True):
                cells = [
                    [
                        _middle(rows, tree=tree, prefetch=prefetch, rays=k, miss=miss, leaf=leaf, triangle=test)
                        for k, miss in across
                    ]
                    for leaf, test in down
                ]  # fmt: skip
                image = panel.imshow(cells, cmap="RdBu", norm=norm, aspect="auto")
                for y, line in enumerate(cells):
                    for x, value in enumerate(line):
                        panel.text(x, y, "-" if isnan(value) else f"{value:.2f}", ha="center", va="center", fontsize=4.5)
                panel.set_title(f"{TREES.get(tree, tree)}: {TITLES.get(prefetch, prefetch)}", fontsize=8)
                panel.set_xticks(range(len(across)), [f"{rays} x {miss}" for rays, miss in across], rotation=90, fontsize=6)
                panel.set_yticks(range(len(down)), [f"{leaf}, {triangle}" for leaf, triangle in down], fontsize=6)
        scenes = ", ".join(dict.fromkeys(map(scene_of, rows)))
        figure.supxlabel(f"rays in flight x miss latency (cycles)\nscenes: {scenes}", fontsize=8)
        figure.supylabel("triangles per leaf, cycles per triangle test", fontsize=8)
        assert image is not None
        figure.colorbar(image, ax=panels, label="median speed-up over scenes and caches", shrink=0.6)
