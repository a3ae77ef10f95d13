"""``python -m tests.bench.speed_error [--quick]``: what each short cut gains, and what it costs in error of Table I.

The speed-up is over the exact run that an estimate replaces: every ray traced into memory, filtered, replayed through the four
caches with and without prefetching. It is a ratio of CPU times, taken on one thread in one process, of everything but
building the tree and compiling. Errors are of every column of Table I against the exact run, the median and the largest
over seeds. Written to docs/data/speed_error.csv, and drawn in docs/speed-error.png and .svg; ``--quick`` writes nothing.
"""

import argparse
import csv
import sys
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cachesim.all_associativity import SetCounts
from cachesim.config import CacheConfig
from cachesim.fast_lru import LruCounts
from cachesim.filter import DirectFilter, filter_sets
from cachesim.layout import addresses
from cachesim.lines import NodeLines
from cachesim.report.table1 import SCENES, caches
from cachesim.sampling.cold_start import ALONE, KnownReplay
from cachesim.sampling.estimate import estimate
from cachesim.sampling.quantities import OF_THE_RUN, QUANTITIES, ratios_of
from cachesim.sampling.sampler import Sampler
from cachesim.sampling.set_sampling import in_classes
from cachesim.sampling.shards import HashedDistances
from cachesim.sampling.strata import Design, weights
from cachesim.sampling.target import parse_target
from cachesim.sampling.two_phase import LIKELY, value_of
from cachesim.sampling.unit_counts import UnitCounts
from cachesim.source import demand_only
from cachesim.stack_distance import StackDistances
from rtrace.ray_source import RayUnits
from rtrace.render import Shooting
from rtrace.scenes.catalog import load_scene
from rtrace.scenes.scene import Scene
from rtrace.trees.tree_cache import build_tree, cached_tree

ROOT = Path(__file__).resolve().parents[2]
OUT, PICTURE = ROOT / "docs" / "data" / "speed_error.csv", ROOT / "docs" / "speed-error"
LARGE = [CacheConfig(64 << 10, 8), CacheConfig(256 << 10, 8)]
FIELDS = (
    "scene",
    "tree",
    "method",
    "parameter",
    "speedup",
    "replay_speedup",
    "column",
    "median_error",
    "worst_error",
    "seeds",
)
PIECE = 6_000_000  # accesses on which replays are timed
KEPT = 15_000_000  # accesses, of those that the filter keeps, on which errors of set sampling are found


class Rows:
    """The rows of one scene and tree."""

    def __init__(self, scene: str, tree: str) -> None:
        self.scene, self.tree = scene, tree
        self.rows: list[dict[str, Any]] = []

    def add(
        self, method: str, parameter: str, speedup: float, errors: dict[str, list[float]], replay: float | None = None
    ) -> None:  # fmt: skip
        """Add one row per column: errors in per cent of the value, signed."""
        for column, values in errors.items():
            size = np.abs(np.array(values))
            self.rows.append({
                "scene": self.scene, "tree": self.tree, "method": method, "parameter": parameter,
                "speedup": f"{speedup:.3f}", "replay_speedup": "" if replay is None else f"{replay:.2f}", "column": column,
                "median_error": f"{np.median(size):.4f}", "worst_error": f"{size.max():.4f}", "seeds": len(values),
            })  # fmt: skip


class ExactRun(NamedTuple):
    """The exact run: its totals (counts, then misses as in ``ratios_of``), what the filter keeps, and a piece unfiltered."""

    totals: np.ndarray
    lines: np.ndarray
    labels: np.ndarray
    piece: tuple[np.ndarray, np.ndarray]
    trace_s: float
    replay_s: float  # filtered, of all accesses
    n: int  # accesses, prefetches included

    @property
    def seconds(self) -> float:
        """CPU time of the exact run."""
        return self.trace_s + self.replay_s


