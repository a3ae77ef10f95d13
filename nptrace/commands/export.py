"""nptrace export: a run as a trace of addresses, for DineroIV or in CSV or Parquet."""

import time
from pathlib import Path

import click

from nptrace.groups import BadInput, Command
from nptrace.options import Choice
from nptrace.output import form_by_ending, output_option, refuse_terminal, unused
from nptrace.progress import Progress, done, say
from nptrace.sources import PlaceOf, one_run
from nptrace_base.places import Place
from nptrace_base.shell import word

FORMS = ("din", "csv", "parquet")


@click.command(cls=Command, old={"--to": "--format", "--prefetch": "--prefetch-as"})
@click.argument("run", type=PlaceOf())
@click.option(
    "--format", "form", type=Choice(FORMS), show_default="by the ending of -o, or din",
    help="DineroIV's traces, or columns address, type and size.",
)  # fmt: skip
@click.option("--binary", is_flag=True, help="Write DineroIV's binary records instead of text.")
@click.option(
    "--prefetch-as",
    "prefetch",
    type=Choice(["b", "read", "misc", "omit"]),
    default="b",
    show_default=True,
    help="Access type of the prefetch requests: b, read (0) or misc (3); omit leaves them out.",
)
@output_option("-o", "--output", help="Output file, - for stdout; by default RUN.din, .csv or .parquet.")
def export(run: Place, form: str | None, binary: bool, prefetch: str, output: Path | None) -> None:
    """Write a run as a trace of addresses: for DineroIV, or in CSV or Parquet for any other program.

    \b
    nptrace export traces/bunny-bvh
    nptrace export traces/bunny-bvh -o bunny.parquet
    dineroIV -informat d -l1-usize 8k -l1-ubsize 32 -l1-uassoc 2 < bunny-bvh.din
    """
    from nptrace_base.atomic import is_special
    from traces.address_files import export_addresses
    from traces.din import export_din
    from traces.format import printable
    from traces.reader import open_run

    endings = {f".{each}": each for each in FORMS}
    if binary and output is not None and output.suffix.lower() not in endings:
        form = form or "din"  # which --binary says
    form = form or form_by_ending(output, endings, "din")
    if binary and form != "din":
        raise BadInput(f"--binary is a form of DineroIV's traces, and {form} has none; leave it out")
    if binary or form == "parquet":
        refuse_terminal(output or Path(), "a trace in binary records" if binary else "Parquet")
    opened, began = open_run(one_run(run)), time.perf_counter()
    target = output or unused(Path(f"{opened.name}.{form}"))
    with Progress(1) as bar:
        bar.job(opened.name)
        bar.phase("export")
        if form == "din":
            written = export_din(opened, target, fmt="binary" if binary else "text", prefetch=prefetch, warn=say)
        else:
            written = export_addresses(opened, target, form=form, prefetch=prefetch)
    name = printable(str(target))
    done(f"{name}: {written:,} accesses", began, "" if is_special(target) else f"npcache replay {word(target)}")
