"""Table I says which runs it is of: those that are not as usual are named, and so is what was asked for of each tree."""

from dataclasses import replace

import pytest

from cachesim.report import table1_tables
from cachesim.report.table1 import choose_runs, table1
from nptrace.studies import table1_notes
from rtrace.run_names import unusual
from rtrace.scenes.catalog import CATALOG
from tests.reference.traces import make_trace, write
from traces.identity import RunIdentity, camera_text, point_text

BUNNY = CATALOG["bunny"]
USUAL = RunIdentity(
    "bunny-kdtree", scene="bunny", stand_in=False, tree="kdtree",
    builder="builder=sah c_isect=2.0 c_trav=1.5 empty_bonus=1.0 max_level=511 max_refs=99", width=128, height=128,
    order="scanline", batch=1, packet=1, shadow="lit", shadow_order="sign", shadow_end="stop",
    camera=camera_text(BUNNY.camera), light=point_text(BUNNY.light),
)  # fmt: skip


def test_a_usual_run_has_nothing_to_tell():
    assert unusual(USUAL) == []
    assert unusual(replace(USUAL, tree="bvh", builder="builder=sweep")) == []
    assert unusual(replace(USUAL, stand_in=True, camera="fitted", light="fitted")) == []


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("width", 512, "512x128 pixels"), ("order", "morton", "order morton"), ("batch", 64, "batch 64"),
        ("packet", 64, "packet 64"), ("shadow", "all", "shadow all"), ("shadow_order", "cheaper", "shadow-order cheaper"),
        ("shadow_end", "drain", "shadow-end drain"), ("camera", "x", "another camera"), ("light", "x", "another light"),
        ("builder", "builder=sah max_level=16", "max_level16"),
    ],
)  # fmt: skip
def test_everything_else_is_told(name, value, text):
    assert unusual(replace(USUAL, **{name: value})) == [text]


@pytest.fixture
def rows(tmp_path):
    """Tables of two runs that are not as usual."""
    runs = [
        write(make_trace(tree, 1, n_rays=30), tmp_path / f"bunny-{tree}-morton", order="morton") for tree in ("kdtree", "bvh")
    ]
    return table1(choose_runs(runs), threads=1)


def test_the_only_run_of_a_scene_is_taken_and_named(rows):
    [note] = [each for each in table1_notes(rows) if each.startswith("Runs that are not as usual")]
    assert "bunny-kdtree-morton: " in note and "1x30 pixels, order morton" in note
    assert "another view" not in note
    usual = replace(USUAL, run="bunny-bvh", tree="bvh", builder="builder=sweep")
    of_usual = [replace(row, identity=usual) for row in rows if row.tree == "bvh"]
    assert not any("not as usual" in each for each in table1_notes(of_usual))
    other = replace(USUAL, camera="fitted", light="fitted", stand_in=True)
    both = [*of_usual, *(replace(row, identity=other) for row in rows if row.tree == "kdtree")]
    assert any("bunny-kdtree (stand-in, " in each and "a view that another row" in each for each in table1_notes(both))


def test_a_row_names_what_was_asked_of_its_tree(rows):
    """One layout of two was told for both trees."""
    assert not any("Ours with" in each for each in table1_tables.notes(rows))
    of_one = [replace(row, layout="stored+8", reads="merged") if row.tree == "kdtree" else row for row in rows]
    told = [each for each in table1_tables.notes(of_one) if "ours with" in each.lower()]
    assert told == [
        "kd-tree: ours with lru replacement and the layout stored+8, reads merged; the paper's, whose caches are LRU, are "
        "what they are."
    ]
    of_both = [replace(row, policy="fifo") for row in rows]
    told = [each for each in table1_tables.notes(of_both) if "ours with" in each.lower()]
    assert told == ["Ours with fifo replacement and the layout stored; the paper's, whose caches are LRU, are what they are."]
