"""nptrace export: a run as a trace that DineroIV replays."""

import shlex
import time
from pathlib import Path

import click

from nptrace.groups import Command
from nptrace.output import output_option
from nptrace.progress import Progress, done, say


@click.command(cls=Command, old={"--to": "--format", "--prefetch": "--prefetch-as"})
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--format", "form", type=click.Choice(["din"]), default="din", show_default=True, help="DineroIV's traces.")
@click.option("--binary", is_flag=True, help="Write DineroIV's binary records instead of text.")
@click.option(
    "--prefetch-as",
    "prefetch",
    type=click.Choice(["b", "read", "misc", "omit"]),
    default="b",
    show_default=True,
    help="Access type of the prefetch requests: b, read (0) or misc (3); omit leaves them out.",
)
@output_option("-o", "--output", help="Output file, - for stdout; by default RUN.din.")
def export(run: Path, form: str, binary: bool, prefetch: str, output: Path | None) -> None:
    """Write a run as a trace that DineroIV itself replays.

    \b
    nptrace export traces/bunny-bvh
    dineroIV -informat d -l1-usize 8k -l1-ubsize 32 -l1-uassoc 2 < bunny-bvh.din
    """
    from traces.din import export_din
    from traces.format import printable
    from traces.reader import open_run

    opened, began = open_run(run), time.perf_counter()
    target = output or Path(f"{opened.name}.{form}")
    with Progress(1) as bar:
        bar.job(opened.name)
        bar.phase("export")
        written = export_din(opened, target, fmt="binary" if binary else "text", prefetch=prefetch, warn=say)
    name = printable(str(target))
    done(f"{name}: {written:,} accesses", began, "" if name == "-" else f"npcache replay {shlex.quote(name)}")
