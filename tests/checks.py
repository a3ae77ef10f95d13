"""Run all tests and write the counts of each: ``python -m tests.checks [-o FILE.json] [-n JOBS] [pytest's arguments]``.

Also the pytest plugin behind it (``-p tests.checks --checks FILE``). A check is one test function. It counts its cases: the
examples of hypothesis, or what it recorded as ``cases``, or the tests it was parametrized to. ``largest error`` is what it
recorded under this name (``record_property``), a relative error unless the check says otherwise; equality has none.
"""

import argparse
import ast
import json
import re
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parent.parent


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option for the file."""
    parser.addoption("--checks", type=Path, help="write every check with its cases and its largest error as JSON")


def pytest_configure(config: pytest.Config) -> None:
    """Count only when asked to; where xdist has workers, they describe what they did, and the process above them counts."""
    if config.getoption("--checks"):
        config.pluginmanager.register(Describing())
        if not hasattr(config, "workerinput"):
            config.pluginmanager.register(Counting(config.getoption("--checks")))


class Describing:
    """Adds to the report of a test what it is called here, and how many examples hypothesis tried."""

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item, call: pytest.CallInfo[None]) -> Any:
        """Describe one part of a test."""
        report = yield
        name = f"{_name_of(item.path)}::{item.originalname}"  # type: ignore[attr-defined]
        passing = re.findall(r"(\d+) passing", getattr(item, "hypothesis_statistics", ""))
        report.user_properties = [*item.user_properties, ("check", name), ("passing", list(map(int, passing)))]
        return report


class Counting:
    """What the tests of this run did, by file and function."""

    def __init__(self, out: Path) -> None:
        self._out = out
        self._checks: dict[str, dict[str, Any]] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Take down one test when its body, or what stopped it before, is over."""
        if report.when == "call" or report.outcome != "passed":
            self._note(report)

    def _note(self, report: pytest.TestReport) -> None:
        recorded: dict[str, Any] = dict(report.user_properties)
        new = {"tests": 0, "cases": 0, "largest error": None, "failed": 0, "skipped": 0, "expected failures": 0}
        check = self._checks.setdefault(recorded["check"], new)
        check["tests"] += 1
        if report.outcome == "skipped":
            check["expected failures" if hasattr(report, "wasxfail") else "skipped"] += 1
            return
        check["failed"] += report.outcome == "failed"
        check["cases"] += sum(recorded["passing"]) or recorded.get("cases", 1)
        if "largest error" in recorded:
            check["largest error"] = max(check["largest error"] or 0.0, float(f"{recorded['largest error']:.2g}"))

    def pytest_sessionfinish(self) -> None:
        """Write the file, one check a line."""
        write(self._out, [{"check": name, **check} for name, check in self._checks.items()])


def what_files_check() -> dict[str, str]:
    """Return the first line of every test file's docstring, by its name."""
    paths = sorted((ROOT / "tests").rglob("test_*.py"))
    texts = {_name_of(path): ast.get_docstring(ast.parse(path.read_text())) for path in paths}
    return {name: (text or "").splitlines()[0] for name, text in texts.items()}


def _name_of(path: Path) -> str:
    """Return the name of a test file: its path below tests/, without the suffix."""
    folder = ROOT / "tests"
    return path.relative_to(folder).with_suffix("").as_posix() if path.is_relative_to(folder) else path.stem


def main() -> None:
    """Run the tests, counting; exit with pytest's status. Named tests replace their own lines of the file only."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", type=Path, default=ROOT / "docs" / "data" / "checks.json")
    parser.add_argument("-n", default="0", help="processes that share the tests")
    args, others = parser.parse_known_args()
    before = json.loads(args.o.read_text(encoding="utf-8")) if others and args.o.exists() else []
    status = pytest.main(
        ["-q", "-n", args.n, "--dist", "worksteal", "-p", "tests.checks", "--checks", str(args.o.resolve()), *others]
    )
    write(args.o, [*before, *json.loads(args.o.read_text(encoding="utf-8"))])
    raise SystemExit(status)


def write(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write one check a line, in the order of their names; of several lines of a check, the last."""
    last = {row["check"]: row for row in rows}
    path.write_text("[\n" + ",\n".join(json.dumps(last[name]) for name in sorted(last)) + "\n]\n", encoding="utf-8")


if __name__ == "__main__":
    main()
