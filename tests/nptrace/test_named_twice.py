"""A run that is named twice, by whatever name, has its rows and its panel once, in Python as on the command line."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

import cli
import nptrace as nt
from tests.nptrace.test_terminal import inputs

RUN, OTHER = "traces/bunny-bvh", "traces/bunny-kdtree"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    inputs(tmp_path)
    Path("link").symlink_to(RUN)
    return tmp_path


def test_rows_come_once_in_the_order_in_which_runs_are_named(folder):
    named = [OTHER, RUN, f"./{RUN}", "link", OTHER]
    rows = json.loads(CliRunner().invoke(cli.npcache, ["replay", *named, "--json"]).stdout)
    assert [row["path"] for row in rows] == [OTHER, RUN]
    assert [row["path"] for row in nt.replay([nt.open(OTHER), RUN, nt.open("link"), Path(RUN).absolute(), OTHER])] == [
        OTHER,
        RUN,
    ]
    assert [row["run"] for row in nt.sweep(["traces", RUN], size="4K")] == ["bunny-bvh", "bunny-kdtree"]


def test_a_picture_has_each_run_once(folder):
    pytest.importorskip("matplotlib")
    once = nt.view([RUN, OTHER], heat="accesses")._repr_png_()
    assert nt.view([RUN, nt.open("link"), OTHER, RUN], heat="accesses")._repr_png_() == once


def test_one_summary_needs_no_list(folder):
    file = nt.summarise(RUN, "all.sum", part=(1, 1))
    for same in (file, str(file), [file], (each for each in [file])):
        assert list(nt.combine(same)) == list(nt.replay(RUN))


def test_an_unknown_policy_is_named_with_its_option(folder):
    with pytest.raises(nt.NptraceError, match="^prefetch: there is no prefetch policy 'foo'; write one of all, next-line"):
        nt.compare(RUN, prefetch="foo")


def test_runs_that_are_named_are_not_looked_for_in_a_folder(folder):
    CliRunner().invoke(cli.nptrace, ["render", "ball.obj", "--accel", "bvh", "--pixels", "8x8", "--out", "q"])
    sentence = "no run that is named is of a scene of Table I (bunny, conference, sibenik, sponza); render one by its name"
    assert sentence in CliRunner().invoke(cli.npcache, ["table1", "q/ball-bvh-8x8"]).stderr
    with pytest.raises(nt.NptraceError) as caught:
        nt.table1("q/ball-bvh-8x8")
    assert str(caught.value) == sentence
    assert "no run in q is of" in CliRunner().invoke(cli.npcache, ["table1", "--traces", "q"]).stderr


@pytest.mark.parametrize(("command", "name"), [("estimate", "ball-bvh-8x8"), ("check", "ball")])
def test_scenes_that_rows_could_not_tell_apart_are_refused(folder, monkeypatch, command, name):
    monkeypatch.setattr("rtrace.trees.tree_cache.cached_tree", lambda *args, **options: pytest.fail("work was done"))
    Path("a").mkdir()
    Path("a/ball.obj").write_text(Path("ball.obj").read_text())
    args = {"estimate": ["--accel", "bvh", "--pixels", "8x8"], "check": ["--pixels", "8x8"]}[command]
    group = {"estimate": cli.npcache, "check": cli.nptrace}[command]
    for other in ("a/ball.obj", "ball.obj"):
        said = CliRunner().invoke(group, [command, "ball.obj", other, *args]).stderr
        assert said == (
            f"Error: two scenes, or two cameras, would both be {name} in every row; rename a file, or {command} them apart\n"
        )


def test_one_cache_is_no_caches(folder):
    args = ["estimate", "ball.obj", "--accel", "bvh", "--pixels", "8x8"]
    assert "1 run (1 exact), 1 cache in" in CliRunner().invoke(cli.npcache, args).stderr
