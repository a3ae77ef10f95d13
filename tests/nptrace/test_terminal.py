"""What a terminal of 80, 100 and 120 columns shows, compared with stored text.

``terminal.txt`` has each width and command, and below it what is printed on stdout; ``python -m tests.nptrace.test_terminal``
prints it again.
"""

import fcntl
import os
import pty
import re
import shlex
import struct
import subprocess
import sys
import tempfile
import termios
from pathlib import Path

import pytest
from click.testing import CliRunner

import cli
from nptrace import precompile
from nptrace_base import jit, tables
from rtrace.checks import hard_cases
from rtrace.checks.hard_cases import CaseRow
from rtrace.scenes import catalog
from rtrace.scenes.shapes import icosphere
from tests.nptrace.test_nptrace import write_obj
from tests.reference.traces import make_trace, write

STORED = Path(__file__).with_name("terminal.txt")
COMMANDS = [
    "nptrace render ball.obj --pixels 24x20 --out out --overwrite",
    "nptrace check ball.obj --pixels 16x16 --random 100",
    "npcache replay traces/bunny-bvh --size 1K,2K --assoc 1,2",
    "npcache replay traces/bunny-kdtree other/bunny-kdtree --size 1K --3c",
    "npcache replay --size 1K --prefetch none,stack:tris*2 --layout veb",
    "npcache replay traces/bunny-bvh --size 1K --by level",
    "npcache replay traces/bunny-bvh --size 1K --by pixel --prefetch none,traced",
    "npcache sweep --size 1K..2K --ways 1,2 --format table",
    "npcache time traces/bunny-bvh --size 1K --assoc 1 --rays 1,4",
    "npcache time traces/bunny-bvh --size 1K --assoc 1 --by level",
    "npcache compare traces/bunny-bvh --size 1K --assoc 1 --prefetch stack,push",
    "npcache table1",
    "npcache estimate ball.obj --pixels 64x64 --size 1K,2K --line 64",
    "nptrace check --hard",
    "nptrace info traces/bunny-bvh",
    "nptrace scenes",
    "nptrace compile",
    "nptrace map ball.obj --quick --pixels 8x8 --out map --threads 1",
    "nptrace run small.toml --format table",
    "npcache summarise traces/bunny-bvh --part 1/2 --size 1K -o 1.sum",
    "npcache summarise traces/bunny-bvh --part 2/2 --size 1K -o 2.sum",
    "npcache combine 1.sum 2.sum",
]
#: What the commands read that takes long, or depends on the machine.
STUDY = '[render]\nscenes = "ball.obj"\npixels = "8x8"\n[replay]\nsize = "1K,2K"\n[time]\nsize = "1K"\nrays = [1, 4]\n'
HARD = [
    CaseRow("primary: ball, 1e4 radii away", "kd-tree, 3 levels", 1600, 0, 0, 0, 1.5, 16.0, 0, 12),
    CaseRow("shadows: light 1e30 away, slanted", "BVH, 64-byte nodes", 296130, 0, 0, 0, 0.0, 0.0, 0, 101),
]
WIDTHS = (80, 100, 120)
ROOT = Path(cli.__file__).resolve().parent


def inputs(folder):
    """Make the mesh, a study and the runs, which hold the same numbers everywhere."""
    (folder / "small.toml").write_text(STUDY)
    write_obj(folder / "ball.obj", icosphere(2))
    for i, (place, kind) in enumerate((("traces", "bvh"), ("traces", "kdtree"), ("other", "kdtree"))):
        write(make_trace(kind, i, n_rays=200, max_level=9), folder / place / f"bunny-{kind}", stand_in=kind == "bvh")


def shown(command, width):
    """Return what a command prints on a terminal of so many columns, without the rows with seconds and bytes of files."""
    program, *args = shlex.split(command)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tables, "width_of", lambda file: width)
        patch.setattr(catalog, "cache_folder", lambda: Path("nowhere"))
        patch.setattr(precompile, "compile_all", lambda watch: 3)
        patch.setattr(hard_cases, "run_all", lambda is_long, threads: HARD)
        if args[0] == "compile":
            patch.setattr(jit, "cache_folder", lambda: Path("kernels"))
        patch.delenv("NPTRACE_SCENES", raising=False)
        result = CliRunner().invoke(getattr(cli, program), args, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    lines = (line.rstrip() for line in result.stdout.strip("\n").splitlines())
    return "\n".join(line for line in lines if not re.match(r" ball-\w+-64x64 | kernels +3 | n_bytes ", line))


def everything():
    return "".join(f"$ [{width}] {command}\n{shown(command, width)}\n" for command in COMMANDS for width in WIDTHS)


def test_every_command_prints_what_is_stored(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    inputs(tmp_path)
    stored = re.split(r"^\$ \[(\d+)\] (.*)\n", STORED.read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]
    assert len(stored) == 3 * len(COMMANDS) * len(WIDTHS)
    for width, command, text in zip(stored[::3], stored[1::3], stored[2::3], strict=True):
        assert max(map(len, text.splitlines())) <= int(width), command
        assert shown(command, int(width)) + "\n" == text, command


def test_every_command_that_prints_results_is_there():
    stored = {" ".join(command.split()[:2]) for command in COMMANDS}
    for program in ("nptrace", "npcache"):
        commands = getattr(cli, program).commands
        for name in commands:
            command = commands[name]
            if any(param.name == "is_wide" for param in command.params):
                assert f"{program} {name}" in stored


def on_terminal(width, *command, cwd):
    """Run a command with all its output on a terminal; return what it wrote."""
    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 50, width, 0, 0))
    environment = {**os.environ, "TERM": "xterm", "PYTHONPATH": str(ROOT)}
    environment.pop("COLUMNS", None)
    program = [sys.executable, "-c", f"import cli; cli.{command[0]}()", *command[1:]]
    process = subprocess.Popen(program, cwd=cwd, env=environment, stdin=slave, stdout=slave, stderr=slave)
    os.close(slave)
    written = b""
    try:
        while piece := os.read(master, 65536):
            written += piece
    except OSError:  # the other end is closed
        pass
    os.close(master)
    assert process.wait() == 0, written
    return written.decode()


@pytest.mark.parametrize("width", [80, 120])
def test_a_real_terminal(tmp_path, width):
    """Its width is that of the table; progress tells each run and phase, and goes; the last line tells what comes next."""
    inputs(tmp_path)
    command = ["nptrace", "render", "ball.obj", "--pixels", "300x200", "--out", "a rather long name"]
    written = on_terminal(width, *command, cwd=tmp_path)
    for said in ("ball.obj: load", "[1/2] ball-kdtree-300x200: build", "[2/2] ball-bvh-300x200: trace", "bvh-300x200: write"):
        assert said in re.sub(r"\x1b\[[0-9;]*m", "", written)
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", written.rpartition("\x1b[2K")[2]).replace("\r", "")
    assert max(map(len, text.splitlines())) <= width
    assert ("--wide prints" in text) == (width == 80)
    following = "npcache replay --traces 'a rather long name' --size 8K,16K\n"
    assert text.endswith(f"\nnext:\n{following}" if width == 80 else f"; next: {following}")


def main():
    with tempfile.TemporaryDirectory() as name:
        os.chdir(name)
        inputs(Path(name))
        print(everything(), end="")


if __name__ == "__main__":
    main()
