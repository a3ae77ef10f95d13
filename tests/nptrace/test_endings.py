"""The ending of an output's name chooses its format in any case, an unknown one is refused; a terminal gets no bytes."""

import os
import pty
import threading

import click.testing
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

import cli
from tests.nptrace.test_messages import inputs

RUN = "traces/one-bvh"
TABLES = [
    "nptrace info", "nptrace scenes", "nptrace compile", "nptrace check one.obj --pixels 4x4 --random 9",
    "nptrace render one.obj --pixels 4x4", "nptrace map one.obj --quick --pixels 4x4", "nptrace run study.toml",
    "npcache replay", "npcache sweep --size 1K", "npcache time", "npcache compare", "npcache combine 1.sum", "npcache table1",
    "npcache estimate one.obj",
]  # fmt: skip


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    inputs(tmp_path)
    return tmp_path


def run(command, *, code=0):
    program, *words = command.split()
    result = CliRunner().invoke(getattr(cli, program), words, catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result


@pytest.mark.parametrize("command", TABLES)
def test_an_unknown_ending_is_refused_before_any_work(folder, command):
    before = sorted(folder.rglob("*"))
    for name in ("x.foo", "x.csv.gz"):
        said = run(f"{command} -o {name}", code=2).stderr
        known = ".csv, .json, .parquet, .md, .tex or .txt"
        ending = name.rpartition(".")[2]
        assert said == (f"Error: -o {name}: no format has the ending .{ending}; end it in {known}, or give --format\n")
    assert sorted(folder.rglob("*")) == before


def test_an_unknown_ending_of_other_outputs(folder):
    said = run(f"nptrace export {RUN} -o x.foo", code=2).stderr
    assert said == "Error: -o x.foo: no format has the ending .foo; end it in .din, .csv or .parquet, or give --format\n"
    for command, endings in (
        (f"nptrace view {RUN} -o", ".png"), (f"nptrace view {RUN} --heat accesses -o", ".pdf or .png or .svg"),
        (f"npcache plot {RUN} -o", ".pdf or .png or .svg"), (f"npcache report {RUN} -o", ".html"),
        (f"npcache sweep {RUN} --plot", ".pdf or .png or .svg"), (f"npcache compare {RUN} --plot", ".pdf or .png or .svg"),
        ("nptrace map one.obj --quick --plot", ".pdf or .png or .svg"),
    ):  # fmt: skip
        assert run(f"{command} x.foo", code=2).stderr == f"Error: cannot write x.foo: its name must end in {endings}\n"


def test_the_case_of_an_ending_does_not_count(folder):
    run(f"npcache sweep {RUN} --size 1K..4K -o X.JSON")
    assert (folder / "X.JSON").read_text().startswith("[")
    run(f"npcache sweep {RUN} --size 1K..4K -o X.Parquet")
    assert pq.read_table("X.Parquet").num_rows == 3
    run("npcache plot X.Parquet -o X.PNG")
    run("npcache plot X.JSON -o X.Svg")
    run(f"nptrace view {RUN} -o Y.PNG")
    run(f"npcache sweep {RUN} --plot Z.PNG")
    assert {(folder / name).read_bytes()[:4] for name in ("X.PNG", "Y.PNG", "Z.PNG")} == {b"\x89PNG"}
    assert b"<svg" in (folder / "X.Svg").read_bytes()
    run(f"nptrace export {RUN} -o X.PARQUET")
    assert "address" in pq.read_schema("X.PARQUET").names


def test_a_name_without_an_ending_and_a_format_that_is_given(folder):
    run("nptrace scenes -o scenes")
    run("nptrace scenes -o scenes.foo --format json")
    assert (folder / "scenes").read_text().split()[0] == "Scene" and (folder / "scenes.foo").read_text().startswith("[")
    os.mkfifo("x.foo")
    reader = os.open("x.foo", os.O_RDONLY | os.O_NONBLOCK)
    run("nptrace scenes -o x.foo")
    assert b"Scene" in os.read(reader, 9999)
    os.close(reader)


def _read(terminal):
    try:
        return os.read(terminal, 65536)
    except OSError:  # the other end is closed
        return b""


@pytest.mark.parametrize(
    ("command", "what"),
    [
        (f"nptrace view {RUN} -o", "a picture"),
        (f"nptrace view {RUN} --heat accesses -o", "a picture"),
        (f"npcache plot {RUN} -o", "a picture"),
        (f"npcache sweep {RUN} --plot", "a picture"),
        (f"npcache compare {RUN} --plot", "a picture"),
        ("nptrace map one.obj --quick --plot", "a picture"),
        (f"nptrace export {RUN} --binary -o", "a trace in binary records"),
        (f"nptrace export {RUN} --format parquet -o", "Parquet"),
        (f"npcache replay {RUN} --format parquet -o", "Parquet"),
        ("nptrace run study.toml --format parquet -o", "Parquet"),
    ],
)
def test_a_terminal_gets_no_bytes_and_a_pipe_does(folder, monkeypatch, command, what):
    (folder / "study.toml").write_text('[render]\nscenes = ["one.obj"]\npixels = "4x4"\n[replay]\nsize = "1K"\n')
    sentence = f"Error: {what} is not for a terminal; name a file, or pipe it to a program\n"
    master, slave = pty.openpty()
    shown = threading.Thread(target=lambda: [*iter(lambda: _read(master), b"")])  # else a writer that is not refused waits
    shown.start()
    said = CliRunner().invoke(getattr(cli, command.split()[0]), [*command.split()[1:], os.ttyname(slave)]).stderr
    os.close(slave)
    shown.join()
    os.close(master)
    assert said == sentence
    monkeypatch.setattr(click.testing._NamedTextIOWrapper, "isatty", lambda self: True)
    assert run(f"{command} -", code=2).stderr == sentence
    monkeypatch.undo()
    monkeypatch.chdir(folder)
    if "map" not in command:
        assert len(run(f"{command} -").stdout_bytes) > 50
