"""npcache replay: runs and traces through caches, exactly."""

import time

import click

from cachesim.config import parse_bytes
from nptrace.following import again, following
from nptrace.groups import BadInput, Command
from nptrace.options import (
    Caches,
    Choice,
    gathered,
    list_option,
    policy_option,
    seed_option,
    size_option,
    threads_option,
    ways_option,
    workers_options,
)
from nptrace.output import Output, results_options
from nptrace.progress import Progress, done
from nptrace.sources import PlaceOf, chosen_sources, layouts_option, prefetch_option, traces_option, untimed_policies
from nptrace_base.errors import NptraceError
from nptrace_base.places import Place

#: By what the counts can be written: ``cachesim.by_group.BY``, which takes long to import.
BY = ("pixel", "level", "node", "ray-type")


@click.command(cls=Command, old={"--report": "--format"}, lists={"Prefetch policies": untimed_policies})
@click.argument("sources", metavar="[RUN | FILE | -]...", nargs=-1, type=PlaceOf())
@traces_option()
@size_option()
@ways_option()
@list_option("--line", item=parse_bytes, metavar="SIZES", default="32", help="Line sizes in bytes.")
@policy_option("lru", "fifo", "random", "opt", help="Replacement: lru, fifo, random, opt (Belady).")
@seed_option("Seed of random replacement.")
@prefetch_option("traced")
@layouts_option()
@click.option(
    "--reads", type=Choice(["own", "children", "merged"]), default="own", show_default=True,
    help="What a visit reads: its node; both children of a node that is entered, at once; or its node unless that lies in the "
    "line read last.",
)  # fmt: skip
@click.option(
    "--flush", type=Choice(["never", "ray"]), default="never", show_default=True,
    help="Empty the caches after every ray (lru and fifo).",
)  # fmt: skip
@click.option("--3c", "three_c", is_flag=True, help="Classify misses as compulsory, capacity or conflict.")
@click.option(
    "--by",
    type=Choice(BY),
    help="Print the counts of a run by pixel, tree level, node or ray type instead: a row for each.",
)
@threads_option()
@workers_options
@results_options("dinero")
@gathered("caches", Caches)
# Many parameters: one per option, as click passes them.
def replay(
    sources: tuple[Place, ...], folder: Place, caches: Caches, prefetch: list[str], layout: list[str], reads: str, flush: str,
    three_c: bool, by: str | None, workers: int, scheduler: str | None, threads: int, output: Output,
) -> None:  # fmt: skip
    """Replay runs, or traces of addresses, through every combination of the cache options, exactly.

    A FILE is a DineroIV trace, also compressed, or CSV or Parquet with a column address and, if you like, type and size.

    \b
    npcache replay --size 8K --assoc 2
    npcache replay traces/bunny-bvh --size 8K,16K --assoc 1,2 --prefetch none,stack:tris*2 --json
    npcache replay traces/bunny-bvh --by level
    npcache replay traces/bunny-bvh --by pixel -o pixels.parquet
    npcache replay x.din --size 2K --assoc 2 --format dinero
    """
    from cachesim.report import replay_tables
    from nptrace.studies import check_whole, replayed, replayed_by
    from nptrace_base.engines import engine_of

    if by is not None and output.form == "dinero":
        raise BadInput("--format dinero has the counts of whole caches, and --by asks for their parts; leave one out")
    check_whole(by, reads, flush, has_workers=bool(workers or scheduler))
    configs, paths, began = caches.configs(), chosen_sources(sources, folder), time.perf_counter()
    with engine_of(workers, scheduler) as engine, Progress(len(paths) * len(layout) * len(prefetch)) as bar:
        if by is None:
            results = replayed(
                paths, configs, prefetch, layout, bar, reads=reads, flush=flush, three_c=three_c, threads=threads,
                engine=engine,
            )  # fmt: skip
            runs = {result.identity for result in results}
        else:
            grouped = replayed_by(paths, configs, prefetch, layout, by, bar, three_c=three_c, threads=threads)
            runs = {result.identity for result in grouped}
    if by is None:
        output.write(
            [result.to_dict() for result in results], lambda: replay_tables.tables(results),
            dinero=lambda: replay_tables.to_dinero(results),
        )  # fmt: skip
    else:
        from cachesim.by_group import GroupedRecords
        from cachesim.report import group_tables

        output.write(GroupedRecords(grouped), lambda: group_tables.tables(grouped))
    n = len(runs)
    what = f"{n} run{'s' * (n != 1)}, {len(configs)} cache{'s' * (len(configs) != 1)}, {bar.n_done:,} accesses read"
    done(what, began, _following(again(sources, folder, paths), prefetch))


def _following(subject: str | None, prefetch: list[str]) -> str:
    """Return the sweep of what was replayed, if its policies can be swept."""
    from cachesim.prefetch import parse_prefetch
    from cachesim.stack_distance import check_one_pass

    try:
        for each in prefetch:
            check_one_pass(parse_prefetch(each))
    except NptraceError:
        return ""
    return following("npcache sweep", subject, "--size 4K..64K -o sweep.csv", drops=["size"])
