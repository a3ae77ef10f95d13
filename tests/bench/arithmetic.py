"""``python -m tests.bench.arithmetic [--quick]``: traversal in float32 and without margins, against ours in float64 with them.

The variants are texts: rtrace/simd.py, intersect.py and traverse.py with the arithmetic or the margin replaced, compiled
for the occasion. Camera rays, their shadow rays left out, and rays aimed at vertices and edges. Ours stands for the truth:
it is brute force's answer, bit by bit. Written to docs/data/arithmetic.csv.
"""

import csv
import importlib
import re
import sys
import tempfile
import time
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from cachesim.layout import addresses
from cachesim.lines import NodeLines
from cachesim.report.table1 import SCENES, caches
from cachesim.sampling.cold_start import ALONE, KnownReplay
from rtrace import traverse as ours
from rtrace.checks.embree import kappa
from rtrace.chunk import primary_rays
from rtrace.rays import Rays, make_rays
from rtrace.scenes.catalog import load_scene
from rtrace.trees.tree import Tree, node_table
from rtrace.trees.tree_cache import cached_tree

ROOT = Path(__file__).resolve().parents[2]
OUT = ROOT / "docs" / "data" / "arithmetic.csv"
#: Replacements (pattern, text) of each variant; every pattern has to occur, or the variant is not what it says.
NO_MARGIN = ((r"^PAD = .*$", "PAD = 0.0"), (r"^ORIGIN_PAD = .*$", "ORIGIN_PAD = 0.0"))
#: A constant in float64 would draw its product to float64 too.
IN_FLOAT32 = (
    (r"np\.float64\b", "np.float32"),
    (r"\b1\.0 / d", "np.float32(1.0) / d"),
    (r"return np\.nan", "return np.float32(np.nan)"),
    (r"^HUGE = float\(", "HUGE = np.float32("),
    (r"^LEAST_PAD = .*$", "LEAST_PAD = np.float32(1e-30)"),
    (r"^THIN = .*$", "THIN = np.float32(2.0**-6)"),
    (r"^_SPLITTER = .*$", "_SPLITTER = np.float32(2.0**12 + 1.0)"),
    (r'name="Lanes"', 'name="Lanes32"'),
    (r"ir\.DoubleType\(\)", "ir.FloatType()"),
    (r"types\.float64", "types.float32"),
    (r"builder\.fpext\((.*), _FOUR_DOUBLES\)", r"\1"),
)
VARIANTS: dict[str, tuple[tuple[str, str], ...]] = {
    "float64, no margin": NO_MARGIN,
    "float32, margin 2^-21": (
        *IN_FLOAT32,
        (r"^PAD = .*$", "PAD = np.float32(2.0**-21)"),
        (r"^ORIGIN_PAD = .*$", "ORIGIN_PAD = np.float32(2.0**-22)"),
    ),
    "float32, no margin": (
        *IN_FLOAT32,
        (r"^PAD = .*$", "PAD = np.float32(0.0)"),
        (r"^ORIGIN_PAD = .*$", "ORIGIN_PAD = np.float32(0.0)"),
    ),
}


def variant(folder: Path, name: str, replacements: tuple[tuple[str, str], ...]) -> ModuleType:
    """Return the traversal module with the replacements made."""
    stem = re.sub(r"\W", "_", name)
    n_made = dict.fromkeys(replacements, 0)
    for module in ("simd", "intersect", "traverse"):
        text = (ROOT / "rtrace" / f"{module}.py").read_text(encoding="utf-8")
        for pattern, replacement in replacements:
            text, n = re.subn(pattern, replacement, text, flags=re.MULTILINE)
            n_made[pattern, replacement] += n
        for other in ("simd", "intersect"):
            text = text.replace(f"from rtrace.{other} import", f"from {other}_{stem} import")
        (folder / f"{module}_{stem}.py").write_text(text, encoding="utf-8")
    missing = [pattern for (pattern, _), n in n_made.items() if not n]
    if missing:
        raise SystemExit(f"{name}: {', '.join(missing)} is not in the kernels any more; change tests/bench/arithmetic.py")
    return importlib.import_module(f"traverse_{stem}")


