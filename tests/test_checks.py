"""The counts of ``tests.checks`` are right, and the open list names existing tests and hard cases."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

from rtrace.checks.hard_cases import CASES
from tests.open_list import OPEN_LIST

TESTS = Path(__file__).parent

SAMPLE = """
import pytest
from hypothesis import given, settings, strategies as st

@settings(max_examples=7)
@given(st.integers())
def test_property(n):
    pass

@pytest.mark.parametrize("n", [1, 2, 3])
def test_three(n, record_property):
    record_property("largest error", 0.1234 / n)

def test_rays(record_property):
    record_property("cases", 500)

def test_fails():
    assert False

@pytest.mark.xfail
def test_known():
    assert False

@pytest.fixture
def broken():
    raise ValueError

def test_setup(broken):
    pass

@pytest.mark.skip
def test_skipped():
    pass
"""


@pytest.mark.parametrize("jobs", ["0", "2"])
def test_cases_errors_and_results_are_counted(tmp_path, jobs):
    (tmp_path / "test_sample.py").write_text(SAMPLE)
    out = tmp_path / "checks.json"
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "tests.checks",
        "--checks",
        str(out),
        "-p",
        "no:cacheprovider",
        "-n",
        jobs,
    ]
    done = subprocess.run([*command, str(tmp_path)], cwd=TESTS.parent, capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stderr
    rows = {row.pop("check"): row for row in json.loads(out.read_text())}
    names = ("tests", "cases", "largest error", "failed", "skipped", "expected failures")
    assert {name.removeprefix("test_sample::"): tuple(row[each] for each in names) for name, row in rows.items()} == {
        "test_property": (1, 7, None, 0, 0, 0),
        "test_three": (3, 3, 0.12, 0, 0, 0),
        "test_rays": (1, 500, None, 0, 0, 0),
        "test_fails": (1, 1, None, 1, 0, 0),
        "test_known": (1, 0, None, 0, 0, 1),
        "test_setup": (1, 1, None, 1, 0, 0),
        "test_skipped": (1, 0, None, 0, 1, 0),
    }


def test_the_open_list_names_what_there_is():
    known = {f'"{name}"' for name in CASES}
    for path in TESTS.rglob("test_*.py"):
        functions = (node.name for node in ast.parse(path.read_text()).body if isinstance(node, ast.FunctionDef))
        known |= {f"{path.stem}::{name}".replace("test_", "") for name in functions if name.startswith("test_")}
    assert [entry.name for entry in OPEN_LIST] == [f"D{n}" for n in range(1, 27)]
    assert [name for entry in OPEN_LIST for name in entry.covered_by if name not in known] == []
