"""npcache replay: runs and traces through caches, exactly."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cachesim.config import CacheConfig, parse_bytes, parse_ways
from nptrace.groups import BadInput, Command
from nptrace.options import list_option, size_option, threads_option
from nptrace.output import Output, results_options
from nptrace.progress import Counted, Progress, done
from nptrace.sources import LAYOUT_HELP, PREFETCH_HELP, chosen_sources, traces_option, untimed_policies

if TYPE_CHECKING:
    from cachesim.by_group import GroupedResult
    from cachesim.result import Result

#: By what the counts can be written: ``cachesim.by_group.BY``, which takes long to import.
BY = ("pixel", "level", "node", "ray-type")


@click.command(cls=Command, old={"--report": "--format"}, lists={"Prefetch policies": untimed_policies})
@click.argument("sources", metavar="[RUN | FILE.din | -]...", nargs=-1, type=click.Path(path_type=Path))
@traces_option()
@size_option()
@list_option("--assoc", "--ways", item=str, metavar="WAYS", default="1", help="Associativity: numbers of ways, e.g. 1,2,full.")
@list_option("--line", item=parse_bytes, metavar="SIZES", default="32", help="Line sizes in bytes.")
@list_option(
    "--policy", item=str.lower, metavar="POLICIES", default="lru", help="Replacement: lru, fifo, random, opt (Belady)."
)
@click.option("--seed", type=int, default=0, show_default=True, help="Seed of random replacement.")
@list_option("--prefetch", item=str, metavar="POLICIES", default="traced", help=PREFETCH_HELP)
@list_option("--layout", item=str, metavar="LAYOUTS", default="stored", help=LAYOUT_HELP)
@click.option("--3c", "three_c", is_flag=True, help="Classify misses as compulsory, capacity or conflict.")
@click.option(
    "--by",
    type=click.Choice(BY),
    help="Write where the counts of a run fall: a row for each pixel, level, node or type of ray.",
)
@threads_option()
@results_options("dinero")
def replay(
    sources: tuple[Path, ...], folder: Path, size: list[int], assoc: list[str], line: list[int], policy: list[str], seed: int,
    prefetch: list[str], layout: list[str], three_c: bool, by: str | None, threads: int, output: Output,
) -> None:  # fmt: skip
    """Replay runs, or DineroIV traces, through every combination of the cache options, exactly.

    \b
    npcache replay --size 8K --assoc 2
    npcache replay traces/bunny-bvh --size 8K,16K --assoc 1,2 --prefetch none,stack:tris*2 --json
    npcache replay traces/bunny-bvh --by level
    npcache replay traces/bunny-bvh --by pixel -o pixels.parquet
    npcache replay x.din --size 2K --assoc 2 --format dinero
    """
    from cachesim.by_group import GroupedRecords, replay_by, run_source
    from cachesim.layout import parse_layout
    from cachesim.prefetch import parse_prefetch
    from cachesim.replay import replay as replay_source
    from cachesim.report import group_tables, replay_tables
    from cachesim.source import open_source

    configs = [
        CacheConfig(one_size, parse_ways(ways, one_size, one_line), one_line, one_policy, seed)
        for one_line in line for one_policy in policy for one_size in size for ways in assoc
    ]  # fmt: skip
    if by is not None and output.form == "dinero":
        raise BadInput("--format dinero has the counts of whole caches, and --by asks for their parts; leave one out")
    policies, layouts = [parse_prefetch(text) for text in prefetch], [parse_layout(text) for text in layout]
    results: list[Result] = []
    grouped: list[GroupedResult] = []
    paths = chosen_sources(sources, folder)
    began, n_events = time.perf_counter(), 0
    with Progress(len(paths) * len(layouts) * len(policies)) as bar:
        for path in paths:
            for one_layout in layouts:
                source = open_source(path, one_layout) if by is None else run_source(path, one_layout, by)
                source.check_passes(len(policies))
                for one_prefetch in policies:
                    bar.job(source.identity.run)
                    progress = Counted(bar.phase(f"replay, prefetch {one_prefetch}", source.n_events))
                    options: Any = {"prefetch": one_prefetch, "three_c": three_c, "threads": threads, "progress": progress}
                    if by is None:
                        results += replay_source(source, configs, **options)
                    else:
                        grouped += replay_by(source, configs, by, **options)
                    n_events += progress.n
    if by is None:
        output.write(
            [result.to_dict() for result in results], lambda: replay_tables.tables(results),
            dinero=lambda: replay_tables.to_dinero(results),
        )  # fmt: skip
    else:
        output.write(GroupedRecords(grouped), lambda: group_tables.tables(grouped))
    n_runs = len({result.identity for result in results} | {result.identity for result in grouped})
    what = f"{n_runs} run{'s' * (n_runs != 1)}, {len(configs)} cache{'s' * (len(configs) != 1)}, {n_events:,} accesses read"
    done(what, began, "npcache sweep -o sweep.csv")
