"""Notes, last lines and commands fit the terminal, can still be pasted, and explain no column that it has no room for."""

import json
import subprocess

import pytest
from click.testing import CliRunner

import cli
from nptrace import progress
from nptrace_base import compiling, tables
from nptrace_base.shell import command_lines, word
from nptrace_base.tables import Table
from tests.nptrace.test_run_names import ONE

CAMERA = "eye=-0.123456789,0.29,0.28 at=0.142497,-0.237678,-0.527869 up=0.0945048,0.847262,-0.522701 fov=31.417"


def words_of(lines):
    printed = subprocess.run(["bash", "-c", 'printf "%s\\0" ' + "\n".join(lines)], capture_output=True, check=True)
    return printed.stdout.split(b"\0")[:-1]


@pytest.mark.parametrize("width", [40, 60, 80, 100, None])
def test_a_command_on_several_lines_is_the_same_to_a_shell(width):
    names = [f"a b {i}'s" for i in range(9)] + ["x\ny", "\udce9", CAMERA, f"'{CAMERA}", "--option", "plain" * 3]
    command = " ".join(["nptrace", *map(word, names)])
    lines = command_lines(command, width)
    assert words_of(lines) == words_of([command]) and len(words_of(lines)) == len(names) + 1
    if width in (60, 80, 100):
        assert (
            max(map(len, command_lines(f"nptrace --camera '{CAMERA}' --light 1,2,3 {'--pixels 8x8 ' * 20}", width))) <= width
        )


def test_info_fits_and_its_command_can_be_pasted(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = "a-rather-long-name-of-a-folder/and-another-one-that-is-long-too"
    (tmp_path / "mesh.obj").write_text(ONE)
    made = ["render", "mesh.obj", "--accel", "bvh", "--pixels", "8x8", "--camera", CAMERA, "--out", folder]
    assert CliRunner().invoke(cli.nptrace, made).exit_code == 0
    [record] = json.loads(CliRunner().invoke(cli.nptrace, ["info", folder, "--json"]).stdout)
    for width in (80, 100, 120):
        monkeypatch.setattr(tables, "width_of", lambda file, width=width: width)
        lines = CliRunner().invoke(cli.nptrace, ["info", folder]).stdout.rstrip("\n").splitlines()
        assert max(map(len, lines)) <= width
        first = next(i for i, line in enumerate(lines) if line.startswith("nptrace render"))
        assert words_of(lines[first:]) == words_of([record["command"]])
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    for form in ("table", "markdown", "latex"):
        assert record["command"] in CliRunner().invoke(cli.nptrace, ["info", folder, "--format", form]).stdout


def test_a_note_explains_the_columns_that_are_shown(capsys, monkeypatch):
    note = "wide thing = a / b; left: what stays; wide thing and left differ. Not shown are zeros."
    table = Table("", ["left", "right", "wide\nthing %"], [["x" * 30, "1" * 30, "2" * 30]], extra=("wide\nthing %",))
    for width, shown in ((120, True), (70, False)):
        monkeypatch.setattr(tables, "width_of", lambda file, width=width: width)
        tables.print_tables([table], [note, "wide thing: gone as a whole."], tables_out := Out())
        text = " ".join(tables_out.text.split())
        assert ("wide thing = a / b" in text) == ("gone as a whole" in text) == shown
        assert "left: what stays; wide thing and left differ. Not shown are zeros." in text


class Out:
    text = ""

    def write(self, text):
        self.text += text

    def isatty(self):
        return False

    def flush(self):
        pass


def test_notes_and_last_lines_fit_the_terminal(capsys, monkeypatch, tmp_path):
    monkeypatch.setattr(progress, "_width", lambda: 80)
    monkeypatch.setattr(compiling, "announce", progress.say)
    monkeypatch.setattr(compiling, "n_compiled", 0)
    compiling.started(tmp_path / "a-folder" / "of-which-the-name" / "is-long" / "x")
    compiling.ended()
    said = capsys.readouterr().err
    assert "compiling for this machine" in said and len(said.splitlines()) > 1
    assert all(len(line) <= 80 or " " not in line for line in said.splitlines())  # a path is never broken
    following = "npcache sweep " + " ".join(f"traces/run-{i}" for i in range(12)) + " --size 4K..64K -o sweep.csv"
    progress.done("12 runs, 1 cache, 2,890,696 accesses read", 0, following)
    first, second, *command = capsys.readouterr().err.splitlines()
    assert first.endswith(" s") and second == "next:" and max(map(len, command)) <= 80
    assert words_of(command) == words_of([following])
    progress.done("1 run", 0, "npcache replay")
    assert capsys.readouterr().err.endswith(" s; next: npcache replay\n")
