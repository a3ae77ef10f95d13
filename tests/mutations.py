"""Break the program on purpose, one place each, and see which test notices: ``python -m tests.mutations [WORD] [-o FILE]``.

Each mutation replaces one piece of source in a copy of the project and runs the tests that should notice, stopping at the
first failure. A mutation that no test notices has survived; the exit status is then 1. The result stands in
docs/correctness.md. With words, only mutations that have one of them are tried, and only their lines of FILE change.
"""

import csv
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from tests import mutation_list, mutation_list_caches
from tests.mutation_list import Mutation

MUTATIONS = [*mutation_list.MUTATIONS, *mutation_list_caches.MUTATIONS]

ROOT = Path(__file__).resolve().parent.parent


def apply(mutation: Mutation, folder: Path) -> None:
    """Change the copy in ``folder``; a piece of source that is no longer there is an error of the list."""
    path = folder / mutation.file
    source = path.read_text(encoding="utf-8")
    if mutation.old not in source:
        raise SystemExit(f"{mutation.what}: {mutation.file} has no {mutation.old!r}; bring the list up to date")
    path.write_text(source.replace(mutation.old, mutation.new), encoding="utf-8")


def who_notices(mutation: Mutation) -> str:
    """Return the test that fails, or "" if the mutation survives."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "project"
        keep = shutil.ignore_patterns(".git", ".venv", "__pycache__", ".hypothesis", ".*_cache", "*-kdtree", "*-bvh")
        shutil.copytree(ROOT, folder, ignore=keep)
        apply(mutation, folder)
        environment = {**os.environ, "PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(Path(name) / "kernels")}
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *mutation.tests.split()]
        done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=900)
    failed = [line.split()[1] for line in done.stdout.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    if done.returncode not in (0, 1) and not failed:
        return f"{mutation.tests.split()[0]} (crashed)"
    return failed[0].removeprefix("tests/") if failed else ""


def main() -> None:
    """Try every mutation (or those whose text has one of the words given) and print who noticed."""
    words = sys.argv[1:]
    out = Path(words.pop(words.index("-o") + 1)) if "-o" in words else None
    words = [word for word in words if word != "-o"]
    rows: dict[str, tuple[str, str, str]] = {}
    for mutation in MUTATIONS:
        if words and not any(word in mutation.what for word in words):
            continue
        test = who_notices(mutation)
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


if __name__ == "__main__":
    main()
