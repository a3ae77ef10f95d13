"""The command that nptrace info prints of a run, pasted into a shell, makes the same files in the same place."""

import json
import os
import shlex
import shutil
import subprocess

import pytest
from click.testing import CliRunner

import cli
from nptrace_base.shell import word
from tests.nptrace.test_run_names import ONE

NAMES = ["m/model.obj", "-dash.obj", "m/a b.obj", "m/it's.obj", "m/a\nb.obj", "m/caf\udce9.obj"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    os.mkdir("m")
    for name in NAMES:
        with open(name, "w") as file:
            file.write(ONE)
    return tmp_path


def run(*args):
    result = CliRunner().invoke(cli.nptrace, args, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


def content(path):
    return {name: (path / name).read_bytes() for name in os.listdir(path)}


@pytest.mark.parametrize("mesh", NAMES)
@pytest.mark.parametrize("place", [(), ("--name", "x"), ("--out", "o u t", "--bvh-nodes", "64", "--order", "random")])
def test_pasted_into_a_shell_it_makes_the_run_again(folder, mesh, place):
    run("render", "--accel", "bvh", "--pixels", "4x4", *place, "--", mesh)
    [found] = {path.parent for path in folder.rglob("accesses.parquet")}
    before = content(found)
    [record] = json.loads(run("info", str(found.relative_to(folder)), "--json"))
    shutil.rmtree(found)
    # The words are the shell's; the program runs here, as another start of it takes seconds.
    printed = subprocess.run(["bash", "-c", f'printf "%s\\0" {record["command"]}'], capture_output=True, check=True).stdout
    program, *args = map(os.fsdecode, printed.split(b"\0")[:-1])
    assert program == "nptrace"
    run(*args)
    assert content(found) == before


def test_a_run_in_this_folder_and_one_of_the_catalogue(folder):
    run("render", "blob", "--accel", "bvh", "--pixels", "4x4", "--out", ".")
    [record] = json.loads(run("info", "blob-standin-bvh-4x4", "--json"))
    assert record["command"].startswith("nptrace render blob --accel bvh") and record["command"].endswith(" --out .")
    os.chdir("blob-standin-bvh-4x4")
    [inside] = json.loads(run("info", ".", "--json"))
    assert inside["command"].endswith(f" --out {word(folder)}")


def test_words_of_a_shell():
    assert [word(name) for name in ("a.obj", "a b", "-x", "-", "a'b", "a\nb", "\udce9'")] == [
        "a.obj", "'a b'", "./-x", "-", shlex.quote("a'b"), "$'a\\x0ab'", "$'\\xe9\\''"
    ]  # fmt: skip


def test_kept_counts_go_on_wherever_the_mesh_lies(folder):
    shutil.copy("m/model.obj", "model.obj")
    for mesh in ("m/model.obj", "model.obj"):
        args = ["estimate", mesh, "--accel", "bvh", "--pixels", "256x256", "--exact-below", "0", "--resume", "kept"]
        result = CliRunner().invoke(cli.npcache, [*args, "--target-error", "50%"], catch_exceptions=False)
        assert result.exit_code == 0, result.output
