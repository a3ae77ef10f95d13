"""npcache compare: all prefetch policies side by side, and what needs none."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from nptrace.clock_options import SOURCES, Machines, machine_options
from nptrace.groups import BadInput, Command
from nptrace.options import list_option, threads_option
from nptrace.output import Output, output_option, results_options
from nptrace.progress import progress_bar
from nptrace.sources import LAYOUT_HELP, chosen_sources, traces_option

if TYPE_CHECKING:
    from cachesim.clock.compare import Compared


@click.command(cls=Command, epilog=SOURCES)
@click.argument("sources", metavar="[RUN]...", nargs=-1, type=click.Path(path_type=Path))
@traces_option()
@machine_options
@list_option("--prefetch", item=str, metavar="POLICIES", default="all", help="Policies, as npcache time has them; all of them.")
@click.option("--layout", default="stored", show_default=True, metavar="LAYOUT", help=LAYOUT_HELP)
@click.option("--baselines/--no-baselines", default=True, show_default=True, help="Compare line sizes, alignments and node orders.")
@threads_option()
@output_option("--plot", "picture", help="Write a plot as .png, .svg or .pdf.")
@results_options()
def compare(
    sources: tuple[Path, ...], folder: Path, machines: Machines, prefetch: list[str], layout: str, baselines: bool, threads: int,
    picture: Path | None, output: Output,
) -> None:  # fmt: skip
    """Compare all prefetch policies on one cache and machine, in cycles, with their bound and with what needs no unit.

    \b
    npcache compare traces/bunny-bvh
    npcache compare --machine rtx2060 --no-baselines --json
    npcache compare traces/bunny-bvh --size 16K --assoc 2 --rays 4 --plot compare.png
    """
    from cachesim.clock.compare import compare as compare_run
    from cachesim.report import compare_tables
    from traces.reader import open_run

    if len(machines.configs) * len(machines.clocks) > 1:
        raise BadInput(
            f"compare takes one cache and one machine, and the options ask for {len(machines.configs)} and "
            f"{len(machines.clocks)}; use npcache time for lists"
        )
    names = [] if prefetch == ["all"] else prefetch
    rows: list[Compared] = []
    for path in chosen_sources(sources, folder):
        run = open_run(path)
        with progress_bar(f"compare {run.name}", None) as progress:
            rows += compare_run(
                run, machines.configs[0], machines.clocks[0], layout=layout, prefetches=names, has_baselines=baselines,
                threads=threads, progress=progress,
            )  # fmt: skip
    if picture is not None:
        compare_tables.plot(rows, picture)
    if picture is None or output.is_asked_for:
        output.write([row.to_dict() for row in rows], lambda: compare_tables.tables(rows))
