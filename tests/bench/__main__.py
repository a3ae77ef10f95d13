"""``python -m tests.bench [--quick]``: measure everything on the four scenes and write docs/data/bench.csv.

Ratios are taken inside one process between calls in turn; a scene's figure is a median over repetitions, the page shows
least, median and largest over the scenes. Without the real scenes the built-in ones are measured, and the file says so.
"""

import csv
import sys
import tempfile
from pathlib import Path

from rtrace.catalog import load_scene
from rtrace.render import Shooting, render
from rtrace.treecache import TREES, cached_tree
from tests.bench.stage1 import bench_scene, build_peer
from tests.bench.stage2 import bench_run, bench_start
from traces.format import open_run

OUT = Path(__file__).resolve().parents[2] / "docs" / "data" / "bench.csv"
#: Goals of the project, and whether a figure has to reach or to stay below them.
GOALS = {
    "closest bvh traced / embree": ">= 0.55",
    "closest kdtree traced / embree": ">= 0.60",
    "any bvh traced / embree": ">= 0.50",
    "any kdtree traced / embree": ">= 0.50",
    "both bvh two threads / embree": ">= 1.0",
    "both kdtree two threads / embree": ">= 1.0",
    "render bvh M accesses/s": ">= 70",
    "render kdtree M accesses/s": ">= 70",
    "closest bvh cost of tracing": "<= 1.08",
    "closest kdtree cost of tracing": "<= 1.08",
    "build binned / embree": "<= 0.35",
    "build kd / embree": "<= 4",
    "2-way, ns per access": "<= 3",
    "128 caches in one pass / one 2-way": "<= 15",
    "stack distances / one 2-way": "<= 6",
    "replay from Parquet / 2-way from memory": "<= 5",
    "decode node + kind, M accesses/s": ">= 120",
    "cold compile of everything, s": "<= 25",
}


def main() -> None:
    """Measure, print and write."""
    quick = "--quick" in sys.argv
    size, repeat = (128, 3) if quick else (512, 7)
    found: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        peer = build_peer(folder)
        for scene_name in ("bunny", "conference", "sibenik", "sponza"):
            scene = load_scene(scene_name, notify=lambda text: print(text, file=sys.stderr))
            print(f"{scene.label} ...", file=sys.stderr)
            figures = [bench_scene(scene, size, repeat, peer)]
            for kind in TREES:
                path = folder / f"{scene_name}-{kind}"
                render(scene, cached_tree(scene, kind), Shooting(size, size), path)
                figures.append(bench_run(open_run(path), repeat))
            for figure in figures:
                for what, value in figure.items():
                    found.setdefault(what, []).append(value)
    for what, value in bench_start().items():
        found[what] = [value]
    rows = []
    for what, values in found.items():
        ordered = sorted(values)
        median = (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2
        rows.append((what, f"{ordered[0]:.3g}", f"{median:.3g}", f"{ordered[-1]:.3g}", GOALS.get(what, "")))
        print(f"{what:46} {ordered[0]:8.3g} {median:8.3g} {ordered[-1]:8.3g}  {GOALS.get(what, '')}")
    if not quick:
        with open(OUT, "w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([("what", "least", "median", "largest", "goal"), *rows])


if __name__ == "__main__":
    main()
