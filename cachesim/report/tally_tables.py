"""The tally of the clock as rows and tables: reads and requests by tree level, ray type, place on the stack or leaf size."""

from collections.abc import Iterator, Sequence
from typing import Any

from cachesim.clock.parameters import NUMBERS
from cachesim.clock.timing import Timing
from cachesim.result import ratio
from nptrace_base.tables import Table, number, percent
from traces.identity import COLUMNS, labels

#: Of a result, what tells it from the others.
_KEYS = (*COLUMNS, "size_bytes", "ways", "line_bytes", "policy", "policy_seed", "prefetch", "layout", "clock", *NUMBERS)

#: Tallies whose classes belong to requests alone: a read has no place on the stack and no leaf.
_OF_REQUESTS = ("slot", "leaf")

_TITLES = {"level": "level", "ray": "ray", "slot": "place on\nthe stack", "leaf": "leaf\nsize"}
#: What rows call a tally by, where the clock calls it otherwise.
_NAMES = {"ray": "ray-type"}
_SHARED = "A request of a unit that all rays share counts for the ray in the first slot."
_NOTES = {
    "level": "level: of the node that is read or requested, from the root's 0; where a policy requests a line, of the node "
    "nearest the root on it.",
    "ray": f"ray: type of the ray that reads, or for which a node is requested. {_SHARED}",
    "slot": f"place on the stack: of the node when it is requested, from the top's 0. {_SHARED}",
    "leaf": f"leaf size: triangles of the leaf that the ray tests at the request, 0 if it tests none. {_SHARED}",
}
_FATES = (
    "requests = redundant + joined + filled; accuracy = (timely + late) / filled; evicted unused: evicted before a read, "
    "whether wanted again or not. Classes without any count are left out.",
)


def records(results: Sequence[Timing], by: str) -> list[dict[str, Any]]:
    """Return a record per result and class that has any count, with the columns ``by`` and ``class``.

    Where classes belong to requests alone, the figures of reads are None.
    """
    return [{name: figures[name] for name in _KEYS} | row for figures, row in _rows(results, by)]


def _rows(results: Sequence[Timing], by: str) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    for result in results:
        figures = result.to_dict()
        for row in classes(result, by):
            yield figures, row


def classes(result: Timing, by: str) -> list[dict[str, Any]]:
    """Return the figures of each class of a result that has any count."""
    found = []
    for i, counts in enumerate(result.tally):
        reads, missed = (None, None) if by in _OF_REQUESTS else (counts["reads"], counts["misses"])
        requests = counts["redundant"] + counts["joined"] + counts["filled"]
        if reads or requests:
            found.append({
                "by": _NAMES.get(by, by), "class": _name(i, len(result.tally), by),
                "demand_reads": reads, "demand_missed": missed,
                "demand_miss_rate": None if reads is None or missed is None else ratio(missed, reads),
                "requests": requests, "redundant": counts["redundant"], "joined": counts["joined"], "filled": counts["filled"],
                "timely": counts["timely"], "late": counts["late"], "evicted_unused": counts["evicted"],
                "accuracy": ratio(counts["timely"] + counts["late"], counts["filled"]),
            })  # fmt: skip
    return found


def _name(i: int, n: int, by: str) -> str:
    if by == "ray":
        return ("primary", "shadow")[i]
    rest = {"level": "no node", "slot": "not on it"}
    return rest[by] if by in rest and i == n - 1 else str(i)


def tables(results: Sequence[Timing], by: str) -> tuple[list[Table], list[str]]:
    """Return a table per result, and the notes below them."""
    names = labels(result.identity for result in results)
    of_reads = by not in _OF_REQUESTS
    header = [_TITLES[by], *(["reads", "miss\nrate %"] if of_reads else [])]
    header += ["requests", "redundant", "joined", "filled", "timely", "late", "evicted\nunused", "accuracy\n%"]
    made = []
    for result in results:
        lines = []
        for row in classes(result, by):
            reads = [number(row["demand_reads"]), percent(row["demand_miss_rate"], 1)] if of_reads else []
            counts = [
                number(row[name]) for name in ("requests", "redundant", "joined", "filled", "timely", "late", "evicted_unused")
            ]
            lines.append([row["class"], *reads, *counts, percent(row["accuracy"], 1)])
        parts = [names[result.identity], str(result.config), *([result.layout] if result.layout != "stored" else [])]
        title = ", ".join([*parts, result.clock.name, result.prefetch])
        made.append(Table(title, header, lines, extra=("joined", "evicted\nunused", "redundant", "late", "timely")))
    return made, [_NOTES[by], *_FATES]
