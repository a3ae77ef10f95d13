"""``python -m tests.bench.scale [--quick]``: what a study costs on 1 to 10,000 workers, and where more of them stop helping.

Rates are measured on this machine: rendering, replay straight from Parquet, joining summaries, their bytes, and the start of
a worker. With them a cluster is simulated: workers that start late, a scheduler that answers one message at a time, tasks
that take longer than others, and one process that joins the summaries as they arrive. Writes
docs/data/scale_rates.csv, scale.csv and scale_limits.csv; ``--quick`` measures and simulates little and writes nothing.
"""

import csv
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np
import simpy

from cachesim.parts import Part, pass_through
from cachesim.replay import Replay
from cachesim.report.table1 import caches
from cachesim.source import RunSource
from cachesim.summary_file import Asked, write_part
from nptrace_base.atomic import whole_file
from rtrace.render import Shooting, render
from rtrace.scenes.catalog import load_scene
from rtrace.trees.tree_cache import cached_tree
from traces.reader import open_run

DATA = Path(__file__).resolve().parents[2] / "docs" / "data"

#: Parts for each worker, and the fewest accesses of one.
PARTS, LEAST = 10, 1 << 22
WORKERS = (1, 10, 100, 1000, 10_000)
ACCESSES = (10**12, 10**14)
#: A worker that opens a run and makes its table of lines, before its first access.
_BEGIN = """
import sys
from cachesim.source import open_source
source = open_source(sys.argv[1])
source.lines(32, 0)
"""


class Cluster(NamedTuple):
    """What a cluster is like; times in seconds."""

    start: float = 20.0  # of a worker, in the mean, and how far they differ
    spread: float = 10.0
    message: float = 0.5e-3  # of the scheduler
    slow_share: float = 0.01  # of the parts, which take
    slow: float = 4.0  # times as long


_USUAL = Cluster()


class Rates(NamedTuple):
    """What was measured, in seconds of one core unless a name says otherwise."""

    render_per_access: float
    replay_per_access: float
    join: float  # of two summaries of the four caches of Table I, with the account of prefetches
    summary_bytes: float
    begin: float  # of a worker: wall time


def measure(pixels: int, repeat: int) -> Rates:
    """Return the rates for a picture of the stand-in court as a BVH."""
    scene = load_scene("court")
    tree = cached_tree(scene, "bvh")
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "run"
        render(scene, tree, Shooting(16, 16), path, threads=1)  # compiles
        before = time.process_time()
        render(scene, tree, Shooting(pixels, pixels), path, threads=1)
        rendered = time.process_time() - before
        run = open_run(path)
        question = Replay(tuple(caches()), "traced")
        source = RunSource(run)
        parts = [Part(source, i, 2, {}) for i in (1, 2)]
        pass_through(parts[0], question)  # compiles
        counted, joins = [], []
        for _ in range(repeat):
            before = time.process_time()
            one, other = (pass_through(part, question) for part in parts)
            counted.append(time.process_time() - before)
            before = time.process_time()
            one.then(other)
            joins.append(time.process_time() - before)
        n_bytes = write_part(Path(name) / "x.sum", parts[0].run, [Asked("stored", question)], [one])
        starts = []
        for _ in range(repeat):
            before = time.perf_counter()
            subprocess.run([sys.executable, "-c", _BEGIN, str(path)], check=True)
            starts.append(time.perf_counter() - before)
        n = run.n_accesses
    return Rates(rendered / n, median(counted) / n, median(joins), n_bytes, median(starts))


