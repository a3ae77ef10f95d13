"""The names of runs: two scenes never share one, no run is lost unasked, and every run is found."""

import os
import shlex
import shutil

import pytest
from click.testing import CliRunner

import cli
from traces.reader import find_runs, open_run

ONE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 1\nf 1 2 3\nf 2 3 4\n"
TWO = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
SMALL = ["--accel", "bvh"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, text in (("a", ONE), ("b", TWO)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "model.obj").write_text(text)
    return tmp_path


def run(*args, code=0):
    result = CliRunner().invoke(cli.nptrace, ["render", *args])
    assert result.exit_code == code, result.output
    return result.stderr.splitlines()[-1]


def test_two_scenes_of_one_name_are_refused_before_anything_is_traced(folder):
    said = "Error: two scenes would both be traces/model-bvh; name them apart with --name, once per SCENE and --camera"
    assert run("a/model.obj", "b/model.obj", *SMALL, code=2) == said
    assert not (folder / "traces").exists()
    (folder / "a b.obj").write_text(ONE)
    (folder / "a-b.obj").write_text(TWO)
    assert "traces/a-b-bvh" in run("a b.obj", "a-b.obj", *SMALL, code=2)
    run("a/model.obj", "b/model.obj", *SMALL, "--name", "x", "--name", "y")
    counts = [open_run(folder / "traces" / f"{name}-bvh").footer.scene.n_triangles for name in "xy"]
    assert counts == [2, 1]
    said = run("a/model.obj", "b/model.obj", *SMALL, "--name", "x", "--name", "x", code=2)
    assert "two scenes would both be traces/x-bvh" in said


def test_a_name_is_that_of_a_folder_once_per_scene(folder):
    for name in ("../x", "a/b", "", ".", ".x", "-x", "a b"):
        assert f"--name: {name!r} cannot name a run" in run("a/model.obj", *SMALL, "--name", name, code=2)
    assert "there are 1 --name for 2 pictures" in run("a/model.obj", "b/model.obj", *SMALL, "--name", "x", code=2)
    assert not (folder / "traces").exists()


def test_a_name_changes_no_byte_of_a_run(folder):
    run("a/model.obj", *SMALL)
    run("a/model.obj", *SMALL, "--name", "x")
    for name in os.listdir("traces/model-bvh"):
        assert (folder / "traces/model-bvh" / name).read_bytes() == (folder / "traces/x-bvh" / name).read_bytes()


@pytest.mark.parametrize(
    ("args", "what"),
    [
        (["b/model.obj"], "scene"),
        (["a/model.obj", "--pixels", "128x9"], "height"),
        (["a/model.obj", "--batch", "0"], "batch"),
        (["a/model.obj", "--order", "tile"], "order"),
        (["a/model.obj", "--packet", "4"], "packet"),
        (["a/model.obj", "--shadow", "all"], "shadow"),
        (["a/model.obj", "--camera", "eye=1,2,3 at=0,0,0"], "camera, light"),
        (["a/model.obj", "--light", "1,2,3"], "light"),
        (["a/model.obj", "--bvh", "binned"], "tree"),
    ],
)
def test_another_run_of_the_name_is_kept_unless_it_may_be_replaced(folder, args, what):
    run("a/model.obj", *SMALL)
    before = open_run("traces/model-bvh").footer
    said = run(*SMALL, *args, "--name", "model", code=2)
    assert f"traces/model-bvh holds another run (of another {what}); replace it with --overwrite" in said
    assert open_run("traces/model-bvh").footer == before
    run(*SMALL, *args, "--name", "model", "--overwrite")
    assert open_run("traces/model-bvh").footer != before
    assert os.listdir("traces") == ["model-bvh"]


def test_the_same_run_replaces_itself_also_from_another_file_and_when_damaged(folder):
    run("a/model.obj", *SMALL)
    (folder / "a" / "copy.obj").write_text(ONE)
    run("a/copy.obj", *SMALL, "--name", "model")
    for name in ("accesses", "rays", "nodes"):
        (folder / "traces" / "model-bvh" / f"{name}.parquet").write_bytes(b"PAR1 nothing")
    run("b/model.obj", *SMALL)  # nothing can be read of the one before
    assert open_run("traces/model-bvh").footer.scene.n_triangles == 1


def test_nothing_is_traced_when_one_of_several_runs_would_be_lost(folder):
    run("b/model.obj", *SMALL, "--name", "second")
    said = run("a/model.obj", "a/model.obj", *SMALL, "--name", "first", "--name", "second", code=2)
    assert "traces/second-bvh holds another run (of another scene)" in said
    assert os.listdir("traces") == ["second-bvh"]


def test_a_stand_in_does_not_replace_the_real_scene(folder, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder / "cache"))
    (folder / "scenes").mkdir()
    (folder / "scenes" / "bunny.obj").write_text(ONE)
    monkeypatch.setenv("NPTRACE_SCENES", str(folder / "scenes"))
    run("bunny", *SMALL, "--offline")
    monkeypatch.delenv("NPTRACE_SCENES")
    run("bunny", *SMALL, "--offline")
    assert sorted(os.listdir("traces")) == ["bunny-bvh", "bunny-standin-bvh"]
    assert not open_run("traces/bunny-bvh").footer.scene.stand_in
    said = run("bunny", *SMALL, "--offline", "--name", "bunny", code=2)
    assert "traces/bunny-bvh holds another run (of another scene" in said


