"""Results of the clock as tables, and in a sentence."""

from collections.abc import Callable, Sequence
from typing import Any

from cachesim.clock.timing import Timing
from nptrace_base.tables import Table, number, percent
from traces.identity import labels

#: Columns without which a narrow terminal does, the first to go first.
_EXTRA = ("unit\n%", "idle\n%", "cycles\n/pixel", "port\n%", "MSHR\nfull %", "without", "hit\n%", "box\n%", "triangle\n%")
_FATE_EXTRA = (
    "demanded\nfirst", "resident", "joined", "no MSHR", "evicted\nearly", "redundant", "no time", "port\nbusy",
    "cycles\nwaited", "cycles\nsaved",
)  # fmt: skip

NOTES = (
    "speed-up = cycles without / with prefetching. The percentages are of the cycles of all rays in flight and add up to 100: "
    "a read's wait for the port and for an MSHR, its hit or its miss (a miss on a line that a prefetch has requested is "
    "late), the tests of boxes and triangles, the wait for an intersection unit, and idle.",
)
_FATE_NOTES = (
    "offered = no time + port busy + no MSHR + demanded first + issued: what the policy wanted, and why the port did not take "
    "it; a node in one line is one request, redundant (in the cache), joined (in flight) or filled; filled = timely + late + "
    "evicted early (and wanted again) + never used + resident.",
)


def keys_of(results: Sequence[Timing]) -> dict[str, list[str]]:
    """Return the columns that tell the results apart, as text: run, cache, layout, policy, and what varies of the clock."""
    names = labels(result.identity for result in results)
    keys: dict[str, list[str]] = {
        "run": [names[each.identity] for each in results],
        "cache": [str(each.config) for each in results],
        "layout": [each.layout for each in results],
    }
    numbers = [name for name in results[0].clock.to_dict() if name != "clock"]
    keys |= {name: [str(getattr(each.clock, name)) for each in results] for name in numbers}
    keys["prefetch"] = [each.prefetch for each in results]
    return {name: cells for name, cells in keys.items() if name == "prefetch" or len(set(cells)) > 1}


def _shared(results: Sequence[Timing]) -> str:
    """Return what all results have in common."""
    names = labels(result.identity for result in results)
    runs, caches = {names[each.identity] for each in results}, {str(each.config) for each in results}
    parts = [*(runs if len(runs) == 1 else ()), *(caches if len(caches) == 1 else ())]
    numbers = {
        name: values.pop()
        for name in results[0].clock.to_dict()
        if name != "clock" and len(values := {getattr(each.clock, name) for each in results}) == 1
    }
    return ", ".join([*parts, " ".join(f"{name}={value}" for name, value in numbers.items())])


def tables(results: Sequence[Timing]) -> tuple[list[Table], list[str]]:
    """Return the table of cycles and that of prefetches, and the notes below them."""
    keys = keys_of(results)
    prefixes = [[cells[i] for cells in keys.values()] for i in range(len(results))]
    columns: dict[str, Callable[[Timing], str]] = {
        "cycles\n/ray": lambda r: number(r.cycles / r.n_rays, 1),
        "without": lambda r: number(r.cycles_without / r.n_rays, 1),
        "speed-up": lambda r: number(r.speed_up, 3),
        "cycles\n/pixel": lambda r: number(r.cycles / r.n_pixels, 1),
    }
    shares = {
        "box\n%": "box test", "triangle\n%": "triangle test", "hit\n%": "hit", "miss\n%": "demand miss",
        "late\n%": "late prefetch", "port\n%": "port", "MSHR\nfull %": "MSHR full", "unit\n%": "unit busy", "idle\n%": "idle",
    }  # fmt: skip
    columns |= {title: _share(name) for title, name in shares.items()}
    rows = [[*prefix, *(make(each) for make in columns.values())] for prefix, each in zip(prefixes, results, strict=True)]
    made = [Table(_shared(results), [*keys, *columns], rows, n_left=len(keys), extra=_EXTRA)]
    notes = list(NOTES)
    if any(each.candidates["offered"] for each in results):
        fates: dict[str, Callable[[dict[str, Any]], Any]] = {
            "offered": lambda d: d["candidates_offered"], "no time": lambda d: d["candidates_no_time"],
            "port\nbusy": lambda d: d["candidates_port_busy"], "no MSHR": lambda d: d["candidates_mshr_full"],
            "demanded\nfirst": lambda d: d["candidates_demanded_first"], "issued": lambda d: d["candidates_issued"],
            "redundant": lambda d: d["redundant"], "joined": lambda d: d["joined"], "filled": lambda d: d["filled"],
            "timely": lambda d: d["timely"], "late": lambda d: d["late"], "evicted\nearly": lambda d: d["evicted_before_use"],
            "never\nused": lambda d: d["never_used"], "resident": lambda d: d["resident"],
            "cycles\nsaved": lambda d: d["cycles_saved"], "cycles\nwaited": lambda d: d["cycles_waited"],
        }  # fmt: skip
        dicts = [each.to_dict() for each in results]
        rows = [[*prefix, *(number(make(d)) for make in fates.values())] for prefix, d in zip(prefixes, dicts, strict=True)]
        made.append(Table("what became of the prefetches", [*keys, *fates], rows, n_left=len(keys), extra=_FATE_EXTRA))
        notes += _FATE_NOTES
    return made, [*notes, *verdict(results)]


def _share(name: str) -> Callable[[Timing], str]:
    return lambda r: percent(r.spent[name] / max(sum(r.spent.values()), 1), 1)


def verdict(results: Sequence[Timing]) -> list[str]:
    """Return what the speed-ups say, policy by policy, in a sentence each."""
    found = []
    for policy in dict.fromkeys(each.prefetch for each in results if each.prefetch != "none"):
        members = [each for each in results if each.prefetch == policy and each.speed_up]
        values = sorted(each.speed_up or 0.0 for each in members)
        if len(members) == 1:
            [r] = members
            change = f"{number(r.cycles / r.n_rays, 1)} cycles per ray instead of {number(r.cycles_without / r.n_rays, 1)}"
            found.append(f"{policy} {_pays(values)}: {change}, a speed-up of {values[0]:.3f}.")
        elif members:
            found.append(f"{policy} {_pays(values)}: speed-ups of {values[0]:.3f} to {values[-1]:.3f} in {len(values)} cases.")
    return found


def _pays(speed_ups: Sequence[float]) -> str:
    """Return what sorted speed-ups say; a change of less than half a thousandth is none."""
    if speed_ups[0] > 1.0005:
        return "pays"
    if speed_ups[-1] < 0.9995:
        return "costs time"
    if speed_ups[0] >= 0.9995:
        return "makes no difference" if speed_ups[-1] <= 1.0005 else "pays or makes no difference"
    return "pays in some cases and costs time in others"
