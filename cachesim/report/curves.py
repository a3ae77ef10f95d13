"""Miss-rate curves: rows of ``npcache sweep`` or ``replay`` -> demand miss rate over cache size, a line for each case.

A panel has one scene and tree. All that varies besides the size is told apart by a channel (dash, colour, marker), and by
panels of its own where the channels do not suffice: no line joins points of two cases.
"""

from collections.abc import Mapping, Sequence
from math import ceil, prod
from pathlib import Path
from typing import Any, NamedTuple

from cachesim.config import format_bytes
from cachesim.report.cases import FACTS, Row, facts_of, identity_of, ways_of
from cachesim.report.pictures import COLOURS, SEQUENTIAL, check_plot, drawn
from cachesim.result import ratio
from traces.identity import RunIdentity, labels

#: What a line can be told by, and the values that each channel can show.
CHANNELS = {"dash": 4, "colour": 8, "marker": 8}
_DASHES = ("-", "--", ":", "-.")
_MARKERS = ("o", "s", "D", "^", "v", "P", "X", "*")
#: Most numbers of ways whose lines are legible; of more, the powers of two are drawn, or the first if there is none.
MOST_WAYS = 6
#: Most lines of a panel.
MOST_LINES = 16
#: What a line may vary in; the order of the rays or the run, where a scene and tree has several runs.
_DIMENSIONS = ("prefetch", "layout", "reads", "flush", "order", "run", "policy", "lines", "ways")
_ORDERED = ("ways", "lines")
#: What gets panels of its own where there are too many lines, the first to go first.
_CROWDING = ("ways", "lines", "policy")


class CurvePoint(NamedTuple):
    """One cache of one case: ``facts`` by ``_DIMENSIONS``, size in bytes, demand miss rate as a fraction."""

    subject: str
    facts: Mapping[str, str]
    size: int
    rate: float


class Line(NamedTuple):
    """One curve: its panel, its facts, and its points by rising size."""

    panel: tuple[str, ...]
    facts: Mapping[str, str]
    sizes: list[int]
    rates: list[float]


def subject_of(identity: RunIdentity) -> tuple[Any, ...]:
    """Return what the runs of one panel have in common: all but the order of their rays, and where they are."""
    return (
        identity.scene or identity.run, identity.stand_in, identity.tree, identity.builder, identity.width, identity.height,
        identity.camera, identity.light,
    )  # fmt: skip


def points_of(rows: Sequence[Row]) -> list[CurvePoint]:
    """Return the points of rows: of each cache with its prefetches, and of the same cache without them, once."""
    identities = list(dict.fromkeys(identity_of(row) for row in rows))
    names = labels(identities)
    subjects: dict[tuple[Any, ...], list[RunIdentity]] = {}
    for each in identities:
        subjects.setdefault(subject_of(each), []).append(each)
    titles = {
        each: names[members[0]] if len(members) == 1 else _title(members[0])
        for members in subjects.values()
        for each in members
    }
    if len(set(titles.values())) < len(subjects):  # two subjects of one title
        titles = {each: names[each] for each in identities}
    # The orders of the rays tell the runs of a subject apart, or else their names do.
    told_by_order = all(len({_order_of(each) for each in members}) == len(members) for members in subjects.values())
    found: dict[tuple[Any, ...], CurvePoint] = {}
    for row in rows:
        identity = identity_of(row)
        facts = {name: facts_of(row).get(name, "") for name in _DIMENSIONS if name in FACTS}
        facts |= {"order": _order_of(identity) if told_by_order else "", "run": "" if told_by_order else names[identity]}
        facts["ways"] = ways_of(row)
        both = [(facts, row["demand_miss_rate"])]
        if facts["prefetch"] != "none" and row.get("prefetch_accesses", 1):
            both.append((facts | {"prefetch": "none"}, ratio(row["demand_misses_without"], row["demand_accesses"])))
        for of, rate in both:
            if rate is not None:
                key = (identity, *(of[name] for name in _DIMENSIONS), row["size_bytes"])
                found[key] = CurvePoint(titles[identity], of, row["size_bytes"], rate)
    return list(found.values())


def _title(identity: RunIdentity) -> str:
    stand_in = " (stand-in)" if identity.stand_in else ""
    return f"{identity.scene}{stand_in} {identity.tree}"


def _order_of(identity: RunIdentity) -> str:
    seed = "" if identity.order_seed is None else f" seed {identity.order_seed}"
    batch = [f"batch {identity.batch}"] if identity.batch not in (None, 1) else []
    return ", ".join([f"{identity.order or ''}{seed}", *batch, *identity.knobs])


