"""A report: runs and their results -> one HTML page that loads nothing, with the results in it as they are in JSON."""

import base64
import io
import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import metadata, resources
from pathlib import Path
from typing import Any

import numpy as np

from cachesim.config import format_bytes
from cachesim.knees import knees_of
from cachesim.report.cases import Row, identity_of, texts_of
from cachesim.report.distances import Distances
from cachesim.report.heat_figure import Scale
from cachesim.report.page_charts import charts
from cachesim.report.pictures import check_packages, ending_of
from cachesim.report.table1 import TREES
from nptrace_base.records import to_json
from nptrace_base.tables import number, percent
from traces.identity import RunIdentity, labels

#: What a page needs besides what is always installed: packages by module.
PACKAGES = {"jinja2": "jinja2", "vl_convert": "vl-convert-python"}
#: Cells of a heat map, or pixels of a picture, on its longer side: a larger one is shown in blocks.
MOST_CELLS = 256

#: The columns of the tables: heading, key of a row, and how its value is written.
Column = tuple[str, str, str]
COLUMNS: dict[str, list[Column]] = {
    "replay": [
        ("demand accesses", "demand_accesses", "n"), ("demand misses", "demand_misses", "n"),
        ("demand miss rate", "demand_miss_rate", "%"), ("paper miss rate", "paper_miss_rate", "%"),
        ("bytes from memory", "bytes_from_memory", "n"), ("coverage", "coverage", "%"),
        ("traffic ratio", "traffic_ratio", "x"), ("requests", "prefetch_accesses", "n"), ("redundant", "redundant", "n"),
        ("useful", "useful", "n"), ("useless", "useless", "n"), ("resident", "resident", "n"), ("accuracy", "accuracy", "%"),
        ("pollution", "pollution", "n"),
    ],
    "sweep": [
        ("demand miss rate", "demand_miss_rate", "%"), ("without prefetching", "demand_miss_rate_without", "%"),
        ("paper miss rate", "paper_miss_rate", "%"), ("traffic ratio", "traffic_ratio", "x"),
    ],
    "levels": [
        ("level", "level", "n"), ("demand accesses", "demand_accesses", "n"), ("demand misses", "demand_misses", "n"),
        ("demand miss rate", "demand_miss_rate", "%"), ("requests", "prefetch_accesses", "n"), ("useful", "useful", "n"),
    ],
    "compare": [
        ("cycles per ray", "cycles_per_ray", "1"), ("speed-up", "speed_up", "x"), ("of the bound", "share_of_bound", "%"),
        ("traffic ratio", "traffic_ratio", "x"), ("accuracy", "accuracy", "%"), ("coverage", "coverage", "%"),
        ("demand miss rate", "demand_miss_rate", "%"), ("requests per read", "requests_per_read", "x"),
        ("pollution", "pollution", "n"),
    ],
}  # fmt: skip

#: The columns of Table I that the paper has too; ``_paper`` is its number.
TABLE1: list[Column] = [
    ("miss A", "demand_miss_rate_without", "%"), ("miss B", "paper_miss_rate", "%"), ("miss B/A", "paper_ratio", "%"),
    ("KB A", "bytes_from_memory_without", "KB"), ("KB B", "bytes_from_memory", "KB"),
    ("KB B/A", "traffic_ratio", "%"), ("ACPR A", "acpr_without", "1"), ("ACPR B", "acpr", "1"),
    ("ACPR B/A", "acpr_ratio", "%"),
]  # fmt: skip
#: And those that are ours alone.
OURS: list[Column] = [("demand B/A", "demand_ratio", "%"), ("speed-up", "speed_up", "x")]


@dataclass(frozen=True)
class Heat:
    """The heat maps of a kind, one for each run, (height, width) of numbers, on one scale; None for a run of packets."""

    kind: str
    scale: Scale
    maps: Sequence[np.ndarray | None]


@dataclass
class Report:
    """What a page shows.

    Attributes
    ----------
    runs : sequence of RunIdentity
    facts : sequence of dict
        What each run holds, as texts by name; ``command`` makes it again.
    pictures : sequence of array
        (height, width, 3) uint8, one for each run.
    results : dict
        Records by command: ``replay``, ``sweep``, ``levels``, ``compare``, ``table1``.
    notes, commands : dict
        The sentences below the results, and the command that prints them, by the same names.
    verdicts : sequence of str
    cache : str
        That of the heat maps, the levels and the clock.
    """

    runs: Sequence[RunIdentity]
    facts: Sequence[Mapping[str, str]]
    pictures: Sequence[np.ndarray]
    results: Mapping[str, Sequence[Row]]
    notes: Mapping[str, Sequence[str]]
    commands: Mapping[str, str]
    verdicts: Sequence[str]
    cache: str
    command: str
    version: str
    heat: Sequence[Heat] = ()
    distances: Sequence[Distances] = field(default_factory=list)


