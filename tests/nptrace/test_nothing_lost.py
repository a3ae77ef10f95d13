"""Files and runs that a command would write under names of its own: what is there is kept, and that is known at once."""

import json
import shutil
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

import cli
from nptrace import studies
from tests.nptrace.test_study import study_in

STUDY = 'out = "runs"\n[render]\nscenes = ["ball.obj"]\naccel = "bvh"\npixels = "8x8"\n[replay]\nsize = "1K"\n'


@pytest.fixture
def folder(tmp_path, monkeypatch):
    return study_in(tmp_path, monkeypatch, STUDY)


def run(command, code=0):
    program, *args = command.split()
    result = CliRunner().invoke(getattr(cli, program), args, catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result


def no_work(monkeypatch):
    monkeypatch.setattr(studies, "rendered", lambda *args, **options: pytest.fail("work was done"))


@pytest.mark.parametrize(("option", "name"), [("", "bunny-bvh.din"), (" --format csv", "bunny-bvh.csv")])
def test_a_trace_that_is_there_is_kept(folder, option, name):
    run(f"nptrace export traces/bunny-bvh{option}")
    first = Path(name).read_bytes()
    said = run(f"nptrace export traces/bunny-bvh --prefetch-as omit{option}", code=2).stderr
    assert said == f"Error: {name} exists; write -o {name} to replace it, or name another file\n"
    assert Path(name).read_bytes() == first
    run(f"nptrace export traces/bunny-bvh --prefetch-as omit -o {name}")
    assert len(Path(name).read_bytes()) < len(first)


def test_rows_of_a_study_replace_those_of_the_last_time_and_nothing_else(folder, monkeypatch):
    pq.write_table(pa.table({"origin": [[0.0, 0.0, 0.0]]}), "study.parquet")
    first = Path("study.parquet").read_bytes()
    with monkeypatch.context() as patch:
        no_work(patch)
        said = run("nptrace run study.toml", code=2).stderr
    assert said == "Error: study.parquet exists; write -o study.parquet to replace it, or name another file\n"
    assert Path("study.parquet").read_bytes() == first
    run("nptrace run study.toml -o study.parquet")
    second = Path("study.parquet").read_bytes()
    assert "study.parquet: 1 row of 1 run in" in run("nptrace run study.toml").stderr
    assert Path("study.parquet").read_bytes() == second


def test_where_the_rows_of_a_study_cannot_go_is_known_before_the_work(folder, monkeypatch):
    no_work(monkeypatch)
    Path("study.parquet").mkdir()
    assert run("nptrace run study.toml", code=2).stderr == (
        "Error: cannot write study.parquet: it is a folder; name another file\n"
    )


def test_scenes_of_a_study_that_have_one_name_are_refused_before_anything_is_traced(folder, monkeypatch):
    no_work(monkeypatch)
    Path("a").mkdir()
    shutil.copy("ball.obj", "a/ball.obj")
    for scenes in ('["ball.obj", "a/ball.obj"]', '["ball.obj"]\ncamera = ["eye=0,0,9 at=0,0,0", "eye=0,0,9 at=0,0,0"]'):
        Path("study.toml").write_text(STUDY.replace('["ball.obj"]', scenes))
        said = run("nptrace run study.toml", code=2).stderr
        assert said.startswith("Error: study.toml: two scenes, or two cameras, would both be runs/ball-bvh-8x8")
        assert "rename a file" in said and "--name" not in said


def test_a_run_of_other_content_stops_a_study_before_anything_is_traced(folder, monkeypatch):
    run("nptrace render ball.obj --accel bvh --pixels 8x8 --out runs")
    no_work(monkeypatch)
    Path("other.obj").write_text(Path("ball.obj").read_text())
    Path("ball.obj").write_text(Path("ball.obj").read_text().replace("v ", "v 1", 1))
    Path("study.toml").write_text(STUDY.replace('["ball.obj"]', '["other.obj", "ball.obj"]'))
    said = run("nptrace run study.toml", code=2).stderr
    assert said == (
        "Error: runs/ball-bvh-8x8 holds another run (of another scene); move it elsewhere, or give the study another out\n"
    )


@pytest.mark.parametrize(
    ("command", "n"),
    [
        ("npcache replay traces/bunny-bvh --prefetch stack,STACK,stack:unlimited --layout stored,Stored,stored+0", 1),
        ("npcache replay traces/bunny-bvh --size 1K --ways 1,1..2,32,full --by level --prefetch none,NONE", 3),
        ("npcache sweep traces/bunny-bvh --size 4K,4096,4K..4K --prefetch stack,stack:unlimited", 1),
        ("npcache time traces/bunny-bvh --prefetch push,Push --layout veb,VEB --rays 1,01", 1),
        ("npcache time traces/bunny-bvh --prefetch traced,stack", 1),
        ("npcache compare traces/bunny-bvh --prefetch traced,stack --no-baselines", 3),
    ],
)
def test_what_is_asked_for_in_two_spellings_has_one_row(folder, command, n):
    rows = json.loads(run(f"{command} --json").stdout)
    cases = {tuple(row.get(key) for key in ("prefetch", "layout", "size_bytes", "ways", "level")) for row in rows}
    assert len(cases) == len(rows)
    assert len({case[:4] for case in cases}) == n
