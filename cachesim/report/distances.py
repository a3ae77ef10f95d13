"""Stack distances of runs as a picture: how far back accesses reach, and what that makes of caches of any size."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np

from cachesim.config import format_bytes
from cachesim.knees import knees_of, misses_by_size, sizes_of
from cachesim.report.cases import shared_text, texts_of
from cachesim.report.pictures import COLOURS, drawn
from cachesim.source import Source
from cachesim.stack_distance import stack_distances
from traces.identity import RunIdentity, labels


@dataclass(frozen=True)
class Distances:
    """The stack distances of the demand accesses of one run under one layout, line size and prefetch policy.

    Attributes
    ----------
    counts : (n,) int64
        Accesses at distance d, in lines; ``counts[0]``: the first ones to a line.
    """

    identity: RunIdentity
    line_bytes: int
    prefetch: str
    layout: str
    counts: np.ndarray

    @property
    def sizes(self) -> list[int]:
        """The sizes at which the curve is drawn, in lines."""
        return sizes_of(len(self.counts))

    @property
    def rates(self) -> list[float]:
        """The miss rate of a fully associative LRU cache of each of ``sizes``."""
        total = max(int(self.counts.sum()), 1)
        return [misses / total for misses in misses_by_size(self.counts, self.sizes)]

    @property
    def shares(self) -> list[float]:
        """The share of the accesses at distances above 2^(k-1), up to 2^k, for k = 0, 1 ..."""
        last = len(self.counts) - 1
        ends = [0, *(min(2**k, last) for k in range(max(last - 1, 1).bit_length() + 1))]
        total = max(int(self.counts.sum()), 1)
        return [int(self.counts[low + 1 : high + 1].sum()) / total for low, high in pairwise(ends)]

    def row(self) -> dict[str, Any]:
        """Return the facts of the case."""
        facts = {"line_bytes": self.line_bytes, "prefetch": self.prefetch, "layout": self.layout}
        return {**self.identity.to_dict(), **facts}


def distances_of(source: Source, line_bytes: int, prefetch: str) -> Distances:
    """Return the stack distances of a source's demand accesses, among its prefetches."""
    everything, _ = stack_distances(source, line_bytes, prefetch=prefetch)
    n = int(np.flatnonzero(everything.counts.sum(axis=1)).max(initial=0)) + 1
    return Distances(source.identity, line_bytes, prefetch, str(source.layout), everything.counts[:n, 0].copy())


def draw_distances(cases: Sequence[Distances], path: Path) -> None:
    """Draw, for each run, the histogram of its distances, and below it the miss rate over size with its knees marked."""
    by_run: dict[RunIdentity, list[Distances]] = {}
    for case in cases:
        by_run.setdefault(case.identity, []).append(case)
    names = labels(by_run)
    facts = [case.row() for case in cases]
    texts = dict(zip(map(id, cases), texts_of(facts, without=("run",), is_spelled=True), strict=True))
    n_across = min(len(by_run), 4 if len(by_run) > 6 else 3 if len(by_run) != 4 else 2)
    n_down = ceil(len(by_run) / n_across)
    wide = 5.4 if n_across == 1 else 3.5
    with drawn(path, wide * n_across + 0.2, 4.2 * n_down + 0.5) as figure:
        grid = figure.subplots(2 * n_down, n_across, sharex=True, sharey="row", squeeze=False)
        for i, (identity, members) in enumerate(by_run.items()):
            upper, lower = grid[2 * (i // n_across), i % n_across], grid[2 * (i // n_across) + 1, i % n_across]
            for place, case in enumerate(members):
                _draw_case(upper, lower, case, COLOURS[place % len(COLOURS)], texts[id(case)], is_alone=len(members) == 1)
            upper.set_title(names[identity] if len(by_run) > 1 else "")
            upper.tick_params(labelbottom=False)
            lower.tick_params(labelbottom=i + n_across >= len(by_run))
            if i % n_across == 0:
                upper.set_ylabel("demand accesses (%)")
                lower.set_ylabel("demand miss rate (%)")
        for i in range(len(by_run), n_down * n_across):
            grid[2 * (i // n_across), i % n_across].remove()
            grid[2 * (i // n_across) + 1, i % n_across].remove()
        _set_axes(grid[1, 0], cases)
        for axes in figure.axes:
            axes.grid(color="0.9", linewidth=0.6)
            axes.set_ylim(bottom=0)
        figure.supxlabel("stack distance above, size of a fully associative LRU cache below (bytes, K = 1024)", fontsize=9)
        figure.suptitle(shared_text(facts), fontsize=9)
        if len(texts) > len(by_run):
            handles, shown = grid[1, 0].get_legend_handles_labels()
            figure.legend(handles, shown, loc="outside right upper", frameon=False)


def _draw_case(upper: Any, lower: Any, case: Distances, colour: str, text: str, *, is_alone: bool) -> None:
    shares = [100 * share for share in case.shares]
    edges = [case.line_bytes * 2.0 ** (k - 0.5) for k in range(len(shares) + 1)]
    if is_alone:
        upper.stairs(shares, edges, fill=True, color=colour, alpha=0.85)
    else:
        upper.stairs(shares, edges, color=colour, linewidth=1.3)
    sizes = [case.line_bytes * size for size in case.sizes]
    rates = [100 * rate for rate in case.rates]
    lower.plot(sizes, rates, color=colour, linewidth=1.4, label=text or "all")
    for knee in knees_of(case.sizes, case.rates):
        size = case.line_bytes * knee
        rate = rates[case.sizes.index(knee)]
        lower.plot([size], [rate], marker="o", markersize=5, color=colour, markerfacecolor="white", zorder=3, clip_on=False)
        if is_alone:
            upper.axvline(size, color="0.35", linewidth=0.8, linestyle=":")
            lower.axvline(size, color="0.35", linewidth=0.8, linestyle=":")
            box = {"facecolor": "white", "edgecolor": "none", "pad": 0.5, "alpha": 0.85}
            text = f"{size_text(size)}: {rate:.1f} %"
            lower.annotate(text, (size, rate), (5, 6), textcoords="offset points", fontsize=8, bbox=box)


def size_text(n_bytes: int) -> str:
    """Return a size of bytes in K or M with three digits or fewer: knees are seldom powers of two."""
    for size, unit in ((1 << 20, "M"), (1 << 10, "K")):
        if n_bytes >= size:
            return f"{n_bytes / size:.3g}{unit}"
    return str(n_bytes)


def _set_axes(axes: Any, cases: Sequence[Distances]) -> None:
    """Set the axis of sizes that all panels share."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

    low = min(case.line_bytes for case in cases)
    high = max(case.line_bytes * case.sizes[-1] for case in cases)
    powers = [1 << k for k in range(48) if low <= 1 << k <= high]
    axes.set_xscale("log", base=2)
    axes.set_xlim(low / 1.5, high * 1.1)
    axes.xaxis.set_major_locator(FixedLocator(powers[:: ceil(len(powers) / 6)] or [low]))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda size, _: format_bytes(round(size))))
    axes.xaxis.set_minor_locator(NullLocator())
