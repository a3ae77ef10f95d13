"""One vocabulary: shared options on every command, old spellings that say what to write, lists, ranges and folders."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

import cli
from tests.nptrace.test_terminal import inputs

ALL = [(group, name) for group in (cli.nptrace, cli.npcache) for name in group.commands]
#: Commands that print no results.
OTHERS = {"export", "view", "plot", "report", "summarise"}
ROOT = Path(cli.__file__).resolve().parent


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    inputs(tmp_path)
    return tmp_path


def run(group, *args, code=0):
    result = CliRunner().invoke(group, [str(arg) for arg in args], catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result


@pytest.mark.parametrize(("group", "name"), ALL)
def test_every_command_has_the_shared_options(group, name):
    options = {spelling for param in group.commands[name].params for spelling in param.opts}
    assert options >= {"-q", "--quiet", "-v", "--verbose", "--version"}
    if name not in OTHERS:
        assert options >= {"--format", "--json", "-o", "--wide"}
    if name in ("replay", "sweep", "table1", "info"):
        assert "--traces" in options and group.commands[name].params[0].nargs == -1
    if name in ("render", "check", "estimate"):
        assert "--pixels" in options
    assert not any("x" in str(p.default) and "--size" in p.opts for p in group.commands[name].params)


@pytest.mark.parametrize(
    ("group", "old", "new"),
    [
        (cli.nptrace, "render ball.obj --size 8x8 -o a", "render ball.obj --pixels 8x8 -o b --overwrite"),
        (cli.nptrace, "check ball.obj --size=8x8 --random 9 -o a", "check ball.obj --pixels=8x8 --random 9 -o b"),
        (cli.npcache, "replay --report csv -o a", "replay --format csv -o b"),
        (cli.nptrace, "export traces/bunny-bvh --prefetch omit -o a",
         "export traces/bunny-bvh --format din --prefetch-as omit -o b"),
    ],
)  # fmt: skip
def test_old_spellings_work_and_say_so(folder, group, old, new):
    said = run(group, *old.split()).stderr
    assert "the old spelling will go" in said and "is now --" in said
    assert "spelling" not in run(group, *new.split()).stderr
    assert (folder / "a").read_bytes() == (folder / "b").read_bytes()


def test_lists_ranges_and_folders(folder):
    rows = json.loads(run(cli.npcache, "replay", "traces", "--size", "1K..4K,6K", "--json").stdout)
    assert [(row["run"], row["size_bytes"]) for row in rows] == [
        (run, size) for run in ("bunny-bvh", "bunny-kdtree") for size in (1024, 2048, 4096, 6144)
    ]
    again = run(cli.npcache, "replay", "traces/bunny-bvh", folder / "traces" / "bunny-bvh", "--json").stdout
    assert len(json.loads(again)) == 1
    for args in (["--accel", "bvh,kdtree"], ["--accel", "bvh", "--accel", "kdtree"], []):
        made = json.loads(run(cli.nptrace, "render", "ball.obj", "--pixels", "8x8", *args, "--json").stdout)
        assert sorted(row["tree"] for row in made) == ["bvh", "kdtree"]
    assert len(json.loads(run(cli.npcache, "table1", "traces/bunny-bvh", "--json").stdout)) == 4
    assert len(json.loads(run(cli.nptrace, "info", "traces", "other", "--json").stdout)) == 5


@pytest.mark.parametrize("ending", ["csv", "json", "parquet", "md", "tex"])
def test_the_ending_of_a_file_chooses_the_format(folder, ending):
    run(cli.npcache, "replay", "--size", "1K", "-o", f"x.{ending}")
    starts = {"csv": b"run,path", "json": b"[\n", "parquet": b"PAR1", "md": b"**bunny", "tex": b"\\textbf"}
    assert (folder / f"x.{ending}").read_bytes().lstrip().startswith((starts[ending], b"\\begin"))
    assert run(cli.npcache, "replay", "--size", "1K", "--format", "csv", "-o", "-").stdout.startswith("run,path")


@pytest.mark.parametrize("program", ["nptrace", "npcache"])
def test_completion(program):
    """As the README says: the shell asks the program, which knows its commands and options."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), f"_{program.upper()}_COMPLETE": "bash_complete"}
    for words, cword, wanted in (
        (f"{program} ", "1", list(getattr(cli, program).commands)),
        (f"{program} scenes --j", "2", []),
    ):
        done = subprocess.run(
            [sys.executable, "-c", f"import sys, cli; sys.argv[0] = '{program}'; cli.{program}()"],
            env={**environment, "COMP_WORDS": words, "COMP_CWORD": cword}, capture_output=True, text=True, check=True,
        )  # fmt: skip
        assert {line.partition(",")[2] for line in done.stdout.splitlines()} >= set(wanted)
