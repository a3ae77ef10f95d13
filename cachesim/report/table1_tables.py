"""Table I, printed: rows of ``cachesim.report.table1`` -> tables (ours, the paper's, the difference) and the notes below."""

from collections.abc import Sequence
from itertools import pairwise

from cachesim.clock.parameters import Clock
from cachesim.clock.timing import Timing
from cachesim.config import format_bytes
from cachesim.report.cases import STAND_IN_NOTE
from cachesim.report.replay_tables import direction
from cachesim.report.table1 import NAMES, PAPER_N, TREES, Equation, Table1Row
from nptrace_base.tables import Table, number, span
from traces.identity import RunIdentity, labels

_HEADER = (
    ["Scene", "Cache", ""]
    + [f"{group}\n{column}" for group in ("miss", "KB", "ACPR") for column in ("A", "B", "B/A")]
    + ["demand\nA", "demand\nB", "demand\nB/A", "cover-\nage", "accu-\nracy"]
)
#: Columns without which a narrow terminal does, the first to go first.
_EXTRA = ("accu-\nracy", "cover-\nage", "ACPR\nA", "ACPR\nB", "KB\nA", "KB\nB")
_DECIMALS = {"miss_a": 1, "miss_b": 1, "kb_a": 0, "kb_b": 0}
_DEMAND = ("demand_miss_a", "demand_miss_b", "demand_ratio", "coverage", "accuracy")

#: What ACPR is, below every table that has it.
ACPR_NOTE = (
    "ACPR: average cycles per ray for node accesses, the paper's equation 1: N ((1 - R) 1 + R 100) with its miss rate R and "
    f"its N: {PAPER_N['kdtree']:.2f} (kd-tree), {PAPER_N['bvh']:.2f} (BVH)."
)

NOTES = (
    "A: without, B: with prefetching; rates and B/A in %. miss, KB and ACPR are the paper's metric, which counts "
    "prefetches as accesses: miss = all misses / all accesses (demand + prefetch), KB = all lines filled. "
    "diff = ours - paper.",
    "The demand metric leaves prefetches out: demand = demand misses / demand accesses; coverage = 1 - demand misses B / A; "
    "accuracy = useful / filled prefetches.",
    ACPR_NOTE,
)  # fmt: skip


def tables(rows: Sequence[Table1Row]) -> list[Table]:
    """Return one table per tree, and a table of the ACPR with the measured N."""
    made = [_tree_table(title, [row for row in rows if row.tree == tree]) for tree, title in TREES.items()]
    times = [(row, row.timing) for row in rows if row.timing is not None]
    return [table for table in made if table.rows] + [_acpr_table(rows)] + ([_time_table(times)] if times else [])


def notes(rows: Sequence[Table1Row], of_runs: Sequence[str] = ()) -> list[str]:
    """Return the notes below the tables; ``of_runs`` are those on which runs they are of."""
    stand_ins = [STAND_IN_NOTE] if any(row.is_stand_in for row in rows) else []
    return [*NOTES[:-1], _acpr_note(rows), *stand_ins, *of_runs, *_asked(rows), *_untimed(rows), *verdict(rows)]


def _untimed(rows: Sequence[Table1Row]) -> list[str]:
    """Return which runs have no cycles, and why."""
    packets = list(dict.fromkeys(row.identity for row in rows if row.timing is None and (row.identity.packet or 1) > 1))
    return [untimed_note(packets)] if packets else []


def untimed_note(runs: Sequence[RunIdentity]) -> str:
    """Return why runs of packets have no cycles."""
    names = ", ".join(labels(runs).values())
    return f"No cycles of {names}: rays of a packet read nodes together, and on the clock every ray reads for itself."


def _asked(rows: Sequence[Table1Row]) -> list[str]:
    """Return what was asked for and is not as usual: in one sentence if it is the same for all trees, or tree by tree."""
    settings = {title: _settings([row for row in rows if row.tree == tree]) for tree, title in TREES.items()}
    settings = {title: of for title, of in settings.items() if of}
    beside = "the paper's, whose caches are LRU, are what they are."
    if len(set(settings.values())) == 1:
        of = next(iter(settings.values()))
        return [f"Ours with {of}; {beside}"] if of != _USUAL else []
    return [f"{title}: ours with {of}; {beside}" for title, of in settings.items() if of != _USUAL]


_USUAL = "lru replacement and the layout stored"


def _settings(rows: Sequence[Table1Row]) -> str:
    texts = [
        f"{row.policy} replacement and the layout {row.layout}" + (f", reads {row.reads}" if row.reads != "own" else "")
        for row in rows
    ]  # fmt: skip
    return ", or ".join(dict.fromkeys(texts))


def _acpr_note(rows: Sequence[Table1Row]) -> str:
    """Return what ACPR is with the equation of the rows."""
    equation = rows[0].equation
    if equation == Equation():
        return ACPR_NOTE
    by_tree = [f"{equation.n[tree]:.2f} ({title})" if tree in equation.n else f"the measured one ({title})"
               for tree, title in TREES.items()]  # fmt: skip
    return (
        f"ACPR: average cycles per ray for node accesses, N ((1 - R) {equation.hit} + R {equation.miss}) with the paper's "
        f"miss rate R and N {', '.join(by_tree)}; the paper's has its own N, 1 and 100."
    )


