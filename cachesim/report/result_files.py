"""Files of results -> rows: what ``npcache replay``, ``sweep``, ``time``, ``compare`` and ``table1`` wrote with ``-o``.

Another program may have written them again: a spreadsheet, polars or R with a byte order mark, or true for True.
"""

import csv
import json
from pathlib import Path
from typing import Any

from nptrace_base.errors import NptraceError
from traces.identity import COLUMNS

#: The endings of files of results.
ENDINGS = (".parquet", ".csv", ".json")

_TEXTS = {name for name, type_ in COLUMNS.items() if type_ is str} | {"prefetch", "layout", "policy", "clock", "class", "by"}


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Return the rows of a file of results, with the types that they have in JSON; NptraceError if it is none."""
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise NptraceError(f"{path} is neither a run nor a file of results, which end in {', '.join(ENDINGS)}; name another")
    try:
        rows = {".parquet": _parquet, ".csv": _csv, ".json": _json}[ending](path)
    except (ValueError, LookupError, TypeError, AttributeError) as e:  # Arrow's errors are among them
        raise NptraceError(f"{path} cannot be read ({(str(e) or type(e).__name__).splitlines()[0]}); write it again") from e
    if not rows or not all(isinstance(row, dict) and row.get("run") for row in rows):
        raise NptraceError(f"{path} has no rows of results, whose columns begin with run; write it again with -o {path.name}")
    return rows


def _parquet(path: Path) -> list[dict[str, Any]]:
    import pyarrow.parquet as pq

    with open(path, "rb") as file:
        found: list[dict[str, Any]] = pq.read_table(file).to_pylist()
    return found


def _json(path: Path) -> list[dict[str, Any]]:
    found = json.loads(path.read_text(encoding="utf-8-sig"))
    return found if isinstance(found, list) else [found]


def _csv(path: Path) -> list[dict[str, Any]]:
    with open(path, encoding="utf-8-sig", newline="") as file:
        return [{name: _value(name, text) for name, text in row.items()} for row in csv.DictReader(file, strict=True)]


def _value(name: str, text: str | None) -> Any:
    if not text:
        return None
    if name in _TEXTS:
        return text
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    for number in (int, float):
        try:
            return number(text)
        except ValueError:
            pass
    return text
