"""Runs in which another tool changed values, types, columns, rows or row groups, and a slow reader of them."""

import json
import random
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq

from tests.reference.cache import derive
from tests.reference.traces import make_trace, write
from traces.format import ACCESSES, FILES, METADATA_KEY, NODES, RAYS

SCHEMAS = {"accesses": ACCESSES, "rays": RAYS, "nodes": NODES}

#: Other types that hold numbers, and some that do not.
TYPES = (
    pa.int8(), pa.int16(), pa.int32(), pa.int64(), pa.uint8(), pa.uint16(), pa.uint32(), pa.uint64(),
    pa.float32(), pa.float64(),
    pa.dictionary(pa.int32(), pa.int64()), pa.dictionary(pa.int8(), pa.uint32()), pa.string(), pa.large_string(), pa.bool_(),
    pa.timestamp("us"), pa.decimal128(20, 2), pa.list_(pa.int64()), pa.null(), pa.binary(),
)  # fmt: skip
NUMBERS = (0, 1, 2, 3, 4, 7, -1, 255, 256, 65535, 65536, 2**31 - 1, 2**31, 2**32 - 1, 2**32, 2**63 - 1, 0.5, 1.0)


class Mutated(NamedTuple):
    """What the files of a changed run hold, as Python values; None where a column is missing or of no number."""

    kind: str
    tables: dict[str, dict[str, list[Any]]]
    what: list[str]


@cache
def good_run(kind: str, folder: Path) -> tuple[dict[str, tuple[pa.Table, dict[bytes, bytes]]], bytes]:
    """Return the tables of a small run with their footers, and its picture."""
    path = folder / f"good-{kind}"
    write(make_trace(kind, 3, n_rays=6, max_level=4), path)
    tables = {}
    for name in SCHEMAS:
        with pq.ParquetFile(path / f"{name}.parquet") as file:
            tables[name] = file.read().replace_schema_metadata(None), {METADATA_KEY: file.metadata.metadata[METADATA_KEY]}
    return tables, (path / FILES[3]).read_bytes()


def mutate(seed: int, path: Path, folder: Path) -> Mutated:
    """Write a changed run to ``path``; the same seed gives the same run."""
    rng = random.Random(seed)
    kind = rng.choice(("kdtree", "bvh"))
    good, image = good_run(kind, folder)
    tables = {name: table for name, (table, _) in good.items()}
    what: list[str] = []
    for _ in range(rng.choice((0, 1, 1, 1, 2, 3))):
        name = rng.choice(list(tables))
        if len(set(tables[name].column_names)) < len(tables[name].column_names):
            continue  # two columns of one name: more changes would not say which
        change = rng.choice((_value, _value, _value, _near, _near, _null, _type, _type, _order, _rows, _columns))
        tables[name], said = change(rng, tables[name], SCHEMAS[name].names)
        what.append(f"{name}: {said}")
    path.mkdir(exist_ok=True)
    n_rows = {f"n_{name}": len(table) for name, table in tables.items()}
    is_told = rng.random() < 0.9  # the footers tell of the rows that are there now
    for name, table in tables.items():
        footer = json.loads(good[name][1][METADATA_KEY]) | (n_rows if is_told else {})
        if rng.random() < 0.01:
            what.append(f"{name}: footer")
            footer |= {rng.choice(("tree", "scene", "n_nodes", "width")): rng.choice((None, 5, "x", [], {}, 2**70))}
        with pq.ParquetWriter(
            path / f"{name}.parquet", table.schema,
            use_dictionary=rng.random() < 0.5, compression=rng.choice(("none", "snappy", "zstd")),
            data_page_size=rng.choice((64, 1 << 20)), version=rng.choice(("1.0", "2.6")), store_schema=rng.random() < 0.5,
        ) as file:  # fmt: skip
            file.write_table(table, row_group_size=rng.choice((1 if rng.random() < 0.1 else 50, 64, 1 << 20)))
            file.add_key_value_metadata({METADATA_KEY: json.dumps(footer, sort_keys=True).encode()})
    (path / FILES[3]).write_bytes(image)
    if not is_told and any(len(table) != len(good[name][0]) for name, table in tables.items()):
        what.append("footers tell of other rows")
    return Mutated(kind, {name: _python(table) for name, table in tables.items()}, what)


def is_as_good(run: Mutated) -> bool:
    """Return whether nothing changed but what must not matter: order, other columns, other types of the same numbers."""
    harmless = ("order of columns", "a column ray_", "a column Node", "a column kind2", "no rows", "no values of")
    numbers = [f" as {type_}" for type_ in TYPES[: TYPES.index(pa.string())]]
    return all(any(each in said for each in harmless) or said.endswith(tuple(numbers)) for said in run.what)


def _python(table: pa.Table) -> dict[str, list[Any]]:
    return {name: table.column(i).to_pylist() for i, name in enumerate(table.column_names)}


def _replaced(table: pa.Table, column: str, values: list[Any], type_: pa.DataType) -> pa.Table:
    index = table.column_names.index(column)
    return table.set_column(index, pa.field(column, type_), pa.array(values, type_))


