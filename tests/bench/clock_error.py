"""``python -m tests.bench.clock_error [--quick]``: cells of the break-even map from part of the rays: time, error, intervals.

The rays of a run are cut into pieces of consecutive rays. A part is every f-th piece, or one stretch of pieces; each is timed
behind a warm-up, the piece before, that is not counted. What is estimated are cycles per read of a node's line: the trace has
the number of reads, so that cycles per ray follow. Four of the parts are tried: their figures against the full run's, and
whether the 95 % interval of its pieces holds the full run's figure. Written to docs/data/clock_error.csv; ``--quick`` writes
nothing.
"""

import argparse
import csv
import os
import tempfile
import time
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cachesim.clock.parameters import PRESETS, Clock
from cachesim.clock.sampled_rays import PIECES, Counted, Figures, count, figures, picked, read_cut_rows, reads_of
from cachesim.clock.timing import Job, Workshop
from cachesim.config import CacheConfig
from cachesim.prefetch import Prefetch, parse_prefetch
from cachesim.report.table1 import SCENES
from cachesim.source import RunSource
from nptrace_base.pools import thread_pool
from rtrace.render import Shooting, render
from rtrace.scenes.catalog import load_scene
from rtrace.scenes.scene import Scene
from rtrace.trees.tree_cache import TREES, cached_tree
from traces.reader import Run, open_run

OUT = Path(__file__).resolve().parents[2] / "docs" / "data" / "clock_error.csv"

#: Scenes that played no part in choosing the least width of an interval.
HELD_OUT = ("blob", "room", "nave", "court")
RAYS = (1, 4, 16, 64)
CACHES = ((8192, 1), (16384, 2))
PREFETCHES = ("none", "stack", "push")

SPREAD, SPREAD_COLD, STRETCH = "every piece in", "every piece in, no warm-up", "one stretch"

#: Which pieces make a part, and of how many parts it is one.
METHODS = ((SPREAD, 4), (SPREAD, 8), (SPREAD, 16), (SPREAD_COLD, 8), (STRETCH, 8))
#: Parts of a run that are tried.
SAMPLES = 4

FIELDS = (
    "scene", "tree", "method", "parts", "rays", "size_bytes", "ways", "prefetch", "samples", "time_share", "speed_up",
    "speed_up_median_error", "speed_up_worst_error", "speed_up_bias", "speed_up_half_width", "speed_up_held",
    "cycles_median_error", "cycles_worst_error", "cycles_bias", "cycles_half_width", "cycles_held",
)  # fmt: skip


class Cell(NamedTuple):
    """One machine: rays in flight, and a cache."""

    clock: Clock
    config: CacheConfig


