"""nptrace export: a run as a trace that DineroIV replays."""

from pathlib import Path

import click

from nptrace.output import output_option


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--to", "form", type=click.Choice(["din"]), default="din", show_default=True, help="Format: DineroIV's traces.")
@click.option("--binary", is_flag=True, help="Write DineroIV's binary records instead of text.")
@click.option(
    "--prefetch",
    type=click.Choice(["b", "read", "misc", "omit"]),
    default="b",
    show_default=True,
    help="Access type of the prefetch requests: b, read (0) or misc (3); omit leaves them out.",
)
@output_option("-o", "--output", help="Output file, - for stdout; by default RUN.din.")
def export(run: Path, form: str, binary: bool, prefetch: str, output: Path | None) -> None:
    """Write a run as a trace that DineroIV itself replays.

    \b
    nptrace export traces/bunny-bvh --to din
    dineroIV -informat d -l1-usize 8k -l1-ubsize 32 -l1-uassoc 2 < bunny-bvh.din
    """
    from traces.din import export_din
    from traces.format import printable
    from traces.reader import open_run

    opened = open_run(run)
    target = output or Path(f"{opened.name}.{form}")
    form_of = "binary" if binary else "text"
    written = export_din(opened, target, fmt=form_of, prefetch=prefetch, warn=lambda text: click.echo(text, err=True))
    click.echo(f"{printable(str(target))}: {written:,} accesses", err=True)
