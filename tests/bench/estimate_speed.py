"""``python -m tests.bench.estimate_speed [--size 2048] [--repeat 3]``: the estimator's wall time against the exact run's.

Estimate and exact run in turn, with as many threads as there are cores, different seeds; tree and kernels are made before.
Written to docs/data/estimate_speed.csv.
"""

import argparse
import csv
import statistics
import sys
import time
from pathlib import Path
from typing import Any

from cachesim.report.table1 import SCENES, caches
from cachesim.sampling.estimate import estimate
from cachesim.sampling.target import parse_target
from cachesim.sampling.unit_counts import UnitCounts
from rtrace.ray_source import RayUnits
from rtrace.render import Shooting
from rtrace.scenes.catalog import load_scene
from rtrace.trees.tree_cache import build_tree
from tests.bench.calibration import TARGET

OUT = Path(__file__).resolve().parents[2] / "docs" / "data" / "estimate_speed.csv"


def timed(function: Any) -> tuple[Any, float, float]:
    """Return what the function returns, and the wall and CPU time it took."""
    wall, cpu = time.perf_counter(), time.process_time()
    result = function()
    return result, time.perf_counter() - wall, time.process_time() - cpu


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=2048)
    parser.add_argument("--repeat", type=int, default=3)
    args = parser.parse_args()
    target, rows = parse_target(TARGET), []
    for name in SCENES:
        scene = load_scene(name, notify=lambda text: print(text, file=sys.stderr))
        for kind in ("kdtree", "bvh"):
            build_tree(scene.triangles[:64], kind)  # compiles
            tree, build_s, _ = timed(lambda scene=scene, kind=kind: build_tree(scene.triangles, kind))
            source = RayUnits(scene, tree, Shooting(args.size, args.size))
            estimate(RayUnits(scene, tree, Shooting(96, 96)), caches(), target)
            estimate(RayUnits(scene, tree, Shooting(256, 256)), caches(), parse_target("50%,20pp"), exact_below=0)
            walls, cpus, shares, estimates, exacts, predictions = [], [], [], [], [], []
            for seed in range(args.repeat):
                result, wall, cpu = timed(lambda seed=seed, s=source: estimate(s, caches(), target, seed=seed, exact_below=0))
                _, exact_wall, exact_cpu = timed(lambda s=source: UnitCounts(s, caches()).everything())
                walls.append(exact_wall / wall)
                cpus.append(exact_cpu / cpu)
                shares.append(result.share)
                estimates.append(wall)
                exacts.append(exact_wall)
                predictions.append(result.exact_seconds / exact_wall)
            row = {"scene": scene.label, "tree": kind, "size": args.size, "build_s": f"{build_s:.2f}"}
            for column, values in (
                ("exact_s", exacts), ("estimate_s", estimates), ("wall", walls), ("cpu", cpus), ("share", shares),
                ("predicted", predictions),
            ):  # fmt: skip
                row[column] = f"{statistics.median(values):.4g}"
            print(row, flush=True)
            rows.append(row)
            with open(OUT, "w", encoding="utf-8", newline="") as file:
                writer = csv.DictWriter(file, list(row), lineterminator="\n")
                writer.writeheader()
                writer.writerows(rows)


if __name__ == "__main__":
    main()