@pytest.mark.parametrize(
    ("args", "name"),
    [
        ([], "model-bvh"),
        (["--pixels", "9x8"], "model-bvh-9x8"),
        (["--pixels", "128x128", "--order", "scanline", "--batch", "1", "--seed", "0"], "model-bvh"),
        (["--order", "morton", "--batch", "0"], "model-bvh-morton-batch0"),
        (["--order", "random", "--seed", "3"], "model-bvh-random-seed3"),
        (["--order", "tile", "--packet", "64", "--pixels", "9x8"], "model-bvh-tile-packet64-9x8"),
        (["--batch", "4", "--shadow", "hit", "--shadow-end", "drain"], "model-bvh-batch4-shadow-hit-shadow-end-drain"),
        (["--packet", "1", "--shadow", "lit", "--shadow-order", "cheaper"], "model-bvh-shadow-order-cheaper"),
        (["--bvh", "binned", "--pixels", "9x8"], "model-bvh-binned-9x8"),
        (["--accel", "kdtree", "--kd", "c_trav=2,c_isect=2"], "model-kdtree-c_trav2"),
        (["--accel", "kdtree", "--kd", "coarse"], "model-kdtree-max_level16"),
    ],
)
def test_a_run_is_named_by_what_differs_from_the_defaults(folder, args, name):
    run("a/model.obj", *(args if "--accel" in args else [*SMALL, *args]))
    assert os.listdir("traces") == [name]


def test_the_command_of_a_run_makes_it_again(folder):
    shutil.copy("a/model.obj", "model.obj")
    knobs = ["--packet", "4", "--shadow", "hit", "--shadow-order", "cheaper", "--shadow-end", "drain"]
    for given in ([], knobs, knobs[2:4]):
        run("model.obj", *SMALL, "--pixels", "9x7", *given, "--out", "one", "--name", "x")
        program, _, *args = shlex.split(open_run("one/x-bvh").footer.command)
        assert program == "nptrace" and args[-len(given) - 2 : -2] == given
        run(*args, "--out", "two", "--name", "x")
        for name in os.listdir("one/x-bvh"):
            assert (folder / "one/x-bvh" / name).read_bytes() == (folder / "two/x-bvh" / name).read_bytes()
        for made in ("one", "two"):
            shutil.rmtree(made)


def test_each_camera_and_light_has_its_run(folder):
    cameras = ["--camera", "eye=1,2,3 at=0,0,0", "--camera", "eye=3,2,1 at=0,0,0"]
    run("a/model.obj", "b/model.obj", *SMALL, *cameras, "--name", "a", "--name", "b", "--name", "c", "--name", "d")
    eyes = [open_run(f"traces/{name}-bvh").footer.camera.eye for name in "abcd"]
    assert eyes == [(1, 2, 3), (3, 2, 1)] * 2
    run("a/model.obj", *SMALL, *cameras, "--out", "more")
    run("a/model.obj", *SMALL, "--light", "1,2,3", "--out", "more")
    names = sorted(os.listdir("more"))
    assert [name.rpartition("-")[0] for name in names] == ["model-bvh-camera"] * 2 + ["model-bvh-light"]
    assert "two scenes would both be traces/model-bvh-camera-" in run("a/model.obj", *SMALL, *cameras[:2] * 2, code=2)
    run("a/model.obj", *SMALL, "--out", "own")
    first = open_run("own/model-bvh").footer
    own = "eye={} at={}".format(*(",".join(map(repr, point)) for point in (first.camera.eye, first.camera.look_at)))
    run("a/model.obj", *SMALL, "--camera", own, "--out", "own")
    assert os.listdir("own") == ["model-bvh"]  # the scene's own view, spelled out


def test_every_run_is_found_but_hidden_ones(folder):
    for name in ("_part", "other", "__x"):
        run("a/model.obj", *SMALL, "--name", name)
    (folder / "traces" / "other-bvh").rename(folder / "traces" / ".other-bvh")
    assert [path.name for path in find_runs("traces")] == ["__x-bvh", "_part-bvh"]
