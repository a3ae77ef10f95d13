"""The study from plan to page: it goes on where it stopped, and what its analysis finds is what was planted."""

import itertools

import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from cachesim.report.table1 import SCENES, TREES
from nptrace.table1_study.__main__ import main
from nptrace.table1_study.analysis import StudyRows, ranges, split, tornado
from nptrace.table1_study.cameras import own_camera, views
from nptrace.table1_study.figures import CACHES, cells, implied, read_rows, setting_of
from nptrace.table1_study.fit import Fits, held_out_by_cache, held_out_by_scene, summary
from nptrace.table1_study.knobs import KNOBS, Setting
from nptrace.table1_study.plan import QUICK_SCENES
from tests.nptrace.table1_study.planted import planted


def run_main(*args):
    done = CliRunner().invoke(main, [str(each) for each in args])
    assert done.exit_code == 0, (done.output, done.exception)
    return done.output


def test_the_quick_form_goes_on_where_it_stopped(tmp_path, monkeypatch):
    monkeypatch.delenv("NPTRACE_SCENES", raising=False)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    some, whole = tmp_path / "some.parquet", tmp_path / "whole.parquet"
    run_main("--quick", "--out", tmp_path / "parts", "-o", some, "--limit", 2)
    parts = {path: path.stat().st_mtime_ns for path in (tmp_path / "parts").iterdir()}
    assert len(parts) == 2
    run_main("--quick", "--out", tmp_path / "parts", "-o", whole)
    assert {path: path.stat().st_mtime_ns for path in parts} == parts  # kept, not made again
    rows = pq.read_table(whole).to_pylist()
    assert {(row["tree"], row["scene"]) for row in rows} == set(itertools.product(TREES, QUICK_SCENES))
    study = StudyRows(read_rows(whole))
    assert study.base == Setting(pixels=32)
    assert {row["changed"] for row in study.rows} >= {(), ("prefetch",), ("builder",), ("reads",)}
    for cell in cells():
        if cell[1] in QUICK_SCENES:
            assert setting_of(study.default(*cell)) == study.base


def test_a_planted_model_is_found_and_held_to_other_rows():
    """``budget=1`` is the paper's in all scenes, but only from the second view; the default is 3 points off, 1 from there."""
    settings = [Setting(), Setting(prefetch="stack:budget=1")]

    def off(setting, view, cell):
        if setting.prefetch == "stack:budget=1":
            return 0.0 if view[1] == "second" else 5.0
        return 1.0 if view[1] == "second" else 3.0

    rows = planted(off, settings=settings, views_of=lambda scene: [("", "first"), ("", "second")])
    fits = Fits(rows, ("builder", "layout", "reads"))
    model = fits.best()
    assert model.shared["prefetch"] == "stack:budget=1"
    assert set(model.views.values()) == {("", "second")}
    assert summary(model.residuals) == pytest.approx((0, 0, 1), abs=1e-9)
    for found, inside, outside in held_out_by_cache(fits):
        assert found.shared == model.shared
        assert inside.worst == pytest.approx(outside.worst, abs=1e-9) == 0
    for of in held_out_by_scene(fits).values():
        assert [round(each.median, 9) for each in of] == [5, 0]  # both views of the scene that was left out


def test_a_model_that_fits_half_of_the_rows_by_chance_is_found_out():
    """The default is right on one half and 8 points off on the other; ``budget=1`` is 3 points off everywhere."""
    half = CACHES[0], CACHES[3]

    def off(setting, view, cell):
        if setting.prefetch == "stack:budget=1":
            return 3.0
        return 0.0 if cell[2] in half else 8.0

    rows = planted(off, settings=[Setting(), Setting(prefetch="stack:budget=1")])
    first, second = held_out_by_cache(Fits(rows, ("builder",)))
    assert (first[1].worst, first[2].worst) == pytest.approx((0, 8), abs=1e-9)
    assert (second[1].worst, second[2].worst) == pytest.approx((3, 3), abs=1e-9)


def test_ranges_and_swings_are_those_planted():
    """``budget=1`` moves B/A down to the paper's, ``restart`` up by 2; ``budget=1`` with ``restart`` is not one knob."""
    settings = [Setting(), Setting(prefetch="stack:budget=1"), Setting(reads="merged"), Setting(order="random"),
                Setting(reads="merged", prefetch="stack:budget=1")]  # fmt: skip

    def off(setting, view, cell):
        if setting.order == "random":
            return 40.0
        return {("own", "stack:unlimited"): 4, ("own", "stack:budget=1"): 0.5, ("merged", "stack:unlimited"): 6}.get(
            (setting.reads, setting.prefetch), -3
        )

    study = StudyRows(planted(off, settings=settings))
    for each in ranges(study, ["miss_ratio"]):
        assert (each.low, each.default, each.high) == pytest.approx((each.paper - 3, each.paper + 4, each.paper + 6))
        assert each.is_inside
    [first, second, *others] = tornado(study, "bvh", "sponza", "miss_ratio")
    assert (first.knob, second.knob) == ("prefetch", "reads")
    assert (first.low, first.high, second.low, second.high) == pytest.approx((-3.5, 0, 0, 2))
    assert not others  # a value that the text contradicts is in no range


def test_the_paper_implies_its_traces():
    """The intervals of raytracing algebra: the four rows have the same accesses, and the same p but for its third digit."""
    apart = []
    for (tree, scene), accesses in zip(
        itertools.product(TREES, SCENES), (185, 564, 868, 486, 1302, 2677, 3393, 1900), strict=True
    ):
        paper = implied(tree, scene)
        assert paper.accesses[0] < paper.accesses[1]
        assert paper.p[0] < paper.p[1]
        apart += [(tree, scene)] if paper.p_gap else []
        assert paper.p_gap in (0, pytest.approx(paper.p[1] - paper.p[0]))
        assert sum(paper.accesses) / 2000 == pytest.approx(accesses, rel=0.005)
    assert apart == [("kdtree", "bunny"), ("kdtree", "sibenik"), ("bvh", "bunny")]
    assert implied("kdtree", "bunny").p_gap == pytest.approx(93.85 / 80.75 - 93.25 / 80.25)
    assert split(80, 100) == (20, 0)
    assert split(80, 95) == pytest.approx((100 - 8000 / 95, 8000 / 95 - 80))


def test_every_published_view_looks_at_its_scene():
    for scene in SCENES:
        found = views(scene)
        assert len({(view.version, view.camera) for view in found}) == len(found)
        if not found[0].seen.stand_in:
            own = found[0].seen.camera
            assert found[0].camera == own_camera(scene)
            assert own.fov in (31.417, 45.0, 60.0)
    assert len({knob.name for knob in KNOBS}) == len(KNOBS)
