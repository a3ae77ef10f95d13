"""The break-even map: what its table and sentences count, and which scenes they are of."""

from xml.etree import ElementTree

import pytest

from cachesim.report.cases import STAND_IN_NOTE
from cachesim.report.map_tables import plot, tables


def cell(speed_up, half=None, **changes):
    """Return a row of a map: a cell with this speed-up, or with this interval."""
    facts = {
        "scene": "bunny", "stand_in": False, "tree": "bvh", "prefetch": "push", "leaf": 1, "size_bytes": 8192, "ways": 1,
        "triangle": 8, "miss": 100, "rays": 1, "parts": 1 if half is None else 4,
    }  # fmt: skip
    return facts | {"speed_up": speed_up, "speed_up_half_width": half} | changes


def texts_of(path):
    found = ElementTree.parse(path).iter()
    return " ".join(" ".join(element.itertext()) for element in found if element.tag.endswith("text"))


def test_stand_ins_are_marked(tmp_path):
    rows = [cell(1.5, stand_in=True), cell(1.2, scene="sponza")]
    notes = tables(rows)[1]
    assert f"{STAND_IN_NOTE} In this map: bunny (stand-in)." in notes
    assert "1.50x at best (bunny (stand-in), leaf 1" in notes[-1]
    assert not any("stand-in" in note for note in tables(rows[1:])[1])
    pytest.importorskip("matplotlib")
    plot(rows, tmp_path / "x.svg")
    assert "scenes: bunny (stand-in), sponza" in texts_of(tmp_path / "x.svg")