def drawn_ways(points: Sequence[CurvePoint]) -> list[CurvePoint]:
    """Return the points whose number of ways is drawn."""
    numbers = {int(text.removesuffix("-way")) for text in (point.facts["ways"] for point in points) if text != "full"}
    if len(numbers) <= MOST_WAYS:
        return list(points)
    kept = [n for n in numbers if n & (n - 1) == 0] or sorted(numbers)[:MOST_WAYS]
    return [point for point in points if point.facts["ways"] in {"full", *(f"{n}-way" for n in kept)}]


def channels_of(points: Sequence[CurvePoint]) -> dict[str, str]:
    """Return the channel of each dimension that varies; one that no channel can show has panels: ``panel``.

    Where a panel would have too many lines, each number of ways has panels of its own, then each line size, and so on.
    """
    values = {name: {point.facts[name] for point in points} for name in _DIMENSIONS}
    varying = [name for name in _DIMENSIONS if len(values[name]) > 1]
    for name in _CROWDING:
        if name in varying and len(varying) > 1 and prod(len(values[each]) for each in varying) > MOST_LINES:
            varying.remove(name)
    found, free = {name: "panel" for name in _DIMENSIONS if len(values[name]) > 1 and name not in varying}, dict(CHANNELS)
    if "prefetch" in varying and len(values["prefetch"]) <= free["dash"]:
        found["prefetch"] = "dash"
        del free["dash"]
    for name in sorted(varying, key=lambda name: -len(values[name])):
        if name in found:
            continue
        channel = next((each for each in ("colour", "marker", "dash") if free.get(each, 0) >= len(values[name])), "panel")
        found[name] = channel
        free.pop(channel, None)
    return found


def lines_of(points: Sequence[CurvePoint], channels: Mapping[str, str]) -> list[Line]:
    """Return the curves."""
    own = [name for name in _DIMENSIONS if channels.get(name) == "panel"]
    by_key: dict[tuple[Any, ...], list[CurvePoint]] = {}
    for point in points:
        by_key.setdefault((point.subject, *(point.facts[name] for name in _DIMENSIONS)), []).append(point)
    found = []
    for members in by_key.values():
        members.sort(key=lambda point: point.size)
        first = members[0]
        panel = (first.subject, *(first.facts[name] for name in own))
        found.append(Line(panel, first.facts, [each.size for each in members], [each.rate for each in members]))
    return found


def draw_curves(rows: Sequence[Row], path: Path) -> None:
    """Draw the curves of rows into a PNG, SVG or PDF file, by the ending of its name."""
    check_plot(path)
    points = drawn_ways(points_of(rows))
    channels = channels_of(points)
    lines = lines_of(points, channels)
    panels = list(dict.fromkeys(line.panel for line in lines)) or [("no demand accesses",)]
    n_across = min(len(panels), 4 if len(panels) > 6 else 3 if len(panels) != 4 else 2)
    n_down = ceil(len(panels) / n_across)
    wide, tall = (5.0, 3.6) if len(panels) == 1 else (2.9, 2.5)
    styles = {name: _styles(name, channel, points) for name, channel in channels.items() if channel != "panel"}
    if "marker" in channels.values():  # else markers go with the colours, for a print without any
        styles = {name: _without_marks(name, channels, of_value) for name, of_value in styles.items()}
    with drawn(path, wide * n_across + (1.7 if styles else 0.2), tall * n_down + 0.3) as figure:
        grid = figure.subplots(n_down, n_across, sharex=True, sharey=True, squeeze=False)
        for panel, axes in zip(panels, grid.flat, strict=False):
            own = [line for line in lines if line.panel == panel]
            for line in own:
                style = {"color": COLOURS[0], "marker": "o", "linestyle": "-"}
                for name, of_value in styles.items():
                    style |= of_value[line.facts[name]]
                axes.plot(line.sizes, [100 * rate for rate in line.rates], markersize=4, linewidth=1.3, **style)
            axes.set_title("\n".join([panel[0], ", ".join(panel[1:])]).strip())
            if len(points) <= 3:
                for line in own:
                    _annotate(axes, line)
        for axes in grid.flat[len(panels) :]:
            axes.remove()
        for i, axes in enumerate(grid.flat[: len(panels)]):
            axes.tick_params(labelbottom=i + n_across >= len(panels), labelleft=i % n_across == 0)
        _set_axes(grid.flat[0], points)
        for axes in grid.flat[: len(panels)]:
            axes.grid(color="0.9", linewidth=0.6)
        figure.supxlabel("cache size (bytes, K = 1024)", fontsize=9)
        figure.supylabel("demand misses / demand accesses (%)", fontsize=9)
        _draw_legend(figure, styles)


