"""How the programs start: versions, help, ``python -m nptrace``, and another distribution's package in place of ours."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

import cli
from nptrace import __version__
from nptrace.__main__ import PARTS

ROOT = Path(cli.__file__).resolve().parent


def started(program, *args, path=ROOT, cwd=ROOT):
    code = f"import sys; sys.argv[0] = {program!r}; from nptrace.__main__ import {program}; {program}()"
    return subprocess.run(
        [sys.executable, "-c", code, *args],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": str(path)},
        capture_output=True,
        text=True,
    )


@pytest.mark.parametrize("program", ["nptrace", "npcache"])
def test_every_command_has_a_version_and_both_names_of_help(program):
    group = getattr(cli, program)
    for command in ([], *([name] for name in group.commands)):
        result = CliRunner().invoke(group, [*command, "--version"])
        assert (result.exit_code, result.output) == (0, f"{program} {__version__}\n")
        short, long = (CliRunner().invoke(group, [*command, name]) for name in ("-h", "--help"))
        assert short.exit_code == 0 and short.output == long.output and "-h, --help" in long.output


def test_a_version_takes_no_look_at_the_installed_distributions():
    code = "import sys, cli\ntry: cli.nptrace(['--version'])\nexcept SystemExit as e: assert not e.code\n"
    code += "assert 'importlib.metadata' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)


def test_the_package_is_a_program():
    words = [sys.executable, "-m", "nptrace", "--version"]
    assert subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True).stdout == f"nptrace {__version__}\n"


def foreign(folder, name, text=""):
    """Make a package of that name, or a module where ours is one; return its file."""
    file = folder / f"{name}.py" if name == "cli" else folder / name / "__init__.py"
    file.parent.mkdir(exist_ok=True, parents=True)
    file.write_text(text or "raise RuntimeError('a foreign package was run')\n", encoding="utf-8")
    return file


@pytest.mark.parametrize("name", PARTS)
def test_a_package_that_hides_ours_is_one_sentence(tmp_path, name):
    file = foreign(tmp_path, name)
    for program in ("nptrace", "npcache"):
        done = started(program, "--help", path=f"{tmp_path}{os.pathsep}{ROOT}", cwd="/")
        assert (done.returncode, done.stdout) == (2, "")
        assert done.stderr == (
            f"Error: {name} is imported from {file}, which is not nptrace's: another package of that name hides it; remove "
            "that from PYTHONPATH, or install nptrace into a separate environment\n"
        )


@pytest.mark.parametrize(
    "text", ["__version__ = '0.9'", "import a_module_that_is_not_there"], ids=["another", "another without what it needs"]
)
def test_a_package_installed_over_ours_is_one_sentence(tmp_path, text):
    """As `pip install traces` does in the environment nptrace is in: the folder is the same, its files are not."""
    for part in (*PARTS[:-1], "nptrace", "cli.py"):
        if part != "traces":
            (tmp_path / part).symlink_to(ROOT / part)
    file = foreign(tmp_path, "traces", text)
    done = started("npcache", "--help", path=tmp_path, cwd="/")
    assert done.returncode == 2 and done.stderr.startswith(f"Error: traces is imported from {file}, which is not nptrace's")


def test_a_folder_of_runs_called_traces_hides_nothing(tmp_path):
    (tmp_path / "traces" / "bunny-bvh").mkdir(parents=True)
    assert started("npcache", "--version", path=f"{tmp_path}{os.pathsep}{ROOT}", cwd=tmp_path).returncode == 0


def test_a_part_that_is_missing_is_one_sentence(tmp_path):
    (tmp_path / "nptrace").symlink_to(ROOT / "nptrace")
    words = [sys.executable, "-S", "-m", "nptrace", "--help"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True)
    want = "Error: nptrace_base, a part of nptrace, is missing; install nptrace again\n"
    assert (done.returncode, done.stderr) == (2, want)
