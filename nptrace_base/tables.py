"""Tables as text: rows of formatted cells -> a terminal, a pipe, Markdown or LaTeX.

On a terminal no line is longer than the terminal is wide. A table that is too wide goes without its columns of
``Table.extra``, the first of them first, and a note names them; no number is broken or cut. A pipe or a file gets every
column, and notes of ``NOTE_WIDTH``.

A new command makes its tables with ``n_left`` key columns (which run, which cache), and names in ``extra`` the columns that a
reader misses least; ``nptrace.output.Output`` prints them. ``traces.identity.labels`` makes the text of a run's key column.
"""

import re
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import TextIO

from nptrace_base.shell import command_lines

#: Columns of a note in a pipe or a file, and on a terminal that is wider.
NOTE_WIDTH = 110
_MANY = 12  # columns above which the gaps between them are one blank, so that a table fits 120
_NARROWEST = 8  # to which the text of a key column is folded


@dataclass
class Table:
    """A table of text cells; a column is right-aligned unless it is one of the first ``n_left``.

    Attributes
    ----------
    n_left : int
        Key columns: they are kept, and folded at worst.
    sections : set of int
        The rows after which a line or a gap is drawn.
    extra : sequence of str
        Headings of the columns without which a narrow terminal does, the first to go first.
    command : str
        A command line that belongs to the table, to be printed below it as a shell can read it.
    """

    title: str
    header: Sequence[str]
    rows: list[list[str]]
    n_left: int = 1
    sections: set[int] = field(default_factory=set)
    extra: Sequence[str] = ()
    command: str = ""


def number(value: float | None, decimals: int = 0, *, sign: bool = False, group: str = ",") -> str:
    """Return a number with ``group`` between thousands; ``-`` for None."""
    if value is None:
        return "-"
    text = f"{value:{'+' if sign else ''}{group}.{decimals}f}"
    return text[1:] if sign and not text.strip("+-0.,") else text  # no signed zero


def percent(value: float | None, decimals: int = 2) -> str:
    """Return a fraction in per cent, without the per cent sign."""
    return number(None if value is None else 100 * value, decimals)


