"""The list of messages: each command's answer to each kind of bad input, word for word; a bug is not reported as one.

``messages.txt`` has a command per line and its sentence below; ``python -m tests.nptrace.test_messages`` prints it again.
"""

import os
import shlex
import tempfile
from pathlib import Path

import pytest
from click.testing import CliRunner

import cli
import rtrace.scenes.catalog

LIST = Path(__file__).with_name("messages.txt")
FILES = {
    "one.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    "empty.obj": "",
    "odd.xyz": "1",
    "x.din": "0 1000\n",
    "bad.din": "0 xyz\n",
    "empty.din": "",
}


def inputs(folder):
    for name, text in FILES.items():
        (folder / name).write_text(text)
    (folder / "folder").mkdir()
    args = ["render", "one.obj", "--name", "one", "--accel", "bvh", "--pixels", "8x8", "--out", str(folder / "traces")]
    done = CliRunner().invoke(cli.nptrace, args)
    assert done.exit_code == 0, done.output


def said(command):
    """Return the exit status, what the command printed, and its last line on stderr."""
    program, *args = shlex.split(command)
    result = CliRunner().invoke(getattr(cli, program), args)
    return result.exit_code, result.stdout, result.stderr.rstrip("\n").rpartition("\n")[2]


def listed():
    lines = LIST.read_text(encoding="utf-8").splitlines()
    return list(zip((line.removeprefix("$ ") for line in lines[::2]), lines[1::2], strict=True))


def test_every_bad_input_has_its_sentence(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("NPTRACE_SCENES", raising=False)
    inputs(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    assert len(listed()) > 100
    for command, sentence in listed():
        assert said(command) == (2, "", sentence), command
    assert sorted(tmp_path.rglob("*")) == before


def test_every_command_is_in_the_list():
    commands = {" ".join(shlex.split(command)[:2]) for command, _ in listed()}
    for program in ("nptrace", "npcache"):
        for name in getattr(cli, program).commands:
            assert f"{program} {name}" in commands


def test_no_sentence_is_a_bare_exception():
    for command, sentence in listed():
        assert sentence.startswith("Error: ") and len(sentence) > 25, command
        for noise in ("Errno", "Traceback", "codec", "index out of", "indices must be", "NoneType", "object is"):
            assert noise not in sentence


@pytest.mark.parametrize(
    "bug", [ValueError("min() arg is an empty sequence"), KeyError("scene"), OSError("odd"), OverflowError()]
)
def test_a_bug_is_no_message(tmp_path, monkeypatch, bug):
    """It is raised out of the command, which shows its traceback and exits 1."""
    monkeypatch.chdir(tmp_path)

    def fail(*args, **kwargs):
        raise bug

    monkeypatch.setattr(rtrace.scenes.catalog, "load_scene", fail)
    result = CliRunner().invoke(cli.nptrace, ["render", "one.obj"])
    assert (result.exit_code, result.exception, result.stderr) == (1, bug, "")


@pytest.mark.parametrize(
    ("trouble", "sentence"),
    [
        (PermissionError(13, "Permission denied", "some/file"), "some/file: Permission denied; name another file or folder"),
        (OSError(28, "No space left on device"), "standard output: No space left on device; name another file or folder"),
        (MemoryError(), "there is not enough memory; take a smaller picture, mesh or cache, or fewer rays"),
        (MemoryError("9 GB"), "there is not enough memory (9 GB); take a smaller picture, mesh or cache, or fewer rays"),
    ],
)
def test_trouble_of_the_machine_is_one_sentence(monkeypatch, trouble, sentence):
    def fail(*args, **kwargs):
        raise trouble

    monkeypatch.setattr(rtrace.scenes.catalog, "load_scene", fail)
    result = CliRunner().invoke(cli.nptrace, ["render", "one.obj"])
    assert (result.exit_code, result.stdout, result.stderr) == (2, "", f"Error: {sentence}\n")


def main():
    with tempfile.TemporaryDirectory() as name:
        os.environ.pop("NPTRACE_SCENES", None)
        os.chdir(name)
        inputs(Path(name))
        for command, _ in listed():
            print(f"$ {command}\n{said(command)[2]}")


if __name__ == "__main__":
    main()