def parts_of(method: str, parts: int) -> list[list[int]]:
    """Return the pieces of every part."""
    if method == STRETCH:
        return [list(range(i, i + PIECES // parts)) for i in range(0, PIECES, PIECES // parts)]
    return [list(range(offset, PIECES, parts)) for offset in range(parts)]


def measure(run: Run, cells: Sequence[Cell], threads: int, methods: Sequence[tuple[str, int]]) -> Iterator[dict[str, Any]]:
    """Yield the rows of one run."""
    source = RunSource(run)
    stream, workshop = read_cut_rows(source), Workshop(source, 1)
    prefetches = [parse_prefetch(name) for name in PREFETCHES]
    jobs = list(product(cells, prefetches))
    with thread_pool(threads) as pool:

        def all_jobs(pieces: list[int], *, is_warm: bool) -> list[Counted]:
            def one(job: tuple[Cell, Prefetch]) -> Counted:
                return count(new_job(job), *picked(stream, pieces, job[0].clock.rays, is_warm=is_warm))

            return list(pool.map(one, jobs))

        def new_job(job: tuple[Cell, Prefetch]) -> Job:
            made = workshop.job(job[0].config, job[0].clock, job[1])
            assert made is not None
            return made

        def full(job: tuple[Cell, Prefetch]) -> tuple[int, int]:
            made = new_job(job)
            made.step(stream.rows)
            return int(made.clock.numbers[0].last_cycle), reads_of(made.clock.numbers[0])

        list(map(full, jobs[: len(prefetches)]))  # once before: what is read once and compiled once
        began = time.process_time()
        truth = [figure[0] / figure[1] for figure in pool.map(full, jobs)]
        full_time = time.process_time() - began
        for method, parts in methods:
            began = time.process_time()
            samples = [
                all_jobs(pieces, is_warm=method != SPREAD_COLD)
                for pieces in parts_of(method, parts)[:: max(parts // SAMPLES, 1)]
            ]
            share = (time.process_time() - began) / len(samples) / full_time
            for j, (cell, prefetch) in enumerate(jobs):
                if prefetch.kind != "none":
                    none = j - j % len(prefetches)
                    of = [figures(sample[none], sample[j]) for sample in samples]
                    yield {
                        "scene": run.footer.scene.name, "tree": run.footer.tree.kind, "method": method, "parts": parts,
                        "rays": cell.clock.rays, "size_bytes": cell.config.size_bytes, "ways": cell.config.ways,
                        "prefetch": prefetch.kind, "samples": len(of), "time_share": f"{share:.3f}",
                        **_against(of, truth[j], truth[none] / truth[j]),
                    }  # fmt: skip


def _against(of: Sequence[Figures], cycles: float, speed_up: float) -> dict[str, str]:
    """Return what the figures of all samples are, against the truth: in per cent of it."""
    found = np.array(of)
    row = {"speed_up": f"{speed_up:.4f}"}
    for name, true, column in (("speed_up", speed_up, 1), ("cycles", cycles, 0)):
        errors, half_widths = 100 * (found[:, column] / true - 1), 100 * found[:, column + 2]
        held = np.abs(errors) <= half_widths * found[:, column] / true
        row |= {
            f"{name}_median_error": f"{np.median(np.abs(errors)):.3f}", f"{name}_worst_error": f"{np.abs(errors).max():.3f}",
            f"{name}_bias": f"{errors.mean():.3f}",
            f"{name}_half_width": f"{np.median(half_widths):.3f}",
            f"{name}_held": str(int(held.sum())),
        }  # fmt: skip
    return row


def runs_of(scene: Scene, side: int, folder: Path) -> Iterator[Run]:
    """Yield the runs of a scene, one a tree."""
    for kind in TREES:
        path = folder / f"{scene.name}-{kind}"
        render(scene, cached_tree(scene, kind), Shooting(side, side), path)
        yield open_run(path)


def write(rows: Sequence[dict[str, Any]], out: Path) -> None:
    """Write the rows measured so far."""
    with open(out, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, FIELDS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one scene and two machines; writes nothing")
    parser.add_argument("--held-out", action="store_true", help="built-in scenes and a machine that chose nothing")
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    arguments = parser.parse_args()
    names, rays, sizes = (("bunny",), (1, 16), CACHES[1:]) if arguments.quick else (SCENES, RAYS, CACHES)
    machine, out = PRESETS["paper"].clock, OUT
    if arguments.held_out:
        names, machine, out = HELD_OUT, machine.with_numbers(miss=200, triangle=4), OUT.with_stem("clock_error_held_out")
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            for run in runs_of(load_scene(name), 128, Path(folder)):
                line = max(32, run.footer.tree.node_bytes)
                cells = [
                    Cell(machine.with_numbers(rays=n, mshrs=64), CacheConfig(size, ways, line))
                    for n in rays
                    for size, ways in sizes
                ]
                began = time.perf_counter()
                rows += measure(run, cells, arguments.threads, METHODS)
                print(f"{run.name}: {time.perf_counter() - began:.0f} s", flush=True)
                if not arguments.quick:
                    write(rows, out)
    for method, parts in METHODS:
        of = [row for row in rows if (row["method"], row["parts"]) == (method, parts)]
        print(f"{method} 1/{parts}: time {np.median([float(row['time_share']) for row in of]):.2f}", end="")
        for what in ("speed_up", "cycles"):
            worst, middle = (max, np.median)
            n_samples, held = (sum(int(row[name]) for row in of) for name in ("samples", f"{what}_held"))
            print(
                f"; {what}: error {middle([float(row[f'{what}_median_error']) for row in of]):.2f} %, worst "
                f"{worst(float(row[f'{what}_worst_error']) for row in of):.2f}, held {100 * held / n_samples:.1f} %",
                end="",
            )
        print()


if __name__ == "__main__":
    main()
