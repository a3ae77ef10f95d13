"""Rows of results in Python, which the functions of ``import nptrace`` return: an Arrow table, and the tables of a command."""

import importlib
import io
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from html import escape
from pathlib import Path
from typing import Any, overload

from nptrace.trouble import trouble
from nptrace.values import PATH
from nptrace_base.errors import NptraceError
from nptrace_base.records import Record
from nptrace_base.records import to_arrow as arrow_of
from nptrace_base.records import to_csv as csv_of
from nptrace_base.records import to_json as json_of
from nptrace_base.tables import Table, print_tables
from traces.identity import COLUMNS

Made = tuple[Sequence[Table], Sequence[str]]


class Results:
    """The rows of one call, in order, with the columns of the command's JSON (docs/results.schema.json).

    ``print(results)`` prints what the command prints, its verdict last; ``notes`` has the sentences below the tables.
    Anything that reads Arrow takes it as it is, such as ``duckdb.sql("SELECT * FROM results")``.
    """

    def __init__(
        self, what: str, records: Sequence[Record], make_tables: Callable[[], Made],
        make_flat: Callable[[], Sequence[Record]] | None = None,
    ) -> None:  # fmt: skip
        self._what, self._records, self._make_tables, self._make_flat = what, records, make_tables, make_flat

    def __len__(self) -> int:
        return len(self._records)

    def __iter__(self) -> Iterator[Record]:
        return iter(self._records)

    def __getitem__(self, i: int) -> Record:
        return self._records[i]

    @property
    def _flat(self) -> Sequence[Record]:
        """The rows as tables of all kinds hold them: of an estimate, one per cache."""
        return self._records if self._make_flat is None else self._make_flat()

    @cached_property
    def _table(self) -> Any:
        return arrow_of(self._flat, COLUMNS)

    def to_arrow(self) -> Any:
        """Return a pyarrow.Table, one row per result, of an estimate one per cache; every call returns the same one.

        Its metadata have the ``schema_version`` of docs/results.schema.json.
        """
        return self._table

    @overload
    def to_csv(self, path: None = None) -> str: ...

    @overload
    def to_csv(self, path: Path | str) -> None: ...

    def to_csv(self, path: Path | str | None = None) -> str | None:
        """Write the rows as the command does with ``-o path``; without a path, return the text.

        The file is written atomically; NptraceError if it cannot be.
        """
        return self._written("csv", self._flat, path)

    @overload
    def to_json(self, path: None = None) -> str: ...

    @overload
    def to_json(self, path: Path | str) -> None: ...

    def to_json(self, path: Path | str | None = None) -> str | None:
        """Write the rows as ``to_csv`` does, as JSON of docs/results.schema.json."""
        return self._written("json", self._records, path)

    def to_parquet(self, path: Path | str) -> None:
        """Write the rows as ``to_csv`` does, as Parquet."""
        self._written("parquet", self._flat, path)

    def _written(self, form: str, records: Sequence[Record], path: Path | str | None) -> str | None:
        from nptrace.output import Output

        if path is None and form != "parquet":
            return {"csv": csv_of, "json": json_of}[form](records)
        try:
            Output(form, Path(PATH.read("path", path))).write(records, self._make_tables)
        except OSError as e:
            if (sentence := trouble(e)) is None:
                raise
            raise NptraceError(sentence) from e
        return None

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
