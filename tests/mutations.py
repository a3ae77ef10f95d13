"""Break the program on purpose, one place at a time, and see which test notices: ``python -m tests.mutations [-o FILE.csv]``.

Each mutation replaces one piece of source in a copy of the project and runs the tests that should notice, stopping at the
first failure. A mutation that no test notices has survived; the exit status is then 1. The result stands in
docs/correctness.md.
"""

import csv
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent


class Mutation(NamedTuple):
    """``old`` stands once (or in every place meant) in ``file``; ``tests`` are the files that should notice."""

    what: str
    file: str
    old: str
    new: str
    tests: str


TRAVERSE, RENDER, BVH, KD = "tests/test_traverse.py", "tests/test_render.py", "tests/test_bvh.py", "tests/test_kdtree.py"
CACHE = "tests/test_cachesim_golden.py tests/test_cachesim_replay.py"
PREFETCH = "tests/test_cachesim_prefetch.py"

MUTATIONS = [
    Mutation("traversal: BVH box test without its margin", "rtrace/traverse.py", "if t0 * NARROWER <= t1 * WIDER:",
             "if t0 * WIDER <= t1 * NARROWER:", TRAVERSE),
    Mutation("traversal: sign of the slab from the direction, not its inverse", "rtrace/traverse.py",
             "nx, fx = (THREE, ZERO) if ix < 0.0 else (ZERO, THREE)", "nx, fx = (THREE, ZERO) if dx < 0.0 else (ZERO, THREE)",
             TRAVERSE),
    Mutation("traversal: a NaN narrows the box interval", "rtrace/traverse.py", "t0 = a if a > t0 else t0", "t0 = t0 if t0 > a else a",
             TRAVERSE),
    Mutation("traversal: BVH children in the order of their numbers", "rtrace/traverse.py",
             "upper_first = backwards >> m & ONE", "upper_first = ZERO", TRAVERSE),
    Mutation("traversal: kd entry beyond the hit ends the ray instead of being skipped", "rtrace/traverse.py",
             "while sp > ZERO and entry[sp - ONE] > best:\n                    sp -= ONE\n",
             "if sp > ZERO and entry[sp - ONE] > best:\n                    break\n", TRAVERSE),
    Mutation("traversal: kd ray in a split plane visits one side", "rtrace/traverse.py",
             "visits_near, visits_far = True, distance == 0.0", "visits_near, visits_far = True, False", TRAVERSE),
    Mutation("traversal: kd split distance not widened", "rtrace/traverse.py",
             "a, z = distance * inverse * NARROWER, distance * inverse * WIDER",
             "a, z = distance * inverse, distance * inverse", TRAVERSE),
    Mutation("traversal: far kd cell keeps the whole interval", "rtrace/traverse.py", "entry[sp] = low if low > t0 else t0",
             "entry[sp] = t0", TRAVERSE),
    Mutation("traversal: highest number wins among equal hits", "rtrace/traverse.py",
             "t < best or (t == best and c < best_prim)", "t < best or (t == best and c > best_prim)", TRAVERSE),
    Mutation("traversal: a hit at t_max does not count", "rtrace/traverse.py",
             "if t >= near_t and (t < best or (t == best and c < best_prim)):", "if t >= near_t and t < best:", TRAVERSE),
    Mutation("traversal: any-hit rays go on after a hit", "rtrace/traverse.py",
             "if any_hit and best_prim != NO_PRIM:", "if any_hit and best_prim == NO_PRIM - 1:", TRAVERSE),
    Mutation("triangle: edges belong to no triangle", "rtrace/intersect.py", "if low < 0.0 and high > 0.0:",
             "if low <= 0.0 and high >= 0.0:", TRAVERSE),
    Mutation("triangle: one edge function with the wrong vertex", "rtrace/intersect.py", "w = bx * ay - by * ax",
             "w = bx * ay - by * cx", TRAVERSE),
    Mutation("pre-fetch unit: a push does not move the pointer", "rtrace/traverse.py", "pp = sp\n", "pp = pp\n", TRAVERSE),
    Mutation("pre-fetch unit: a pop does not lower the pointer", "rtrace/traverse.py", "pp = min(pp, sp)", "pp = pp", TRAVERSE),
    Mutation("pre-fetch unit: requests from the bottom of the stack", "rtrace/traverse.py",
             "events[n_events] = np.uint64(stack[pp]) << TWO | PREFETCH", "events[n_events] = np.uint64(stack[ZERO]) << TWO | PREFETCH",
             TRAVERSE),
    Mutation("pre-fetch unit: an empty leaf triggers it too", "rtrace/traverse.py", "if n_prims > ZERO:", "if n_prims >= ZERO:",
             TRAVERSE),
    Mutation("trace: room for events is not checked", "rtrace/traverse.py", "limit = np.uint64(events.size - 2 * max_level - 3)",
             "limit = np.uint64(events.size * 1000)", TRAVERSE),
    Mutation("shadow rays: no offset", "rtrace/shoot.py", "off = OFFSET * size", "off = 0.0 * size", RENDER),
    Mutation("shadow rays: the segment ends in the light", "rtrace/shoot.py",
             "last = 1.0 - OFFSET * max(size, light_size) / reach", "last = 1.0 + 0.0 * reach", RENDER),
    Mutation("shadow rays: also where the surface faces away", "rtrace/shoot.py", "if not cosine > 0.0:", "if not cosine < 9e99:",
             RENDER),
    Mutation("render: first rows of chunks not shifted", "rtrace/render.py", 'chunk.rays["first"] += np.uint64(n_accesses)',
             'chunk.rays["first"] += np.uint64(0)', RENDER),
    Mutation("render: shadow ray before its primary ray", "rtrace/shoot.py",
             "while shadow < owner.size and owner[shadow] < end:", "while shadow < owner.size and owner[shadow] < end - 1:", RENDER),
    Mutation("BVH: pairs not cut along the longest axis", "rtrace/bvh.py", "if end - start == 2:", "if end - start == 1:", BVH),
    Mutation("BVH: last split position never tried", "rtrace/bvh.py", "for i in range(start, end - 1):",
             "for i in range(start, end - 2):", BVH),
    Mutation("BVH: a split that costs as much as a leaf is taken", "rtrace/bvh.py", "if not area + cost < area * count:",
             "if not area + cost <= area * count:", BVH),
    Mutation("BVH: partition not stable", "rtrace/bvh.py", "ids[at + i] = scratch[i]", "ids[at + i] = scratch[n_right - 1 - i]", BVH),
    Mutation("format: rows of the last, partly filled group lost", "traces/format.py",
             "        if self._filled:\n            self._flush()\n        self._writer.add", "        self._writer.add", "tests/test_format.py"),
    Mutation("format: mixed files accepted", "traces/format.py", "if len(texts) > 1:", "if len(texts) > 3:", "tests/test_format.py"),
]  # fmt: skip


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
    rows = []
    for mutation in MUTATIONS:
        if words and not any(word in mutation.what for word in words):
            continue
        test = who_notices(mutation)
        rows.append((mutation.what, mutation.file, test))
        print(f"{'noticed by ' + test if test else 'SURVIVED':80} {mutation.what}", flush=True)
    if out is not None:
        with open(out, "w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([("mutation", "file", "noticed by"), *rows])
    survivors = sum(not test for *_, test in rows)
    print(f"{len(rows)} mutations, {survivors} survived")
    raise SystemExit(1 if survivors else 0)


if __name__ == "__main__":
    main()
