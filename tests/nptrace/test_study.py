"""Studies in a file: every combination, the rows of the commands, errors with their line, and going on after a stop."""

import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

import cli
from nptrace import studies
from nptrace import study as module
from nptrace.study import read_study, run_study
from nptrace_base.errors import NptraceError
from nptrace_base.source_files import closure
from tests.nptrace.test_terminal import inputs

ROOT = Path(cli.__file__).resolve().parent
STUDY = """\
out = "runs"
[render]
scenes = ["ball.obj"]
pixels = ["16x16", "24x16"]
order = ["scanline", "morton"]
[replay]
size = "1K,2K"
prefetch = ["none", "traced"]
layout = ["stored", "bfs"]
[time]
size = "1K"
ways = 1
rays = [1, 4]
"""


def study_in(tmp_path, monkeypatch, text):
    """Go to a folder with the usual inputs and a study; return it."""
    monkeypatch.chdir(tmp_path)
    inputs(tmp_path)
    (tmp_path / "study.toml").write_text(text)
    return tmp_path


@pytest.fixture
def folder(tmp_path, monkeypatch):
    return study_in(tmp_path, monkeypatch, STUDY)


def run(group, *args, code=0):
    result = CliRunner().invoke(group, [str(arg) for arg in args], catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result


def test_every_combination_is_one_tidy_table(folder):
    said = run(cli.nptrace, "run", "study.toml").stderr
    table = pq.read_table("study.parquet")
    rows = table.to_pylist()
    assert f"study.parquet: {len(rows)} rows of 8 runs" in said and "next: npcache compare --traces runs" in said
    assert len({row["run"] for row in rows}) == 8 == len(list((folder / "runs").glob("*/rays.parquet")))
    assert [sum(row["section"] == name for row in rows) for name in ("replay", "time")] == [8 * 2 * 2 * 2, 8 * 2]
    assert {row["cycles"] is None for row in rows if row["section"] == "replay"} == {True}
    keys = ("path", "section", "size_bytes", "ways", "policy", "prefetch", "layout", "rays")
    assert len({tuple(row[key] for key in keys) for row in rows}) == len(rows)


def test_the_rows_are_those_of_the_commands(folder):
    rows = json.loads(run(cli.nptrace, "run", "study.toml", "--json").stdout)
    name = "runs/ball-bvh-morton-24x16"
    args = ["--size", "1K,2K", "--prefetch", "none,traced", "--layout", "stored,bfs", "--json"]
    replayed = json.loads(run(cli.npcache, "replay", name, *args).stdout)
    timed = json.loads(run(cli.npcache, "time", name, "--size", "1K", "--ways", 1, "--rays", "1,4", "--json").stdout)
    for section, wanted in (("replay", replayed), ("time", timed)):
        mine = [row for row in rows if row["path"] == name and row["section"] == section]
        assert [{key: value for key, value in row.items() if key != "section"} for row in mine] == wanted


def test_it_goes_on_where_it_was_stopped(folder, monkeypatch):
    """Stopped in the third run's replay: what was finished is not made again, and the rows are those of one go."""
    counted, real = {"render": 0, "replay": 0, "time": 0}, {}

    def counting(name, work, last):
        real[name] = work

        def one(*args, **options):
            counted[name] += 1
            if counted[name] == last[0]:
                raise KeyboardInterrupt
            return work(*args, **options)

        return one

    limit = [10]
    for name, function in (("render", "rendered"), ("replay", "replayed"), ("time", "timed")):
        monkeypatch.setattr(studies, function, counting(name, getattr(studies, function), limit if name == "replay" else [0]))
    study = read_study(Path("study.toml"))
    with pytest.raises(KeyboardInterrupt):
        run_study(study)
    assert counted == {"render": 3, "replay": 10, "time": 2}
    limit[0] = 0
    rows = run_study(study)
    assert counted == {"render": 8, "replay": 10 + 32 - 9, "time": 8}
    assert run_study(study) == rows and counted["render"] == 8 and counted["time"] == 8
    assert len(rows) == 8 * 8 + 16


def test_rows_of_another_version_are_counted_again(folder, monkeypatch):
    """Its counts may be wrong; the runs stay, as they do for every command."""
    text = STUDY.replace('["16x16", "24x16"]', '"16x16"').replace(', "morton"', "").partition("[time]")[0]
    (folder / "study.toml").write_text(text)
    study, counted, real = read_study(Path("study.toml")), [], studies.replayed
    monkeypatch.setattr(studies, "replayed", lambda *args, **options: counted.append(1) or real(*args, **options))
    rows = run_study(study)
    assert run_study(study) == rows and len(counted) == 2 * 4
    source = ROOT / "cachesim" / "cache_counts.py"
    assert source in closure([Path(studies.__file__)])
    read = Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda path: read(path) + b"#" * (path == source))
    monkeypatch.setattr(studies, "rendered", None)
    module._code.cache_clear()
    assert run_study(study) == rows and len(counted) == 2 * 2 * 4
    module._code.cache_clear()


