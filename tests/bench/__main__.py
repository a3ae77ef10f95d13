"""``python -m tests.bench [--quick | --repeat N]``: measure everything, print it beside the goals, and write docs/data/*.csv.

Ratios are taken inside one process between calls in turn; a scene's figure is a median over repetitions, the page shows
least, median and largest over the scenes. Without the real scenes the built-in ones are measured, and the files say so.
``--quick`` measures one built-in scene at a small size and writes nothing: it shows that the bench works, not how fast we are.
"""

import csv
import json
import os
import platform
import statistics
import sys
import tempfile
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

import numpy as np

from rtrace.chunk import primary_rays
from rtrace.render import Shooting, render
from rtrace.scenes.catalog import load_scene
from rtrace.shading import shadow_rays
from rtrace.traverse import trace
from rtrace.trees.tree_cache import cached_tree
from tests.bench.goals import ABSENT, GOALS, is_met
from tests.bench.parts import bench_long
from tests.bench.savings import bench_savings
from tests.bench.several_rays import bench_several
from tests.bench.stage1 import bench_scene, build_peer, pieces
from tests.bench.stage2 import bench_comparison, bench_run, bench_start
from tests.bench.tried import bench_tried
from tests.bench.variants import bench_variants
from traces.reader import open_run

DATA = Path(__file__).resolve().parents[2] / "docs" / "data"
SCENES = ("bunny", "conference", "sibenik", "sponza")

Figures = dict[str, list[float]]


def machine(labels: Sequence[str]) -> dict[str, str]:
    """Return what the figures were measured on and of; no names of hosts or users."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        models = [line.partition(":")[2].strip() for line in info.read_text().splitlines() if line.startswith("model name")]
        model = models[0] if models else model
    facts = {"processor": model, "processors": str(os.cpu_count()), "scenes": ", ".join(labels)}
    facts["Python"] = platform.python_version()
    return facts | {name: version(name) for name in ("numpy", "numba", "llvmlite", "pyarrow", "embreex")}


def add(found: Figures, figures: dict[str, float]) -> None:
    """Append the figures of one scene."""
    for what, value in figures.items():
        found.setdefault(what, []).append(value)


def spread(values: Sequence[float]) -> list[str]:
    """Return least, median and largest, to three digits."""
    return [f"{value:.3g}" for value in (min(values), statistics.median(values), max(values))]


def print_goals(found: Figures) -> list[list[str]]:
    """Print every figure beside its goal, those that are missing too; return the rows."""
    rows = []
    for what, (words, goal) in GOALS.items():
        if what not in found:
            why = next((reason for part, reason in ABSENT.items() if part in what), "not measured")
            print(f"{words:100} skipped: {why}")
            rows.append([what, words, "", "", "", goal, f"skipped: {why}"])
            continue
        met = is_met(goal, statistics.median(found[what]))
        verdict = {None: "", True: "met", False: "not met"}[met]
        rows.append([what, words, *spread(found[what]), goal, verdict])
        print(f"{words:100} {' '.join(f'{value:>8}' for value in rows[-1][2:5])}  {goal:8} {verdict}")
    return rows


def print_others(title: str, found: Figures) -> list[list[str]]:
    """Print figures without goals; return the rows."""
    print(title)
    rows = [[what, *spread(values)] for what, values in found.items()]
    for what, *values in rows:
        print(f"  {what:98} {' '.join(f'{value:>8}' for value in values)}")
    return rows


def main() -> None:
    """Measure, print and write."""
    quick = "--quick" in sys.argv
    names, size, repeat = (("blob",), 64, 2) if quick else (SCENES, 512, 7)
    if "--repeat" in sys.argv:
        repeat = int(sys.argv[sys.argv.index("--repeat") + 1])
    found: Figures = {}
    savings: Figures = {}
    tried: Figures = {}
    labels = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        peer, several = build_peer(folder), build_peer(folder, "several_rays")
        for scene_name in names:
            scene = load_scene(scene_name, notify=lambda text: print(text, file=sys.stderr), download=False)
            labels.append(scene.label)
            print(f"{scene.label} ...", file=sys.stderr)
            add(found, bench_scene(scene, size, repeat, peer))
            add(savings, bench_savings(scene, size, repeat))
            pixels = np.arange(size * size, dtype=np.uint32)
            primary = primary_rays(scene.camera.frame(size, size), pixels, size)
            for kind in ("kdtree", "bvh"):
                tree, path = cached_tree(scene, kind), folder / f"{scene_name}-{kind}"
                shadow = shadow_rays(tree, primary, trace(tree, primary), scene.light)[0]
                add(tried, bench_variants(tree, pieces(primary), repeat))
                add(tried, bench_several(tree, primary, False, repeat, several))
                add(tried, bench_several(tree, shadow, True, repeat, several))
                render(scene, tree, Shooting(size, size), path)
                add(found, bench_run(open_run(path), repeat))
                render(scene, tree, Shooting(min(size, 128), min(size, 128)), folder / "small")
                add(found, bench_comparison(open_run(folder / "small")))
                render(scene, tree, Shooting(2 * size, 2 * size), folder / "long")
                add(found, bench_long(open_run(folder / "long"), repeat))
                add(tried, bench_tried(open_run(path), repeat))
    if not quick:
        add(found, bench_start())
    tables = {
        "bench": (["figure", "what", "least", "median", "largest", "goal", "verdict"], print_goals(found)),
        "savings": (["what", "least", "median", "largest"], print_others("What each saves", savings)),
        "tried": (["what", "least", "median", "largest"], print_others("Tried", tried)),
    }
    if quick:
        return
    for table, (header, rows) in tables.items():
        with open(DATA / f"{table}.csv", "w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([header, *rows])
    (DATA / "machine.json").write_text(json.dumps(machine(labels), indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
