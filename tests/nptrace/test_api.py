"""``import nptrace``: the functions are the commands, their results share memory, their errors are the package's own."""

import inspect
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import click
import duckdb
import pyarrow as pa
import pytest
from click.testing import CliRunner

import cli
import nptrace as nt
from cachesim.clock.parameters import NUMBERS
from tests.nptrace.test_terminal import inputs

ROOT = Path(cli.__file__).resolve().parent
OF_STAGE_2 = ("replay", "sweep", "summarise", "combine", "time", "compare", "estimate", "table1", "plot", "report")
FUNCTIONS = {**dict.fromkeys(("render", "view", "map"), cli.nptrace), **dict.fromkeys(OF_STAGE_2, cli.npcache)}
#: Commands that have no function: what they do needs none, or is a method of a run.
NO_FUNCTIONS = {"check", "scenes", "export", "info", "compile", "run"}
#: Options of output, and of an estimated Table I, which is a command of its own.
NOT_OF_FUNCTIONS = {
    "form", "as_json", "output_path", "is_wide", "version", "quiet", "verbose", "help", "picture", "timeline", "error"
}  # fmt: skip
#: What a command calls otherwise.
CALLED = {
    "names": "scenes",
    "cameras": "camera",
    "kd_text": "kd",
    "bvh_text": "bvh",
    "run_names": "name",
    "ray_file": "rays",
    "folder": "traces",
    "kinds": "heat",
    "path": "output",
    "assoc": "ways",
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    inputs(tmp_path)
    return tmp_path


def printed(*args, group=cli.npcache):
    result = CliRunner().invoke(group, [*args, "--json"], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return [{name: value for name, value in row.items() if name != "schema_version"} for row in json.loads(result.stdout)]


def plain(default):
    """Return an option's default in one form: of the function ``32``, of the command ``["32"]``."""
    if default in (None, (), "", False) or "UNSET" in str(default):
        return ()
    return tuple(map(str, default)) if isinstance(default, (list, tuple)) else (str(default),)


def options_of_error(command):
    return next(param for param in command.params if param.name == "error")


def test_every_command_has_its_function():
    commands = {name for group in (cli.nptrace, cli.npcache) for name in group.commands}
    assert commands == {*FUNCTIONS, *NO_FUNCTIONS}
    assert {*FUNCTIONS} == {name for name in nt.__all__ if inspect.isfunction(getattr(nt, name))} - {"open"}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_has_the_options_and_defaults_of_its_command(name):
    command = FUNCTIONS[name].commands[name]
    options = {CALLED.get(param.name, param.name): param for param in command.params if param.name not in NOT_OF_FUNCTIONS}
    if name == "estimate":
        options = {**options, "target_error": options_of_error(command)}
    if name == "table1":
        options = {key: value for key, value in options.items() if key not in ("pixels", "seed")}
    parameters = inspect.signature(getattr(nt, name)).parameters
    assert set(options) == (set(parameters) - {"numbers"}) | (set(NUMBERS) if "numbers" in parameters else set())
    for option, param in options.items():
        is_given = option in parameters and parameters[option].default is not inspect.Parameter.empty
        if is_given and option not in ("scenes", "sources", "threads"):
            assert plain(parameters[option].default) == plain(param.default), option


@pytest.mark.parametrize(
    ("call", "args"),
    [
        (lambda: nt.replay("traces/bunny-bvh", size="1K,2K", ways=[1, "full"], prefetch="none,stack:tris*2", three_c=True),
         "replay traces/bunny-bvh --size 1K,2K --ways 1,full --prefetch none,stack:tris*2 --3c"),
        (lambda: nt.replay(), "replay"),
        (lambda: nt.replay("traces/bunny-bvh", by="level"), "replay traces/bunny-bvh --by level"),
        (lambda: nt.sweep([nt.open("traces/bunny-bvh"), Path("other")], size="1K..2K", ways="1..2"),
         "sweep traces/bunny-bvh other --size 1K..2K --ways 1..2"),
        (lambda: nt.time("traces/bunny-bvh", size=1024, ways=1, rays=[1, 4], policy="fifo"),
         "time traces/bunny-bvh --size 1K --ways 1 --rays 1,4 --policy fifo"),
        (lambda: nt.time("traces/bunny-bvh", size="1K", by="level"), "time traces/bunny-bvh --size 1K --by level"),
        (lambda: nt.compare("traces/bunny-bvh", prefetch=["push"], baselines=False, miss=50),
         "compare traces/bunny-bvh --prefetch push --no-baselines --miss 50"),
        (lambda: nt.table1(traces="traces", layout="bfs"), "table1 --layout bfs"),
    ],
)  # fmt: skip
def test_the_rows_are_those_of_the_command(folder, call, args):
    results = call()
    assert list(results) == printed(*args.split())
    group, name = cli.npcache, args.split()[0]
    text = CliRunner().invoke(group, [name, *args.split()[1:], *(["--format", "table"] if name == "sweep" else [])]).stdout
    assert str(results) == text.rstrip("\n")
    assert results.to_arrow().column_names == list(results[0])


def test_estimate_is_the_command(folder):
    def without_times(rows):
        return [{name: value for name, value in row.items() if "seconds" not in name} for row in rows]

    results = nt.estimate("blob", accel="bvh", pixels="32x32", size=["1K", "2K"], exact_below=10**6)
    args = "estimate blob --accel bvh --pixels 32x32 --size 1K,2K --exact-below 1000000"
    assert without_times(results) == without_times(printed(*args.split()))
    assert [cell["size_bytes"] for cell in results[0]["cells"]] == [1024, 2048]
    of_table1 = nt.estimate("blob", accel="bvh", pixels="32x32", is_table1=True)
    for name, value in (("size", "16K"), ("ways", 2), ("line", 64)):
        with pytest.raises(nt.NptraceError, match=f"{name}: is_table1 has the caches of Table I; leave out one of both"):
            nt.estimate("blob", is_table1=True, **{name: value})
    assert len(of_table1[0]["cells"]) == 4


def test_render_is_the_command(folder):
    run = nt.render("ball.obj", accel="bvh", pixels="16x12", order="morton", out="a")
    row = printed(
        "render", "ball.obj", "--accel", "bvh", "--pixels", "16x12", "--order", "morton", "--out", "b", group=cli.nptrace
    )
    assert isinstance(run, nt.Run) and run.name == row[0]["run"]
    for file in ("accesses", "rays", "nodes"):
        assert (folder / "a" / run.name / f"{file}.parquet").read_bytes() == (
            folder / "b" / run.name / f"{file}.parquet"
        ).read_bytes()
    both = nt.render("ball.obj", pixels="16x12", out="a", bvh_nodes=[32, 64])
    assert [each.footer.tree.kind for each in both] == ["kdtree", "bvh", "bvh64"]
    assert isinstance(nt.render("ball.obj", accel=["bvh"], pixels="16x12", out="a"), list)


def test_frames_share_the_memory_of_the_table(folder):
    results = nt.replay("traces/bunny-bvh", size="1K,2K")
    table = results.to_arrow()
    assert results.to_arrow() is table

    def address(column):
        return column.chunk(0).buffers()[1].address

    frame, polars = results.to_pandas(), results.to_polars()
    for name in ("demand_misses", "traffic_ratio"):
        assert address(pa.chunked_array(frame[name].array.__arrow_array__())) == address(table[name])
        assert polars[name].to_arrow().buffers()[1].address == address(table[name])
    assert frame["run"].tolist() == polars["run"].to_list() == ["bunny-bvh"] * 2
    assert duckdb.sql("SELECT sum(demand_misses) FROM results").fetchall() == [(sum(row["demand_misses"] for row in results),)]


@pytest.mark.parametrize("library", ["pandas", "polars"])
def test_a_library_that_is_missing_is_one_sentence(folder, monkeypatch, library):
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(nt.NptraceError, match=f"needs {library}, which is not installed; pip install {library}, or"):
        getattr(nt.replay("traces/bunny-bvh"), f"to_{library}")()


def test_reprs_are_short_and_html_is_escaped(folder):
    (folder / "a<b>").mkdir()
    (folder / "traces" / "bunny-bvh").rename(folder / "a<b>" / "x&y")
    run = nt.open("a<b>/x&y")
    assert repr(run) == f"<Run a<b>/x&y: bunny (stand-in), bvh, {run.identity.pixels}, 200 rays, {run.n_accesses:,} accesses>"
    results = nt.replay(run)
    assert repr(results) == "<Results of replay: 1 row of 1 run, 43 columns>"
    for text in (run._repr_html_(), results._repr_html_()):
        assert "x&amp;y" in text and "x&y" not in text and text.count("<table>") >= 1
    assert "data:image/png;base64," in run._repr_html_()
    scene = __import__("rtrace").load_scene("blob")
    assert len(repr(scene)) < 120 and "triangles" in repr(scene)


def test_a_cache_is_written_as_a_paper_writes_it():
    assert nt.CacheConfig("8K", 2) == nt.CacheConfig(8192, 2) == nt.CacheConfig("8K", "2", "32")
    assert nt.CacheConfig("8K", "full").ways == 256
    for args in ((8192.0,), (8192, None), ("8K", 2, [32]), (8192, 2, 32, 5), (8192, 2, 32, "lru", "x"), ("8 apples",)):
        with pytest.raises(nt.NptraceError, match="write e.g."):
            nt.CacheConfig(*args)


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: nt.render(), "no scene is given"),
        (lambda: nt.render("nosuch"), "is neither a file nor a known scene"),
        (lambda: nt.render("blob", accel="tree"), "accel: 'tree' is not a tree"),
        (lambda: nt.render("blob", order="spiral"), "order: 'spiral' is not one of"),
        (lambda: nt.render("blob", bvh="fast"), "'fast' is neither"),
        (lambda: nt.render("blob", bvh_nodes=48), "bvh_nodes: '48'"),
        (lambda: nt.render("blob", name=["a", "b"]), "there are 2 --name for 1 picture"),
        (lambda: nt.estimate(), "no scene is given"),
        (lambda: nt.estimate("blob", policy="fifo"), "lru"),
        (lambda: nt.estimate("blob", target_error="often"), "'often'"),
        (lambda: nt.estimate("blob", resume="counts", accel=["bvh", "kdtree"]), "keeps the counts of one run"),
        (lambda: nt.replay(size="x"), "size: 'x' is not a size"),
        (lambda: nt.replay(policy="mru"), "'mru' is not a replacement policy"),
        (lambda: nt.replay(traces="nosuch"), "there is no folder nosuch"),
        (lambda: nt.replay("nosuch"), "there is no nosuch"),
        (lambda: nt.sweep(ways="4..1"), "ways: '4..1' is not a range"),
        (lambda: nt.time(machine="mine"), "there is no machine 'mine'"),
        (lambda: nt.time(foo=1), "a machine has no number foo"),
        (lambda: nt.time(by="x"), "by: 'x' is not one of"),
        (lambda: nt.compare(rays=[1, 2]), "compare takes one cache and one machine"),
        (lambda: nt.table1("other"), "is of a scene of Table I|are both bunny"),
        (lambda: nt.open("nosuch"), "is not a run directory"),
        (lambda: nt.render("blob", seed=-1), r"seed: -1 is not a whole number from 0 to 2\^63 - 1; write e.g. seed=1"),
        (lambda: nt.render("blob", seed="x"), "seed: 'x' is not a whole number from 0"),
    ],
)
def test_errors_are_the_packages_own(folder, call, sentence):
    with pytest.raises(nt.NptraceError, match=sentence) as caught:
        call()
        (folder / "other" / "bunny-kdtree").rename(folder / "gone")
        raise nt.NptraceError("is of a scene of Table I")
    assert not isinstance(caught.value, click.ClickException)


