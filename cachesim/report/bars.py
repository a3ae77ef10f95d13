"""Rows of results as bars: what became of prefetches, where the accesses of a tree fall, and speed-ups."""

from collections.abc import Sequence
from math import ceil
from pathlib import Path
from typing import Any

from cachesim.report.cases import Row, facts_of, identity_of, shared_text, texts_of
from cachesim.report.pictures import COLOURS, drawn
from cachesim.result import ratio
from nptrace_base.errors import NptraceError
from traces.identity import labels

BLUE, ORANGE, GREEN, PURPLE, SKY, YELLOW = COLOURS[:6]

#: What became of requests, in a replay and with a clock: the columns of a row that add up to all, a text and a colour.
REPLAY_ACCOUNT = {
    "redundant": (("redundant",), "0.72"), "useful": (("useful",), BLUE), "useless": (("useless",), ORANGE),
    "resident": (("resident",), YELLOW),
}  # fmt: skip
CLOCK_ACCOUNT = {
    "redundant": (("redundant",), "0.72"), "joined": (("joined",), "0.5"), "timely": (("timely",), BLUE),
    "late": (("late",), SKY), "evicted unused": (("evicted_before_use", "never_used"), ORANGE),
    "resident": (("resident",), YELLOW),
}  # fmt: skip

_ORDER = ("redundant", "joined", "useful", "timely", "late", "useless", "evicted unused", "resident")

#: What rows are by that can be drawn.
LEVELS = ("level", "ray-type", "ray")

_BAR = 0.26  # inches of a bar and the gap below it


def account_of(row: Row) -> dict[str, int]:
    """Return what became of the requests of a row, by text; the numbers add up to all of them."""
    parts = CLOCK_ACCOUNT if "timely" in row else REPLAY_ACCOUNT
    return {text: sum(row[name] for name in names) for text, (names, _) in parts.items()}


def draw_account(rows: Sequence[Row], path: Path) -> None:
    """Draw what became of the prefetches of each case, as shares of its requests."""
    shown = [row for row in rows if sum(account_of(row).values())]
    if not shown:
        raise NptraceError("the results have no prefetch requests; choose a prefetch policy with --prefetch")
    texts = texts_of(shown)
    parts = {**REPLAY_ACCOUNT, **CLOCK_ACCOUNT}
    names = [name for name in _ORDER if any(account_of(row).get(name) for row in shown)]
    with drawn(path, 7.2, 1.25 + _BAR * len(shown)) as figure:
        axes = figure.subplots()
        before = [0.0] * len(shown)
        for name in names:
            shares = [100 * account_of(row).get(name, 0) / sum(account_of(row).values()) for row in shown]
            colour = parts[name][1]
            axes.barh(range(len(shown)), shares, 0.8, before, color=colour, edgecolor="white", linewidth=0.5, label=name)
            for i, share in enumerate(shares):
                if share >= 6:
                    dark = colour in (BLUE, "0.5")
                    place = before[i] + share / 2, i
                    axes.text(
                        *place, f"{share:.0f} %", ha="center", va="center", fontsize=7, color="white" if dark else "black"
                    )
            before = [old + share for old, share in zip(before, shares, strict=True)]
        for i, row in enumerate(shown):
            axes.text(101, i, f"{sum(account_of(row).values()):,}", va="center", fontsize=8)
        axes.text(101, -0.75, "requests", va="bottom", fontsize=8)
        axes.set_yticks(range(len(shown)), texts)
        axes.set(xlim=(0, 100), ylim=(len(shown) - 0.5, -0.6), xlabel="share of the prefetch requests (%)")
        axes.set_title(f"What became of the prefetches\n{shared_text(shown)}", loc="left", pad=12)
        figure.legend(loc="outside lower center", ncols=len(names), frameon=False)


