"""A comparison of policies as tables, and in sentences."""

from collections.abc import Sequence
from itertools import groupby

from cachesim.clock.compare import BOUND, REFERENCE, Compared
from cachesim.prefetch import parse_prefetch
from nptrace_base.tables import Table, number, percent
from traces.identity import labels

_EXTRA = ("pollution", "requests\n/read", "coverage\n%", "demand\nmiss %", "accuracy\n%")

NOTES = (
    "speed-up = cycles of none on the first cache / cycles; bound %: of the cycles that 'perfect' saves, for which every read "
    "hits. requests: of the unit, per line that a read looks up; accuracy = (timely + late) / filled; coverage = 1 - demand "
    "misses / those of none; traffic = bytes from memory / those of none; pollution: demand misses on lines that a prefetch "
    "evicted.",
)


def tables(rows: Sequence[Compared]) -> tuple[list[Table], list[str]]:
    """Return one table per run of policies and one of baselines, the fastest first, and the notes below them."""
    names = labels(row.timing.identity for row in rows)
    made, notes = [], list(NOTES)
    for identity, of_run in groupby(rows, key=lambda row: row.timing.identity):
        members = list(of_run)
        made.append(_policies(f"{names[identity]}, {members[0].reference.config}: policies", members))
        if any(row.group == "baseline" for row in members):
            made.append(_baselines(f"{names[identity]}: no unit needed: longer lines, alignment, node order", members))
        notes += verdict(names[identity], members)
    return made, notes


def _policies(title: str, rows: Sequence[Compared]) -> Table:
    header = ["prefetch", "cycles\n/ray", "speed-up", "bound\n%", "traffic", "accuracy\n%", "coverage\n%", "demand\nmiss %"]
    header += ["requests\n/read", "pollution"]
    lines = []
    for row in sorted((row for row in rows if row.group == "policy"), key=lambda row: row.timing.cycles):
        figures = row.to_dict()
        lines.append([
            row.timing.prefetch, number(figures["cycles_per_ray"], 1), number(row.speed_up, 3), percent(row.share_of_bound,
            1), number(row.traffic_ratio, 2), percent(figures["accuracy"], 1), percent(row.coverage, 1),
            percent(figures["demand_miss_rate"], 1), number(figures["requests_per_read"], 3),
            number(row.timing.lines["pollution"]),
        ])  # fmt: skip
    return Table(title, header, lines, extra=_EXTRA)


def _baselines(title: str, rows: Sequence[Compared]) -> Table:
    """Return a line per cache and layout without prefetches, with what a unit on top of it gives."""
    on_top = {(row.timing.config, row.timing.layout, row.timing.prefetch): row for row in rows}
    units = list(
        dict.fromkeys(row.timing.prefetch for row in rows if row.group == "baseline" and row.timing.prefetch != REFERENCE)
    )
    header = ["cache", "layout", "cycles\n/ray", "speed-up", "bound\n%", "traffic", "demand\nmiss %"]
    header += [f"and\n{unit.removesuffix(':unlimited')}" for unit in units]
    lines = []
    plain = [row for row in rows if row.group == "baseline" and row.timing.prefetch == REFERENCE]
    for row in sorted(plain, key=lambda row: row.timing.cycles):
        key = row.timing.config, row.timing.layout
        lines.append([
            str(row.timing.config), row.timing.layout, number(row.to_dict()["cycles_per_ray"], 1), number(row.speed_up, 3),
            percent(row.share_of_bound, 1), number(row.traffic_ratio, 2), percent(row.to_dict()["demand_miss_rate"], 1),
            *(number(on_top[*key, unit].speed_up, 3) for unit in units),
        ])  # fmt: skip
    return Table(title, header, lines, n_left=2, extra=_EXTRA)


def is_buildable(prefetch: str) -> bool:
    """Whether hardware can do it: the bound and policies that know what a first pass has read cannot be built."""
    parsed = parse_prefetch(prefetch)
    is_asked_ahead = parsed.options.get("live", parsed.kind != "stack")  # of the paper's unit the option alone looks ahead
    return not (parsed.policy.is_perfect or (parsed.policy.scout is not None and is_asked_ahead))


def verdict(name: str, rows: Sequence[Compared]) -> list[str]:
    """Return what the comparison says, in sentences."""
    real = [row for row in rows if row.group == "policy" and row.timing.prefetch not in (BOUND, REFERENCE)]
    found = []
    unit = next((row for row in real if row.timing.prefetch == "stack:unlimited"), None)
    buildable = [row for row in real if is_buildable(row.timing.prefetch)]
    if buildable:
        best = min(buildable, key=lambda row: row.timing.cycles)
        which, gain = best.timing.prefetch, f"{number(best.speed_up, 3)}x"
        text = f"{name}: " + (
            f"the best unit is {which} with {gain}" if _pays(best) else f"no unit pays: the best, {which}, gives {gain}"
        )
        found.append(f"{text}, the paper's gives {number(unit.speed_up, 3)}x." if unit and unit is not best else f"{text}.")
    plain = [row for row in rows if row.group == "baseline" and row.timing.prefetch == "none"]
    if plain:
        best = min(plain, key=lambda row: row.timing.cycles)
        on_top = [row for row in rows if (row.timing.config, row.timing.layout) == (best.timing.config, best.timing.layout)]
        gains = ", ".join(
            f"{row.timing.prefetch} {number(best.timing.cycles / row.timing.cycles, 3)}x" for row in on_top if row is not best
        )
        which = f"{best.timing.config} with the layout {best.timing.layout}"
        start = which if _pays(best) else f"no line or layout pays: the best, {which},"
        found.append(
            f"Without any unit, {start} gives {number(best.speed_up, 3)}x at {number(best.traffic_ratio, 2)} of the bytes; on "
            f"top of it: {gains}."
        )
    return found


def _pays(row: Compared) -> bool:
    return row.speed_up is not None and row.speed_up > 1