def cpu(function: Callable[[], Any], repeat: int = 3) -> float:
    """Return the least CPU time of some calls, after one that may compile."""
    function()
    taken = []
    for _ in range(repeat):
        start = time.process_time()
        function()
        taken.append(time.process_time() - start)
    return min(taken)


def columns(totals: np.ndarray, truth: np.ndarray, configs: list[CacheConfig]) -> dict[str, float]:
    """Return the largest error over the caches of every column, in per cent of the true value."""
    ratios = ratios_of(configs)
    true = np.array([value_of(ratio, truth) for ratio in ratios])
    error = 100 * (np.array([value_of(ratio, totals) for ratio in ratios]) / true - 1)
    by_cache = error[len(OF_THE_RUN) :].reshape(len(configs), len(QUANTITIES))
    largest = by_cache[np.abs(by_cache).argmax(axis=0), np.arange(len(QUANTITIES))]
    return {"accesses_per_ray": float(error[0])} | dict(zip(QUANTITIES, largest.tolist(), strict=True))


def collect(several: list[dict[str, float]]) -> dict[str, list[float]]:
    """Return the values of every column."""
    return {name: [each[name] for each in several] for name in several[0]}


def accesses(source: RayUnits) -> Iterator[tuple[np.ndarray, np.ndarray, int]]:
    """Yield the lines, labels and number of rays of a run, piece by piece."""
    table = NodeLines(addresses(source.nodes, source.node_bytes, "stored"), source.node_bytes, 32, 0)
    for start in range(0, source.n_positions, 4096):
        stretch = source.trace((start, min(start + 4096, source.n_positions)))[0]
        lines, labels = table.accesses(stretch.nodes, (stretch.kinds == 3).view(np.uint8) * np.uint8(11))
        yield lines, labels, stretch.n_rays


def run_exactly(source: RayUnits, configs: list[CacheConfig]) -> ExactRun:
    """Trace and replay everything, and keep what the filter keeps."""
    direct, replay = DirectFilter(filter_sets(configs), keep_first_use=True), KnownReplay(configs, from_start=True)
    totals = np.zeros(3 + 3 * len(configs))
    kept: list[tuple[np.ndarray, np.ndarray]] = []
    piece: list[tuple[np.ndarray, np.ndarray]] = []
    n, trace_s, replay_s, start = 0, 0.0, 0.0, time.process_time()
    for lines, labels, n_rays in accesses(source):
        traced = time.process_time()
        found = replay.step(lines, labels)
        replayed = time.process_time()
        trace_s += traced - start
        replay_s += replayed - traced
        totals[:3] += found.accesses, found.prefetches, n_rays
        totals[3:] += found.misses.ravel()
        kept.append(direct.accesses(lines, labels))
        if sum(part[0].size for part in piece) < PIECE:
            piece.append((lines, labels))
        n += lines.size
        start = time.process_time()
    lines, labels = (np.concatenate([k[i] for k in kept]) for i in (0, 1))
    whole = np.concatenate([p[0] for p in piece]), np.concatenate([p[1] for p in piece])
    return ExactRun(totals, lines, labels, whole, trace_s, replay_s, n)


def unfiltered(lines: np.ndarray, labels: np.ndarray, configs: list[CacheConfig]) -> None:
    """Replay with and without prefetches through every cache, each access."""
    for config in configs:
        for stream in ((lines, labels), demand_only(lines, labels)):
            LruCounts(config).step(*stream)


