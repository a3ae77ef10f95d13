"""npcache time: runs through a node cache, a memory and a prefetch unit, cycle by cycle."""

import time
from pathlib import Path
from typing import Any

import click

from nptrace.clock_options import Machines, machine_options, machine_sources
from nptrace.following import again, following
from nptrace.groups import BadInput, Command
from nptrace.options import Choice, threads_option
from nptrace.output import Output, output_option, results_options
from nptrace.progress import Progress, done, say
from nptrace.sources import PlaceOf, chosen_sources, layouts_option, policies, prefetch_option, traces_option
from nptrace_base.places import Place

#: The tallies of the clock that can be printed, and how an option and the rows call one, as npcache replay does.
BY, NAMES = ("level", "ray", "slot", "leaf"), {"ray": "ray-type"}


class ByChoice(Choice):
    """A tally of the clock, as ``BY`` has it, by its name; that of the clock is the old spelling."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the tally."""
        if value in NAMES:
            say(f"--by {value} is now --by {NAMES[value]}; the old spelling will go")
            return value
        tallies = {name: by for by, name in NAMES.items()}
        found = super().convert(value, param, ctx)
        return tallies.get(found, found)


@click.command(
    "time", cls=Command, lists={"Prefetch policies": policies, "Machines and where their numbers come from": machine_sources}
)
@click.argument("sources", metavar="[RUN]...", nargs=-1, type=PlaceOf())
@traces_option()
@machine_options("Lists make every combination.")
@prefetch_option("stack", is_clocked=True)
@layouts_option()
@output_option(
    "--timeline", "timeline", help="Write some cycles of one case as a trace-event file, for Perfetto or chrome://tracing."
)
@click.option(
    "--by",
    type=ByChoice([NAMES.get(by, by) for by in BY]),
    help="Print reads and requests by tree level, ray type, place on the stack or leaf size instead: a row for each.",
)
@threads_option()
@results_options()
def time_(
    sources: tuple[Place, ...], folder: Place, machines: Machines, prefetch: list[str], layout: list[str],
    timeline: Path | None, by: str | None, threads: int, output: Output,
) -> None:  # fmt: skip
    """Count the cycles of runs, with and without prefetching, and say where they went.

    The machine is that of the paper's Figure 1: rays in flight walk their recorded visits; a node read takes a port of the
    node cache and hits, or waits for memory through an MSHR; a leaf takes an intersection unit, and the prefetch unit uses
    the cycles of the port that no read needs.

    \b
    npcache time --size 8K --assoc 2
    npcache time traces/bunny-bvh --rays 1,4,64 --mshrs 64 --prefetch stack,push
    npcache time traces/bunny-bvh --machine rtx2060 --prefetch stack,push,perfect --json
    npcache time traces/bunny-bvh --by level
    """
    from cachesim.prefetch import parse_prefetch
    from cachesim.report import tally_tables, timing_tables
    from cachesim.source import open_source
    from nptrace.studies import timed

    paths = chosen_sources(sources, folder)
    n_cases = len(paths) * len(layout) * len(prefetch) * len(machines.configs) * len(machines.clocks)
    if timeline is not None and n_cases > 1:
        raise BadInput(
            f"--timeline shows one case, and the options ask for {n_cases}; name one run, cache, machine and policy"
        )
    began = time.perf_counter()
    with Progress(len(paths) * len(layout)) as bar:
        results = timed(
            paths, machines.configs, machines.clocks, prefetch, layout, bar, by=by or "nothing", threads=threads
        )  # fmt: skip
        if timeline is not None:
            from cachesim.clock.timeline import write_timeline

            bar.phase("timeline")
            source, policy = open_source(paths[0], layout[0]), parse_prefetch(prefetch[0])
            write_timeline(source, machines.configs[0], machines.clocks[0], policy, timeline)
    if str(timeline) == "-" and not output.is_asked_for:
        pass  # stdout has the timeline
    elif by is None:
        output.write([result.to_dict() for result in results], lambda: timing_tables.tables(results))
    else:
        output.write(tally_tables.records(results, by), lambda: tally_tables.tables(results, by))
    what = f"{len(results)} case{'s' * (len(results) != 1)}, {sum(result.cycles for result in results):,} cycles"
    subject = again(sources, folder, paths, needs_run=True)
    done(what, began, following("npcache compare", subject, drops=["prefetch"], is_single=True))
