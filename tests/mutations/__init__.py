"""Break the program on purpose, one place each, and see which test notices.

``python -m tests.mutations [WORD ...] [-o FILE] [-j JOBS] [--missing]``: each mutation replaces one piece of source in a copy
of the project and runs the tests that should notice, stopping at the first failure. A mutation that no test notices has
survived; the exit status is then 1. Last, the tests that noticed run on the project as it is, where they have to pass. The
result stands in docs/correctness.md.

With words, only mutations that have one of them are tried, with ``--missing`` only those that FILE has no line of; the other
lines of FILE stay. The test that noticed a mutation last time is tried first.
"""

import argparse
import csv
import importlib
import os
import queue
import shlex
import shutil
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

from tests.mutations.mutation import Mutation

ROOT = Path(__file__).resolve().parents[2]
#: Every file of mutations beside this one, by name.
_FILES = sorted(Path(__file__).parent.glob("[a-z]*.py"))
_LISTS = sorted(path.stem for path in _FILES if path.stem not in ("mutation", "test_mutations"))
MUTATIONS = [mutation for name in _LISTS for mutation in importlib.import_module(f"tests.mutations.{name}").MUTATIONS]

_RUNS = ("*-kdtree", "*-bvh", "*-bvh64")  # folders with runs, which a copy does not need

_TIMEOUT = 900  # seconds; what runs longer never ends
_FAILURES = ("FAILED ", "ERROR ")  # how pytest's lines about them begin
_NOT_FOUND = (4, 5)  # exit status of pytest: no such test, no tests
_SAME_FOLDER = ("return digest.hexdigest()[:16]\n\n\ndef versions", 'return "0123456789abcdef"\n\n\ndef versions')
_FOLDER_A_VERSION = ('self._folder = folder / f"{self._file.parent.name}-{where}"', " / _stamp(self._file)")


class Workshop:
    """A copy of the project in which one thing at a time is broken.

    Compiling takes most of the time, so all copies share one folder of kernels, with a folder for each version of a source
    file: a mutation compiles the kernels of the changed file and of all that depend on it. Trees are kept from one test to the
    next, but not from one mutation to the next.
    """

    def __init__(self, root: Path, kernels: Path, source: Path = ROOT) -> None:
        self._project, self._trees, self._kernels = root / "project", root / "trees", kernels
        self._n_written = 0
        left_out = shutil.ignore_patterns(".git", ".venv*", "__pycache__", ".hypothesis", ".*_cache", *_RUNS)
        shutil.copytree(source, self._project, ignore=left_out)
        kernels.mkdir(mode=0o700, exist_ok=True)
        (old, new), (place, version) = _SAME_FOLDER, _FOLDER_A_VERSION
        self._replace("nptrace_base/jit.py", old, new)
        self._replace("nptrace_base/jit.py", place, place + version)
        self._replace("nptrace_base/jit.py", "mkdir(mode=0o700, ", "mkdir(mode=0o700, parents=True, ")

    def _replace(self, file: str, old: str, new: str) -> None:
        """Change the copy; a piece of source that is not there is an error."""
        source = (self._project / file).read_text(encoding="utf-8")
        if old not in source:
            raise SystemExit(f"{file} has no {old!r}; bring the list up to date")
        self._write(file, source.replace(old, new))

    def _write(self, file: str, text: str) -> None:
        """Write a source of the copy. No two have the same time: Python compiles again what has another time."""
        path = self._project / file
        path.write_text(text, encoding="utf-8")
        self._n_written += 1
        os.utime(path, (self._n_written, self._n_written))

    def run(self, tests: list[str], *options: str) -> tuple[int, list[str]]:
        """Run tests in the copy; return pytest's exit status and the tests that failed."""
        shutil.rmtree(self._trees, ignore_errors=True)
        environment = {**os.environ, "PYTHONPATH": str(self._project), "NUMBA_CACHE_DIR": str(self._kernels)}
        environment |= {"HYPOTHESIS_PROFILE": "first failure", "XDG_CACHE_HOME": str(self._trees)}
        command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *options, *tests]
        try:
            done = subprocess.run(
                command,
                cwd=self._project,
                env=environment,
                capture_output=True,
                check=False,
                timeout=_TIMEOUT,
                text=True,
                errors="replace",  # a test may print a name of any bytes
            )
        except subprocess.TimeoutExpired:
            return -1, [f"{tests[0]} (does not end)"]
        failed = [
            line.partition(" ")[2].partition(" - ")[0] for line in done.stdout.splitlines() if line.startswith(_FAILURES)
        ]
        if done.returncode not in (0, 1, *_NOT_FOUND) and not failed:
            failed = [f"{tests[0]} (crashed)"]
        return done.returncode, failed

    def who_notices(self, mutation: Mutation, first: str = "") -> str:
        """Return the test that fails, or "" if the mutation survives; ``first`` is tried before all others."""
        whole = (self._project / mutation.file).read_text(encoding="utf-8")
        self._replace(mutation.file, mutation.old, mutation.new)
        try:
            for tests in ([f"tests/{first}"] if first else [], shlex.split(mutation.tests)):
                if tests and (failed := self.run(tests, "-x")[1]):
                    return failed[0].removeprefix("tests/")
            return ""
        finally:
            self._write(mutation.file, whole)

    def unfit(self, noticed_by: set[str]) -> list[str]:
        """Return those tests that fail on the project as it is: that they failed on a mutation says nothing."""
        names = {f"tests/{_test_of(test)}" for test in noticed_by}
        if not names:
            return []
        status, failed = self.run(sorted(names))
        if status not in (0, 1):
            raise SystemExit(f"the tests that noticed do not run on the project as it is: {failed}")
        return sorted(test for test in noticed_by if any(f"tests/{_test_of(test)}" == _test_of(each) for each in failed))


