"""Heat maps of runs as one figure: a panel for each run and kind, one scale and one colour bar for all panels of a kind.

A panel shows each pixel of a run as a square of whole pixels of the figure, in exactly the colour of its number.
"""

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from cachesim.report.pictures import DIVERGING, SEQUENTIAL, drawn

#: Dots of a raster figure per inch; everything below is in dots.
_DPI = 100
_GAP, _BAR, _LINE, _NARROWEST = 16, 68, 15, 240
_SHOWN, _FAR = 0.995, 1.25
_CHARACTER = 6.6  # of a title, on average


@dataclass(frozen=True)
class Scale:
    """The colours of the numbers of a kind, with what its colour bar says."""

    label: str
    least: float
    most: float
    is_cut: bool = False  # some numbers are beyond, and have the colour of the end

    @property
    def colours(self) -> str:
        """The name of the colour map."""
        return DIVERGING if self.least < 0 else SEQUENTIAL


@dataclass(frozen=True)
class Panel:
    """One map: ``values`` is (height, width) of numbers, or (height, width, 3) uint8 of a picture, which has no scale."""

    title: str
    values: np.ndarray
    scale: Scale | None = None


@dataclass
class Sheet:
    """The panels of a figure: a row for each run and a column for each kind; of one kind, rows of as many as look well."""

    columns: list[list[Panel]] = field(default_factory=list)

    def grid(self) -> list[list[Panel]]:
        """Return the rows of panels."""
        if len(self.columns) > 1:
            return [list(row) for row in zip(*self.columns, strict=True)]
        [panels] = self.columns
        n = columns_of(len(panels))
        return [panels[i : i + n] for i in range(0, len(panels), n)]


def columns_of(n: int) -> int:
    """Return the panels in a row of ``n``: at most four."""
    return n if n <= 3 else 2 if n == 4 else 3 if n <= 6 else 4


def scale_of(label: str, maps: Sequence[np.ndarray], *, is_signed: bool = False) -> Scale:
    """Return one scale for some maps, from 0 to the most or as far on either side of 0.

    Where a few pixels have far more than all others, which would be dark, it ends at what ``_SHOWN`` of them do not exceed.
    """
    sizes = np.abs(np.concatenate([each.ravel() for each in maps]))
    most = float(sizes.max(initial=0)) or 1.0
    common = float(np.ceil(np.quantile(sizes, _SHOWN))) if sizes.size else most
    is_cut = 0 < common < most / _FAR
    end = common if is_cut else most
    if is_cut:
        label += f"; the end: {end:,.0f} to {most:,.0f}"
    return Scale(label, -end if is_signed else 0.0, end, is_cut)


def figures_of(values: np.ndarray) -> str:
    """Return what a panel's title says of its numbers."""
    total, most = int(values.sum()), int(values.max(initial=0))
    if values.min(initial=0) < 0:
        return f"sum {total:+,}, from {int(values.min()):,} to {most:,} per pixel".replace("-", "\N{MINUS SIGN}")
    return f"total {total:,}, at most {most:,} per pixel"