def check_page(path: Path) -> None:
    """Raise NptraceError if a page cannot be written into a file: its ending is another, or a package is missing."""
    ending_of(path, [".html"])
    check_packages("a report", PACKAGES)


def page(report: Report) -> str:
    """Return the page."""
    from jinja2 import Environment

    names = labels(report.runs)
    made = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True).from_string(
        _file("page.html")
    )
    tables = {name: table(rows, COLUMNS[name], names) for name, rows in report.results.items() if name in COLUMNS}
    if report.results.get("table1"):
        tables["table1"] = table1_table(report.results["table1"])
    return made.render(
        report=report, runs=_runs(report, names), tables=tables, charts=_charts(report), data=_script(_data(report, names)),
        style=_file("page.css"), script=_file("page.js"), trees=_trees(report.runs), scenes=_scenes(report.runs),
        library=_library(),
    )  # fmt: skip


def table(rows: Sequence[Row], columns: Sequence[Column], names: Mapping[RunIdentity, str]) -> dict[str, Any]:
    """Return the head and the lines of a table: cells with a text and what they are sorted by."""
    facts = texts_of(rows, without=("run",), is_spelled=True)
    head = ["run", *(["case"] if any(facts) else []), *(heading for heading, _, _ in columns)]
    lines = []
    for row, fact in zip(rows, facts, strict=True):
        cells = [_cell(names[identity_of(row)])] + ([_cell(fact, _size_first(row))] if any(fact for fact in facts) else [])
        lines.append(_line(row, cells + [_number(row, key, form) for _, key, form in columns]))
    return {"head": head, "n_left": len(head) - len(columns), "lines": lines}


def table1_table(rows: Sequence[Row]) -> dict[str, Any]:
    """Return Table I: of each number ours, the paper's below it, and a shade for how far apart they are."""
    head = ["tree", "scene", "cache", *(heading for heading, _, _ in (*TABLE1, *OURS))]
    lines = []
    for row in rows:
        scene = f"{row['scene']}{' (stand-in)' if row['stand_in'] else ''}"
        cells = [
            _cell(TREES[row["tree"]]),
            _cell(scene),
            _cell(f"{format_bytes(row['size_bytes'])} {row['ways']}-way", _size_first(row)),
        ]
        for _, key, form in TABLE1:
            ours, paper = row[key], row[f"{key}_paper"]
            cell = _number(row, key, form) | {"paper": _text(paper, form)}
            if ours is not None and paper:
                apart = ours / paper - 1
                cell |= {
                    "shade": shade(apart),
                    "title": f"diff {_text(ours - paper, form)}, {100 * apart:+.1f} % of the paper's",
                }
            cells.append(cell)
        lines.append(_line(row, cells + [_number(row, key, form) for _, key, form in OURS]))
    return {"head": head, "n_left": 3, "lines": lines}


def shade(apart: float) -> str:
    """Return the class of a cell whose number is above (+) or below the paper's by a share of it; "" if by less than 5 %."""
    steps = sum(abs(apart) >= least for least in (0.05, 0.15, 0.4))
    return f"{'more' if apart > 0 else 'less'}{steps}" if steps else ""


def _line(row: Row, cells: list[dict[str, Any]]) -> dict[str, Any]:
    return {"scene": row["scene"], "tree": row["tree"], "cells": cells}


def _cell(text: str, order: Any = None) -> dict[str, Any]:
    return {"text": text, "order": text if order is None else order}


def _size_first(row: Row) -> str:
    """Return what sorts cases: their sizes as numbers, and what else they are as text."""
    return f"{row['size_bytes']:012d} {row['ways']:06d} {row.get('layout')} {row.get('prefetch')}"


def _number(row: Row, key: str, form: str) -> dict[str, Any]:
    return {"text": _text(row[key], form), "order": row[key]}


def _text(value: Any, form: str) -> str:
    if form == "KB":
        return number(None if value is None else value / 1024)
    return percent(value) if form == "%" else number(value, {"n": 0, "1": 1, "x": 3}[form])


def _scenes(runs: Sequence[RunIdentity]) -> list[str]:
    return list(dict.fromkeys(str(run.scene) for run in runs))


def _trees(runs: Sequence[RunIdentity]) -> dict[str, str]:
    return {str(run.tree): TREES.get(str(run.tree), str(run.tree)) for run in runs}


def _runs(report: Report, names: Mapping[RunIdentity, str]) -> list[dict[str, Any]]:
    found = []
    for i, (run, facts, picture) in enumerate(zip(report.runs, report.facts, report.pictures, strict=True)):
        heat = [
            {"kind": each.kind, "label": each.scale.label, "total": f"{int(values.sum()):,}",
             "most": f"{int(values.max(initial=0)):,}", "number": n}
            for n, each in enumerate(report.heat) if (values := each.maps[i]) is not None
        ]  # fmt: skip
        found.append({
            "name": names[run], "scene": run.scene, "tree": run.tree, "facts": facts, "picture": _picture(picture),
            "heat": heat, "index": i,
        })  # fmt: skip
    return found


