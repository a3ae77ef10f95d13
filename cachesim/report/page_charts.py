"""The charts of a report: what each shows of the rows of results, in Vega-Lite; the page gives them their rows and colours."""

from typing import Any

from cachesim.report.pictures import COLOURS

_RUN: Any = {"field": "label", "title": "run", "scale": {"range": list(COLOURS)}, "legend": {"symbolType": "circle"}}
_SIZES = {"type": "log", "base": 2}
#: Text of a size in bytes on an axis: 8K.
_BYTES = "datum.value >= 1048576 ? datum.value / 1048576 + 'M' : datum.value >= 1024 ? datum.value / 1024 + 'K' : datum.value"


def _hover(*fields: tuple[str, str, str]) -> list[dict[str, Any]]:
    return [
        {"field": field, "title": title} | ({"format": form, "type": "quantitative"} if form else {})
        for field, title, form in (("label", "run", ""), *fields)
    ]  # fmt: skip


def _size(field: str, title: str, **more: Any) -> dict[str, Any]:
    axis = {"labelExpr": _BYTES, "tickCount": 8}
    return {"field": field, "type": "quantitative", "title": title, "scale": _SIZES | {"nice": False}, "axis": axis, **more}


def charts() -> list[dict[str, Any]]:
    """Return the charts: name, title, the text that stands for it where it is not seen, columns of panels, and the spec.

    ``rows`` names the rows, of the results or of the distances, that become the data of the spec.
    """
    return [_curves(), _account(), _levels(), _distances(), _knees(), _speed_ups()]


def _chart(
    name: str, rows: str, title: str, alt: str, spec: dict[str, Any], n_across: int = 1, lines: str = ""
) -> dict[str, Any]:
    return {"lines": lines, "name": name, "rows": rows, "title": title, "alt": alt, "columns": n_across, "spec": spec}


def _curves() -> dict[str, Any]:
    hover = _hover(
        ("size_bytes", "size", ",d"),
        ("ways", "ways", "d"),
        ("line_bytes", "line (bytes)", "d"),
        ("prefetching", "prefetching", ""),
        ("rate", "demand miss rate", ".2%"),
    )
    spec = {
        "transform": [
            {"calculate": "datum.demand_miss_rate", "as": "with"},
            {"calculate": "datum.demand_miss_rate_without", "as": "without"},
            {"fold": ["without", "with"], "as": ["prefetching", "rate"]},
            {"calculate": "datum.ways + '-way, lines of ' + datum.line_bytes + ' B'", "as": "panel"},
            {"calculate": "datum.line_bytes * 1048576 + datum.ways", "as": "place"},
        ],
        "facet": {"field": "panel", "type": "nominal", "title": None, "sort": {"field": "place", "op": "min"}},
        "columns": 2,
        "spec": {
            "height": 210,
            "mark": {"type": "line", "point": {"size": 28}, "strokeWidth": 1.6},
            "encoding": {
                "x": _size("size_bytes", "cache size (bytes)"),
                "y": {"field": "rate", "type": "quantitative", "title": "demand miss rate", "axis": {"format": ".0%"}},
                "color": _RUN,
                "strokeDash": {
                    "field": "prefetching", "title": "prefetching",
                    "scale": {"domain": ["with", "without"], "range": [[1, 0], [5, 4]]},
                    "legend": None,
                },
                "detail": [{"field": "layout"}, {"field": "prefetch"}],
                "tooltip": hover,
            },
        },
    }  # fmt: skip
    alt = (
        "Lines: demand miss rate over cache size, solid with and dashed without prefetching, a panel for each number of ways "
        "and size of a line."
    )
    return _chart("curves", "sweep", "Miss-rate curves; dashed: without prefetching", alt, spec, 2)


def _account() -> dict[str, Any]:
    parts = ["redundant", "useful", "useless", "resident"]
    spec = {
        "height": {"step": 22},
        "transform": [
            {"filter": "datum.prefetch_accesses > 0"},
            {"fold": parts, "as": ["what", "requests"]},
            {"calculate": "datum.requests / datum.prefetch_accesses", "as": "share"},
            {"calculate": f"indexof({parts}, datum.what)", "as": "place"},
        ],
        "mark": "bar",
        "encoding": {
            "y": {"field": "case", "type": "nominal", "title": None, "sort": None, "axis": {"labelLimit": 260}},
            "x": {
                "field": "share", "type": "quantitative", "title": "share of the prefetch requests", "stack": "zero",
                "axis": {"format": ".0%"}, "scale": {"domain": [0, 1]},
            },
            "color": {
                "field": "what", "title": "what became of them",
                "scale": {"domain": parts, "range": ["#a8a8a8", COLOURS[0], COLOURS[1], COLOURS[5]]},
            },
            "order": {"field": "place"},
            "tooltip": _hover(("what", "what became", ""), ("requests", "requests", ",d"), ("share", "share", ".2%")),
        },
    }  # fmt: skip
    alt = "Bars: the shares of the prefetch requests that were redundant, useful, useless, or still resident at the end."
    return _chart("account", "replay", "What became of the prefetches", alt, spec, lines="case")