def _changed(rng: random.Random, table: pa.Table, names: list[str], new: Any) -> tuple[pa.Table, str]:
    column = rng.choice([name for name in names if name in table.column_names] or table.column_names)
    values, type_ = table.column(column).to_pylist(), table.column(column).type
    for row in rng.sample(range(len(values)), min(len(values), rng.choice((1, 1, 2, 9)))):
        values[row] = new(values[row])
    try:
        return _replaced(table, column, values, type_), f"values of {column}"
    except (pa.ArrowException, OverflowError, TypeError):
        for wider in (pa.int64(), pa.uint64(), pa.float64()):
            try:
                return _replaced(table, column, values, wider), f"values of {column}, {wider}"
            except (pa.ArrowException, OverflowError, TypeError):
                continue
    return table, f"no values of {column}"


def _value(rng: random.Random, table: pa.Table, names: list[str]) -> tuple[pa.Table, str]:
    return _changed(rng, table, names, lambda before: rng.choice(NUMBERS))


def _near(rng: random.Random, table: pa.Table, names: list[str]) -> tuple[pa.Table, str]:
    return _changed(
        rng, table, names, lambda before: before + rng.choice((-1, 1, 2)) if isinstance(before, (int, float)) else before
    )


def _null(rng: random.Random, table: pa.Table, names: list[str]) -> tuple[pa.Table, str]:
    return _changed(rng, table, names, lambda before: None)


def _type(rng: random.Random, table: pa.Table, names: list[str]) -> tuple[pa.Table, str]:
    column, type_ = rng.choice(table.column_names), rng.choice(TYPES)
    try:
        values = table.column(column)
        if pa.types.is_dictionary(type_):
            changed = values.cast(type_.value_type).dictionary_encode().cast(type_)
        else:
            changed = values.cast(type_)
        return table.set_column(table.column_names.index(column), pa.field(column, type_), changed), f"{column} as {type_}"
    except (pa.ArrowException, OverflowError):
        return table, f"no {column} as {type_}"


def _order(rng: random.Random, table: pa.Table, names: list[str]) -> tuple[pa.Table, str]:
    return table.select(rng.sample(table.column_names, len(table.column_names))), "order of columns"


def _rows(rng: random.Random, table: pa.Table, names: list[str]) -> tuple[pa.Table, str]:
    n = len(table)
    if not n:
        return table, "no rows"
    at, width = rng.randrange(n), rng.choice((1, 2, n))
    kept = rng.choice((
        [*range(at), *range(min(at + width, n), n)], [*range(n), *range(at, min(at + width, n))],
        [*range(at, n), *range(at)], rng.sample(range(n), n),
    ))  # fmt: skip
    return table.take(pa.array(kept, pa.int64())), f"rows at {at}"


def _columns(rng: random.Random, table: pa.Table, names: list[str]) -> tuple[pa.Table, str]:
    column = rng.choice(table.column_names)
    if rng.random() < 0.5:
        return table.drop_columns([column]), f"no column {column}"
    extra = rng.choice(("ray_", "Node", column, "kind2", "split"))
    return table.append_column(extra, table.column(column)), f"a column {extra}"


# --- a slow reading -----------------------------------------------------------------------------------------------------


def legal_events(run: Mutated, prefetch: str) -> list[tuple[int, bool]] | None:
    """Return the (node, is a request) events of a run as a plain reading gives them; None if it breaks a rule.

    ``prefetch`` is ``traced`` or ``stack:budget=2``.
    """
    nodes = _legal_nodes(run)
    columns = _numbers(run.tables["accesses"], ("node", "kind"))
    if nodes is None or columns is None or "footers tell of other rows" in run.what:
        return None
    parent, n_prims = nodes
    inner = set(parent[1:])
    rows = list(zip(columns["node"], columns["kind"], strict=True))
    for node, kind in rows:
        if not 0 <= node < len(parent) or not 0 <= kind <= 3:
            return None
        if (kind == 1 and node not in inner) or (kind == 2 and node in inner):
            return None
        if kind == 0 and node not in inner and run.kind == "kdtree":
            return None
    if prefetch == "traced":
        return [(node, kind == 3) for node, kind in rows]
    if next((node for node, kind in rows if kind != 3), 0) != 0:
        return None  # no ray starts below the root
    try:
        return derive(rows, run.kind, n_prims, budget=2)
    except (AssertionError, IndexError):
        return None


def _numbers(table: dict[str, list[Any]], names: tuple[str, ...]) -> dict[str, list[int]] | None:
    out = {}
    for name in names:
        values = table.get(name)
        if values is None or any(type(value) not in (int, float) or value != value or value % 1 for value in values):
            return None
        out[name] = [int(value) for value in values]
    return out


def _legal_nodes(run: Mutated) -> tuple[list[int], list[int]] | None:
    columns = _numbers(run.tables["nodes"], ("node", "parent", "level", "axis", "n_prims"))
    if columns is None or len(columns["node"]) % 2 == 0:
        return None
    node, parent, level, axis, n_prims = columns.values()
    inner = set(parent[1:])
    legal = node == list(range(len(node))) and parent[0] == -1 and level[0] == 0
    legal = legal and all(0 <= up < i for i, up in enumerate(parent) if i) and parent[1::2] == parent[2::2]
    legal = legal and len(inner) == len(node) // 2
    legal = legal and all(level[i] == level[parent[i]] + 1 for i in range(1, len(node)))
    legal = legal and all(0 <= a <= 2 if i in inner else a == 3 for i, a in enumerate(axis))
    legal = legal and all(0 <= n < 2**32 and not (n and i in inner) for i, n in enumerate(n_prims))
    return (parent, n_prims) if legal else None
