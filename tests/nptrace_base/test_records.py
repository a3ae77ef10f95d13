"""Records as JSON, CSV and Parquet: whole numbers stay whole, nothing is NaN or infinite, what is not known is empty."""

import csv
import io
import json
import math

import pyarrow.parquet as pq

from nptrace_base.records import to_csv, to_json, write_parquet

RECORDS = [
    {"run": "a", "rate": None, "n": 1 << 53, "is_good": None, "only": None},
    {"run": "b\udce9", "rate": 0.1, "n": 2, "is_good": True, "only": None},
]


def test_json_has_no_nan_and_no_infinity():
    text = to_json([{"bound": math.inf, "cells": [{"value": math.nan}, (1.5, -math.inf)]}])
    assert json.loads(text, parse_constant=lambda name: 1 / 0) == [
        {"schema_version": 1, "bound": None, "cells": [{"value": None}, [1.5, None]]}
    ]


def test_csv_has_every_key_of_every_record():
    rows = list(csv.DictReader(io.StringIO(to_csv([{"a": 1}, {"a": None, "b": 0.1}]))))
    assert rows == [{"a": "1", "b": ""}, {"a": "", "b": "0.1"}]


def test_parquet_has_types_also_of_empty_columns(tmp_path):
    write_parquet(RECORDS, tmp_path / "x.parquet", {"only": str})
    table = pq.read_table(tmp_path / "x.parquet")
    types = {field.name: str(field.type) for field in table.schema}
    assert types == {"run": "string", "rate": "double", "n": "int64", "is_good": "bool", "only": "string"}
    assert table.to_pylist() == [RECORDS[0], {**RECORDS[1], "run": "b\\udce9"}]
