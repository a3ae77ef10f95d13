"""The next command that a last line names runs as it is printed, and is about the same runs, caches and policies."""

import json
import os
import shlex
import subprocess

import pytest
from click.testing import CliRunner

import cli
from rtrace.scenes.shapes import icosphere
from tests.nptrace.test_nptrace import write_obj

OUT = "--pixels 8x8 --out"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("following")
    write_obj(folder / "-ball.obj", icosphere(1))
    before = os.getcwd()
    os.chdir(folder)
    for name in "abcd":
        run(f"nptrace render --accel bvh {OUT} many --name {name} -- -ball.obj")
    run(f"nptrace render --accel bvh {OUT} packets --packet 4 -- -ball.obj")
    run("nptrace export many/a-bvh -o a.din")
    os.chdir(before)
    return folder


@pytest.fixture
def folder(made, monkeypatch):
    monkeypatch.chdir(made)
    return made


def run(command, input=None):
    # The words are the shell's; the program runs here, as another start of it takes seconds.
    printed = subprocess.run(["bash", "-c", f'printf "%s\\0" {command}'], capture_output=True, check=True).stdout
    program, *words = map(os.fsdecode, printed.split(b"\0")[:-1])
    result = CliRunner().invoke(getattr(cli, program), words, input=input, catch_exceptions=False)
    assert result.exit_code == 0, (command, result.output)
    return result


def following(command, input=None):
    return run(command, input).stderr.rstrip("\n").partition("; next: ")[2]


MANY = " ".join(f"many/{name}-bvh" for name in "abcd")
SOME = " ".join(f"many/{name}-bvh" for name in "abd")
FOLLOWING = [
    (f"npcache replay {MANY}", "npcache sweep --traces many --size 4K..64K -o sweep.csv"),
    ("npcache replay many", "npcache sweep --traces many --size 4K..64K -o sweep.csv"),
    ("npcache replay --traces many", "npcache sweep --traces many --size 4K..64K -o sweep.csv"),
    (f"npcache replay {SOME}", f"npcache sweep {SOME} --size 4K..64K -o sweep.csv"),
    (
        "npcache replay many/a-bvh --size 1K --ways 2 --line 64 --layout veb,bfs --prefetch none,stack --json",
        "npcache sweep many/a-bvh --ways 2 --line 64 --prefetch none,stack --layout veb,bfs --size 4K..64K -o sweep.csv",
    ),
    ("npcache replay many/a-bvh --policy lru --reads own", "npcache sweep many/a-bvh --size 4K..64K -o sweep.csv"),
    ("npcache replay many/a-bvh --policy fifo", ""),  # which a sweep does not know
    ("npcache replay many/a-bvh --prefetch next-line:miss", ""),
    ("npcache replay many/a-bvh --flush ray", ""),
    (
        "npcache sweep many/a-bvh --size 1K..2K --ways 1,2 --line 64 -o x.csv",
        "npcache time many/a-bvh --size 1K..2K --ways 1,2 --line 64 --prefetch stack,push",
    ),
    (
        "npcache sweep many/a-bvh --size 6K --ways 3 -o x.csv",
        "npcache time many/a-bvh --size 6K --ways 3 --prefetch stack,push",
    ),
    ("npcache sweep many/a-bvh --size 5K..6K --ways 3 -o x.csv", ""),  # of which 5K is no cache
    ("npcache sweep packets -o x.csv", ""),  # which a clock cannot time
    ("npcache sweep a.din -o x.csv", ""),
    (
        "npcache time many/a-bvh --machine ttp --size 8K,16K --ways 1..2 --rays 4,8 --layout veb --prefetch push",
        "npcache compare many/a-bvh --machine ttp --size 8K --ways 1 --rays 4 --layout veb",
    ),
    ("npcache time many/a-bvh --policy lru,random --seed 3", "npcache compare many/a-bvh --policy lru"),
    ("npcache time many/a-bvh --policy random --seed 3", "npcache compare many/a-bvh --policy random --seed 3"),
    (
        "npcache compare many/a-bvh --size 16K --hit 2 --prefetch push --no-baselines --layout bfs",
        "npcache report many/a-bvh --size 16K --hit 2 --layout bfs -o report.html",
    ),
    (
        "npcache estimate ./-ball.obj --accel bvh --pixels 16x16 --size 1K --order tile --seed 2 --light 1,2,3",
        "nptrace render ./-ball.obj --accel bvh --light 1,2,3 --order tile --pixels 16x16",
    ),
    ("npcache estimate ./-ball.obj --pixels 16x16 --order random --seed 2",
     "nptrace render ./-ball.obj --order random --seed 2 --pixels 16x16"),
    ("nptrace check --pixels 4x4 --random 9 -- -ball.obj", "nptrace render ./-ball.obj"),
    ("nptrace export many/a-bvh -o ./-x.din", "npcache replay ./-x.din"),
    ("nptrace export many/a-bvh -o /dev/null", ""),
    (f"nptrace render --accel bvh {OUT} many --name a -- -ball.obj", "npcache replay many/a-bvh --size 8K,16K"),
    (f"nptrace render {OUT} 'o t' -- -ball.obj", "npcache replay --traces 'o t' --size 8K,16K"),
    ("npcache summarise many/a-bvh --part 1/2 -o 1.sum", ""),
    ("npcache summarise many/a-bvh --part 2/2 -o 2.sum", "npcache combine *.sum"),
]  # fmt: skip


@pytest.mark.parametrize(("command", "expected"), FOLLOWING)
def test_the_next_command_is_about_the_same_and_runs(folder, command, expected):
    printed = following(command)
    assert printed == expected
    if printed.startswith("npcache report"):
        printed = printed.replace("report", "info", 1).replace("npcache", "nptrace").split(" --")[0]  # the page takes long
    if printed:
        run(printed)


def test_what_came_through_a_pipe_cannot_be_read_again(folder):
    assert following("npcache replay -", input=(folder / "a.din").read_bytes()) == ""


def test_the_next_command_of_table_1_and_of_a_study(folder):
    run(f"nptrace render bunny {OUT} paper --accel bvh")
    assert following("npcache table1 --traces paper --miss 50 --layout bfs --n measured") == (
        "npcache compare paper/bunny-standin-bvh-8x8 --layout bfs --miss 50"
        if os.path.exists("paper/bunny-standin-bvh-8x8")
        else "npcache compare paper/bunny-bvh-8x8 --layout bfs --miss 50"
    )
    study = '[render]\nscenes = ["./-ball.obj"]\npixels = "8x8"\naccel = "bvh"\n[replay]\nsize = "1K"\n'
    (folder / "study.toml").write_text('out = "many"\n' + study)
    said = following("nptrace run study.toml --format csv")
    assert said == "npcache compare many/ball-bvh-8x8"
    assert json.loads(run(said + " --json").stdout)[0]["run"] == "ball-bvh-8x8" and shlex.split(said)
    (folder / "study.toml").write_text('out = "many"\n' + study.replace('"bvh"', '"bvh"\npacket = 4'))
    assert following("nptrace run study.toml --format csv") == ""
