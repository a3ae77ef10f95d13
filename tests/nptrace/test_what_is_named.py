"""What is named and is no run, a command of the other program, a policy that a command lacks: what it is, and the way out."""

import pytest
from click.testing import CliRunner

import cli
from tests.nptrace.test_messages import inputs, said

RUN = "traces/one-bvh"
READERS = ["nptrace info", "npcache replay", "npcache time", "npcache compare", "npcache report -o x.html"]
ONE = ["nptrace export", "npcache summarise --part 1/1 -o x.sum"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    inputs(tmp_path)
    return tmp_path


@pytest.mark.parametrize("command", [*READERS, *ONE, "npcache sweep", "npcache table1", "nptrace view"])
def test_a_place_that_holds_no_run(folder, command):
    assert said(f"{command} nosuch") == (
        2, "", "Error: there is no nosuch; check the spelling, or make a run with nptrace render SCENE"
    )  # fmt: skip
    sentence = "Error: there is no run in folder; make one with nptrace render SCENE, or name another folder"
    assert said(f"{command} folder") == (2, "", sentence)
    part = f"{RUN}/rays.parquet"
    assert said(f"{command} {part}")[2] == f"Error: {part} is a part of a run; name the run, {RUN}"


@pytest.mark.parametrize("ending", ["csv", "json", "parquet"])
def test_a_table_of_results_is_no_run(folder, ending):
    CliRunner().invoke(cli.npcache, ["replay", RUN, "-o", f"x.{ending}"])
    for command in (*READERS, *ONE, "npcache sweep"):
        assert f"x.{ending} holds results, and no run; draw them with npcache plot" in said(f"{command} x.{ending}")[2]
    assert CliRunner().invoke(cli.npcache, ["plot", f"x.{ending}", "-o", "x.png"]).exit_code == 0


def test_tables_of_addresses_are_read_whatever_else_they_hold(folder):
    (folder / "x.csv").write_text("run,address\na,64\nb,4096\n")
    result = CliRunner().invoke(cli.npcache, ["replay", "x.csv", "--json"])
    assert result.exit_code == 0 and '"demand_accesses": 2' in result.stdout


def test_a_folder_that_is_missing_or_empty(folder):
    assert "there is no folder nosuch; make a run" in said("npcache replay --traces nosuch")[2]
    assert "there is no run in folder; make a run" in said("npcache replay --traces folder")[2]
    (folder / "traces").rename(folder / "other")
    assert "there is no folder traces; make a run with nptrace render SCENE" in said("nptrace info")[2]


def test_one_run_of_a_folder_is_enough_and_several_are_named(folder):
    assert CliRunner().invoke(cli.nptrace, ["export", "traces", "-o", "x.din"]).exit_code == 0
    CliRunner().invoke(cli.nptrace, ["render", "one.obj", "--pixels", "8x8", "--name", "two"])
    assert said("nptrace export traces -o x.din")[2] == "Error: traces holds 3 runs; name one of them, e.g. traces/one-bvh"


@pytest.mark.parametrize(
    ("command", "sentence"),
    [
        ("nptrace replay", "replay is a command of npcache, not of nptrace; write npcache replay"),
        ("npcache render x", "render is a command of nptrace, not of npcache; write nptrace render"),
        ("npcache info", "info is a command of nptrace, not of npcache; write nptrace info"),
    ],
)
def test_a_command_of_the_other_program(command, sentence):
    assert said(command) == (2, "", f"Error: {sentence}")


@pytest.mark.parametrize("command", [f"npcache replay {RUN}", f"npcache sweep {RUN}", f"npcache report {RUN} -o x.html"])
def test_an_unknown_policy_lists_those_that_the_command_takes(folder, command):
    said_ = said(f"{command} --prefetch foo")[2]
    assert "--prefetch: there is no prefetch policy 'foo'; write one of next-line" in said_
    assert "predictor" not in said_ and "stride" not in said_
    clocked = said(f"npcache time {RUN} --prefetch foo")[2]
    assert "predictor" in clocked and "stride" in clocked
    assert "write one of all, next-line" in said(f"npcache compare {RUN} --prefetch foo")[2]


def test_an_unknown_replacement_lists_those_that_the_command_takes(folder):
    for command, taken in (
        (f"npcache replay {RUN}", "lru, fifo, random or opt"), (f"npcache time {RUN}", "lru, fifo or random"),
        ("npcache estimate one.obj", "lru"), (f"npcache summarise {RUN} --part 1/1 -o x", "lru"),
    ):  # fmt: skip
        sentence = f"Error: --policy: 'mru' is not a replacement policy; choose {taken}"
        assert said(f"{command} --policy mru")[2] == sentence


def test_a_part_is_refused_without_a_word_of_workers(folder):
    for given in ("--policy fifo", "--prefetch next-line:miss"):
        sentence = said(f"npcache summarise {RUN} --part 1/2 -o x.sum {given}")[2]
        assert sentence.endswith("; use npcache replay for the whole run") and "worker" not in sentence
