"""What a new user stumbled over, where no other test holds it: stand-ins, progress, notes without news, words, keys."""

import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner

import cli
from nptrace import precompile
from nptrace.progress import Progress
from tests.nptrace.test_terminal import inputs

ROOT = Path(cli.__file__).resolve().parent
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("NPTRACE_SCENES", raising=False)
    inputs(tmp_path)
    return tmp_path


def run(command):
    program, *args = command.split()
    result = CliRunner().invoke(getattr(cli, program), args, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result


def test_a_stand_in_is_marked_in_every_table_and_is_a_field_of_every_row(folder):
    for command in (
        "nptrace render blob --accel bvh --pixels 8x8", "npcache replay traces/bunny-bvh", "npcache sweep traces/bunny-bvh",
        "npcache time traces/bunny-bvh", "npcache compare traces/bunny-bvh --prefetch push", "npcache table1 traces/bunny-bvh",
        "npcache estimate blob --accel bvh --pixels 8x8", "nptrace map blob --quick --pixels 8x8 --out map",
    ):  # fmt: skip
        rows = json.loads(run(f"{command} --json").stdout)
        assert {row["stand_in"] for row in rows} == {True}, command
        assert not any("(" in str(row.get("run")) for row in rows), command
        assert "(stand-in)" in run(f"{command} --format table").stdout, command


@pytest.mark.parametrize(
    ("command", "job", "phases"),
    [
        ("nptrace render ball.obj --accel bvh --pixels 8x8", "ball-bvh-8x8", "load, build, trace, write"),
        ("nptrace check ball.obj --pixels 8x8 --random 9", "ball", "load, build, compare with Embree"),
        ("nptrace compile", "compile", "a minute or two"),
        (
            "nptrace map ball.obj --quick --pixels 8x8 --out map",
            "ball-bvh-max_leaf1-min_leaf1-8x8",
            "load, build, trace, time",
        ),
        ("nptrace run small.toml", "ball-bvh-8x8", "load, build, trace, write, replay, prefetch traced, time"),
        ("nptrace view traces/bunny-bvh --heat accesses", "bunny-bvh", "accesses, draw"),
        ("npcache replay traces/bunny-bvh", "bunny-bvh", "replay, prefetch traced"),
        ("npcache sweep traces/bunny-bvh", "bunny-bvh", "sweep, prefetch traced"),
        ("npcache time traces/bunny-bvh", "bunny-bvh", "time"),
        ("npcache compare traces/bunny-bvh --prefetch push --no-baselines", "bunny-bvh", "compare"),
        ("npcache table1", "Table I", "replay and time"),
        ("npcache estimate ball.obj --accel bvh --pixels 8x8", "ball bvh", "load, build, estimate"),
        ("npcache summarise traces/bunny-bvh --part 1/2 -o 1.sum", "part 1 of 2", "replay, prefetch traced"),
        ("npcache plot traces/bunny-bvh -o p.png", "bunny-bvh", "count, prefetch traced, draw"),
        (
            "npcache report traces/ball-bvh-8x8 -o r.html",
            "ball-bvh-8x8",
            "replay, prefetch traced, sweep, prefetch traced, stack distances, write",
        ),
    ],
)
def test_progress_names_what_it_works_on_and_the_phase(folder, monkeypatch, command, job, phases):
    jobs, seen = [], []
    if "ball-bvh" in command:
        run("nptrace render ball.obj --accel bvh --pixels 8x8")
    monkeypatch.setattr(precompile, "compile_all", lambda watch: 3)
    monkeypatch.setattr(Progress, "job", lambda self, name: jobs.append(name))
    monkeypatch.setattr(Progress, "phase", lambda self, what, total=None: seen.append(what) or (lambda n: None))
    run(command)
    assert job in jobs, (jobs, seen)
    for phase in phases.split(", "):
        assert any(phase in what for what in seen), (phase, seen)


def test_a_note_without_news_is_for_verbose(folder):
    assert "float32" not in run("nptrace render ball.obj --accel bvh --pixels 8x8").stderr
    assert "float32" in run("nptrace render ball.obj --accel bvh --pixels 8x8 -v").stderr
    assert run("nptrace render ball.obj --accel bvh --pixels 8x8").stderr.count("\n") == 1
    assert run("nptrace render ball.obj --accel bvh --pixels 8x8 -q").stderr == ""


def test_the_words_of_table_1_are_explained_where_they_first_appear(folder):
    notes = run("npcache table1").stdout
    for word in ("A: without, B: with prefetching", "ACPR: average cycles per ray for node accesses"):
        assert word in " ".join(notes.split())
    verdict = " ".join(run("npcache replay traces/bunny-bvh").stdout.split())
    assert re.search(r"to 1 / \(1 \+ p\) of A", verdict) and not re.search(r"by (about )?1 ?/ ?\(1", verdict)
    for page in PAGES:
        assert not re.search(r"\bby (about )?1 ?/ ?\(1", page.read_text(encoding="utf-8")), page


def test_a_quantity_has_one_name_and_one_unit_in_json():
    text = (ROOT / "docs" / "results.schema.json").read_text(encoding="utf-8")
    keys = set(re.findall(r'^ +"(\w+)": \{$', text, re.MULTILINE))
    assert {"demand_miss_rate", "size_bytes", "tree", "n_prefetches"} <= keys
    wrong = re.compile(
        r"(^|_)(kb|mb|kib|percent|per_cent|pct|prefetch_count|assoc|associativity|cache_size|structure_kind)($|_)"
    )
    assert not [key for key in keys if wrong.search(key)]
    assert not keys & {"prefetches", "n_prefetch", "misses", "accesses", "accel", "pixels", "cache_bytes", "bytes", "n_ways"}
