"""Results of ``npcache replay`` as tables and as DineroIV's statistics."""

from collections.abc import Mapping, Sequence
from itertools import groupby

from cachesim.access import PREFETCH
from cachesim.report.dinero import dinero_block
from cachesim.result import Result
from nptrace_base.tables import Table, number, percent, span
from traces.identity import RunIdentity, labels

#: What the rates of a replay and of a sweep are.
RATES = (
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


#: Columns without which a narrow terminal does, the first to go first.
_EXTRA = ("traffic\nratio", "KB from\nmemory", "coverage\n%", "demand\naccesses", "compulsory")
_PREFETCH_EXTRA = ("resident", "redundant", "pollution", "useless")


def to_dinero(results: Sequence[Result]) -> str:
    """Return DineroIV's statistics block of every result; with several, each after a line that names it."""
    if len(results) == 1:
        return dinero_block(results[0])
    names = labels(result.identity for result in results)
    return "".join(f"{_source(result, names)}, {result.config}\n{dinero_block(result)}" for result in results)


def tables(results: Sequence[Result]) -> tuple[list[Table], list[str]]:
    """Return the tables, grouped by source, and the notes below them."""
    made = []
    names = labels(result.identity for result in results)
    for title, group in groupby(results, key=lambda result: _source(result, names)):
        made += _tables_of_group(title, names, list(group))
    notes = list(RATES)
    if any(result.has_3c for result in results):
        notes.append(_3C_NOTE)
    if any(result.prefetch_accesses for result in results):
        notes += _PREFETCH_NOTES
    return made, [*notes, *verdict(results)]


def verdict(results: Sequence[Result]) -> list[str]:
    """Return what the numbers say of each prefetch policy, in a sentence made from them.

    The paper's miss rate of B is, exactly, that of A x bytes from memory B/A / (1 + p): p prefetches per demand access count
    as accesses, and lower the rate even where no byte less is read.
    """
    found = []
    for policy in dict.fromkeys(each.prefetch for each in results):
        of_policy = (each for each in results if each.prefetch == policy)
        members = [each for each in of_policy if each.prefetch_accesses and each.demand_misses_without]
        if not members:
            continue
        p = [each.prefetch_accesses / each.demand_accesses for each in members]
        traffic = [each.bytes_from_memory / (each.demand_misses_without * each.config.line_bytes) for each in members]
        demand = _changes([each.demand_misses / each.demand_misses_without for each in members])
        paper = [ratio / (1 + extra) for ratio, extra in zip(traffic, p, strict=True)]
        alone = span([100 / (1 + extra) for extra in p])
        because, lower, end = _WHY[direction([ratio - 1 for ratio in paper])]
        found.append(
            f"{policy}, with prefetching (B) against without (A): demand misses change by {demand} %, bytes from memory by "
            f"{_changes(traffic)} %. The paper's miss rate changes by {_changes(paper)} %, {because} p = {span(p, 3)} "
            f"prefetches per demand access count as accesses{lower} to 1 / (1 + p) of A, {alone} %{end}."
        )
    return found


#: What stands before p, between it and 1 / (1 + p), and after that, by where the paper's miss rate goes.
_WHY = {
    "down": ("because", ": they alone lower it", ""),
    "up": ("although", ", which alone lowers it", ": the lines filled rise by more"),
    "both": ("since", ", which alone lowers it", ", and the lines filled rise by less or by more"),
}


def direction(changes: Sequence[float]) -> str:
    """Return where all of some changes go: ``"down"``, ``"up"``, or ``"both"`` if they do not agree or one is none."""
    return "down" if max(changes) < 0 else "up" if min(changes) > 0 else "both"


def _changes(ratios: Sequence[float]) -> str:
    return span([100 * (ratio - 1) for ratio in ratios], sign=True)


def _source(result: Result, names: Mapping[RunIdentity, str]) -> str:
    layout = f", layout {result.layout}" if result.layout != "stored" else ""
    reads = f", reads {result.reads}" if result.reads != "own" else ""
    flush = f", flush {result.flush}" if result.flush != "never" else ""
    return f"{names[result.identity]}, prefetch {result.prefetch}{layout}{reads}{flush}"


def _tables_of_group(title: str, names: Mapping[RunIdentity, str], results: list[Result]) -> list[Table]:
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
    made = [Table(title, header, rows, extra=_EXTRA)]
    if has_prefetch:
        header = ["cache", "issued", "redundant", "filled", "useful", "useless", "resident", "accuracy %", "pollution"]
        rows = [
            [str(r.config)]
            + [number(n) for n in (r.prefetch_accesses, r.prefetch_accesses - r.prefetch_misses, r.prefetch_misses)]
            + [number(n) for n in (r.useful, r.useless, r.resident)]
            + [percent(r.accuracy), number(r.pollution)]
            for r in results
        ]
        made.append(Table(f"prefetches of {title}", header, rows, extra=_PREFETCH_EXTRA))
    return made
