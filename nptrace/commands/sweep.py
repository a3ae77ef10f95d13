"""npcache sweep: every LRU cache in ranges, in one pass."""

import json
from pathlib import Path

import click

from cachesim.config import parse_bytes
from nptrace.options import list_option, threads_option
from nptrace.output import output_option
from nptrace.progress import progress_bar
from nptrace.sources import default_sources, traces_option


@click.command()
@click.argument("sources", metavar="[RUN | FILE.din | -]...", nargs=-1, type=click.Path(path_type=Path))
@traces_option()
@list_option("--size", item=str, metavar="SIZES", default="4K..64K", help="Cache sizes and ranges, e.g. 4K..64K,96K.")
@list_option("--ways", "--assoc", item=str, metavar="WAYS", default="1..16", help="Associativity, with ranges, e.g. 1..16.")
@list_option("--line", item=parse_bytes, metavar="SIZES", default="32", help="Line sizes in bytes.")
@list_option("--prefetch", item=str, metavar="POLICIES", default="traced", help="Prefetch policy: none, traced, stack[:...].")
@list_option("--layout", item=str, metavar="LAYOUTS", default="stored", help="Node layout, as in npcache replay.")
@threads_option()
@output_option("-o", "--output", help="Write a .parquet or .csv file; - writes CSV to stdout.")
@output_option("--plot", "picture", help="Write a plot as .png, .svg or .pdf.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of CSV.")
def sweep(
    sources: tuple[Path, ...], folder: Path, size: list[str], ways: list[str], line: list[int], prefetch: list[str],
    layout: list[str], threads: int, output: Path | None, picture: Path | None, as_json: bool,
) -> None:  # fmt: skip
    """Count the misses of every LRU cache in ranges of size, associativity and line, exactly, in one pass over each trace.

    A cache is in the sweep if its size lies in a range and its number of sets is a power of two.

    \b
    npcache sweep --size 4K..64K --ways 1..16 --line 32,64 -o sweep.parquet --plot sweep.png
    npcache sweep traces/bunny-bvh --ways 1,2,4,full --prefetch none,stack:tris*2
    """
    from cachesim import sweep as sweeping
    from cachesim.grid import grid, parse_range, parse_ways_range
    from cachesim.report import sweep_output
    from cachesim.source import open_source

    all_ways = list(dict.fromkeys(way for text in ways for way in parse_ways_range(text)))
    for path, endings in ((output, sweep_output.TABLES), (picture, sweep_output.PICTURES)):
        if path is not None:
            sweep_output.ending_of(path, endings)  # refused now, not after counting
    configs = grid([parse_range(text) for text in size], all_ways, line)
    rows: list[sweeping.SweepRow] = []
    for path in sources or default_sources(folder):
        for one_layout in layout:
            source = open_source(path, one_layout)
            source.check_passes(len(prefetch))
            for one_prefetch in prefetch:
                with progress_bar("sweep", source.n_events) as progress:
                    rows += sweeping.sweep(source, configs, prefetch=one_prefetch, threads=threads, progress=progress)
    if output is not None:
        sweep_output.write(rows, output)
    if picture is not None:
        sweep_output.plot(rows, picture)
    if as_json:
        click.echo(json.dumps([row.to_dict() for row in rows], indent=2))
    elif output is None and picture is None:
        click.echo(sweep_output.to_csv(rows), nl=False)
