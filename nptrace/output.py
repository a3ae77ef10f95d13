"""Where results go: stdout or a file, as text or as tables."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from nptrace.groups import BadInput
from nptrace_base.errors import NptraceError

if TYPE_CHECKING:
    from nptrace_base.tables import Table

FORMATS = ("table", "csv", "json", "markdown", "latex")


def one_form(option: str, form: str | None, as_json: bool) -> str:
    """Return the format that an option and --json ask for, the table by default; the two must not differ."""
    if as_json and form not in (None, "json"):
        raise BadInput(f"{option} {form} and --json ask for two formats; leave one out")
    return "json" if as_json else form or "table"


def write_tables(tables: "list[Table]", notes: list[str], form: str, output: Path | None) -> None:
    """Write tables as ``table``, ``markdown`` or ``latex``."""
    import io

    from nptrace_base import tables as texts

    if form != "table":
        write_out({"markdown": texts.to_markdown, "latex": texts.to_latex}[form](tables, notes), output)
    elif output is None:
        texts.print_tables(tables, notes, sys.stdout)
    else:
        printed = io.StringIO()
        texts.print_tables(tables, notes, printed)
        write_out(printed.getvalue(), output)


def write_out(text: str, out: Path | None) -> None:
    """Write text to stdout, or to a file atomically."""
    if out is None:
        click.echo(text, nl=False)
        return
    from nptrace_base.atomic import whole_file

    with whole_file(out) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="surrogateescape")


def output_option(*names: str, help: str) -> Any:
    """Return an option for an output file; whether it can be written is checked before any work is done."""

    def checked(ctx: click.Context, param: click.Parameter, path: Path | None) -> Path | None:
        if path is not None:
            from nptrace_base.atomic import check_writable

            try:
                check_writable(path)
            except NptraceError as e:
                raise BadInput(str(e)) from e
        return path

    return click.option(*names, type=click.Path(path_type=Path, allow_dash=True), callback=checked, help=help)