def span(values: Sequence[float], decimals: int = 1, *, sign: bool = False) -> str:
    """Return the least and the most of some numbers, such as ``-3.7 to +0.5``; one number if these print alike."""
    low, high = (number(end, decimals, sign=sign) for end in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def width_of(file: TextIO) -> int | None:
    """Return the columns of a terminal; None for a pipe or a file, which has no width."""
    from rich.console import Console

    console = Console(file=file)
    return console.width if console.is_terminal else None


def print_tables(tables: Sequence[Table], notes: Sequence[str], file: TextIO, *, is_wide: bool = False) -> None:
    """Print tables and the notes below them; a pipe gets plain ASCII.

    On a terminal tables are fitted to its width, unless ``is_wide``.
    """
    width = width_of(file)
    left_out: dict[str, None] = {}
    kept: set[str] = set()
    for table in tables:
        shown, gap, widths = fitted(table, None if is_wide else width)
        left_out |= {_one_line(name): None for name in table.header if name not in shown.header}
        kept |= {_one_line(name) for name in shown.header}
        _print_table(shown, gap, widths, width, file)
        if table.command:
            print("\n".join(command_lines(table.command, width)), end="\n\n", file=file)
    if left_out:
        notes = [*filter(None, (_without(note, left_out.keys() - kept, kept) for note in notes))]
        columns = f"{len(left_out)} column{'s' if len(left_out) > 1 else ''}"
        notes = [*notes, f"--wide prints {columns} more: {', '.join(left_out)}."]
    for note in notes:
        print(textwrap.fill(note, min(width or NOTE_WIDTH, NOTE_WIDTH)), file=file)


def _without(note: str, hidden: Iterable[str], kept: Iterable[str]) -> str:
    """Return a note without its clauses, ``NAME = ...`` or ``NAME: ...``, that explain columns which are not shown."""
    sentences = []
    for sentence in re.split(r"(?<=\.) ", note):
        clauses = [
            each for each in sentence.rstrip(".").split("; ") if not (_explains(each, hidden) and not _explains(each, kept))
        ]
        sentences += ["; ".join(clauses) + ("." if sentence.endswith(".") else "")] if clauses else []
    return " ".join(sentences)


def _explains(clause: str, columns: Iterable[str]) -> bool:
    """Return whether a clause says what one of some columns is: by its heading, or the first words of it."""
    named = re.match(r"([^=:]+?)(?: =|:) ", clause)
    return named is not None and any(f"{name} ".startswith(f"{named[1].removesuffix(' %')} ") for name in columns)


def fitted(table: Table, width: int | None) -> tuple[Table, int, list[int]]:
    """Return a table with the columns that fit a terminal, the blanks between two of them, and the width of each.

    ``width`` None: all of them.
    """
    widths = [max(map(_cell_width, [name, *(row[i] for row in table.rows)])) for i, name in enumerate(table.header)]
    kept = list(range(len(widths)))
    if width is None:
        return table, 2 if len(kept) <= _MANY else 1, widths

    def excess(gap: int) -> int:
        return sum(widths[i] for i in kept) + gap * (len(kept) - 1) + 2 - width

    # The columns of ``extra`` first, then those farthest to the right; never the key columns, nor all others.
    going = [i for name in table.extra for i in kept if table.header[i] == name]
    going += [i for i in reversed(kept[table.n_left :]) if i not in going]
    n_extra = len(table.extra)
    while excess(1) > 0:
        if n_extra <= 0:
            _fold(widths, table.n_left, excess(1))
        if excess(1) <= 0 or len(kept) <= table.n_left + 1 or not going:
            break
        kept.remove(going.pop(0))
        n_extra -= 1
    shown = replace(table, header=[table.header[i] for i in kept], rows=[[row[i] for i in kept] for row in table.rows])
    return shown, 2 if excess(2) <= 0 and len(kept) <= _MANY else 1, [widths[i] for i in kept]


def _fold(widths: list[int], n_left: int, excess: int) -> None:
    """Narrow the key columns, the widest first, by what a table is too wide."""
    for _ in range(excess):
        widest = max(range(n_left), key=widths.__getitem__)
        if widths[widest] <= _NARROWEST:
            return
        widths[widest] -= 1


def _cell_width(text: str) -> int:
    from rich.cells import cell_len

    return max(map(cell_len, text.split("\n")))


def _print_table(table: Table, gap: int, widths: Sequence[int], width: int | None, file: TextIO) -> None:
    from rich.box import SIMPLE, Box
    from rich.console import Console
    from rich.table import Table as RichTable
    from rich.text import Text

    box = Box(str(SIMPLE).replace("\u2500", "-"), ascii=True) if width is None else SIMPLE
    rich = RichTable(box=box, padding=(0, gap - 1, 0, 0), pad_edge=False)
    for i, name in enumerate(table.header):
        is_key = i < table.n_left
        rich.add_column(name, justify="left" if is_key else "right", no_wrap=not is_key, overflow="fold", width=widths[i])
    for i, row in enumerate(table.rows):
        rich.add_row(*row, end_section=i in table.sections)
    if table.title:
        title = Console(file=file, width=width or 10_000, highlight=False, markup=False, emoji=False)
        title.print(Text(table.title, style="italic"))
    full = sum(widths) + gap * (len(widths) - 1) + 2
    Console(file=file, width=full, highlight=False, markup=False, emoji=False).print(rich)


def to_markdown(tables: Sequence[Table], notes: Sequence[str]) -> str:
    """Return the tables in GitHub's Markdown."""
    parts = []
    for table in tables:
        if table.title:
            parts.append(f"**{table.title}**\n")
        rule = ["---" if i < table.n_left else "---:" for i in range(len(table.header))]
        lines = [[_one_line(name) for name in table.header], rule, *table.rows]
        parts.append("\n".join("| " + " | ".join(cell.replace("|", r"\|") for cell in line) + " |" for line in lines) + "\n")
        if table.command:
            parts.append(f"```sh\n{table.command}\n```\n")
    return "\n".join([*parts, *(note + "\n" for note in notes)])


def to_latex(tables: Sequence[Table], notes: Sequence[str]) -> str:
    """Return the tables as LaTeX tabulars; only ``booktabs`` is needed."""
    parts = []
    for table in tables:
        columns = "l" * table.n_left + "r" * (len(table.header) - table.n_left)
        header = _latex_row([_one_line(name) for name in table.header])
        lines = [f"\\begin{{tabular}}{{{columns}}}", "\\toprule", header, "\\midrule"]
        if table.title:
            lines.insert(0, f"\\textbf{{{_latex(table.title)}}}\\\\")
        for i, row in enumerate(table.rows):
            lines.append(_latex_row(row))
            if i in table.sections and i + 1 < len(table.rows):
                lines.append("\\midrule")
        parts.append("\n".join([*lines, "\\bottomrule", "\\end{tabular}", ""]))
        if table.command:
            parts.append("\n".join(["\\begin{verbatim}", table.command, "\\end{verbatim}", ""]))
    return "\n\n".join([*parts, *(_latex(note) + "\n" for note in notes)])


def _one_line(name: str) -> str:
    return name.replace("-\n", "").replace("\n", " ")


def _latex_row(cells: Sequence[str]) -> str:
    return " & ".join(_latex(cell) for cell in cells) + r" \\"


#: What LaTeX would take for something else, in text.
_LATEX = str.maketrans(
    {each: f"\\{each}" for each in "&%#_${}"}
    | {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
)


def _latex(text: str) -> str:
    text = text.translate(_LATEX)
    return text.replace("-", "$-$") if text[:1] == "-" and text[1:2].isdigit() else text
