"""The nptrace commands as a user types them: output, files, exit status, and one sentence for every bad input."""

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import cli
from rtrace.scenes.shapes import boxes, icosphere
from traces.format import FILES
from traces.reader import open_run


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_obj(tmp_path / "ball.obj", icosphere(3))
    return tmp_path


def write_obj(path, triangles):
    lines = ["v {} {} {}".format(*map(repr, map(float, corner))) for corner in triangles.reshape(-1, 3)]
    lines += [f"f {3 * i + 1} {3 * i + 2} {3 * i + 3}" for i in range(len(triangles))]
    path.write_text("\n".join(lines) + "\n")


def run(*args, code=0):
    result = CliRunner().invoke(cli.nptrace, [str(a) for a in args], catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result


def test_render_writes_both_trees_and_reports_them(folder):
    result = run("render", "ball.obj", "--name", "ball", "--pixels", "40x30")
    assert "traces/ball-kdtree" in result.stdout and "traces/ball-bvh" in result.stdout
    assert re.fullmatch(r"2 runs, [\d,]+ rays, [\d.]+ kB in \d+\.\d s; next: npcache replay --size 8K,16K\n", result.stderr)
    verbose = run("render", "ball.obj", "--name", "ball", "--pixels", "40x30", "-v").stderr
    assert "float32 vertices, float64 arithmetic: the shortest edge is" in verbose and verbose.count("\n") == 2
    quiet = run("render", "ball.obj", "--name", "ball", "--pixels", "40x30", "-q")
    assert quiet.stderr == "" and quiet.stdout == result.stdout
    for tree in ("kdtree", "bvh"):
        opened = open_run(folder / "traces" / f"ball-{tree}")
        assert (opened.footer.width, opened.footer.height) == (40, 30)
        assert opened.footer.tree.kind == tree
        assert sorted(os.listdir(opened.path)) == sorted(FILES)


def test_json_counts_are_those_of_the_files(folder):
    (summary,) = json.loads(run("render", "ball.obj", "--accel", "bvh", "--pixels", "32x32", "--json").stdout)
    opened = open_run(summary["path"])
    rays = opened.columns("rays")
    kinds = np.concatenate([kind for _, kind in opened.batches()])
    assert summary["n_rays"] == len(rays["ray"]) and summary["n_shadow_rays"] == (rays["type"] == 1).sum()
    assert summary["n_accesses"] == (kinds != 3).sum() and summary["n_prefetches"] == (kinds == 3).sum()
    assert summary["n_hits"] == ((rays["prim"] >= 0) & (rays["type"] == 0)).sum() > 100
    assert summary["n_bytes"] == sum((opened.path / name).stat().st_size for name in FILES)


def test_the_recorded_command_makes_the_same_bytes(folder):
    import shlex

    args = ["--accel", "kdtree", "--pixels", "33x21", "--order", "hilbert", "--kd", "coarse", "--threads", 1]
    run("render", "ball.obj", *args)
    first = folder / "traces" / "ball-kdtree-max_level16-hilbert-33x21"
    words = shlex.split(open_run(first).footer.command)
    assert words[0] == "nptrace"
    run(*words[1:], "--out", "again", "--threads", 2)
    for name in FILES:
        assert (folder / "again" / first.name / name).read_bytes() == (first / name).read_bytes()


def test_options_reach_the_run(folder):
    camera = "eye=0,1,4 at=0,0,0 up=0,1,0 fov=50"
    args = ["--pixels", "24x24", "--camera", camera, "--light", "3,3,3", "--order", "random", "--seed", "9", "--batch", "64"]
    run("render", "ball.obj", "--name", "ball", *args, "--kd", "c_trav=1,max_level=7", "--bvh", "binned")
    kd, bvh = (open_run(folder / "traces" / f"ball-{t}").footer for t in ("kdtree", "bvh"))
    assert kd.camera.eye == (0, 1, 4) and kd.camera.fov == 50 and kd.light == (3, 3, 3)
    assert (kd.order, kd.seed, kd.batch) == ("random", 9, 64)
    assert (kd.tree.params["c_trav"], kd.tree.params["max_level"], bvh.tree.params["builder"]) == (1.0, 7, "binned")


def test_check_agrees_and_exits_1_beyond_a_limit(folder, monkeypatch):
    result = run("check", "ball.obj", "--pixels", "32x32", "--random", 2000)
    assert "0 beyond their limit" in result.stdout
    rows = json.loads(run("check", "ball.obj", "--pixels", "32x32", "--random", 2000, "--json").stdout)
    assert all(row["is_good"] for row in rows) and {row["tree"] for row in rows} == {"kdtree", "bvh", "bvh64"}
    monkeypatch.setattr("rtrace.checks.embree.KAPPA_LIMIT", -1.0)
    assert "BEYOND" in run("check", "ball.obj", "--pixels", "32x32", "--random", 2000, code=1).stdout


def test_scenes_are_listed(folder):
    assert "sponza" in run("scenes").stdout
    assert {row["name"] for row in json.loads(run("scenes", "--json").stdout)} >= {"bunny", "conference", "sibenik", "sponza"}


def test_the_ending_chooses_the_format_of_an_exported_run(folder):
    run("render", "ball.obj", "--name", "ball", "--accel", "bvh", "--pixels", "16x16")
    for name, first in (("x.parquet", b"PAR1"), ("x.csv", b"address"), ("x.din", b"0 "), ("x.CSV", b"address")):
        run("export", "traces/ball-bvh", "-o", name)
        assert Path(name).read_bytes().startswith(first), name
    run("export", "traces/ball-bvh", "--format", "din", "-o", "y.csv")
    assert Path("y.csv").read_bytes().startswith(b"0 ")


def test_an_exported_run_is_a_din_trace(folder):
    run("render", "ball.obj", "--name", "ball", "--accel", "bvh", "--pixels", "16x16")
    run("export", "traces/ball-bvh")
    lines = Path("ball-bvh.din").read_text().splitlines()
    assert len(lines) == open_run("traces/ball-bvh").n_accesses
    assert {line.split()[0] for line in lines} == {"0", "b"}
    run("export", "traces/ball-bvh", "--binary", "--prefetch-as", "omit", "-o", "x.bin")
    assert Path("x.bin").stat().st_size == 8 * sum(line[0] == "0" for line in lines)


@pytest.mark.parametrize(
    "args, words",
    [
        (["nowhere.obj"], "nowhere.obj"),
        (["bunnny"], "did you mean bunny"),
        (["broken.obj"], "broken.obj"),
        (["empty.ply"], "empty"),
        (["ball.obj", "--pixels", "0x10"], "0x10"),
        (["ball.obj", "--pixels", "99999x99999"], "99999x99999"),
        (["ball.obj", "--pixels", "wide"], "wide"),
        (["ball.obj", "--camera", "eye=1,2,3 at=1,2,3"], "same point"),
        (["ball.obj", "--camera", "eye=0,5,0 at=0,0,0 up=0,1,0"], "parallel"),
        (["ball.obj", "--camera", "from=0,5,0"], "from=0,5,0"),
        (["ball.obj", "--light", "1,2"], "1,2"),
        (["ball.obj", "--kd", "depth=3"], "depth=3"),
        (["ball.obj", "--kd", "c_trav=lots"], "lots"),
        (["ball.obj", "--kd", "c_trav=-1"], "-1"),
        (["ball.obj", "--out", "ball.obj"], "ball.obj"),
    ],
)
def test_bad_input_is_one_sentence_and_leaves_nothing(folder, args, words):
    (folder / "broken.obj").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(range(256)))
    (folder / "empty.ply").write_bytes(b"")
    before = sorted(p.name for p in folder.iterdir())
    result = run("render", "--pixels", "16x16", *args, code=2)
    assert words in result.stderr and "Traceback" not in result.stderr and result.stdout == ""
    assert sorted(p.name for p in folder.iterdir()) == before


