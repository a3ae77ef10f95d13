"""One bad run among good ones: info shows the others, every other command names it and says how to leave it out."""

import json

import pytest
from click.testing import CliRunner

import cli
from rtrace.scenes.shapes import icosphere
from tests.nptrace.test_nptrace import write_obj

RUN_COMMANDS = ["replay", "sweep", "time", "compare", "table1", "report -o x.html"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_obj(tmp_path / "ball.obj", icosphere(1))
    run("nptrace render ball.obj --pixels 8x8 --name bunny", code=0)
    (tmp_path / "traces" / "bunny-kdtree" / "rays.parquet").write_bytes(b"PAR1")
    return tmp_path


def run(command, *args, code):
    program, *words = command.split()
    result = CliRunner().invoke(getattr(cli, program), [*words, *args], catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result


def test_info_shows_the_good_runs_and_names_the_bad_one(folder):
    for where in ([], ["traces"], ["--traces", "traces"], ["traces/bunny-bvh", "traces/bunny-kdtree"]):
        result = run("nptrace info --json", *where, code=1)
        assert [row["run"] for row in json.loads(result.stdout)] == ["bunny-bvh"]
        assert result.stderr.startswith("Error: traces/bunny-kdtree/rays.parquet is damaged (")
    assert run("nptrace info -q", code=1).stderr
    result = run("nptrace info traces/bunny-kdtree nosuch", code=2)
    assert result.stdout == "" and len(result.stderr.splitlines()) == 2
    (folder / "traces" / "bunny-kdtree").rename(folder / "traces" / "a")  # the first of them
    assert [row["run"] for row in json.loads(run("nptrace info --json", code=1).stdout)] == ["bunny-bvh"]


@pytest.mark.parametrize("command", RUN_COMMANDS)
def test_other_commands_say_how_to_leave_it_out(folder, command):
    way = "; to leave it out, name the other runs, or move it out of traces\n"
    for where in ([], ["traces"]):
        said = run(f"npcache {command}", *where, code=2).stderr
        assert said.startswith("Error: traces/bunny-kdtree/rays.parquet is damaged (") and said.endswith(way)
    named = run(f"npcache {command}", "traces/bunny-bvh", "traces/bunny-kdtree", code=2).stderr
    assert "bunny-kdtree/rays.parquet is damaged" in named and way not in named


def test_the_way_is_that_of_the_run_that_the_sentence_names(folder):
    """Not of one whose name begins like it, and none if the fault is of no run."""
    (folder / "traces" / "bunny-kdtree").rename(folder / "traces" / "bunny-bvh2")
    assert "name the other runs" in run("npcache replay", code=2).stderr
    assert "name the other runs" not in run("npcache replay --layout foo", code=2).stderr


def test_a_run_that_a_clock_cannot_time_is_named_too(folder):
    run("nptrace render ball.obj --accel bvh --pixels 8x8 --packet 4 --out mixed", code=0)
    run("nptrace render ball.obj --accel bvh --pixels 8x8 --out mixed", code=0)
    said = run("npcache time --traces mixed", code=2).stderr
    assert "mixed/ball-bvh-packet4-8x8" in said and said.endswith("or move it out of mixed\n")
