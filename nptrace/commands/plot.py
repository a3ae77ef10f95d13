"""npcache plot: results, or runs, as a picture."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from cachesim.config import parse_bytes
from nptrace.groups import BadInput, Command
from nptrace.ignored import refuse
from nptrace.options import SIZE_HELP, WAYS_HELP, Choice, ListOf, joined, merged, threads_option
from nptrace.output import output_option
from nptrace.progress import Progress, done
from nptrace.sources import (
    LAYOUT_HELP,
    PREFETCH_HELP,
    PlaceOf,
    chosen_sources,
    is_trace,
    layout_of,
    policy_of,
    untimed_policies,
)
from nptrace_base.errors import NptraceError
from nptrace_base.places import Place, Remote

#: What can be drawn, and of what.
KINDS = {
    "curves": "demand miss rate over cache size",
    "distances": "stack distances, and the knees of the curve that they make",
    "account": "what became of the prefetches",
    "levels": "accesses and misses by tree level or ray type",
    "speed-ups": "cycles without prefetching / with",
    "table1": "Table I, ours beside the paper's",
}
#: What is drawn of runs themselves; the others need results.
OF_RUNS = ("distances", "curves", "account", "levels")
#: Sizes and ways of the caches of a run, by kind, where none are given.
_USUAL = {"curves": ("4K..64K", "1,2,4,8"), "account": ("8K,16K", "1,2"), "levels": ("8K", "1"), "distances": ("8K", "1")}


def _list(name: str, *others: str, item: Any, metavar: str, help: str, callback: Callable[..., Any] = merged) -> Any:
    return click.option(
        name, *others, type=ListOf(metavar, item), metavar=metavar, multiple=True, callback=callback,
        help=f"Of runs: {help[0].lower()}{help[1:]}",
    )  # fmt: skip


def _sizes(text: str) -> list[int]:
    from cachesim.grid import parse_sizes

    return parse_sizes(text)


def _ways(text: str) -> tuple[str, ...]:
    from cachesim.grid import parse_ways_range

    return parse_ways_range(text)


@click.command(cls=Command, lists={"Prefetch policies": untimed_policies})
@click.argument("sources", metavar="RESULTS|RUN...", nargs=-1, type=PlaceOf())
@click.option(
    "--kind", type=Choice(list(KINDS)),
    help=f"What to draw: {'; '.join(f'{name}: {text}' for name, text in KINDS.items())}. Else what the results say.",
)  # fmt: skip
@_list("--size", item=_sizes, metavar="SIZES", help=f"{SIZE_HELP}.", callback=joined)
@_list("--ways", "--assoc", item=_ways, metavar="WAYS", help=f"{WAYS_HELP}.")
@_list("--line", item=parse_bytes, metavar="SIZES", help="Line sizes in bytes.")
@_list("--prefetch", item=policy_of(), metavar="POLICIES", help=PREFETCH_HELP)
@_list("--layout", item=layout_of, metavar="LAYOUTS", help=LAYOUT_HELP)
@threads_option()
@output_option(
    "-o", "--output", "path", binary="a picture", help="The picture, which is required: .png, .svg or .pdf; - is stdout."
)
def plot(
    sources: tuple[Place, ...], kind: str | None, size: list[int], ways: list[tuple[str, ...]], line: list[int],
    prefetch: list[str], layout: list[str], threads: int, path: Path | None,
) -> None:  # fmt: skip
    """Draw results that npcache replay, sweep, time, compare and table1 wrote with -o, or runs.

    All that varies has its own line, bar or panel, named in the legend: runs, orders, layouts, policies, lines.

    \b
    npcache sweep --layout stored,veb -o sweep.parquet && npcache plot sweep.parquet -o curves.png
    npcache plot traces/bunny-kdtree traces/bunny-bvh -o distances.png
    npcache plot traces/bunny-bvh --kind curves --prefetch none,stack,next-line:miss -o curves.svg
    npcache table1 -o table1.csv && npcache plot table1.csv -o table1.pdf
    """
    from cachesim.report.pictures import check_plot

    began = time.perf_counter()
    if not sources:
        raise BadInput("npcache plot draws the results or runs that it is given, and none is named; name a file, or a run")
    if path is None:
        raise BadInput("name the picture with -o, for instance -o plot.png")
    check_plot(path)
    asked: dict[str, list] = {"size": size, "ways": ways, "line": line, "prefetch": prefetch, "layout": layout}
    kind, n = drawn(sources, kind, asked, path, threads, refuse)
    done(f"{path}: {KINDS[kind]}, of {n} row{'s' * (n != 1)}", began)


def drawn(
    sources: Sequence[Place], kind: str | None, asked: Mapping[str, list], path: Path, threads: int | None,
    refuse: Callable[..., object],
) -> tuple[str, int]:  # fmt: skip
    """Draw runs, through the caches, policies and layouts asked for, or files of results; return the kind and its rows.

    ``refuse(reason, *names, way=...)`` raises an NptraceError if some of what is asked for has these names.
    """
    from cachesim.report.result_files import read_rows

    of_runs = [each for each in sources if isinstance(each, Remote) or each.is_dir() or is_trace(each)]
    if of_runs and len(of_runs) < len(sources):
        others = next(source for source in sources if source not in of_runs)
        raise NptraceError(f"{of_runs[0]} is a run and {others} holds results; draw runs or results, not both at once")
    if not of_runs:
        refuse("results have their caches and policies", *asked, way=", or name runs")
        return draw_results({each: read_rows(Path(str(each))) for each in sources}, kind, path)
    kind = kind or "distances"
    if kind not in OF_RUNS:
        raise NptraceError(f"--kind {kind} needs results, of npcache {_WRITTEN_BY[kind]} -o FILE; name that file")
    if kind == "distances":
        refuse("--kind distances shows caches of every size", "size", "ways", way=", or name another kind")
    sizes, numbers = _USUAL[kind]
    size = asked["size"] or [each for text in sizes.split(",") for each in _sizes(text)]
    ways = asked["ways"] or [(each,) for each in numbers.split(",")]
    cases = Combinations(size, ways, asked["line"] or [32], asked["prefetch"] or ["traced"], asked["layout"] or ["stored"])
    return kind, _draw_runs(chosen_sources(of_runs, Path()), kind, cases, path, threads)


_WRITTEN_BY = {"speed-ups": "time or compare", "table1": "table1"}


class Combinations:
    """The caches, policies and layouts that runs go through."""

    def __init__(
        self, sizes: list[int], ways: list[tuple[str, ...]], lines: list[int], prefetches: list[str], layouts: list[str]
    ) -> None:  # fmt: skip
        from cachesim.grid import caches

        self.lines, self.prefetches, self.layouts = lines, prefetches, layouts
        self.configs = caches(sizes, ways, lines)


def draw_results(files: Mapping[Any, Sequence[Mapping[str, Any]]], kind: str | None, path: Path) -> tuple[str, int]:
    """Draw the rows of files; return what was drawn, and the number of rows."""
    rows = [row for found in files.values() for row in found]
    kinds = {each: kind_of(found[0]) for each, found in files.items()}
    possible = set(kinds.values())
    if len(possible) > 1:
        texts = ", ".join(f"{each} {found}" for each, found in kinds.items())
        raise NptraceError(f"the files hold different results ({texts}); draw each kind by itself")
    kind = kind or possible.pop()
    drawings = _drawings()
    missing = [name for name in _NEEDS[kind] if name not in rows[0]]
    if kind == "distances" or missing:
        lacks = f"the results have no column {missing[0]}" if missing else "results have no stack distances"
        raise NptraceError(f"--kind {kind}: {lacks}; name {'runs' if kind in OF_RUNS else 'other results'}, or another kind")
    drawings[kind](rows, path)
    return kind, len(rows)


#: The columns that a kind of picture cannot do without.
_NEEDS = {
    "curves": ("demand_miss_rate", "demand_misses_without", "demand_accesses", "ways"), "account": ("redundant",),
    "levels": ("by",), "speed-ups": ("speed_up", "prefetch"), "table1": ("paper_ratio_paper",), "distances": (),
}  # fmt: skip


def kind_of(row: Mapping[str, Any]) -> str:
    """Return what a row of results is drawn as, where nobody asks for another kind."""
    if "paper_ratio_paper" in row:
        return "table1"
    if "by" in row:
        return "levels"
    if "speed_up" in row:
        return "speed-ups"
    if "demand_miss_rate" in row and "ways" in row:
        return "curves"
    raise NptraceError(
        f"results with the columns {', '.join(list(row)[-3:])} cannot be drawn; name those of npcache replay, sweep, time, "
        "compare or table1"
    )


def _drawings() -> dict[str, Callable[[Sequence[Any], Path], None]]:
    from cachesim.report.bars import draw_account, draw_levels, draw_speed_ups
    from cachesim.report.curves import draw_curves
    from cachesim.report.distances import draw_distances
    from cachesim.report.table1_plot import draw_table1

    return {
        "curves": draw_curves, "distances": draw_distances, "account": draw_account, "levels": draw_levels,
        "speed-ups": draw_speed_ups, "table1": draw_table1,
    }  # fmt: skip


def _draw_runs(paths: Sequence[Place], kind: str, cases: Combinations, path: Path, threads: int | None) -> int:
    """Count what a kind of picture shows of runs, and draw it; return the number of rows."""
    from cachesim.source import open_source

    rows: list[Any] = []
    with Progress(len(paths) * len(cases.layouts) * len(cases.prefetches)) as bar:
        for run in paths:
            for layout in cases.layouts:
                source = open_source(run, layout)
                source.check_passes(len(cases.prefetches) * (len(cases.lines) if kind == "distances" else 1))
                for prefetch in cases.prefetches:
                    bar.job(source.identity.run)
                    progress = bar.phase(f"count, prefetch {prefetch}", source.n_events)
                    rows += _rows_of(kind, source, prefetch, cases, threads, progress)
        bar.phase("draw")
        _drawings()[kind](rows, path)
    return len(rows)


def _rows_of(
    kind: str, source: Any, prefetch: str, cases: Combinations, threads: int | None, progress: Callable[[int], None]
) -> Iterator[Any]:  # fmt: skip
    """Yield the rows of one source under one policy."""
    from cachesim.by_group import replay_by
    from cachesim.replay import replay
    from cachesim.report.distances import distances_of

    if kind == "distances":
        for line in cases.lines:
            yield distances_of(source, line, prefetch)
    elif kind == "levels":
        for grouped in replay_by(source, cases.configs, "level", prefetch=prefetch, threads=threads, progress=progress):
            yield from grouped.rows()
    else:
        for result in replay(source, cases.configs, prefetch=prefetch, threads=threads, progress=progress):
            yield result.to_dict()