def enlargement(shapes: Sequence[tuple[int, ...]], n_panels: int) -> int:
    """Return how many dots of the figure a pixel takes on either side, unless somebody asks for another number."""
    side = max(max(shape[:2]) for shape in shapes)
    return max(1, (512 if n_panels == 1 else 384) // side)


def draw(sheet: Sheet, path: Path, enlarge: int) -> tuple[int, int]:
    """Draw the panels, ``enlarge`` dots to a pixel; return width and height of the figure in dots."""
    grid = sheet.grid()
    tall = [max(panel.values.shape[0] for panel in row) * enlarge for row in grid]
    n_across = max(map(len, grid))
    wide = [max([_NARROWEST, *(row[i].values.shape[1] * enlarge for row in grid if i < len(row))]) for i in range(n_across)]
    titles = [[_title(panel, wide[i]) for i, panel in enumerate(row)] for row in grid]
    heads = [_LINE * max(map(len, row)) + 6 for row in titles]
    bars = _bars(sheet, wide)
    width = sum(wide) + _GAP * (n_across + 1)
    n_bars = max(map(len, bars.values()), default=0)
    height = sum(tall) + sum(heads) + _GAP * (len(grid) + 1) + _BAR * n_bars
    with drawn(path, width / _DPI, height / _DPI, dpi=_DPI, layout=None) as figure:
        y = _GAP
        for row, lines, head, panel_height in zip(grid, titles, heads, tall, strict=True):
            x = _GAP
            for panel, text, cell in zip(row, lines, wide, strict=False):
                figure.text(x / width, 1 - (y + head - 5) / height, "\n".join(text), va="bottom", linespacing=1.15)
                _draw_panel(figure, panel, (x, y + head), enlarge, (width, height))
                x += cell + _GAP
            y += head + panel_height + _GAP
        for (x, across), scales in bars.items():
            for i, scale in enumerate(scales):
                _draw_bar(figure, scale, (x, y + i * _BAR + 4, across, 12), (width, height))
    return width, height


def _title(panel: Panel, across: int) -> list[str]:
    lines = textwrap.wrap(panel.title, int(across / _CHARACTER))
    return lines if panel.scale is None else [*lines, figures_of(panel.values)]


def _bars(sheet: Sheet, wide: Sequence[int]) -> Mapping[tuple[int, int], list[Scale]]:
    """Return the scales by place and width of their colour bars: below their column, or of one kind side by side."""
    found: dict[tuple[int, int], list[Scale]] = {}
    by_column = [list(dict.fromkeys(panel.scale for panel in column if panel.scale)) for column in sheet.columns]
    if len(sheet.columns) > 1:
        x = _GAP
        for cell, scales in zip(wide, by_column, strict=True):
            if scales:
                found[x, cell] = scales
            x += cell + _GAP
        return found
    [scales] = by_column
    total = sum(wide) + _GAP * (len(wide) - 1)
    across = min(total, 640)
    return {(_GAP, across): scales} if scales else {}


def _draw_panel(figure: Any, panel: Panel, at: tuple[int, int], enlarge: int, size: tuple[int, int]) -> None:
    """Draw a panel whose upper left corner is ``at`` dots from that of the figure, and a frame around it."""
    from matplotlib.patches import Rectangle

    (x, y), (width, height) = at, size
    across, down = panel.values.shape[1] * enlarge, panel.values.shape[0] * enlarge
    axes = figure.add_axes((x / width, 1 - (y + down) / height, across / width, down / height))
    axes.set_axis_off()
    options: dict[str, Any] = {}
    if panel.scale is not None:
        options = {"cmap": panel.scale.colours, "vmin": panel.scale.least, "vmax": panel.scale.most}
    axes.imshow(panel.values, interpolation="nearest", aspect="auto", **options)
    frame = Rectangle(
        ((x - 1) / width, 1 - (y + down + 1) / height), (across + 2) / width, (down + 2) / height, fill=False,
        edgecolor="0.55", linewidth=0.7, transform=figure.transFigure,
    )  # fmt: skip
    figure.add_artist(frame)


def _draw_bar(figure: Any, scale: Scale, place: tuple[float, float, float, float], size: tuple[int, int]) -> None:
    """Draw a colour bar with its numbers and its label below."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.ticker import FuncFormatter, MaxNLocator

    (x, y, across, down), (width, height) = place, size
    axes = figure.add_axes((x / width, 1 - (y + down) / height, across / width, down / height))
    colours = ScalarMappable(Normalize(scale.least, scale.most), scale.colours)
    extend = ("both" if scale.least < 0 else "max") if scale.is_cut else "neither"
    ticks = MaxNLocator(max(3, int(across / 80)), integer=True)
    bar = figure.colorbar(colours, cax=axes, orientation="horizontal", ticks=ticks, extend=extend)
    bar.ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}".replace("-", "\N{MINUS SIGN}")))
    bar.outline.set_linewidth(0.5)
    bar.ax.tick_params(length=3, pad=2)
    figure.text(
        x / width, 1 - (y + down + 20) / height, "\n".join(textwrap.wrap(scale.label, int(across / (_CHARACTER - 0.1)))[:2]),
        va="top", fontsize=8.5, linespacing=1.1,
    )  # fmt: skip