def simulate(
    n_accesses: int, n_workers: int, task_rate: float, rates: Rates, cluster: Cluster = _USUAL
) -> tuple[float, float, int]:  # fmt: skip
    """Return the wall time of a study on so many workers, the busy time of all of them, and the number of parts."""
    n_parts = max(min(PARTS * n_workers, n_accesses // LEAST), 1)
    task = task_rate * n_accesses / n_parts
    random = np.random.default_rng(n_workers)
    slow = np.where(random.random(n_parts) < cluster.slow_share, cluster.slow, 1.0)
    starts = np.maximum(random.normal(cluster.start, cluster.spread, n_workers), 0.0) + rates.begin
    environment = simpy.Environment()
    scheduler, joiner = simpy.Resource(environment), simpy.Resource(environment)
    waiting, busy = iter(range(n_parts)), [0.0]

    def held(resource: Any, seconds: float) -> Iterator[Any]:
        with resource.request() as turn:
            yield turn
            yield environment.timeout(seconds)

    def worker(start: float) -> Iterator[Any]:
        yield environment.timeout(start)
        while (part := next(waiting, None)) is not None:
            yield from held(scheduler, cluster.message)
            busy[0] += task * slow[part]
            yield environment.timeout(task * slow[part])
            yield from held(scheduler, cluster.message)
            yield from held(joiner, rates.join)

    for start in starts[:n_parts]:
        environment.process(worker(float(start)))
    environment.run()
    return environment.now, busy[0], n_parts


def rows(rates: Rates, workers: tuple[int, ...], accesses: tuple[int, ...]) -> list[dict[str, object]]:
    """Return what each study takes: a replay of a run that is there, and rendering and replaying it."""
    found: list[dict[str, object]] = []
    works = {"replay": rates.replay_per_access, "render and replay": rates.render_per_access + rates.replay_per_access}
    for n_accesses in accesses:
        for what, rate in works.items():
            for n_workers in workers:
                wall, busy, n_parts = simulate(n_accesses, n_workers, rate, rates)
                row = {
                    "accesses": n_accesses, "work": what, "workers": n_workers, "parts": n_parts, "wall s": f"{wall:.4g}",
                    "core hours": f"{rate * n_accesses / 3600:.4g}", "efficiency": f"{busy / (wall * n_workers):.3f}",
                    "summaries MB": f"{n_parts * rates.summary_bytes / 1e6:.4g}",
                }  # fmt: skip
                found.append(row)
                print(*row.values(), sep="\t", flush=True)
    return found


def limits(rates: Rates, n_accesses: int, workers: tuple[int, ...]) -> list[dict[str, object]]:
    """Return by how much less time a replay would take without each thing that holds it up."""
    rate, cluster = rates.replay_per_access, _USUAL
    without = {
        "late starts": (rates._replace(begin=0.0), cluster._replace(start=0.0, spread=0.0)),
        "messages to the scheduler": (rates, cluster._replace(message=0.0)),
        "joining summaries": (rates._replace(join=0.0), cluster),
        "slow parts": (rates, cluster._replace(slow_share=0.0)),
    }
    found: list[dict[str, object]] = []
    for n_workers in workers:
        wall, *_ = simulate(n_accesses, n_workers, rate, rates)
        for what, (other_rates, other) in without.items():
            less, *_ = simulate(n_accesses, n_workers, rate, other_rates, other)
            found.append({"workers": n_workers, "without": what, "wall s": f"{wall:.4g}", "saved s": f"{wall - less:.4g}"})
            print(*found[-1].values(), sep="\t", flush=True)
    return found


def main() -> None:
    """Measure, simulate and write."""
    is_quick = sys.argv[1:] == ["--quick"]
    rates = measure(*((64, 1) if is_quick else (1024, 3)))
    print(*(f"{name}={value:.4g}" for name, value in rates._asdict().items()))
    if is_quick:
        rows(rates, (1, 100), (10**10,))
        limits(rates, 10**10, (100,))
        return
    found = rows(rates, WORKERS, ACCESSES)
    table = [{"rate": name, "value": f"{value:.4g}"} for name, value in rates._asdict().items()]
    causes = limits(rates, ACCESSES[0], WORKERS[-2:])
    for name, records in (("scale_rates", table), ("scale", found), ("scale_limits", causes)):
        with whole_file(DATA / f"{name}.csv") as path, open(path, "w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, records[0], lineterminator="\n")
            writer.writeheader()
            writer.writerows(records)


if __name__ == "__main__":
    main()