def draw_levels(rows: Sequence[Row], path: Path) -> None:
    """Draw the accesses and misses of each level, or type of ray, and their miss rate below, a panel for each case."""
    shown = [row for row in rows if row["by"] in LEVELS and row.get("class") != "no node"]  # which nothing reads
    if not shown:
        raise NptraceError(
            f"results by {rows[0]['by']} cannot be drawn as bars; write them by level or ray-type, or see nptrace view for "
            "pixels"
        )
    by_case: dict[str, list[Row]] = {}
    is_mixed = len({row["by"] for row in shown}) > 1
    for text, row in zip(texts_of(shown, is_spelled=True), shown, strict=True):
        by_case.setdefault(f"{text}, by {row['by']}" if is_mixed else text, []).append(row)
    most = 100 * max(_rate(row) for row in shown) or 1.0
    n_across = min(len(by_case), 4 if len(by_case) > 6 else 3)
    n_down = ceil(len(by_case) / n_across)
    wide = 5.5 if n_across == 1 else 3.4
    with drawn(path, wide * n_across + 0.3, 3.6 * n_down + 0.4) as figure:
        grid = figure.subplots(
            2 * n_down, n_across, sharex="col" if n_down == 1 else "all", sharey="row", squeeze=False,
            gridspec_kw={"height_ratios": [2, 1] * n_down},
        )  # fmt: skip
        for i, (text, members) in enumerate(by_case.items()):
            upper, lower = grid[2 * (i // n_across), i % n_across], grid[2 * (i // n_across) + 1, i % n_across]
            _draw_case(upper, lower, members)
            upper.set_title(text or shared_text(shown))
            upper.tick_params(labelbottom=False)
            upper.set_ylim(0, 1.05 * max(row[columns_of(row)[0]] or 0 for row in shown))
            lower.set_ylim(0, 1.2 * most)
            if members[0]["by"] == "level" and i + n_across >= len(by_case):
                lower.set_xlabel("level of the node (root: 0)")
            if i % n_across == 0:
                upper.set_ylabel("demand accesses")
                lower.set_ylabel("miss rate (%)")
        for i in range(len(by_case), n_down * n_across):
            grid[2 * (i // n_across), i % n_across].remove()
            grid[2 * (i // n_across) + 1, i % n_across].remove()
        handles, names = grid[0, 0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside lower center", ncols=2, frameon=False)
        if len(by_case) > 1:
            figure.suptitle(shared_text(shown), fontsize=9)


def columns_of(row: Row) -> tuple[str, str]:
    """Return the columns of a row by level or ray type with its accesses and its misses."""
    return ("demand_accesses", "demand_misses") if "demand_accesses" in row else ("demand_reads", "demand_missed")


def _rate(row: Row) -> float:
    reads, missed = columns_of(row)
    return ratio(row[missed], row[reads]) or 0.0


def _draw_case(upper: Any, lower: Any, members: Sequence[Row]) -> None:
    """Draw one case: accesses with their misses above, the miss rate below."""
    from matplotlib.ticker import FuncFormatter, MaxNLocator

    by = members[0]["by"]
    reads, missed = columns_of(members[0])
    names = [_class_of(row) for row in members]
    places = [int(name) for name in names] if by == "level" else list(range(len(names)))
    upper.bar(places, [row[reads] for row in members], 0.85, color=SKY, label="demand accesses")
    upper.bar(places, [row[missed] for row in members], 0.85, color=BLUE, label="of them demand misses")
    upper.yaxis.set_major_formatter(FuncFormatter(short_number))
    upper.yaxis.set_major_locator(MaxNLocator(5))
    rates = [100 * _rate(row) for row in members]
    lower.bar(places, rates, 0.85, color="0.45")
    if by == "level":
        lower.xaxis.set_major_locator(MaxNLocator(8, integer=True))
    else:
        lower.set_xticks(places, names)
        for place, rate in zip(places, rates, strict=True):
            lower.text(place, rate, f"{rate:.1f}", ha="center", va="bottom", fontsize=8)


def _class_of(row: Row) -> str:
    for name in ("class", "level", "ray_type"):
        if row.get(name) is not None:
            return str(row[name])
    raise NptraceError(f"a row by {row['by']} does not say of what it is; write the results again")


def short_number(value: float, _: object = None) -> str:
    """Return a number for an axis: 250k, 1.5M."""
    for size, unit in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if abs(value) >= size:
            return f"{value / size:g}{unit}"
    return f"{value:g}"


def draw_speed_ups(rows: Sequence[Row], path: Path) -> None:
    """Draw the speed-ups of policies, machines and caches as bars, a panel for each run, the fastest last.

    The policy ``perfect``, for which every read hits, is named in the title if all bars share it: its bar would dwarf the
    others.
    """
    identities = list(dict.fromkeys(identity_of(row) for row in rows))
    names = labels(identities)
    texts = dict(zip(map(id, rows), texts_of(rows, without=("run", "group")), strict=True))
    of_run = {each: [row for row in rows if identity_of(row) == each] for each in identities}
    real = {each: [row for row in of_run[each] if row["prefetch"] != "perfect" and row["speed_up"]] for each in identities}
    shown = {each: sorted(members, key=lambda row: row["speed_up"]) for each, members in real.items()}
    n_bars = max(map(len, shown.values()), default=0)
    n_across = min(len(identities), 4)
    n_down = ceil(len(identities) / n_across)
    with drawn(path, 4.9 * n_across, n_down * (0.9 + 0.19 * n_bars) + 0.3) as figure:
        grid = figure.subplots(n_down, n_across, squeeze=False)
        for axes, (identity, members) in zip(grid.flat, shown.items(), strict=False):
            values = [row["speed_up"] for row in members]
            bars = axes.barh(range(len(members)), values, color=[_colour(row) for row in members])
            box = {"facecolor": "white", "edgecolor": "none", "pad": 0.3, "alpha": 0.8}
            axes.bar_label(bars, fmt="%.2f", padding=2, fontsize=7, bbox=box)
            axes.set_yticks(range(len(members)), [texts[id(row)] or row["prefetch"] for row in members], fontsize=7)
            axes.axvline(1, color="black", linewidth=0.8)
            bounds = [row["speed_up"] for row in of_run[identity] if row["prefetch"] == "perfect" and row["speed_up"]]
            bound = f" (bound {max(bounds):.2f})" if bounds and _is_one_case(of_run[identity]) else ""
            axes.set_title(f"{names[identity]}{bound}")
            axes.margins(x=0.12, y=0.01)
        for axes in grid.flat[len(identities) :]:
            axes.remove()
        note = "; blue: policies, yellow: layouts and line sizes" if any(row.get("group") for row in rows) else ""
        figure.supxlabel(f"speed-up over no prefetching{note}", fontsize=9)


def _is_one_case(rows: Sequence[Row]) -> bool:
    """Whether all rows share a bound: they are of one cache on one machine, whatever the policy; baselines are none's own."""
    of_cases = [facts_of(row) | {"prefetch": "", "group": ""} for row in rows if row.get("group") != "baseline"]
    return all(each == of_cases[0] for each in of_cases)


def _colour(row: Row) -> str:
    return YELLOW if row.get("group") == "baseline" else BLUE
