"""Break the program on purpose, one place each, and see which test notices: ``python -m tests.mutations [WORD] [-o FILE]``.

Each mutation replaces one piece of source in a copy of the project and runs the tests that should notice, stopping at the
first failure. A mutation that no test notices has survived; the exit status is then 1. The result stands in
docs/correctness.md. With words, only mutations that have one of them are tried, and only their lines of FILE change.
"""

import csv
import importlib
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.mutations.mutation import Mutation

ROOT = Path(__file__).resolve().parents[2]
#: Every file of mutations beside this one, by name.
_FILES = sorted(Path(__file__).parent.glob("[a-z]*.py"))
_LISTS = sorted(path.stem for path in _FILES if path.stem not in ("mutation", "test_mutations"))
MUTATIONS = [mutation for name in _LISTS for mutation in importlib.import_module(f"tests.mutations.{name}").MUTATIONS]


class Workshop:
    """A copy of the project in which one thing at a time is broken.

    Compiling takes most of the time, so a broken copy starts with the kernels of the whole one. Those of the changed file and
    of all that depend on it are compiled again: a kernel is stored with a digest of its sources. Trees are kept from one test
    to the next, but not from one copy to the next.
    """

    def __init__(self, root: Path, source: Path = ROOT) -> None:
        self._source, self._project, self._trees = source, root / "project", root / "trees"
        self._kernels, self._whole = root / "kernels", root / "whole"
        self._seen: set[str] = set()

    def _restore(self) -> None:
        keep = shutil.ignore_patterns(".git", ".venv*", "__pycache__", ".hypothesis", ".*_cache", "*-kdtree", "*-bvh")
        for folder in (self._project, self._trees, self._kernels):
            shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(self._source, self._project, ignore=keep)
        self._kernels.mkdir()
        jit = self._project / "nptrace_base/jit.py"  # one folder for all kernels, whatever their sources
        text = jit.read_text(encoding="utf-8")
        assert "return digest.hexdigest()[:16]" in text
        jit.write_text(text.replace("return digest.hexdigest()[:16]", 'return "0123456789abcdef"'), encoding="utf-8")
        if self._whole.exists():
            shutil.copytree(self._whole, self._kernels, dirs_exist_ok=True)

    def _test(self, tests: str) -> str:
        """Return the first test that fails in the copy, "" if none does."""
        environment = {**os.environ, "PYTHONPATH": str(self._project), "NUMBA_CACHE_DIR": str(self._kernels)}
        environment |= {"HYPOTHESIS_PROFILE": "first failure", "XDG_CACHE_HOME": str(self._trees)}
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *shlex.split(tests)]
        done = subprocess.run(
            command, cwd=self._project, env=environment, capture_output=True, text=True, check=False, timeout=900
        )
        failed = [line.split()[1] for line in done.stdout.splitlines() if line.startswith(("FAILED ", "ERROR "))]
        if done.returncode not in (0, 1) and not failed:
            return f"{shlex.split(tests)[0]} (crashed)"
        return failed[0].removeprefix("tests/") if failed else ""

    def _compile_whole(self, tests: str) -> None:
        """Run the tests on the whole project once, and keep its kernels."""
        if tests in self._seen:
            return
        self._restore()
        if failed := self._test(tests):
            raise SystemExit(f"{failed} fails on the project as it is; mend it first")
        shutil.rmtree(self._whole, ignore_errors=True)
        shutil.copytree(self._kernels, self._whole)
        self._seen.add(tests)

    def who_notices(self, mutation: Mutation) -> str:
        """Return the test that fails, or "" if the mutation survives."""
        self._compile_whole(mutation.tests)
        self._restore()
        apply(mutation, self._project)
        return self._test(mutation.tests)


def apply(mutation: Mutation, folder: Path) -> None:
    """Change the copy in ``folder``; a piece of source that is no longer there is an error of the list."""
    path = folder / mutation.file
    source = path.read_text(encoding="utf-8")
    if mutation.old not in source:
        raise SystemExit(f"{mutation.what}: {mutation.file} has no {mutation.old!r}; bring the list up to date")
    path.write_text(source.replace(mutation.old, mutation.new), encoding="utf-8")


def main() -> None:
    """Try every mutation (or those whose text has one of the words given) and print who noticed."""
    words = sys.argv[1:]
    out = Path(words.pop(words.index("-o") + 1)) if "-o" in words else None
    words = [word for word in words if word != "-o"]
    rows: dict[str, tuple[str, str, str]] = {}
    with tempfile.TemporaryDirectory() as folder:
        workshop = Workshop(Path(folder))
        for mutation in MUTATIONS:
            if words and not any(word in mutation.what for word in words):
                continue
            test = workshop.who_notices(mutation)
            rows[mutation.what] = (mutation.what, mutation.file, test)
            print(f"{'noticed by ' + test if test else 'SURVIVED':80} {mutation.what}", flush=True)
            if out is not None:
                write(out, rows)
    survivors = sum(not test for *_, test in rows.values())
    print(f"{len(rows)} mutations, {survivors} survived")
    raise SystemExit(1 if survivors else 0)


def write(path: Path, tried: dict[str, tuple[str, str, str]]) -> None:
    """Write the lines of the mutations tried, and keep those of the others that are still on the list."""
    known = {}
    if path.exists():
        with open(path, encoding="utf-8", newline="") as file:
            known = {row[0]: tuple(row) for row in list(csv.reader(file))[1:]}
    known |= tried
    lines = [known[mutation.what] for mutation in MUTATIONS if mutation.what in known]
    with open(path, "w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([("mutation", "file", "noticed by"), *lines])
