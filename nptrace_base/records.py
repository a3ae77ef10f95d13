"""Records of results (flat dicts, one per row, all with the same keys) -> JSON, CSV, Parquet.

None is a rate whose denominator is 0, or a fact that is not known: null in JSON and Parquet, an empty field in CSV.
"""

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

#: Raised when a key of the JSON output gets another meaning or goes; a new key does not count.
SCHEMA_VERSION = 1

#: Largest seed, which a column of whole numbers holds.
MAX_SEED = (1 << 63) - 1

_AT_A_TIME = 1 << 16  # records of which Arrow makes columns: a sequence may make its records when they are asked for

Record = Mapping[str, Any]


def to_json(records: Sequence[Record]) -> str:
    """Return a JSON array with one object per record, each with its ``schema_version``; NaN and infinities become null."""
    found = [{"schema_version": SCHEMA_VERSION, **_finite(record)} for record in records]
    return json.dumps(found, indent=2, allow_nan=False) + "\n"


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _finite(item) for name, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def to_csv(records: Sequence[Record]) -> str:
    """Return CSV with a header, one line per record."""
    out = io.StringIO()
    writer = csv.DictWriter(out, list(dict.fromkeys(name for record in records for name in record)), lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    return out.getvalue()


def to_arrow(records: Sequence[Record], types: Mapping[str, type] | None = None) -> Any:
    """Return a pyarrow.Table, whose metadata have the ``schema_version``.

    ``types`` has those of columns that may hold nothing but None; other such columns are rates.
    """
    import pyarrow as pa

    arrow = {str: pa.string(), bool: pa.bool_(), int: pa.int64()}
    found: dict[str, type | None] = {}
    for record in records:
        for name, value in record.items():
            if found.get(name) is None:
                found[name] = None if value is None else type(value)
    version = {"schema_version": str(SCHEMA_VERSION)}
    held = {name: type_ or (types or {}).get(name, float) for name, type_ in found.items()}
    schema = pa.schema([pa.field(name, arrow.get(type_, pa.float64())) for name, type_ in held.items()], version)
    rows, pieces = iter(records), []
    for _ in range(0, len(records), _AT_A_TIME):
        plain = [{name: _utf8(value) for name, value in record.items()} for record in islice(rows, _AT_A_TIME)]
        pieces.append(pa.Table.from_pylist(plain, schema))
    return pa.concat_tables(pieces or [schema.empty_table()])


def write_parquet(records: Sequence[Record], path: Path, types: Mapping[str, type] | None = None) -> None:
    """Write the table of ``to_arrow`` as a Parquet file."""
    import pyarrow.parquet as pq

    table = to_arrow(records, types)
    with open(path, "wb") as file:  # by Python: Arrow opens only names that are UTF-8
        pq.write_table(table, file)


def _utf8(value: Any) -> Any:
    """Return a text that Parquet can hold: the name of a run may not be UTF-8."""
    return value.encode("utf-8", "backslashreplace").decode() if isinstance(value, str) else value