def test_bad_triangles_are_dropped_with_a_warning_or_refused(folder):
    triangles = boxes()
    triangles[[3, 7], 0, 0] = np.nan
    write_obj(folder / "holes.obj", triangles)
    result = run("render", "holes.obj", "--name", "holes", "--accel", "bvh", "--pixels", "16x16")
    assert "2" in result.stderr and "3, 7" in result.stderr
    assert open_run("traces/holes-bvh").footer.scene.n_triangles == len(triangles) - 2
    assert "--strict" in run("render", "holes.obj", "--strict", code=2).stderr


def test_a_directory_that_is_no_run_is_not_overwritten(folder):
    (folder / "traces" / "ball-bvh").mkdir(parents=True)
    (folder / "traces" / "ball-bvh" / "thesis.tex").write_text("precious")
    assert "is not a run" in run("render", "ball.obj", "--name", "ball", "--accel", "bvh", "--pixels", "8x8", code=2).stderr
    assert (folder / "traces" / "ball-bvh" / "thesis.tex").read_text() == "precious"


def test_a_read_only_folder_is_reported(folder):
    if os.geteuid() == 0:
        target = "/proc/runs"  # root may write anywhere but here
    else:
        (folder / "locked").mkdir(mode=0o500)
        target = "locked/runs"
    assert "cannot write" in run("render", "ball.obj", "--name", "ball", "--pixels", "8x8", "--out", target, code=2).stderr
