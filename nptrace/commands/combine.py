"""npcache combine: the summaries of all parts of a run -> what npcache replay prints."""

import time
from pathlib import Path

import click

from nptrace.groups import Command
from nptrace.output import Output, results_options
from nptrace.progress import done


@click.command(cls=Command)
@click.argument("summaries", metavar="SUMMARY...", nargs=-1, type=click.Path(path_type=Path))
@results_options("dinero")
def combine(summaries: tuple[Path, ...], output: Output) -> None:
    """Join the files that npcache summarise wrote of all parts of a run, and print what npcache replay prints of the run.

    \b
    npcache combine *.sum
    npcache combine *.sum -o results.parquet
    """
    from cachesim.report import replay_tables
    from cachesim.summary_file import combine as combined

    began = time.perf_counter()
    results = combined(summaries)
    output.write(
        [result.to_dict() for result in results], lambda: replay_tables.tables(results),
        dinero=lambda: replay_tables.to_dinero(results),
    )  # fmt: skip
    n = len(summaries)
    done(f"{n} summar{'ies' if n != 1 else 'y'}, {len(results)} result{'s' * (len(results) != 1)}", began)