def test_another_run_of_the_name_is_kept_and_a_damaged_one_is_made_again(folder):
    (folder / "study.toml").write_text(
        STUDY.replace('pixels = ["16x16", "24x16"]', 'pixels = "16x16"').replace(', "morton"', "")
    )
    run(cli.nptrace, "run", "study.toml")
    first = Path("study.parquet").read_bytes()
    Path("runs/ball-bvh-16x16/rays.parquet").write_bytes(b"")
    run(cli.nptrace, "run", "study.toml")
    assert Path("study.parquet").read_bytes() == first
    text = (folder / "ball.obj").read_text().replace("v ", "v 1", 1)
    (folder / "ball.obj").write_text(text)
    assert "holds another run (of another scene)" in run(cli.nptrace, "run", "study.toml", code=2).stderr


@pytest.mark.parametrize(
    ("old", "new", "line", "sentence"),
    [
        ("order =", "orders =", 5, "[render] has no 'orders'; its keys are scenes, accel, pixels"),
        ("[time]", "[clock]", 10, "a study has no 'clock'; its keys are out, render, replay, sweep, time"),
        ('out = "runs"', "out = 3", 1, "out is 3, and not a path; write e.g. out = 'traces'"),
        ('out = "runs"', 'out = "s3://bucket/runs"', 1, "out is s3://bucket/runs, and a study keeps rows beside its runs"),
        ('out = "runs"', 'out = "s3://me:hunter2@bucket"', 1, "s3://bucket was given with a user or a password"),
        ('"24x16"]', '"24"]', 4, "24"),
        ('"morton"', '"spiral"', 5, "order must be one of"),
        ('size = "1K,2K"', 'size = "1K,x"', 7, "size: 'x' is not a size"),
        ('"traced"', '"foo"', 8, "prefetch: "),
        ('"bfs"]', '"bfs"]\nflush = "x"', 10, "flush: 'x' is not one of never, ray"),
        ('"bfs"]', '"bfs"]\nreads = 3', 10, "replay.reads is 3, and not a text; write e.g. reads = 'own'"),
        ('"bfs"', '"foo"', 9, "layout: 'foo' is not a layout"),
        ("ways = 1", "ways = 3", 10, "is not a whole number of sets"),
        (
            "ways = 1",
            "ways = true",
            12,
            "time.ways is true, and not a text or a whole number, or a list of them; write e.g. ways = [1, 2, 'full']",
        ),
        ("ways = 1", "ways = []", 12, "time.ways is an empty list"),
        ("rays = [1, 4]", "rays = [1, 0.5]", 13, "time.rays is [1, 0.5], and not"),
        ("rays = [1, 4]", 'rays = "x"', 13, "rays: 'x' is not a whole number"),
        ("ways = 1", 'machine = "mine"', 10, "there is no machine 'mine'"),
        (
            '["ball.obj"]',
            "[1]",
            3,
            "render.scenes is [1], and not the name of a scene or a mesh file, or a list of such; write e.g. scenes",
        ),
        ('scenes = ["ball.obj"]', "", 2, "[render] names no scene"),
        (
            "[replay]",
            "seed = [1, 2]\n[replay]",
            6,
            "render.seed is [1, 2], and not a whole number from 0 to 2^63 - 1; write e.g. seed = 1",
        ),
        (
            "[replay]",
            "batch = -1\n[replay]",
            6,
            "render.batch is -1, and not a whole number from 0, or a list of such; write e.g. batch = 64",
        ),
        ('["16x16", "24x16"]', "4", 4, "render.pixels is 4, and not a text, or a list of such; write e.g. pixels = '64x64'"),
        ("[replay]", "kd = 3\n[replay]", 6, "render.kd is 3, and not a text, or a list of such; write e.g. kd = 'max_leaf=4'"),
        (
            "[replay]",
            "light = 1979-05-27\n[replay]",
            6,
            "render.light is 1979-05-27, and not a text; write e.g. light = '0,9,0'",
        ),
        ("[replay]", "[render.bvh]\nx = 1\n[replay]", 6, "render.bvh is {'x': 1}, and not a text, or a list of such; write"),
        (
            "[replay]",
            "shadow = [\n 'lit',\n 3]\n[replay]",
            6,
            "render.shadow is ['lit', 3], and not a text, or a list of such",
        ),
        ('size = "1K,2K"', '"size x" = 1', 7, "[replay] has no 'size x'; its keys are size, ways"),
        ("ways = 1", 'policy = """\nways = 3\n"""\nways = 1.5', 15, "time.ways is 1.5, and not a text or a whole number"),
        ("[replay]", "packet = 8\n[replay]", 6, "packet must be one of 1, 4, 16, 64 rays, got 8"),
        ("[replay]", "packet = [1, 4]\n[replay]", 6, "on the clock every ray reads for itself; leave out [time]"),
        ("[replay]", 'shadow = ["lit", "some"]\n[replay]', 6, "shadow must be one of lit, hit, all, got 'some'"),
        ("[replay]", 'shadow_end = "drain"\nbvh_nodes = 64\n[replay]', 7, "and not for bvh64; leave out"),
        ("[replay]", 'bvh = "fast"\n[replay]', 6, "'fast' is neither"),
        ("[replay]", "bvh_nodes = 48\n[replay]", 6, "bvh_nodes: '48' is not one of"),
        ("[replay]", 'camera = "eye=1"\n[replay]', 6, "eye=1"),
        ("[time]", "three_c = 1\n[time]", 10, "replay.three_c is 1, and not true or false; write e.g. three_c = true"),
        ('out = "runs"', "replay = 3", 1, "replay is a table|Cannot declare|line"),
    ],
)
def test_an_error_names_its_line(folder, old, new, line, sentence):
    text = STUDY.replace(old, new, 1)
    assert text != STUDY
    (folder / "study.toml").write_text(text)
    said = run(cli.nptrace, "run", "study.toml", code=2).stderr
    if new == "replay = 3":  # TOML's own error
        assert "study.toml is not valid TOML: " in said and "line" in said
        return
    assert said.startswith(f"Error: study.toml, line {line}: ") and sentence in said and said.count("\n") == 1
    assert not Path("runs").exists()