def _test_of(test: str) -> str:
    """Return a test without its parameters, which a mutation may have changed, and without how it ended."""
    return test.partition("[")[0].partition(" (")[0]


def main() -> None:
    """Try every mutation (or those asked for), print who noticed, and write it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("words", nargs="*", metavar="WORD")
    parser.add_argument("-o", type=Path, help="CSV of results; lines of mutations that are not tried stay")
    parser.add_argument("-j", "--jobs", type=int, default=2)
    parser.add_argument("--missing", action="store_true", help="only mutations that FILE has no line of")
    args = parser.parse_args()
    known = read(args.o)
    chosen = [m for m in MUTATIONS if not args.words or any(word in m.what for word in args.words)]
    chosen = [m for m in chosen if not (args.missing and m.what in known)]
    tried: dict[str, tuple[str, str, str]] = {}
    todo: queue.SimpleQueue[Mutation] = queue.SimpleQueue()
    for mutation in sorted(chosen, key=_is_compiled):  # those that are tried in seconds first
        todo.put(mutation)
    lock = threading.Lock()

    def work(workshop: Workshop) -> None:
        while True:
            try:
                mutation = todo.get_nowait()
            except queue.Empty:
                return
            _, _, before = known.get(mutation.what, ("", "", ""))
            test = workshop.who_notices(mutation, _test_of(before))
            with lock:
                tried[mutation.what] = (mutation.what, mutation.file, test)
                print(f"{'noticed by ' + test if test else 'SURVIVED':80} {mutation.what}", flush=True)
                if args.o is not None:
                    write(args.o, known | tried)

    with tempfile.TemporaryDirectory() as folder:
        workshops = [Workshop(Path(folder) / str(job), Path(folder) / "kernels") for job in range(args.jobs)]
        threads = [threading.Thread(target=work, args=[workshop]) for workshop in workshops]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        unfit = workshops[0].unfit({test for *_, test in tried.values() if test})
    for test in unfit:
        print(f"{test} fails on the project as it is: what it noticed is not counted")
    tried = {what: row for what, row in tried.items() if row[2] not in unfit}
    if args.o is not None:
        write(args.o, {what: row for what, row in known.items() if row[2] not in unfit} | tried)
    survivors = sum(not test for *_, test in tried.values())
    print(f"{len(tried)} mutations, {survivors} survived")
    raise SystemExit(1 if survivors or len(tried) < len(chosen) else 0)


def _is_compiled(mutation: Mutation) -> bool:
    """Return whether a mutation is in a file with kernels."""
    return "from nptrace_base.jit import" in (ROOT / mutation.file).read_text(encoding="utf-8")


def read(path: Path | None) -> dict[str, tuple[str, str, str]]:
    """Return the recorded lines (mutation, file, test that noticed), by mutation."""
    if path is None or not path.exists():
        return {}
    with open(path, encoding="utf-8", newline="") as file:
        return {what: (what, source, test) for what, source, test in list(csv.reader(file))[1:]}


def write(path: Path, rows: dict[str, tuple[str, str, str]]) -> None:
    """Write the lines of all mutations that are still on the list, in its order."""
    lines = [rows[mutation.what] for mutation in MUTATIONS if mutation.what in rows]
    with open(path, "w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([("mutation", "file", "noticed by"), *lines])