def test_every_public_name_is_there_and_is_described():
    assert set(nt.__all__) <= set(dir(nt)) and "render" in nt.__all__
    for name in set(nt.__all__) - {"__version__"}:
        assert inspect.getdoc(getattr(nt, name)), name
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = nt.nothing


@pytest.mark.parametrize("name", [name for name in nt.__all__ if inspect.isfunction(getattr(nt, name))])
def test_help_has_every_parameter_what_is_returned_and_the_errors(name):
    function = getattr(nt, name)
    text = inspect.getdoc(function)
    parameters, _, rest = text.partition("\nParameters\n")[2].partition("\nReturns\n")
    described = {each for line in re.findall(r"^\w[\w, ]*", parameters, re.MULTILINE) for each in line.strip().split(", ")}
    assert described == set(inspect.signature(function).parameters)
    assert "\nRaises\n" in rest and "NptraceError" in rest


def test_importing_costs_nothing():
    code = "import sys, nptrace\nassert not {'numba', 'numpy', 'pyarrow', 'click'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)


def test_the_package_runs_both_programs(folder):
    def run(*args):
        return subprocess.run(
            [sys.executable, "-m", "nptrace", *args], cwd=ROOT, capture_output=True, text=True, check=True
        ).stdout

    assert "npcache: replay, sweep" in " ".join(run("--help").split())
    assert run("cache", "--help").startswith("Usage: python -m nptrace cache [OPTIONS]") and "replay" in run("cache", "--help")
    assert json.loads(run("cache", "replay", str(folder / "traces" / "bunny-bvh"), "--json"))[0]["run"] == "bunny-bvh"


def test_the_notebook_runs_and_is_short(folder):
    text = (ROOT / "docs" / "notebook.py").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    assert len(lines) <= 20
    scope: dict = {}
    exec(compile(text, "notebook.py", "exec"), scope)
    assert len(scope["runs"]) == 4 and len(scope["replayed"]) == 4 * 2 * 5 * 2


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere names are Unicode")
def test_a_folder_whose_name_is_not_utf_8(tmp_path):
    out = tmp_path / os.fsdecode(b"caf\xe9")
    run = nt.render("blob", accel="bvh", pixels="8x8", out=out)
    assert run.path.parent == out
    assert run.n_accesses > 0
