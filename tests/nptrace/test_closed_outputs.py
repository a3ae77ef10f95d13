"""Standard output that is full or closed: one sentence, whatever was to be printed."""

import subprocess
import sys

import pytest

from tests.nptrace.test_terminal import inputs

PROGRAM = "import cli; cli.{}()"


def run(program, *args, stdout):
    command = [sys.executable, "-c", PROGRAM.format(program), *args]
    return subprocess.run(command, stdout=stdout, stderr=subprocess.PIPE, text=True, check=False)


@pytest.mark.parametrize("args", [["--version"], ["--help"], ["scenes", "--help"], ["scenes", "--version"]])
def test_a_full_disk_behind_it(args):
    with open("/dev/full", "w") as full:
        result = run("nptrace", *args, stdout=full)
    assert (result.returncode, result.stderr) == (
        2, "Error: standard output: No space left on device; name another file or folder\n"
    )  # fmt: skip


@pytest.mark.parametrize("form", ["table", "json"])
def test_results_that_a_closed_one_would_lose_are_refused(tmp_path, form):
    inputs(tmp_path)
    code = f"import os; os.chdir({str(tmp_path)!r}); import sys; sys.stdout = None; {PROGRAM.format('npcache')}"
    args = ["replay", "traces/bunny-bvh", "--format", form, "-o", "-"]
    result = subprocess.run([sys.executable, "-c", code, *args], stderr=subprocess.PIPE, text=True, check=False)
    assert result.returncode == 2 and "cannot write -: standard output is closed; name another file" in result.stderr
