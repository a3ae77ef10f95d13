"""The break-even map: what its table and sentences count, and which scenes they are of."""

from xml.etree import ElementTree

import pytest

from cachesim.report.cases import STAND_IN_NOTE
from cachesim.report.map_tables import plot, tables


def cell(speed_up, half=None, **changes):
    """Return a row of a map: a cell with this speed-up, or with this interval."""
    facts = {
        "scene": "bunny", "stand_in": False, "tree": "bvh", "prefetch": "push", "leaf": 1, "size_bytes": 8192, "ways": 1,
        "triangle": 8, "miss": 100, "rays": 1, "one_in": 1 if half is None else 4,
    }  # fmt: skip
    return facts | {"speed_up": speed_up, "speed_up_half_width": half} | changes


def texts_of(path):
    found = ElementTree.parse(path).iter()
    return " ".join(" ".join(element.itertext()) for element in found if element.tag.endswith("text"))


def test_a_cell_pays_or_costs_only_beyond_its_interval():
    """Cells of which nobody knows were counted, and the widest interval was the best."""
    rows = [cell(1.04, 0.05), cell(1.02, 0.01), cell(0.9, 0.2), cell(0.98, 0.01)]
    [table], notes = tables(rows)
    named = dict(zip(table.header, table.rows[0], strict=True))
    assert (named["pays\n%"], named["costs\n%"], named["cells"]) == ("25", "25", "4")
    assert "1.02 +- 0.01x at best" in notes[-1] and "costs up to 2.0 % more cycles" in notes[-1]
    assert "A cell pays or costs only if all of its interval lies above 1.005 or below 0.995." in notes[-2]
    [table], notes = tables([cell(each["speed_up"]) for each in rows])
    named = dict(zip(table.header, table.rows[0], strict=True))
    assert (named["pays\n%"], named["costs\n%"]) == ("50", "50")
    assert "1.04x at best" in notes[-1] and "costs up to 11.1 % more cycles" in notes[-1] and "interval" not in " ".join(notes)


def test_a_policy_that_pays_nowhere():
    assert tables([cell(1.04, 0.05), cell(1.0)])[1][-1] == (
        "BVH, 32-byte nodes: asking at the push gives 1.020x in the middle, and pays in no cell."
    )


def test_a_cell_without_reads_has_no_speed_up(tmp_path):
    """The median of nothing ended the plot."""
    rows = [cell(None), cell(1.2, rays=4)]
    assert [line[2] for line in tables(rows)[0][0].rows] == ["4"]
    pytest.importorskip("matplotlib")
    plot(rows, tmp_path / "x.svg")
    assert "1.20" in texts_of(tmp_path / "x.svg")


def test_stand_ins_are_marked(tmp_path):
    rows = [cell(1.5, stand_in=True), cell(1.2, scene="sponza")]
    notes = tables(rows)[1]
    assert f"{STAND_IN_NOTE} In this map: bunny (stand-in)." in notes
    assert "1.50x at best (bunny (stand-in), leaf 1" in notes[-1]
    assert not any("stand-in" in note for note in tables(rows[1:])[1])
    pytest.importorskip("matplotlib")
    plot(rows, tmp_path / "x.svg")
    assert "scenes: bunny (stand-in), sponza" in texts_of(tmp_path / "x.svg")