def _tree_table(title: str, rows: Sequence[Table1Row]) -> Table:
    lines: list[list[str]] = []
    sections = set()
    for row in rows:
        is_first = not lines or len(lines) - 1 in sections
        cache = f"{format_bytes(row.size_bytes)}({row.ways})"
        scene = row.scene.title() if is_first else ""
        mark = "(stand-in)" if is_first and row.is_stand_in else ""
        ours, paper, diff = [scene, cache, "ours"], [mark, "", "paper"], ["", "", "diff"]
        for name in NAMES:
            decimals, mine = _DECIMALS.get(name, 1), row.ours[name]
            ours.append(number(mine, decimals, group=""))
            paper.append(number(row.paper[name], 0 if name == "acpr_ratio" else decimals, group=""))
            diff.append(number(None if mine is None else mine - row.paper[name], decimals, sign=True, group=""))
        ours += [number(row.ours[name], 1 if name in ("demand_ratio", "accuracy") else 2) for name in _DEMAND]
        lines += [ours, paper + [""] * len(_DEMAND), diff + [""] * len(_DEMAND)]
        if row.size_bytes == rows[-1].size_bytes and row.ways == rows[-1].ways:
            sections.add(len(lines) - 1)
    return Table(title, _HEADER, lines, n_left=3, sections=sections, extra=_EXTRA)


def _acpr_table(rows: Sequence[Table1Row]) -> Table:
    caches = sorted({(row.size_bytes, row.ways) for row in rows})
    header = ["Tree", "Scene", "N"] + [f"{format_bytes(size)}({ways})\n{ab}" for size, ways in caches for ab in "AB"]
    groups: dict[tuple[str, str], dict[tuple[int, int], Table1Row]] = {}
    for row in rows:
        groups.setdefault((row.tree, row.scene_title), {})[row.size_bytes, row.ways] = row
    lines = []
    for (tree, scene), by_cache in groups.items():
        line = [TREES[tree], scene[:1].upper() + scene[1:], number(next(iter(by_cache.values())).nodes_per_ray, 2)]
        for cache in caches:
            line += [number(by_cache[cache].measured_acpr(name), 1) for name in ("acpr_a", "acpr_b")]
        lines.append(line)
    return Table("ACPR with the measured N (demand accesses per ray)", header, lines, n_left=2)


def _time_table(rows: Sequence[tuple[Table1Row, Timing]]) -> Table:
    """Return what the printed reductions are worth in time."""
    header = ["Tree", "Scene", "Cache", "paper's\nmiss B/A", "ours", "demand\nB/A"]
    header += ["cycles/ray\nA", "cycles/ray\nB", "speed-up"]
    lines = [
        [
            TREES[row.tree], row.scene_title[:1].upper() + row.scene_title[1:], f"{format_bytes(row.size_bytes)}({row.ways})",
            number(row.paper["miss_ratio"], 1), number(row.ours["miss_ratio"], 1), number(row.ours["demand_ratio"], 1),
            number(timing.cycles_without / timing.n_rays, 1), number(timing.cycles / timing.n_rays, 1),
            number(timing.speed_up, 3),
        ]
        for row, timing in rows
    ]  # fmt: skip
    pairs = [(row.tree, row.scene) for row, _ in rows]
    sections = {i for i, (pair, after) in enumerate(pairwise(pairs)) if pair != after}
    title = f"In time: the clock's machine 'paper' ({_numbers(rows[0][1].clock)})"
    return Table(title, header, lines, n_left=3, sections=sections, extra=("cycles/ray\nA", "cycles/ray\nB", "ours"))


def _numbers(clock: Clock) -> str:
    return ", ".join(
        f"{name} {value}" for name, value in clock.to_dict().items() if name in ("hit", "miss", "box", "triangle", "rays")
    )


def verdict(rows: Sequence[Table1Row]) -> list[str]:
    """Return, for each tree, what the numbers mean, in a sentence made from them."""
    found = []
    for tree, title in TREES.items():
        members = [row for row in rows if row.tree == tree]
        if not members:
            continue
        paper, demand = (_changes([row.ours[name] for row in members]) for name in ("miss_ratio", "demand_ratio"))
        if not any(row.ours["prefetches"] for row in members):
            found.append(f"{title}: nothing is prefetched, so that A and B are the same.")
        elif not paper or not demand:
            found.append(f"{title}: nothing misses without prefetching, so that B/A has no value.")
        else:
            times = [100 / row.timing.speed_up - 100 for row in members if row.timing and row.timing.speed_up]
            found.append(
                f"{title}: the paper's miss rate changes by {span(paper, sign=True)} %, {_WHY[direction(paper)]}; demand "
                f"misses change by {span(demand, sign=True)} %"
                + (f"; the time of a ray by {span(times, sign=True)} %." if times else ".")
            )
    return found


#: Why the paper's miss rate changes: B/A is that of the lines filled, over that of the accesses.
_WHY = {
    "down": "because its prefetches count as accesses",
    "up": "although its prefetches count as accesses, since the lines filled rise by more",
    "both": "since its prefetches count as accesses, and the lines filled rise by less or by more",
}


def _changes(ratios: Sequence[float | None]) -> list[float]:
    return [value - 100 for value in ratios if value is not None]
