"""The charts of a report, drawn: no line joins or hides those of another case."""

import re

import pytest

from cachesim.report.page_charts import charts

vl_convert = pytest.importorskip("vl_convert")


def test_each_line_size_has_panels_of_its_own():
    """Lines of 32 and 64 bytes had one colour and one dash."""
    rows = [
        {
            "label": "x", "ways": ways, "line_bytes": line, "size_bytes": size, "layout": "stored", "prefetch": "traced",
            "demand_miss_rate": 0.1, "demand_miss_rate_without": 0.2,
        }
        for line in (32, 128) for ways in (2, 16) for size in (4096, 8192)
    ]  # fmt: skip
    [chart] = [each for each in charts() if each["name"] == "curves"]
    spec = {"columns": 2, **chart["spec"], "data": {"values": rows}}
    svg = vl_convert.vegalite_to_svg(spec)
    panels = re.findall(r">(\d+-way, lines of \d+ B)<", svg)
    assert panels == [f"{ways}-way, lines of {line} B" for line in (32, 128) for ways in (2, 16)]
    assert svg.count('aria-roledescription="line mark"') == 2 * len(panels)