def _charts(report: Report) -> list[dict[str, Any]]:
    """Return the charts that have something to show."""
    have = {**{name: bool(rows) for name, rows in report.results.items()}, "distances": bool(report.distances)}
    have |= {"curve": bool(report.distances)}
    requests = any(row["prefetch_accesses"] for row in report.results["replay"])
    return [each for each in charts() if have.get(each["rows"]) and (each["name"] != "account" or requests)]


def _data(report: Report, names: Mapping[RunIdentity, str]) -> dict[str, Any]:
    """Return what the page's script reads; ``results`` are what ``--json`` prints."""
    results = {name: json.loads(to_json(rows)) for name, rows in report.results.items()}
    cases = texts_of(report.results["replay"]) if report.results.get("replay") else []
    return {
        "runs": [
            {"run": run.run, "path": run.path, "scene": run.scene, "tree": run.tree, "label": names[run]}
            for run in report.runs
        ],
        "results": results,
        "cases": [case or names[report.runs[0]] for case in cases],
        "distances": [row for each in report.distances for row in _histogram(each, names)],
        "curve": [row for each in report.distances for row in _curve(each, names)],
        "heat": [_heat(each) for each in report.heat],
        "charts": {each["name"]: each for each in _charts(report)},
    }


def _of(case: Distances, names: Mapping[RunIdentity, str]) -> dict[str, Any]:
    return {"label": names[case.identity], "scene": case.identity.scene, "tree": case.identity.tree}


def _histogram(case: Distances, names: Mapping[RunIdentity, str]) -> list[dict[str, Any]]:
    """Return a row for each power of two of the distance, in bytes."""
    return [
        {**_of(case, names), "low": case.line_bytes << k >> 1 if k else 0, "high": case.line_bytes << k, "share": share}
        for k, share in enumerate(case.shares)
    ]


def _curve(case: Distances, names: Mapping[RunIdentity, str]) -> list[dict[str, Any]]:
    """Return a row for each size of a fully associative cache."""
    knees = set(knees_of(case.sizes, case.rates))
    return [
        {**_of(case, names), "size_bytes": size * case.line_bytes, "rate": rate, "is_knee": size in knees}
        for size, rate in zip(case.sizes, case.rates, strict=True)
    ]


def blocks(values: np.ndarray) -> tuple[np.ndarray, int]:
    """Return the sums of a map, (height, width), over squares of as few pixels as ``MOST_CELLS`` allows, and their side."""
    side = -(-max(values.shape) // MOST_CELLS)
    rows, columns = (range(0, n, side) for n in values.shape)
    return np.add.reduceat(np.add.reduceat(values, rows, axis=0), columns, axis=1), side


def _heat(heat: Heat) -> dict[str, Any]:
    """Return the maps of a kind as compressed numbers of 32 bits, lowest byte first."""
    maps: list[dict[str, Any] | None] = []
    for values in heat.maps:
        if values is None:
            maps.append(None)
            continue
        cells, side = blocks(values)
        packed = zlib.compress(np.ascontiguousarray(cells, dtype="<u4").tobytes(), 9)
        maps.append({
            "width": cells.shape[1], "height": cells.shape[0], "side": side, "data": base64.b64encode(packed).decode("ascii"),
        })  # fmt: skip
    return {"kind": heat.kind, "label": heat.scale.label, "most": heat.scale.most, "maps": maps}


def _picture(picture: np.ndarray) -> str:
    """Return a picture as a data URI."""
    from PIL import Image

    image = Image.fromarray(picture)
    image.thumbnail((2 * MOST_CELLS, 2 * MOST_CELLS))
    out = io.BytesIO()
    image.save(out, format="PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(out.getvalue()).decode("ascii")


def _script(data: Any) -> str:
    """Return JSON that can stand in a script element: no name in it can end the element."""
    return json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


@cache
def _library() -> str:
    """Return the script of Vega-Lite and Vega, which takes seconds to make, below its licence, which a copy must have."""
    import vl_convert

    return f"/*\n{_licence()}\n*/\n{vl_convert.javascript_bundle('window.vegaEmbed = vegaEmbed;')}"


def _licence() -> str:
    """Return whose the script is, and its conditions: Vega's are those of the package that brings it."""
    files = metadata.files("vl-convert-python") or []
    texts = [file.read_text(encoding="utf-8") for file in files if file.name.upper().startswith("LICEN")]
    holders = (
        "Vega, Vega-Lite, Vega-Embed: Copyright (c) 2013-2024, University of Washington Interactive Data Lab, BSD 3-Clause.\n"
        "D3: Copyright (c) 2010-2024, Mike Bostock, ISC. They come with VlConvert, whose licence is also that of Vega:\n\n"
    )
    return (holders + "\n".join(texts)).replace("*/", "* /")


def _file(name: str) -> str:
    return resources.files("cachesim.report").joinpath(name).read_text(encoding="utf-8")
