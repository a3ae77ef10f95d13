"""``python -m tests.bench.large [--quick | TRIANGLES...]``: how time and memory of the builders grow with the scene.

A scene of instances of the stand-in ``court``, turned and moved, is built as both trees by one thread and by two, and by
Embree, each in a process of its own, whose highest memory is read at its end. Writes docs/data/large.csv; ``--quick`` builds
one small scene and writes nothing.
"""

import csv
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TRIANGLES = (100_000, 300_000, 1_000_000, 3_000_000, 10_000_000)
BUILDS = ("bvh", "bvh 2", "kdtree", "kdtree 2", "embree")
HEADER = ["triangles", "build", "wall s", "cpu s", "bytes per triangle", "nodes", "references"]

#: Builds one tree and prints wall and CPU seconds, memory beyond that of the program and its kernels, nodes and references.
_MEASURE = """
import resource, sys, time
import numpy as np
from rtrace.checks.embree import embree_scene
from rtrace.scenes.catalog import load_scene
from rtrace.trees.tree_cache import build_tree
from tests.bench.large import instances

n, build = int(sys.argv[1]), sys.argv[2].split()
def highest():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
def built(triangles):
    if build[0] == "embree":
        embree_scene(triangles).run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))
        return 0, 0
    tree = build_tree(triangles, build[0], threads=int(build[-1]) if build[1:] else 1)
    return len(tree.nodes), len(tree.prims)
room = load_scene("court").triangles
built(instances(room, 40_000))  # compiles
before, triangles = highest(), instances(room, n)
wall, cpu = time.perf_counter(), time.process_time()
counts = built(triangles)
print(time.perf_counter() - wall, time.process_time() - cpu, (highest() - before) / n, *counts)
"""


def instances(room, n):
    """Return n triangles of copies of a room on a square grid, every one turned by another number of quarters: (n, 3, 3)."""
    import numpy as np

    n_rooms = -(-n // len(room))
    side = int(np.ceil(np.sqrt(n_rooms)))
    size = float((room.max(axis=(0, 1)) - room.min(axis=(0, 1))).max())
    out = np.empty((n, 3, 3), np.float32)
    for i in range(n_rooms):
        x, z = room[: len(out) - i * len(room), :, 0], room[: len(out) - i * len(room), :, 2]
        part = out[i * len(room) : (i + 1) * len(room)]
        turned = ((x, z), (z, -x), (-x, -z), (-z, x))[i % 4]
        part[..., 0], part[..., 2] = turned[0] + size * (i % side), turned[1] + size * (i // side)
        part[..., 1] = room[: len(part), :, 1]
    return out


def rows(sizes: tuple[int, ...]) -> list[list[object]]:
    """Return one row per scene and build."""
    found: list[list[object]] = []
    for n in sizes:
        for build in BUILDS:
            done = subprocess.run(
                [sys.executable, "-c", _MEASURE, str(n), build], check=True, capture_output=True, text=True, cwd=ROOT,
                env=dict(os.environ),
            )  # fmt: skip
            wall, cpu, n_bytes, *counts = done.stdout.split()
            found.append([n, build, *(f"{float(x):.4g}" for x in (wall, cpu, n_bytes)), *counts])
            print(*found[-1], sep="\t", flush=True)
    return found


def main() -> None:
    """Measure and write."""
    if sys.argv[1:] == ["--quick"]:
        rows((50_000,))
        return
    found = rows(tuple(map(int, sys.argv[1:])) or TRIANGLES)
    with open(ROOT / "docs" / "data" / "large.csv", "w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([HEADER, *found])


if __name__ == "__main__":
    main()