def _levels() -> dict[str, Any]:
    x: dict[str, Any] = {
        "field": "level",
        "type": "quantitative",
        "title": "level of the node (root: 0)",
        "axis": {"tickMinStep": 1},
    }
    x["scale"] = {"domainMin": -0.5, "nice": False}
    hover = _hover(
        ("level", "level", "d"), ("demand_accesses", "demand accesses", ",d"), ("demand_misses", "demand misses", ",d"),
        ("demand_miss_rate", "demand miss rate", ".2%"),
    )  # fmt: skip
    spec = {
        "transform": [
            {"calculate": "datum.demand_accesses - datum.demand_misses", "as": "hits"},
            {"calculate": "datum.demand_misses", "as": "misses"},
            {"fold": ["misses", "hits"], "as": ["what", "n"]},
        ],
        "facet": {"field": "label", "type": "nominal", "title": None, "sort": None},
        "columns": 2,
        "spec": {
            "height": 150,
            "mark": {"type": "bar", "width": {"band": 1}, "binSpacing": 0, "size": 7},
            "encoding": {
                "x": x,
                "y": {
                    "field": "n", "type": "quantitative", "title": "demand accesses", "axis": {"format": "~s", "tickCount": 4}
                },
                "color": {
                    "field": "what", "title": "demand accesses that",
                    "scale": {"domain": ["misses", "hits"], "range": [COLOURS[1], COLOURS[4]]},
                    "legend": {"labelExpr": "datum.value == 'misses' ? 'miss' : 'hit'"},
                },
                "order": {"field": "what", "sort": "descending"},
                "tooltip": hover,
            },
        },
        "resolve": {"scale": {"x": "shared", "y": "shared"}},
    }  # fmt: skip
    alt = "Bars: demand accesses of each level of the tree, those that hit and those that miss, a panel for each run."
    return _chart("levels", "levels", "Accesses and misses by level", alt, spec, 2)


def _distances() -> dict[str, Any]:
    hover = _hover(("low", "above", ",d"), ("high", "up to (bytes)", ",d"), ("share", "share of demand accesses", ".2%"))
    spec = {
        "height": 230,
        "mark": {"type": "line", "interpolate": "step-before", "point": {"size": 22}, "strokeWidth": 1.6},
        "encoding": {
            "x": _size("high", "stack distance, up to (bytes)"),
            "y": {"field": "share", "type": "quantitative", "title": "demand accesses", "axis": {"format": ".0%"}},
            "color": _RUN,
            "tooltip": hover,
        },
    }
    alt = "Steps: the share of demand accesses by stack distance, in powers of two, a line for each run."
    return _chart("distances", "distances", "Stack distances", alt, spec)


def _knees() -> dict[str, Any]:
    x = _size("size_bytes", "size of a fully associative LRU cache (bytes)")
    y = {"field": "rate", "type": "quantitative", "title": "demand miss rate", "axis": {"format": ".0%"}}
    hover = _hover(("size_bytes", "size", ",d"), ("rate", "demand miss rate", ".2%"))
    points = {
        "transform": [{"filter": "datum.is_knee"}],
        "mark": {"type": "point", "size": 70, "filled": True, "opacity": 1},
        "encoding": {"x": x, "y": y, "color": _RUN, "tooltip": hover},
    }
    line = {
        "mark": {"type": "line", "strokeWidth": 1.6}, "encoding": {"x": x, "y": y, "color": _RUN, "tooltip": hover}
    }  # fmt: skip
    alt = "Lines: the miss rate of a fully associative LRU cache over its size; dots mark the knees."
    return _chart("knees", "curve", "What they make of a cache, with its knees", alt, {"height": 230, "layer": [line, points]})


def _speed_ups() -> dict[str, Any]:
    hover = _hover(
        ("prefetch", "prefetch policy", ""), ("speed_up", "speed-up", ".3f"), ("cycles_per_ray", "cycles per ray", ",.1f"),
        ("traffic_ratio", "bytes, with / without", ".3f"),
    )  # fmt: skip
    dots = {
        "mark": {"type": "point", "filled": True, "size": 70, "opacity": 0.85},
        "encoding": {
            "y": {
                "field": "prefetch", "type": "nominal", "title": None,
                "sort": {"field": "speed_up", "op": "mean", "order": "descending"}, "axis": {"grid": True, "labelLimit": 260},
            },
            "x": {
                "field": "speed_up", "type": "quantitative", "title": "speed-up over no prefetching",
                "scale": {"zero": False, "padding": 10},
            },
            "color": _RUN,
            "tooltip": hover,
        },
    }  # fmt: skip
    rule = {"mark": {"type": "rule", "strokeDash": [4, 3]}, "encoding": {"x": {"datum": 1}}}
    spec = {
        "height": {"step": 20},
        "transform": [{"filter": "datum.group == 'policy' && datum.prefetch != 'perfect' && datum.speed_up != null"}],
        "layer": [rule, dots],
    }
    alt = "Dots: the speed-up of each prefetch policy over none, a colour for each run; a line marks 1."
    return _chart("speed-ups", "compare", "The clock: speed-ups of the prefetch policies", alt, spec, lines="prefetch")