def _annotate(axes: Any, line: Line) -> None:
    for size, rate in zip(line.sizes, line.rates, strict=True):
        axes.annotate(f"{100 * rate:.2f} %", (size, 100 * rate), (7, 3), textcoords="offset points", fontsize=8)


def _styles(name: str, channel: str, points: Sequence[CurvePoint]) -> dict[str, dict[str, Any]]:
    """Return how each value of a dimension is drawn."""
    values = list(dict.fromkeys(point.facts[name] for point in points))
    if name in _ORDERED:
        values.sort(key=_number)
    if channel == "dash":
        values.sort(key=lambda value: value == "none")  # with prefetches: solid
        dashes = _DASHES if name != "prefetch" or "none" not in values else ("-", ":", "-.", "--")
        styles = dict(zip(values, dashes, strict=False))
        if name == "prefetch" and "none" in styles:
            styles["none"] = "--"
        hollow = {"markerfacecolor": "white"}
        return {value: {"linestyle": dash} | (hollow if dash == "--" else {}) for value, dash in styles.items()}
    marks = {value: {"marker": mark} for value, mark in zip(values, _MARKERS, strict=False)}
    if channel == "marker":
        return marks
    colours: Sequence[Any] = COLOURS
    if name in _ORDERED:
        from matplotlib import colormaps

        colours = [tuple(colormaps[SEQUENTIAL](0.88 - 0.88 * i / max(len(values) - 1, 1))) for i in range(len(values))]
    return {value: marks[value] | {"color": colour} for value, colour in zip(values, colours, strict=False)}


def _without_marks(name: str, channels: Mapping[str, str], of_value: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    if channels[name] != "colour":
        return of_value
    return {value: {"color": style["color"]} for value, style in of_value.items()}


def _number(text: str) -> float:
    """Return what ways and line sizes are sorted by."""
    if text == "full":
        return float("inf")
    digits = text.split()[0].removesuffix("-way")
    unit = {"K": 1024, "M": 1 << 20}.get(digits[-1:], 1)
    return float(digits.rstrip("KM")) * unit


def _set_axes(axes: Any, points: Sequence[CurvePoint]) -> None:
    """Set the scales that all panels share, with a number at every cache size or at those that fit, and at round rates."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

    sizes = sorted({point.size for point in points}) or [1]
    rates = [100 * point.rate for point in points] or [0.0, 1.0]
    ticks = sizes if len(sizes) <= 7 else [size for size in sizes if size & (size - 1) == 0] or sizes
    ticks = ticks[:: ceil(len(ticks) / 7)]
    axes.set_xscale("log", base=2)
    axes.set_xlim(sizes[0] / 1.4, sizes[-1] * 1.4)
    axes.xaxis.set_major_locator(FixedLocator(ticks))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda size, _: format_bytes(round(size))))
    axes.xaxis.set_minor_locator(NullLocator())
    low, high = min(rates), max(rates)
    if low > 0 and high / low > 4:
        axes.set_yscale("log")
        axes.set_ylim(low / 1.2, high * 1.2)
        axes.yaxis.set_major_locator(FixedLocator(round_numbers(low / 1.2, high * 1.2)))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda rate, _: f"{rate:g}"))
        axes.yaxis.set_minor_locator(NullLocator())
    else:
        axes.set_ylim(0, high * 1.1 or 1)


def round_numbers(low: float, high: float) -> list[float]:
    """Return round numbers for a logarithmic axis: 1, 2 and 5 times powers of ten, or of a long axis those powers alone."""
    for digits in ((1,), (1, 2, 5), (1, 1.5, 2, 3, 4, 5, 6, 7, 8, 9)):
        found = [float(f"{digit}e{power}") for power in range(-9, 10) for digit in digits]
        found = [value for value in found if low <= value <= high]
        if len(found) >= 4:
            return found
    return found


def _draw_legend(figure: Any, styles: Mapping[str, Mapping[str, dict[str, Any]]]) -> None:
    """Draw one legend: each dimension's name, and below it how each of its values looks."""
    from matplotlib.lines import Line2D

    keys = []
    for name, of_value in styles.items():
        keys.append(Line2D([], [], linestyle="none", label=f"{'replacement' if name == 'policy' else name}:"))
        for value, style in of_value.items():
            shown = {"color": "0.35", "marker": "o" if "markerfacecolor" in style else "", "linestyle": "-"} | style
            if "linestyle" not in style:
                shown["linestyle"] = "-" if "color" in style else "none"
            keys.append(Line2D([], [], markersize=4.5, linewidth=1.3, label=value or "trace", **shown))
    if keys:
        legend = figure.legend(handles=keys, loc="outside right upper", frameon=False, handlelength=2.4)
        for text in legend.get_texts():
            if text.get_text().endswith(":"):
                text.set_fontweight("bold")
