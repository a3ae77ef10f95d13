"""``npcache table1 --preset``: its rows are those of the runs and the replay that the preset names."""

import json

import pytest
from click.testing import CliRunner

import cli
import nptrace as nt
from nptrace.table1_study.presets import PRESETS

ARGS = {
    "kdtree": (["--accel", "kdtree"], ["--layout", "stored+8", "--reads", "merged"]),
    "bvh": (["--accel", "bvh", "--bvh", "min_leaf=4"], []),
}
RAYS = ["--packet", "4", "--shadow-order", "cheaper", "--shadow-end", "drain"]
CACHES = ["--size", "8K,16K", "--ways", "1,2", "--prefetch", "stack:budget=2"]
SAME = [
    "demand_accesses", "prefetch_accesses", "demand_miss_rate", "paper_miss_rate", "coverage", "accuracy", "traffic_ratio",
    "bytes_from_memory", "layout", "prefetch", "reads", "size_bytes", "ways", "stand_in", "builder", "packet",
]  # fmt: skip


@pytest.fixture(autouse=True)
def one_scene(monkeypatch, tmp_path):
    monkeypatch.delenv("NPTRACE_SCENES", raising=False)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    monkeypatch.setattr("cachesim.report.table1.SCENES", ("bunny",))
    monkeypatch.chdir(tmp_path)


def run(command, *args):
    done = CliRunner().invoke(command, args)
    assert done.exit_code == 0, done.output
    return done.stdout


def test_its_rows_are_those_of_its_runs():
    expected = []
    for tree, (rendered, replayed) in ARGS.items():
        run(cli.nptrace, "render", "bunny", *rendered, *RAYS, "--out", tree)
        (place,) = json.loads(run(cli.npcache, "replay", "--traces", tree, "--json", "--size", "1K"))[:1]
        expected += json.loads(run(cli.npcache, "replay", place["path"], *CACHES, *replayed, "--json"))
    rows = json.loads(run(cli.npcache, "table1", "--preset", "paper2013", "--json"))
    for row, of_replay in zip(rows, expected, strict=True):
        for name in SAME:
            value = of_replay[name]
            assert row[name] == (pytest.approx(value, abs=1e-11) if isinstance(value, float) else value), name
    assert [row["scene"] for row in rows] == ["bunny"] * 8
    assert [{"schema_version": 1, **row} for row in nt.table1(preset="paper2013")] == rows
    printed = run(cli.npcache, "table1", "--preset", "paper2013", "--n", "measured")
    told = " ".join(printed.split())
    assert "paper2013 is a fit of B/A, not of A" in told and "BVH: packet 4, shadow_order cheaper" in told
    assert "In time" not in told and "the time of a ray" not in told


@pytest.mark.parametrize("args", [["some/run"], ["--policy", "fifo"], ["--layout", "bfs"], ["--target-error", "2%"]])
def test_it_goes_with_nothing_that_it_decides(args):
    done = CliRunner().invoke(cli.npcache, ["table1", "--preset", "paper2013", *args])
    assert done.exit_code == 2
    assert "--preset paper2013 has its own pictures, caches and layouts; leave out " in done.output
    assert done.output.endswith(f"leave out {'RUN' if args == ['some/run'] else args[0]}\n")


@pytest.mark.parametrize(
    ("options", "message"),
    [({"preset": "mine"}, "'mine' is not one of paper2013"), ({"preset": "paper2013", "layout": "bfs"}, "its own pictures")],
)
def test_from_python_too(options, message):
    with pytest.raises(nt.NptraceError, match=message):
        nt.table1(**options)
    assert list(PRESETS) == ["paper2013"]
