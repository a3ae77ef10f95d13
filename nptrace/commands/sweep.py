"""npcache sweep: every LRU cache in ranges, in one pass."""

import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from cachesim.config import parse_bytes
from nptrace.following import again, following
from nptrace.groups import Command
from nptrace.options import list_option, threads_option, ways_option, workers_options
from nptrace.output import Output, output_option, results_options
from nptrace.progress import Progress, done
from nptrace.sources import PlaceOf, chosen_sources, layouts_option, prefetch_option, traces_option, untimed_policies
from nptrace_base.errors import NptraceError
from nptrace_base.places import Place

if TYPE_CHECKING:
    from cachesim.sweep import SweepRow


@click.command(cls=Command, lists={"Prefetch policies": untimed_policies})
@click.argument("sources", metavar="[RUN | FILE | -]...", nargs=-1, type=PlaceOf())
@traces_option()
@list_option(
    "--size",
    item=str,
    metavar="SIZES",
    default="4K..64K",
    help="Cache sizes, and ranges of all sizes with a power of two of sets, e.g. 4K..64K,96K.",
)
@ways_option()
@list_option("--line", item=parse_bytes, metavar="SIZES", default="32", help="Line sizes in bytes.")
@prefetch_option("traced")
@layouts_option()
@threads_option()
@workers_options
@output_option("--plot", "picture", binary="a picture", help="Write a plot as .png, .svg or .pdf.")
@results_options(default="csv")
# Many parameters: one per option, as click passes them.
def sweep(
    sources: tuple[Place, ...], folder: Place, size: list[str], ways: list[tuple[str, ...]], line: list[int],
    prefetch: list[str], layout: list[str], workers: int, scheduler: str | None, threads: int, picture: Path | None,
    output: Output,
) -> None:  # fmt: skip
    """Count the misses of every LRU cache in ranges of size, associativity and line, exactly, in one pass over each trace.

    A cache is in the sweep if its size lies in a range and its number of sets is a power of two. Of the next-line policies
    only next-line:always can be swept.

    \b
    npcache sweep --size 4K..64K --ways 1..16 --line 32,64 -o sweep.parquet --plot sweep.png
    npcache sweep traces/bunny-bvh --ways 1,2,4,full --prefetch none,stack:tris*2
    """
    from cachesim.grid import grid, parse_range
    from cachesim.report import sweep_output
    from cachesim.report.curves import draw_curves
    from cachesim.report.pictures import check_plot
    from nptrace.studies import swept
    from nptrace_base.engines import engine_of

    if picture is not None:
        check_plot(picture)  # refused now, not after counting
    configs = grid([parse_range(text) for text in size], [way for named in ways for way in named], line)
    paths, began = chosen_sources(sources, folder), time.perf_counter()
    with engine_of(workers, scheduler) as engine, Progress(len(paths) * len(layout) * len(prefetch)) as bar:
        rows = swept(paths, configs, prefetch, layout, bar, threads=threads, engine=engine)
        if picture is not None:
            bar.phase("plot")
            draw_curves([row.to_dict() for row in rows], picture)
    if picture is None or output.is_asked_for:
        output.write([row.to_dict() for row in rows], lambda: sweep_output.tables(rows))
    n_runs = len({row.identity for row in rows})
    what = f"{n_runs} run{'s' * (n_runs != 1)}, {len(configs)} cache{'s' * (len(configs) != 1)}, {bar.n_done:,} accesses read"
    done(what, began, _following(again(sources, folder, paths, needs_run=True), rows, size, ways, line))


def _following(
    subject: str | None, rows: "list[SweepRow]", size: list[str], ways: list[tuple[str, ...]], line: list[int]
) -> str:  # fmt: skip
    """Return the clock's command for what was swept, if a clock can time the runs and has such caches."""
    from cachesim.grid import caches, parse_sizes

    if any((row.identity.packet or 1) > 1 for row in rows):
        return ""
    try:
        caches([each for text in size for each in parse_sizes(text)], ways, line)
    except NptraceError:
        return ""
    return following("npcache time", subject, "--prefetch stack,push", drops=["prefetch"])