def in_hottest_tenth(lines: np.ndarray, labels: np.ndarray, n_classes: int, config: CacheConfig) -> float:
    """Return the share, in per cent, of the misses without prefetching that a tenth of the sets has."""
    order = np.argsort(lines % n_classes, kind="stable")
    ends = np.searchsorted(lines[order] % n_classes, np.arange(n_classes + 1))
    misses = [
        KnownReplay([config], from_start=True).step(lines[order[a:b]], labels[order[a:b]]).misses[0, ALONE]
        for a, b in pairwise(ends)
    ]
    return 100 * float(sum(sorted(misses)[-max(n_classes // 10, 1) :]) / sum(misses))


def replays(rows: Rows, exact: ExactRun, configs: list[CacheConfig]) -> None:
    """Add the exact ways to replay, as timed on the piece."""
    lines, labels = exact.piece
    scale = exact.n / lines.size

    def one_pass() -> None:
        demand = demand_only(lines, labels)
        for stream in ((lines, labels), demand):
            SetCounts(configs).step(*stream)

    def single() -> None:
        demand = demand_only(lines, labels)
        for config in configs:
            for stream in ((lines, labels), demand):
                SetCounts([config]).step(*stream)

    filtered = scale * cpu(lambda: KnownReplay(configs, from_start=True).step(lines, labels))
    none = {name: [0.0] for name in ("accesses_per_ray", *QUANTITIES)}
    for method, parameter, seconds in (
        ("exact", "filtered", filtered),
        ("exact", "without the filter", scale * cpu(lambda: unfiltered(lines, labels, configs))),
        ("exact", "one-pass sweep", scale * cpu(one_pass)),
        ("exact", "sweep, one cache at a time", scale * cpu(single)),
    ):
        rows.add(method, parameter, (exact.trace_s + filtered) / (exact.trace_s + seconds), none, filtered / seconds)


def set_sampling(rows: Rows, exact: ExactRun, configs: list[CacheConfig], label: str, n_seeds: int) -> None:
    """Add 1/2, 1/4 and 1/8 of the sets: errors on the first accesses that the filter keeps, times on the piece unfiltered."""
    n_classes = filter_sets(configs)
    lines, labels = exact.lines[:KEPT], exact.labels[:KEPT]
    scale = exact.n / exact.piece[0].size
    filtered = scale * cpu(lambda: KnownReplay(configs, from_start=True).step(*exact.piece))

    def totals_of(lines: np.ndarray, labels: np.ndarray, times: int) -> np.ndarray:
        misses = times * KnownReplay(configs, from_start=True).step(lines, labels).misses.ravel()
        return np.concatenate([exact.totals[:3], misses])

    truth = totals_of(lines, labels, 1)
    about = {
        "unfiltered_over_filtered": [scale * cpu(lambda: unfiltered(*exact.piece, configs), 1) / filtered],
        "misses_in_hottest_tenth": [in_hottest_tenth(lines, labels, n_classes, config) for config in configs],
    }
    for every in (2, 4, 8):
        errors = []
        for seed in range(n_seeds):
            taken = np.zeros(n_classes, np.bool_)
            taken[np.random.default_rng(seed).permutation(n_classes)[::every]] = True
            errors.append(columns(totals_of(*in_classes(lines, labels, taken), every), truth, configs))

        def thinned(taken: np.ndarray = taken) -> None:
            KnownReplay(configs, from_start=True).step(*in_classes(*exact.piece, taken))

        seconds = scale * cpu(thinned)
        gain = (exact.trace_s + filtered) / (exact.trace_s + seconds)
        rows.add(f"set sampling, {label}", f"1/{every}", gain, collect(errors) | about, filtered / seconds)


def hashed_lines(rows: Rows, exact: ExactRun, n_seeds: int) -> None:
    """Add part of the lines for the fully associative curve, 8K to 256K, against exact stack distances."""
    lines, labels = exact.piece
    n_ids, sizes = int(exact.lines.max()) + 1, [256 << k for k in range(6)]

    def exactly() -> StackDistances:
        distances = StackDistances()
        distances.step(lines, labels, n_ids)
        return distances

    truth = exactly()
    true = [sum(truth.misses(n)) / lines.size for n in sizes]
    whole = cpu(exactly, 1)
    for part in (2, 8, 32):
        errors: list[dict[str, float]] = []
        for seed in range(n_seeds):
            distances = HashedDistances(1 / part, seed)
            distances.step(lines, labels, n_ids)
            found = [100 * (distances.miss_rate(n) - t) for n, t in zip(sizes, true, strict=True)]
            errors.append({"fully_associative_points": max(found, key=abs)})
        seconds = cpu(lambda part=part: HashedDistances(1 / part, 0).step(lines, labels, n_ids), 1)
        scale = exact.n / lines.size
        rows.add(
            "hashed lines", f"1/{part}", (exact.trace_s + scale * whole) / (exact.trace_s + scale * seconds), collect(errors),
            whole / seconds,
        )  # fmt: skip


def row_sampling(rows: Rows, source: RayUnits, exact: ExactRun, configs: list[CacheConfig], n_seeds: int, most: int) -> None:
    """Add rows of the picture drawn at random, by their share and by their warm-up; then the estimator itself."""
    counts = UnitCounts(source, configs, 1)
    # A part of the units, drawn once, stands for all: the seeds draw from it, and warm-ups are compared on the same rows.
    units = np.sort(np.random.default_rng(0).permutation(counts.n_units)[:most])
    counts.count(units.tolist(), units.tolist(), counts.row)
    sure, certain, open_ = counts.table(units.tolist())
    settled, bracket = counts.long_table(units.tolist(), counts.row)
    ways = {
        "short warm-up, open = misses": certain + open_,
        "short warm-up, open = hits": certain,
        "a row of warm-up": settled + LIKELY * bracket,
    }
    truth_of_part = np.concatenate([sure.sum(axis=0), (settled + LIKELY * bracket).sum(axis=0)])
    timed = units[:: max(len(units) // 12, 1)].tolist()
    for name, misses in ways.items():
        warm = counts.row if name.startswith("a row") else 0
        fresh = UnitCounts(source, configs, 1)
        one = cpu(lambda fresh=fresh, warm=warm: [fresh._one((u, warm)) for u in timed], 1) / len(timed)
        for part in (32, 16, 8):
            n = max(counts.n_units // part, 4)
            if n >= len(units):
                continue
            errors = []
            for seed in range(n_seeds):
                drawn = np.random.default_rng(seed).permutation(len(units))[:n]
                totals = np.concatenate([sure[drawn].sum(axis=0), misses[drawn].sum(axis=0)])
                errors.append(columns(totals, truth_of_part, configs))
            for error in errors:  # totals are of the part drawn
                for column in ("bytes_from_memory_without", "bytes_from_memory"):
                    del error[column]
            rows.add(f"rows at random, {name}", f"1/{part}", exact.seconds / (n * one), collect(errors))


def estimator(rows: Rows, source: RayUnits, exact: ExactRun, configs: list[CacheConfig], n_seeds: int) -> None:
    """Add ``npcache estimate`` for several targets: errors over seeds from counts kept, time of one run."""
    counts = UnitCounts(source, configs, 1)
    for text in ("10%,0.2pp", "5%,0.1pp", "2%,0.05pp"):
        target = parse_target(text)
        errors, shares = [], []
        scouts = [counts.scout(seed) for seed in range(3)]
        for seed in range(n_seeds):
            design = Design(weights(*scouts[seed % 3], counts.middles), seed)
            sampler = Sampler(counts, configs, source.row, seed)
            while True:
                look = sampler.look(design.stage(), target)
                if look.is_within or look.hopeless:
                    break
                design.split(look.split)
            shares.append(look.share)
            if look.is_within:
                true = np.array([value_of(ratio, exact.totals) for ratio in ratios_of(configs)])
                error = 100 * (np.array([interval.value for interval in look.intervals]) / true - 1)
                by_cache = error[len(OF_THE_RUN) :].reshape(len(configs), len(QUANTITIES))
                largest = by_cache[np.abs(by_cache).argmax(axis=0), np.arange(len(QUANTITIES))]
                errors.append({"accesses_per_ray": float(error[0])} | dict(zip(QUANTITIES, largest.tolist(), strict=True)))
        taken = []
        for seed in range(3):
            start = time.process_time()
            result = estimate(source, configs, target, seed=seed, threads=1, exact_below=0)
            if result.method == "sampled":
                taken.append(time.process_time() - start)
        if errors and taken:
            rows.add("estimate", text, exact.seconds / float(np.median(taken)), collect(errors))


def other_pictures(rows: Rows, scene: Scene, kind: str, size: int, exact: ExactRun, configs: list[CacheConfig]) -> None:
    """Add lower resolutions, which are no estimate, and cheaper trees."""
    for part in (2, 4):
        lower = run_exactly(RayUnits(scene, cached_tree(scene, kind), Shooting(size // part, size // part)), configs)
        totals = lower.totals * part**2
        rows.add(
            "lower resolution", f"1/{part}", exact.seconds / lower.seconds, collect([columns(totals, exact.totals, configs)])
        )
    params: dict[str, Any] = {"builder": "binned"} if kind == "bvh" else {"max_level": 16}
    start = time.process_time()
    build_tree(scene.triangles, kind)
    full_s = time.process_time() - start
    start = time.process_time()
    tree = build_tree(scene.triangles, kind, **params)
    build_s = time.process_time() - start
    other = run_exactly(RayUnits(scene, tree, Shooting(size, size)), configs)
    name = "binned SAH" if kind == "bvh" else "coarse kd-tree"
    gain = (full_s + exact.seconds) / (build_s + other.seconds)
    rows.add("another tree", f"{name}, build and run", gain, collect([columns(other.totals, exact.totals, configs)]))
    rows.add("another tree", f"{name}, build alone", full_s / build_s, {"build": [0.0]})


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one small picture, few seeds; writes nothing")
    parser.add_argument("--size", type=int, default=1024, help="side of the pictures")
    parser.add_argument("--scenes", default=",".join(SCENES))
    args = parser.parse_args()
    size, n_seeds, names = (192, 4, "sponza") if args.quick else (args.size, 20, args.scenes)
    found: list[dict[str, Any]] = []
    for name in names.split(","):
        scene = load_scene(name, notify=lambda text: print(text, file=sys.stderr))
        for kind in ("kdtree", "bvh"):
            rows, configs = Rows(scene.label, kind), caches()
            source = RayUnits(scene, cached_tree(scene, kind), Shooting(size, size))
            run_exactly(RayUnits(scene, cached_tree(scene, kind), Shooting(48, 48)), configs)  # compiles
            exact = run_exactly(source, configs)
            replays(rows, exact, configs)
            set_sampling(rows, exact, configs, "Table I", n_seeds)
            set_sampling(rows, exact, LARGE, "64K and 256K 8-way", n_seeds)
            hashed_lines(rows, exact, n_seeds)
            row_sampling(rows, source, exact, configs, n_seeds, most=size // 2)
            estimator(rows, source, exact, configs, n_seeds)
            other_pictures(rows, scene, kind, size, exact, configs)
            for row in rows.rows:
                if row["column"] in ("demand_miss_rate_without", "fully_associative_points"):
                    print(*(row[field] for field in FIELDS), flush=True)
            found += rows.rows
            if not args.quick:
                write(found)
    if not args.quick:
        draw(found)


def write(rows: list[dict[str, Any]]) -> None:
    """Write all rows."""
    with open(OUT, "w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, FIELDS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def frontier(points: dict[tuple[str, str], tuple[float, float]]) -> list[tuple[str, str]]:
    """Return the methods that no other beats in both speed-up and error, fastest last."""
    front: list[tuple[str, str]] = []
    least = float("inf")
    for name, (_, error) in sorted(points.items(), key=lambda item: (-item[1][0], item[1][1])):
        if error < least:
            front.append(name)
            least = error
    return front[::-1]


def points_of(rows: list[dict[str, Any]]) -> dict[tuple[str, str], tuple[float, float]]:
    """Return (median speed-up, largest error over runs, columns and seeds) of every method with errors of Table I."""
    points = {}
    for key in dict.fromkeys((row["method"], row["parameter"]) for row in rows):
        of = [
            row
            for row in rows
            if (row["method"], row["parameter"]) == key and row["column"] in ("accesses_per_ray", *QUANTITIES)
        ]
        if of and "64K" not in key[0]:
            speed = {(row["scene"], row["tree"]): float(row["speedup"]) for row in of}
            points[key] = (float(np.median(list(speed.values()))), max(float(row["worst_error"]) for row in of))
    return points


def draw(rows: list[dict[str, Any]]) -> None:
    """Draw speed-up against the largest error, with the frontier, as PNG and SVG."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

    from cachesim.report.curves import round_numbers
    from cachesim.report.pictures import COLOURS, drawn

    points = points_of(rows)
    least = 0.05  # exact methods stand there: the axis is logarithmic
    places = {key: (speed, max(error, least)) for key, (speed, error) in points.items()}
    for kind in ("png", "svg"):
        with drawn(PICTURE.with_suffix(f".{kind}"), 8.6, 5.2, dpi=130) as figure:
            axes = figure.subplots()
            axes.set(
                xscale="log",
                yscale="log",
                xlabel="speed-up over the filtered exact run",
                ylabel="largest error of Table I (%)",
            )
            axes.set(xlim=(0.2, 31), ylim=(least / 2.2, 400))
            axes.plot(
                *zip(*(places[key] for key in frontier(points)), strict=True), color="0.75", zorder=0, label="Pareto front"
            )
            for i, method in enumerate(dict.fromkeys(method for method, _ in points)):
                of = [place for (name, _), place in places.items() if name == method]
                line = ":" if method not in ("exact", "another tree") else "none"
                axes.plot(
                    *zip(*of, strict=True), color=COLOURS[i], marker="osD^vPX*"[i], markersize=5, linestyle=line, label=method
                )
            for axis, limits in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
                axis.set_major_locator(FixedLocator(round_numbers(*limits)))
                axis.set_major_formatter(FuncFormatter(lambda value, _: "exact" if value < least else f"{value:g}"))
                axis.set_minor_locator(NullLocator())
            axes.grid(color="0.93", linewidth=0.6)
            axes.axhline(least, color="0.85", linewidth=0.8, zorder=0)
            axes.annotate("exact", (axes.get_xlim()[1], least), (-3, 3), textcoords="offset points", ha="right", fontsize=8)
            figure.legend(loc="outside right upper", frameon=False)
            figure.draw_without_rendering()  # the axes take their size, and keep it
            figure.set_layout_engine("none")
            names = [parameter.partition(",")[0] if method == "another tree" else parameter for method, parameter in places]
            label_apart(axes, names, list(places.values()))


def label_apart(axes: Any, texts: list[str], points: list[tuple[float, float]]) -> None:
    """Write a text beside each point, in the first place around it where it covers no other text and no point."""
    dots = axes.transData.transform(points)
    taken: list[Any] = []
    around = [(0, 7), (0, -7), (6, 0), (-6, 0), (5, 6), (-5, 6), (5, -6), (-5, -6)]
    around += [(x, y) for y in (17, -17, 27, -27) for x in (0, 8, -8)]
    sides = {1: "left", 0: "center", -1: "right"}
    for text, point in zip(texts, points, strict=True):
        for x, y in around:
            label = axes.annotate(
                text, point, (x, y), textcoords="offset points", fontsize=7, ha=sides[int(np.sign(x))],
                va={1: "bottom", 0: "center", -1: "top"}[int(np.sign(y))],
            )  # fmt: skip
            box = label.get_window_extent().expanded(1.2, 1.2)
            is_free = not any(box.overlaps(other) for other in taken) and not any(box.contains(*dot) for dot in dots)
            if (
                is_free
                and axes.get_window_extent().contains(box.x0, box.y0)
                and axes.get_window_extent().contains(box.x1, box.y1)
            ):
                taken.append(box)
                break
            label.remove()


if __name__ == "__main__":
    main()
