"""JSON output: every command's is that of docs/results.schema.json, without NaN and infinity, and no key is unknown to it."""

import json
import math
from pathlib import Path

import jsonschema
import pytest
from click.testing import CliRunner

import cli
from nptrace import precompile
from rtrace.checks import hard_cases
from tests.nptrace.test_terminal import inputs

SCHEMA = json.loads((Path(cli.__file__).resolve().parent / "docs" / "results.schema.json").read_text(encoding="utf-8"))
COMMANDS = {
    "render": "nptrace render ball.obj --pixels 24x20 --order random --out out",
    "scenes": "nptrace scenes",
    "info": "nptrace info traces/bunny-bvh other",
    "check": "nptrace check ball.obj --pixels 16x16 --random 50",
    "hard_check": "nptrace check --hard",
    "replay": "npcache replay traces/bunny-bvh empty.din --size 1K,2K --policy lru,random --prefetch none,traced",
    "replay_by": "npcache replay traces/bunny-bvh --size 1K --by node --3c --prefetch none,traced",
    "combine": "npcache combine all.sum",
    "sweep": "npcache sweep traces/bunny-kdtree empty.din --size 1K --ways 1,full",
    "time": "npcache time traces/bunny-bvh --size 1K --assoc 1 --rays 1,4 --policy random",
    "time_by": "npcache time traces/bunny-bvh --size 1K --assoc 1 --by slot",
    "compare": "npcache compare traces/bunny-bvh --no-baselines --prefetch stack,push --size 1K --assoc 1",
    "map": "nptrace map ball.obj --quick --pixels 16x16 --out map",
    "table1": "npcache table1",
    "compile": "nptrace compile",
    "run": "nptrace run study.toml",
    "estimate": "npcache estimate ball.obj --pixels 32x32 --size 1K",
}


STUDY = """
[render]
scenes = "ball.obj"
pixels = "16x16"
[replay]
size = "1K"
[sweep]
size = "1K"
[time]
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Runs, a trace whose every access is a prefetch, so that rates have no value, and hard cases, one with no limit of t."""
    monkeypatch.chdir(tmp_path)
    inputs(tmp_path)
    (tmp_path / "empty.din").write_text("b 1000\nb 1020\n")
    (tmp_path / "study.toml").write_text(STUDY)
    part = "summarise traces/bunny-bvh --part 1/1 --size 1K --prefetch none,traced -o all.sum"
    assert CliRunner().invoke(cli.npcache, part.split()).exit_code == 0
    rows = [hard_cases.CaseRow("case", "kdtree", 9, 0, 0, 0, 0.5, bound, 0, 1) for bound in (4.0, math.inf)]
    monkeypatch.setattr(precompile, "compile_all", lambda watch: 3)
    monkeypatch.setattr(hard_cases, "run_all", lambda is_long, threads: rows)
    return tmp_path


@pytest.mark.parametrize("name", COMMANDS)
def test_a_commands_json_is_that_of_the_schema(folder, name):
    program, *args = COMMANDS[name].split()
    result = CliRunner().invoke(getattr(cli, program), [*args, "--json"], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    rows = json.loads(result.stdout, parse_constant=lambda text: pytest.fail(f"{text} is no JSON"))
    validator = jsonschema.Draft202012Validator({"$ref": f"#/$defs/{name}", "$defs": SCHEMA["$defs"]})
    assert rows and [error.message for error in validator.iter_errors(rows)] == []
    jsonschema.Draft202012Validator(SCHEMA).validate(rows)
    for wrong in ({**rows[0], "more": 1}, {**rows[0], "schema_version": 2}, {}):
        assert not validator.is_valid([wrong])


def test_every_command_with_json_is_in_the_schema():
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    commands = [command for group in (cli.nptrace, cli.npcache) for command in map(group.commands.get, group.commands)]
    names = {command.name for command in commands if any("--json" in param.opts for param in command.params)}
    assert (
        names | {"hard_check", "time_by", "replay_by"}
        == set(COMMANDS)
        == {ref["$ref"].rpartition("/")[2] for ref in SCHEMA["anyOf"]}
    )