def aimed(tree: Tree, eye: np.ndarray, n: int) -> Rays:
    """Return rays from the camera at vertices and middles of edges of random triangles."""
    rng = np.random.default_rng(1)
    chosen = tree.triangles[rng.integers(len(tree.triangles), size=n)].astype(np.float64)
    a, b = rng.integers(3, size=(2, n))
    at = (chosen[np.arange(n), a] + chosen[np.arange(n), b]) / 2
    origin = np.asarray(eye, np.float32)
    direction = (at - origin).astype(np.float32)
    direction[~direction.any(axis=1)] = 1.0
    return make_rays(origin, direction)


def measure(module: Any, tree: Tree, rays: Rays) -> tuple[Any, np.ndarray, float]:
    """Return hits, events and CPU seconds."""
    module.trace_recorded(tree, Rays(*(a[:64] for a in rays)))  # compiles
    taken = []
    for _ in range(2):
        start = time.process_time()
        hits, _, events = module.trace_recorded(tree, rays)
        taken.append(time.process_time() - start)
    return hits, events, min(taken)


def miss_rates(tree: Tree, events: np.ndarray) -> np.ndarray:
    """Return the demand miss rate without prefetching of the four caches."""
    table, node_bytes = node_table(tree), tree.nodes.dtype.itemsize
    lines = NodeLines(addresses(table, node_bytes, "stored"), node_bytes, 32, 0)
    labels = ((events & np.uint32(3)) == 3).astype(np.uint8) * np.uint8(11)
    found = KnownReplay(caches(), from_start=True).step(*lines.accesses(events >> np.uint32(2), labels))
    return found.misses[:, ALONE] / found.accesses


def main() -> None:
    """Measure, print and write."""
    is_quick = "--quick" in sys.argv
    side, n_aimed, names = (64, 2_000, SCENES[-1:]) if is_quick else (512, 200_000, SCENES)
    sums: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    with tempfile.TemporaryDirectory() as name:
        sys.path.insert(0, name)
        modules = {what: variant(Path(name), what, replacements) for what, replacements in VARIANTS.items()}
        for scene_name in names:
            scene = load_scene(scene_name, notify=lambda text: print(text, file=sys.stderr))
            frame = scene.camera.frame(side, side)
            for kind in ("kdtree", "bvh"):
                tree = cached_tree(scene, kind)
                for what, rays in (
                    ("camera", primary_rays(frame, np.arange(side * side, dtype=np.uint32), side)),
                    ("at vertices and edges", aimed(tree, frame[0], n_aimed)),
                ):
                    true, true_events, true_s = measure(ours, tree, rays)
                    true_rates = miss_rates(tree, true_events)
                    for label, module in modules.items():
                        hits, events, seconds = measure(module, tree, rays)
                        sums.setdefault((label, kind, what), []).append(
                            compare(tree, rays, true, hits)
                            | {"visits": len(events) / len(true_events), "speed": true_s / seconds,
                               "miss": float(np.abs(miss_rates(tree, events) / true_rates - 1).max())}
                        )  # fmt: skip
    rows = []
    for (label, kind, what), found in sums.items():
        n = sum(each["n"] for each in found)
        row = {"traversal": label, "tree": kind, "rays": f"{what}, {n:,}"}
        row |= {column: f"{sum(each[column] for each in found):,}" for column in ("lost", "invented", "other")}
        row["t_error"] = f"{max(each['t_error'] for each in found):.2g}"
        row["visits"] = f"{100 * (np.mean([each['visits'] for each in found]) - 1):+.3f}"
        row["miss"] = f"{100 * max(each['miss'] for each in found):.2g}"
        row["speed"] = f"{np.median([each['speed'] for each in found]):.2f}"
        print(row, flush=True)
        rows.append(row)
    if not is_quick:
        with open(OUT, "w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


def compare(tree: Tree, rays: Rays, true: Any, hits: Any) -> dict[str, Any]:
    """Return counts of differing answers, and the 99.9th percentile of the error of t in units of kappa."""
    both = (true.prim >= 0) & (hits.prim >= 0)
    same = both & (true.prim == hits.prim)
    unit = kappa(tree.triangles, Rays(*(a[same] for a in rays)), true.prim[same])
    error = np.abs(hits.t[same] - true.t[same]) / np.maximum(unit, 1e-300)
    return {
        "n": len(true.prim), "lost": int(((true.prim >= 0) & (hits.prim < 0)).sum()),
        "invented": int(((true.prim < 0) & (hits.prim >= 0)).sum()), "other": int((both & ~same).sum()),
        "t_error": float(np.quantile(error, 0.999)) if error.size else 0.0,
    }  # fmt: skip


if __name__ == "__main__":
    main()
