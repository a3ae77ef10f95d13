"""Where results go: stdout or a file, as tables for people or records for programs.

A command that prints results has ``@results_options()``, takes ``output: Output``, and ends with one call:

    output.write(records, lambda: (tables, notes))

That gives it --format, --json, -o and --wide, tables that fit the terminal (``nptrace_base.tables``), and JSON of the
project's schema (``nptrace_base.records``). Records begin with the columns of a run's identity (``traces.identity``).
"""

import io
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from nptrace.groups import BadInput
from nptrace.options import Choice
from nptrace.typed import listing
from nptrace_base.errors import NptraceError
from nptrace_base.shell import word

if TYPE_CHECKING:
    from nptrace_base.records import Record
    from nptrace_base.tables import Table

FORMATS = ("table", "csv", "json", "parquet", "markdown", "latex")
#: The format that the ending of an output file asks for.
ENDINGS = {".csv": "csv", ".json": "json", ".parquet": "parquet", ".md": "markdown", ".tex": "latex", ".txt": "table"}


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


def results_options(*more: str, default: str = "table") -> Any:
    """Return a decorator that adds the options of an output, and passes their ``Output`` as ``output``.

    ``more`` are formats that only this command has.
    """
    forms = [*FORMATS, *more]

    def decorate(function: Callable[..., Any]) -> Any:
        @wraps(function)
        def command(form: str | None, as_json: bool, output_path: Path | None, is_wide: bool, **kwargs: Any) -> Any:
            chosen = one_form(form, as_json)
            is_asked_for = chosen is not None or output_path is not None or (is_wide and default == "table")
            chosen = chosen or form_by_ending(output_path, ENDINGS, default)
            if is_wide and chosen != "table":
                raise BadInput(f"--wide is for tables, and {chosen} has every column without it; leave out --wide")
            # The default of a command that writes Parquet goes to a file of its own.
            if chosen == "parquet" and (is_asked_for or default != "parquet"):
                refuse_terminal(output_path or Path("-"), "Parquet")
            return function(output=Output(chosen, output_path, is_wide, is_asked_for), **kwargs)

        for option in (
            click.option("--wide", "is_wide", is_flag=True, help="Print every column, also those too many for the terminal."),
            output_option(
                "-o", "--output", "output_path", help="Write a file, whose ending may choose the format; - is stdout."
            ),
            click.option("--json", "as_json", is_flag=True, help="The same as --format json."),
            click.option("--format", "form", type=Choice(forms), show_default=default, help="Output format."),
        ):
            option(command)
        return command

    return decorate


def one_form(form: str | None, as_json: bool) -> str | None:
    """Return the format that --format and --json ask for; the two must not differ."""
    if as_json and form not in (None, "json"):
        raise BadInput(f"--format {form} and --json ask for two formats; leave one out")
    return "json" if as_json else form


def form_by_ending(path: Path | None, endings: Mapping[str, str], default: str) -> str:
    """Return the format that the ending of an output file asks for; ``default`` where it has none, as stdout and devices."""
    ending = "" if path is None else path.suffix.lower()
    if ending in endings:
        return endings[ending]
    if path is not None and ending:
        from nptrace_base.atomic import is_special

        if not is_special(path):
            known = listing(list(endings), "or")
            raise BadInput(f"-o {path}: no format has the ending {path.suffix}; end it in {known}, or give --format")
    return default


def write_tables(
    tables: "Sequence[Table]", notes: Sequence[str], form: str, output: Path | None, *, is_wide: bool = False
) -> None:
    """Write tables as ``table``, ``markdown`` or ``latex``."""
    from nptrace_base import tables as texts

    if form != "table":
        write_out({"markdown": texts.to_markdown, "latex": texts.to_latex}[form](tables, notes), output)
    elif output is None or (str(output) == "-" and sys.stdout is not None):
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


def unused(path: Path) -> Path:
    """Return the name of a file where -o gives none; BadInput if there is a file of that name, which is kept."""
    if os.path.lexists(path):
        name = word(path)
        raise BadInput(f"{name} exists; write -o {name} to replace it, or name another file")
    return path


def refuse_terminal(path: Path, what: str) -> None:
    """Raise BadInput if a path leads to a terminal, for ``what`` is bytes that would garble it."""
    if str(path) == "-":
        is_terminal = sys.stdout is not None and sys.stdout.isatty()
    elif is_terminal := path.is_char_device():
        opened = os.open(path, os.O_WRONLY | os.O_NOCTTY)
        is_terminal = os.isatty(opened)
        os.close(opened)
    if is_terminal:
        raise BadInput(f"{what} is not for a terminal; name a file, or pipe it to a program")


def output_option(*names: str, help: str, binary: str = "") -> Any:
    """Return an option for an output file; whether it can be written is checked before any work is done.

    ``binary`` says what the file is, if it is no text.
    """

    def checked(ctx: click.Context, param: click.Parameter, path: Path | None) -> Path | None:
        if path is not None:
            from nptrace_base.atomic import check_writable

            try:
                check_writable(path)
            except NptraceError as e:
                raise BadInput(str(e)) from e
            if binary:
                refuse_terminal(path, binary)
        return path

    return click.option(*names, type=click.Path(path_type=Path, allow_dash=True), callback=checked, help=help)
