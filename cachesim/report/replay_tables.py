"""Results of ``npcache replay`` as tables, JSON, CSV, and DineroIV's statistics."""

import csv
import io
import json
from collections.abc import Sequence
from itertools import groupby

from cachesim.access import PREFETCH
from cachesim.report.dinero import dinero_block
from cachesim.result import Result
from nptrace_base.tables import Table, number, percent

_NOTES = (
    "demand miss rate = demand misses / demand accesses; paper miss rate = all misses / all accesses (demand + prefetch); "
    "KB = lines filled x line bytes.",
)
_3C_NOTE = (
    "compulsory + capacity + conflict = demand misses; conflict: the fully associative cache of the same size and policy "
    "hits; otherwise compulsory: first touch of the line; otherwise capacity."
)
_PREFETCH_NOTES = (
    "coverage = 1 - demand misses with / without prefetching; traffic ratio = KB with / without; accuracy = useful / filled; "
    "issued = redundant + filled, filled = useful + useless + resident; "
    "pollution = demand misses on lines that a prefetch evicted.",
)


def to_json(results: Sequence[Result]) -> str:
    """Return a JSON array with one object per result."""
    return json.dumps([result.to_dict() for result in results], indent=2) + "\n"


def to_csv(results: Sequence[Result]) -> str:
    """Return CSV with a header, one line per result; an empty field is a rate whose denominator is 0."""
    out = io.StringIO()
    writer = csv.DictWriter(out, list(results[0].to_dict()), lineterminator="\n")
    writer.writeheader()
    writer.writerows(result.to_dict() for result in results)
    return out.getvalue()


def to_dinero(results: Sequence[Result]) -> str:
    """Return DineroIV's statistics block of every result; with several, each after a line that names it."""
    if len(results) == 1:
        return dinero_block(results[0])
    return "".join(f"{_source(result)}, {result.config}\n{dinero_block(result)}" for result in results)


def tables(results: Sequence[Result]) -> tuple[list[Table], list[str]]:
    """Return the tables, grouped by source, and the notes below them."""
    made = []
    for _, group in groupby(results, key=_source):
        made += _tables_of_group(list(group))
    notes = list(_NOTES)
    if any(result.has_3c for result in results):
        notes.append(_3C_NOTE)
    if any(result.prefetch_accesses for result in results):
        notes += _PREFETCH_NOTES
    return made, notes


def _source(result: Result) -> str:
    layout = f", layout {result.layout}" if result.layout != "stored" else ""
    return f"{result.run}, prefetch {result.prefetch}{layout}"


def _tables_of_group(results: list[Result]) -> list[Table]:
    has_3c, has_prefetch = results[0].has_3c, any(result.prefetch_accesses for result in results)
    header = ["cache", "demand\naccesses", "demand\nmisses", "demand\nmiss rate %", "paper\nmiss rate %"]
    header += ["compulsory", "capacity", "conflict"] if has_3c else []
    header += ["KB from\nmemory"] + (["coverage\n%", "traffic\nratio"] if has_prefetch else [])
    rows = []
    for r in results:
        row = [str(r.config), number(r.demand_accesses), number(r.demand_misses)]
        row += [percent(r.demand_miss_rate), percent(r.paper_miss_rate)]
        if has_3c:
            row += [number(int(kind[:PREFETCH].sum())) for kind in (r.compulsory, r.capacity, r.conflict)]
        row.append(number(r.bytes_from_memory / 1024))
        rows.append(row + ([percent(r.coverage), number(r.traffic_ratio, 3)] if has_prefetch else []))
    made = [Table(_source(results[0]), header, rows)]
    if has_prefetch:
        header = ["cache", "issued", "redundant", "filled", "useful", "useless", "resident", "accuracy %", "pollution"]
        rows = [
            [str(r.config)]
            + [number(n) for n in (r.prefetch_accesses, r.prefetch_accesses - r.prefetch_misses, r.prefetch_misses)]
            + [number(n) for n in (r.useful, r.useless, r.resident)]
            + [percent(r.accuracy), number(r.pollution)]
            for r in results
        ]
        made.append(Table(f"prefetches of {results[0].run}", header, rows))
    return made
