"""Tables as text: rows of formatted cells -> a terminal, a pipe, Markdown or LaTeX."""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TextIO

_NOTE_WIDTH = 110
_MANY = 12  # columns above which the gaps between them are one blank, so that a table fits 120


@dataclass
class Table:
    """A table of text cells; a column is right-aligned unless it is one of the first ``n_left``.

    ``sections`` are the rows after which a line or a gap is drawn.
    """

    title: str
    header: Sequence[str]
    rows: list[list[str]]
    n_left: int = 1
    sections: set[int] = field(default_factory=set)


def number(value: float | None, decimals: int = 0, *, sign: bool = False, group: str = ",") -> str:
    """Return a number with ``group`` between thousands; ``-`` for None."""
    if value is None:
        return "-"
    text = f"{value:{'+' if sign else ''}{group}.{decimals}f}"
    return text[1:] if sign and not text.strip("+-0.,") else text  # no signed zero


def percent(value: float | None, decimals: int = 2) -> str:
    """Return a fraction in per cent, without the per cent sign."""
    return number(None if value is None else 100 * value, decimals)


def print_tables(tables: Sequence[Table], notes: Sequence[str], file: TextIO) -> None:
    """Print tables and the notes below them. Nothing is cut off, however narrow the output; a pipe gets plain ASCII."""
    from rich.box import SIMPLE, Box
    from rich.console import Console
    from rich.measure import Measurement
    from rich.table import Table as RichTable

    is_terminal = Console(file=file).is_terminal
    box = SIMPLE if is_terminal else Box(str(SIMPLE).replace("\u2500", "-"), ascii=True)
    for table in tables:
        padding = (0, 1, 0, 0) if len(table.header) <= _MANY else 0
        rich = RichTable(title=table.title or None, title_justify="left", box=box, padding=padding, pad_edge=False)
        for i, name in enumerate(table.header):
            rich.add_column(name, justify="left" if i < table.n_left else "right", no_wrap=True)
        for i, row in enumerate(table.rows):
            rich.add_row(*row, end_section=i in table.sections)
        wide = Console(file=file, width=10_000)
        width = max(Measurement.get(wide, wide.options, rich).maximum, len(table.title))
        Console(file=file, width=width, highlight=False, markup=False, emoji=False).print(rich)
    for note in notes:
        print(textwrap.fill(note, _NOTE_WIDTH), file=file)


def to_markdown(tables: Sequence[Table], notes: Sequence[str]) -> str:
    """Return the tables in GitHub's Markdown."""
    parts = []
    for table in tables:
        if table.title:
            parts.append(f"**{table.title}**\n")
        rule = ["---" if i < table.n_left else "---:" for i in range(len(table.header))]
        lines = [[_one_line(name) for name in table.header], rule, *table.rows]
        parts.append("\n".join("| " + " | ".join(cell.replace("|", r"\|") for cell in line) + " |" for line in lines) + "\n")
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
    return "\n\n".join([*parts, *(_latex(note) + "\n" for note in notes)])


def _one_line(name: str) -> str:
    return name.replace("-\n", "").replace("\n", " ")


def _latex_row(cells: Sequence[str]) -> str:
    return " & ".join(_latex(cell) for cell in cells) + r" \\"


def _latex(text: str) -> str:
    for char in "&%#_":
        text = text.replace(char, "\\" + char)
    return text.replace("-", "$-$") if text[:1] == "-" and text[1:2].isdigit() else text
