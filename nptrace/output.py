"""Where results go: stdout or a file, as tables for people or records for programs.

A command that prints results has ``@results_options()``, takes ``output: Output``, and ends with one call:

    output.write(records, lambda: (tables, notes))

That gives it --format, --json, -o and --wide, tables that fit the terminal (``nptrace_base.tables``), and JSON of the
project's schema (``nptrace_base.records``). Records begin with the columns of a run's identity (``traces.identity``).
"""

import io
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from nptrace.groups import BadInput
from nptrace_base.errors import NptraceError

if TYPE_CHECKING:
    from nptrace_base.records import Record
    from nptrace_base.tables import Table

FORMATS = ("table", "csv", "json", "parquet", "markdown", "latex")
#: The format that the ending of an output file asks for.
ENDINGS = {".csv": "csv", ".json": "json", ".parquet": "parquet", ".md": "markdown", ".tex": "latex"}


@dataclass(frozen=True)
class Output:
    """What --format, --json, -o and --wide ask for; ``path`` None or ``-`` is stdout."""

    form: str
    path: Path | None = None
    is_wide: bool = False
    is_asked_for: bool = True  # by an option; else it is the default

    def write(
        self, records: "Sequence[Record]", make_tables: "Callable[[], tuple[Sequence[Table], Sequence[str]]]",
        **others: Callable[[], str],
    ) -> None:  # fmt: skip
        """Write results in the chosen format.

        Parameters
        ----------
        records : sequence of mappings
            One per row, for json; flat ones for csv and parquet too.
        make_tables : callable
            Returns the tables and the notes below them, for table, markdown and latex.
        others : callables
            Return the text of a format of the command's own.
        """
        from nptrace_base import records as made

        if self.form == "parquet":
            self._write_parquet(records)
        elif self.form in others:
            write_out(others[self.form](), self.path)
        elif self.form in ("json", "csv"):
            write_out({"json": made.to_json, "csv": made.to_csv}[self.form](records), self.path)
        else:
            write_tables(*make_tables(), self.form, self.path, is_wide=self.is_wide)

    def _write_parquet(self, records: "Sequence[Record]") -> None:
        from nptrace_base.atomic import whole_file
        from nptrace_base.records import write_parquet
        from traces.identity import COLUMNS

        with whole_file(self.path or Path("-")) as temporary:
            write_parquet(records, temporary, COLUMNS)


def results_options(*more: str, without: Sequence[str] = (), default: str = "table") -> Any:
    """Return a decorator that adds the options of an output, and passes their ``Output`` as ``output``.

    ``more`` are formats that only this command has, ``without`` those that it lacks.
    """
    forms = [form for form in (*FORMATS, *more) if form not in without]

    def decorate(function: Callable[..., Any]) -> Any:
        @wraps(function)
        def command(form: str | None, as_json: bool, output_path: Path | None, is_wide: bool, **kwargs: Any) -> Any:
            chosen = one_form(form, as_json)
            is_asked_for = chosen is not None or output_path is not None
            if chosen is None and output_path is not None:
                chosen = ENDINGS.get(output_path.suffix)
            chosen = chosen or default
            if chosen not in forms:
                raise BadInput(f"-o {output_path}: these results have no format {chosen}; choose one of {', '.join(forms)}")
            if chosen == "parquet" and output_path is None and sys.stdout.isatty():
                raise BadInput("--format parquet is not for a terminal; name a file with -o")
            return function(output=Output(chosen, output_path, is_wide, is_asked_for), **kwargs)

        for option in (
            click.option("--wide", "is_wide", is_flag=True, help="Print every column, also those too many for the terminal."),
            output_option(
                "-o", "--output", "output_path", help="Write a file, whose ending may choose the format; - is stdout."
            ),
            click.option("--json", "as_json", is_flag=True, help="The same as --format json."),
            click.option("--format", "form", type=click.Choice(forms), show_default=default, help="Output format."),
        ):
            option(command)
        return command

    return decorate


def one_form(form: str | None, as_json: bool) -> str | None:
    """Return the format that --format and --json ask for; the two must not differ."""
    if as_json and form not in (None, "json"):
        raise BadInput(f"--format {form} and --json ask for two formats; leave one out")
    return "json" if as_json else form


def write_tables(
    tables: "Sequence[Table]", notes: Sequence[str], form: str, output: Path | None, *, is_wide: bool = False
) -> None:
    """Write tables as ``table``, ``markdown`` or ``latex``."""
    from nptrace_base import tables as texts

    if form != "table":
        write_out({"markdown": texts.to_markdown, "latex": texts.to_latex}[form](tables, notes), output)
    elif output is None or str(output) == "-":
        texts.print_tables(tables, notes, sys.stdout, is_wide=is_wide)
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
