"""Rows of results in Python, which the functions of ``nptrace.api`` return: an Arrow table, and the tables of a command."""

import importlib
import io
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from html import escape
from typing import Any

from nptrace_base.errors import NptraceError
from nptrace_base.records import Record
from nptrace_base.records import to_arrow as arrow_of
from nptrace_base.tables import Table, print_tables
from traces.identity import COLUMNS

Made = tuple[Sequence[Table], Sequence[str]]


class Results:
    """The rows of one call, in order, with the columns of the command's JSON (docs/results.schema.json).

    ``print(results)`` prints what the command prints, its verdict last; ``notes`` has the sentences below the tables.
    Anything that reads Arrow takes it as it is, such as ``duckdb.sql("SELECT * FROM results")``.
    """

    def __init__(self, what: str, records: Sequence[Record], make_tables: Callable[[], Made]) -> None:
        self._what, self._records, self._make_tables = what, records, make_tables

    def __len__(self) -> int:
        return len(self._records)

    def __iter__(self) -> Iterator[Record]:
        return iter(self._records)

    def __getitem__(self, i: int) -> Record:
        return self._records[i]

    @cached_property
    def _table(self) -> Any:
        return arrow_of(self._records, COLUMNS)

    def to_arrow(self) -> Any:
        """Return a pyarrow.Table, one row per result; every call returns the same one."""
        return self._table

    def __arrow_c_stream__(self, requested_schema: Any = None) -> Any:
        return self._table.__arrow_c_stream__(requested_schema)

    def to_pandas(self) -> Any:
        """Return a pandas.DataFrame whose columns are the Arrow columns themselves, not copies (``pandas.ArrowDtype``).

        Raises
        ------
        NptraceError
            pandas is not installed.
        """
        pandas = _library("pandas")
        return self._table.to_pandas(types_mapper=pandas.ArrowDtype)

    def to_polars(self) -> Any:
        """Return a polars.DataFrame that shares the memory of the Arrow table's numbers.

        Raises
        ------
        NptraceError
            polars is not installed.
        """
        return _library("polars").from_arrow(self._table, rechunk=False)

    @property
    def notes(self) -> list[str]:
        """The sentences below the tables, which explain the columns, and the verdict."""
        return list(self._make_tables()[1])

    def __repr__(self) -> str:
        n_runs = len({(record.get("run"), record.get("path")) for record in self._records})
        n = f"{len(self)} row{'s' * (len(self) != 1)} of {n_runs} run{'s' * (n_runs != 1)}"
        return f"<Results of {self._what}: {n}, {self._table.num_columns} columns>"

    def __str__(self) -> str:
        out = io.StringIO()
        print_tables(*self._make_tables(), out)
        return out.getvalue().rstrip("\n")

    def _repr_html_(self) -> str:
        """Return the command's tables and notes, for notebooks."""
        tables, notes = self._make_tables()
        return "".join([*map(_html, tables), *(f"<p>{escape(note)}</p>" for note in notes)])


def _library(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as e:
        raise NptraceError(f"to_{name} needs {name}, which is not installed; pip install {name}, or use to_arrow") from e


def _html(table: Table) -> str:
    """Return a table as HTML; key columns are at the left."""

    def row(cells: Sequence[str], tag: str) -> str:
        sides = ["left" if i < table.n_left else "right" for i in range(len(cells))]
        made = (f'<{tag} style="text-align:{side}">{escape(c)}</{tag}>' for side, c in zip(sides, cells, strict=True))
        return f"<tr>{''.join(made)}</tr>"

    head = row([name.replace("-\n", "").replace("\n", " ") for name in table.header], "th")
    caption = f"<caption>{escape(table.title)}</caption>" if table.title else ""
    return f"<table>{caption}<thead>{head}</thead><tbody>{''.join(row(cells, 'td') for cells in table.rows)}</tbody></table>"
