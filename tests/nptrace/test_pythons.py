"""The supported Pythons are those that are tested, each in a separate environment."""

import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_the_hosted_tests_run_every_python_promised():
    low, high = re.search(r'requires-python = ">=3\.(\d+),<3\.(\d+)"', (ROOT / "pyproject.toml").read_text()).groups()
    promised = [f"3.{minor}" for minor in range(int(low), int(high))]
    matrix = re.search(r"python: \[(.*)\]", (ROOT / ".github" / "workflows" / "test.yml").read_text())[1]
    assert [word.strip(' "') for word in matrix.split(",")] == promised
    assert f"Python {promised[0]} to {promised[-1]}" in (ROOT / "README.md").read_text()


def environment_of(*settings):
    """Return the folder that `make test` would install into."""
    command = ["make", "-n", "-B", "test", *settings]
    # Without what a `make test PYTHON=...` around this test hands down.
    environment = {name: value for name, value in os.environ.items() if name != "PYTHON" and not name.startswith("MAKE")}
    said = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True).stdout
    return re.search(r"-m venv (\S+)", said)[1]


def test_another_python_has_another_environment():
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    assert environment_of() == ".venv"
    assert environment_of(f"PYTHON={sys.executable}") == f".venv-{version}"
