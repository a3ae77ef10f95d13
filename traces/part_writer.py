"""Columns of a part's rays and accesses -> its two files, encoded in memory: no reader ever sees half of one."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pyarrow as pa

from traces.footer import Footer
from traces.format import ACCESSES, RAYS
from traces.writer import Columns, TableWriter

#: The content of each file of a part, as a buffer, and its rows.
Encoded = Mapping[str, tuple[Any, int]]


class PartWriter:
    """The tables of one part; its rays and its rows are numbered from 0."""

    def __init__(self) -> None:
        self._sinks = {name: pa.BufferOutputStream() for name in ("rays", "accesses")}
        schemas = {"rays": RAYS, "accesses": ACCESSES}
        self._tables = {name: TableWriter(sink, schemas[name]) for name, sink in self._sinks.items()}

    def append(self, rays: Mapping[str, np.ndarray], accesses: Mapping[str, np.ndarray]) -> None:
        """Append rays and their accesses."""
        self._tables["rays"].append(rays)
        self._tables["accesses"].append(accesses)

    def encoded(self, footer: Callable[[int, int], Footer]) -> Encoded:
        """Return the files; ``footer`` is called with the numbers of rays and of accesses. Nothing is appended after it."""
        for table in self._tables.values():
            table.complete()
            table.wait()
        n_rays, n_accesses = (self._tables[name].n_rows for name in ("rays", "accesses"))
        text = footer(n_rays, n_accesses).to_json()
        return {name: _closed(table, self._sinks[name], text) for name, table in self._tables.items()}

    def abandon(self) -> None:
        """Let go of the threads that encode."""
        for table in self._tables.values():
            table.abandon(False)


def encoded_table(schema: pa.Schema, columns: Columns, footer: Footer) -> tuple[Any, int]:
    """Return a whole table as the content of a file, and its rows."""
    sink = pa.BufferOutputStream()
    table = TableWriter(sink, schema)
    table.append(columns)
    table.complete()
    table.wait()
    return _closed(table, sink, footer.to_json())


def _closed(table: TableWriter, sink: pa.BufferOutputStream, footer: bytes) -> tuple[Any, int]:
    table.close(footer)
    return sink.getvalue(), table.n_rows
