"""Ranges and lists of ways, layouts and policies, threads, one default each, and a last line that names the next command."""

import json

import pytest
from click.testing import CliRunner

import cli
from cachesim.config import CacheConfig
from cachesim.grid import caches, parse_ways_range
from nptrace import precompile
from nptrace_base.errors import NptraceError
from rtrace.checks import hard_cases
from tests.nptrace.test_terminal import inputs

GROUPS = (cli.nptrace, cli.npcache)
SMALL = ["ball.obj", "--accel", "bvh", "--pixels", "32x32"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    inputs(tmp_path)
    return tmp_path


def run(group, *args, code=0):
    result = CliRunner().invoke(group, [str(arg) for arg in args], catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result


def rows_of(group, *args):
    return json.loads(run(group, *args, "--json").stdout)


def test_ranges_of_ways(folder):
    rows = rows_of(cli.npcache, "replay", "traces/bunny-bvh", "--size", "1K,6K", "--ways", "1..4,full")
    assert [(row["size_bytes"], row["ways"]) for row in rows] == [
        (1024, 1), (1024, 2), (1024, 4), (1024, 32), (6144, 1), (6144, 2), (6144, 3), (6144, 4), (6144, 192)
    ]  # fmt: skip
    rows = rows_of(cli.npcache, "estimate", *SMALL, "--size", "1K..2K", "--ways", "1..2")
    assert [(cell["size_bytes"], cell["ways"]) for cell in rows[0]["cells"]] == [(1024, 1), (1024, 2), (2048, 1), (2048, 2)]
    rows = rows_of(cli.npcache, "time", "traces/bunny-bvh", "--size", "1K..4K", "--ways", "1..2")
    assert [(row["size_bytes"], row["ways"]) for row in rows] == [(k << 10, ways) for k in (1, 2, 4) for ways in (1, 2)]


def test_a_number_of_ways_that_does_not_fit_is_left_out_of_a_range_alone():
    assert caches([1024], [parse_ways_range("1..4")], [32]) == [CacheConfig(1024, ways) for ways in (1, 2, 4)]
    assert caches([1024], [("2",), parse_ways_range("1..2")], [32], ["lru", "opt"]) == [
        CacheConfig(1024, ways, 32, policy) for policy in ("lru", "opt") for ways in (2, 1)
    ]
    for ways in ("3", "5..7"):
        with pytest.raises(NptraceError, match="is not a whole number of sets"):
            caches([1024], [parse_ways_range(ways)], [32])


def test_one_default_each():
    """Of --seed and of --ways, wherever they are; a machine, and results, have their own."""
    found = {"--seed": set(), "--ways": set()}
    for group in GROUPS:
        for command in map(group.commands.get, group.commands):
            for param in command.params:
                for name in set(param.opts) & set(found):
                    if "UNSET" not in str(param.default):
                        found[name].add(str(param.default))
    assert found == {"--seed": {"0"}, "--ways": {"['1']"}}


def test_layouts_of_an_estimate_are_those_of_a_replay(folder):
    """Counted exactly, so the estimate's rates are the replay's; the layout tells its rows apart."""
    run(cli.nptrace, "render", *SMALL, "--out", "out")
    caches_ = ["--size", "1K", "--layout", "stored,veb"]
    replayed = rows_of(cli.npcache, "replay", "out", *caches_)
    estimated = rows_of(cli.npcache, "estimate", *SMALL, *caches_)
    assert [row["layout"] for row in estimated] == [row["layout"] for row in replayed] == ["stored", "veb"]
    for one, other in zip(estimated, replayed, strict=True):
        assert one["cells"][0]["demand_miss_rate"]["value"] == other["demand_miss_rate"]
    assert replayed[0]["demand_miss_rate"] != replayed[1]["demand_miss_rate"]
    assert "ball-bvh-32x32, layout veb" in run(cli.npcache, "estimate", *SMALL, *caches_).stdout


def test_counts_of_another_layout_are_not_continued(folder):
    args = ["estimate", "ball.obj", "--accel", "bvh", "--pixels", "256x256", "--exact-below", "0", "--size", "1K"]
    args += ["--target-error", "50%", "--resume", "kept"]
    run(cli.npcache, *args)
    assert (folder / "kept").exists()
    assert "kept" in run(cli.npcache, *args, "--layout", "bfs", code=2).stderr


def test_table1_of_another_policy_and_layout_is_that_of_the_replay(folder):
    rows = rows_of(cli.npcache, "table1", "traces/bunny-kdtree", "--policy", "fifo", "--layout", "bfs")
    args = ["--policy", "fifo", "--layout", "bfs", "--size", "8K,16K", "--ways", "1,2"]
    replayed = rows_of(cli.npcache, "replay", "traces/bunny-kdtree", *args)
    assert {(row["policy"], row["layout"]) for row in rows} == {("fifo", "bfs")}
    for one, other in zip(rows, replayed, strict=True):
        assert one["demand_miss_rate"] == pytest.approx(other["demand_miss_rate"])
    text = run(cli.npcache, "table1", "traces/bunny-kdtree", "--layout", "bfs").stdout
    assert "Ours with lru replacement and the layout bfs" in text.replace("\n", " ")
    assert "Ours with" not in run(cli.npcache, "table1", "traces/bunny-kdtree").stdout


@pytest.mark.parametrize("args", [["estimate", *SMALL], ["table1", "--target-error", "9%"], ["estimate", *SMALL, "--table1"]])
def test_what_cannot_be_estimated_is_refused_with_the_reason(folder, args):
    said = run(cli.npcache, *args, "--policy", "fifo", code=2).stderr
    assert "cannot be estimated: under fifo, a cache's first content may affect all later accesses" in said


def test_checks_do_not_depend_on_threads(folder):
    args = ["check", "ball.obj", "--pixels", "16x16", "--random", "500", "--threads"]
    assert rows_of(cli.nptrace, *args, 1) == rows_of(cli.nptrace, *args, 3)
    case = hard_cases.CASES[min(hard_cases.CASES)](False)
    assert hard_cases.run_case(case) == hard_cases.run_case(case, threads=3)


def test_a_check_prints_one_kind_of_rows(folder):
    said = run(cli.nptrace, "check", "ball.obj", "--hard", code=2).stderr
    assert "its rows are not those of ball.obj; run one at a time" in said


def test_compile_writes_a_row(folder, monkeypatch):
    monkeypatch.setattr(precompile, "compile_all", lambda watch: 3)
    [row] = rows_of(cli.nptrace, "compile")
    assert row["n_compiled"] == 3 and row["folder"] and row["seconds"] >= 0
    run(cli.nptrace, "compile", "-o", "x.csv")
    assert (folder / "x.csv").read_text().startswith("n_compiled,seconds,folder\n3,")


@pytest.mark.parametrize(
    ("group", "command", "following"),
    [
        (cli.nptrace, "render ball.obj --pixels 8x8 --out out", "npcache replay --traces out --size 8K,16K"),
        (cli.nptrace, "check ball.obj --pixels 8x8 --random 9", "nptrace render ball.obj"),
        (cli.nptrace, "export traces/bunny-bvh", "npcache replay bunny-bvh.din"),
        (cli.nptrace, "map ball.obj --quick --pixels 8x8 --out m", "npcache compare --traces m"),
        (cli.nptrace, "compile", "nptrace render sponza"),
        (cli.npcache, "replay traces/bunny-bvh", "npcache sweep traces/bunny-bvh --size 4K..64K -o sweep.csv"),
        (cli.npcache, "sweep traces --size 4K", "npcache time --size 4K --prefetch stack,push"),
        (cli.npcache, "time traces/bunny-bvh", "npcache compare traces/bunny-bvh"),
        (cli.npcache, "compare traces/bunny-bvh --prefetch stack", "npcache report traces/bunny-bvh -o report.html"),
        (cli.npcache, "table1", "npcache compare"),
        (cli.npcache, "estimate ball.obj --pixels 8x8", "nptrace render ball.obj --pixels 8x8"),
    ],
)
def test_the_last_line_names_the_next_command(folder, monkeypatch, group, command, following):
    monkeypatch.setattr(precompile, "compile_all", lambda watch: 3)
    said = run(group, *command.split()).stderr.rstrip("\n")
    assert said.rpartition("; next: ")[2] == following