def test_packets_and_shadow_rays_are_combinations_too(folder):
    knobs = 'packet = [1, 16]\nshadow = ["lit", "hit"]\nshadow_order = "cheaper"\n'
    text = STUDY.replace('["16x16", "24x16"]', '"16x16"').replace('["scanline", "morton"]', f'"tile"\n{knobs}')
    (folder / "study.toml").write_text(text.partition("[time]")[0])
    run(cli.nptrace, "run", "study.toml")
    rows = pq.read_table("study.parquet").to_pylist()
    told = {(row["tree"], row["packet"], row["shadow"], row["shadow_order"], row["shadow_end"], row["run"]) for row in rows}
    names = [f"{packet}{shadow}-shadow-order-cheaper-16x16" for packet in ("", "-packet16") for shadow in ("", "-shadow-hit")]
    assert sorted(each[-1] for each in told) == sorted(
        f"ball-{tree}-tile{name}" for tree in ("kdtree", "bvh") for name in names
    )
    assert {each[1:5] for each in told} == {(n, who, "cheaper", "stop") for n in (1, 16) for who in ("lit", "hit")}


def test_what_is_no_study_is_one_sentence(folder):
    for text, sentence in (
        ("x", "is not valid TOML: "), ("[render]\nscenes = 'ball.obj'\n", "asks for no rows; add one of the tables [replay]"),
        ("[replay]\n", "has no table [render]"), ("render = 3\n", "study.toml, line 1: render is a table"),
    ):  # fmt: skip
        (folder / "study.toml").write_text(text)
        assert sentence in run(cli.nptrace, "run", "study.toml", code=2).stderr
    with pytest.raises(NptraceError, match="cannot read nosuch: No such file"):
        read_study(Path("nosuch"))


def test_the_example_runs(tmp_path, monkeypatch):
    """With smaller pictures and one scene; every key that it comments out is a key."""
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "docs" / "study.toml").read_text(encoding="utf-8")
    read_study(ROOT / "docs" / "study.toml")
    (tmp_path / "all.toml").write_text(
        "\n".join(line.removeprefix("# ") if line[:2] == "# " and " = " in line else line for line in text.splitlines())
    )
    assert read_study(tmp_path / "all.toml").render["strict"] is True
    (tmp_path / "study.toml").write_text(text.replace("48x48", "16x16").replace('["court", "nave"]', '"court"'))
    run(cli.nptrace, "run", "study.toml")
    rows = pq.read_table("study.parquet").to_pylist()
    assert {row["section"] for row in rows} == {"replay", "sweep", "time"} and len({row["run"] for row in rows}) == 4


def test_no_two_rows_of_the_table_look_alike(folder):
    text = STUDY.replace('["16x16", "24x16"]', '"16x16"').replace('["scanline", "morton"]', '"tile"')
    text = text.replace('prefetch = ["none", "traced"]', 'ways = 4\npolicy = ["lru", "fifo"]\nline = [32, 64]')
    (folder / "study.toml").write_text(text)
    printed = run(cli.nptrace, "run", "study.toml", "--format", "markdown").stdout
    rows = [[cell.strip() for cell in line.split("|")] for line in printed.splitlines() if line.startswith("| ball-")]
    n_keys = [cell.strip() for cell in printed.splitlines()[0].split("|")].index("demand miss rate %")
    assert len(rows) == 2 * (2 * 2 * 2 * 2 + 2) == len({tuple(row[:n_keys]) for row in rows})
