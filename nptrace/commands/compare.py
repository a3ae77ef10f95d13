"""npcache compare: all prefetch policies side by side, and what needs none."""

import time
from pathlib import Path

import click

from nptrace.clock_options import Machines, machine_options, machine_sources, one_machine
from nptrace.following import again, following
from nptrace.groups import Command
from nptrace.options import threads_option, workers_options
from nptrace.output import Output, output_option, results_options
from nptrace.progress import Progress, done
from nptrace.sources import LAYOUT_HELP, PREFETCH_HELP, PlaceOf, chosen_sources, policies, prefetch_option, traces_option
from nptrace_base.places import Place


@click.command(
    cls=Command, lists={"Prefetch policies": policies, "Machines and where their numbers come from": machine_sources}
)
@click.argument("sources", metavar="[RUN]...", nargs=-1, type=PlaceOf())
@traces_option()
@machine_options("One cache and one machine.")
@prefetch_option("all", is_clocked=True, also=["all"], help=f"{PREFETCH_HELP} all: the usual ones.")
@click.option("--layout", default="stored", show_default=True, metavar="LAYOUT", help=LAYOUT_HELP)
@click.option(
    "--baselines/--no-baselines", default=True, show_default=True, help="Compare line sizes, alignments and node orders."
)
@threads_option()
@workers_options
@output_option("--plot", "picture", binary="a picture", help="Write a plot as .png, .svg or .pdf.")
@results_options()
# Many parameters: one per option, as click passes them.
def compare(
    sources: tuple[Place, ...], folder: Place, machines: Machines, prefetch: list[str], layout: str, baselines: bool,
    workers: int, scheduler: str | None, threads: int, picture: Path | None, output: Output,
) -> None:  # fmt: skip
    """Compare all prefetch policies on one cache and machine, in cycles, with their bound and with what needs no unit.

    \b
    npcache compare traces/bunny-bvh
    npcache compare --machine rtx2060 --no-baselines --json
    npcache compare traces/bunny-bvh --size 16K --assoc 2 --rays 4 --plot compare.png
    """
    from cachesim.report import compare_tables
    from cachesim.report.bars import draw_speed_ups
    from cachesim.report.pictures import check_plot
    from nptrace.studies import compared
    from nptrace_base.engines import engine_of

    config, clock = one_machine(machines)
    if picture is not None:
        check_plot(picture)
    paths, began = chosen_sources(sources, folder), time.perf_counter()
    with engine_of(workers, scheduler) as engine, Progress(1 if engine else len(paths)) as bar:
        rows = compared(
            paths, config, clock, prefetch, layout, bar, baselines=baselines, threads=threads, engine=engine
        )  # fmt: skip
        if picture is not None:
            bar.phase("plot")
            draw_speed_ups([row.to_dict() for row in rows], picture)
    if picture is None or output.is_asked_for:
        output.write([row.to_dict() for row in rows], lambda: compare_tables.tables(rows))
    page = following("npcache report", again(sources, folder, paths), "-o report.html", drops=["prefetch"])
    done(f"{len(rows)} cases, {sum(row.timing.cycles for row in rows):,} cycles", began, page)
