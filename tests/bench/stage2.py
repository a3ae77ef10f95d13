"""Stage 2 against itself and against DineroIV and pycachesim, where they are at hand: one cache, all caches, decoding."""

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cachesim.all_associativity import SetCounts
from cachesim.clock.compare import compare
from cachesim.clock.parameters import PRESETS
from cachesim.clock.stretches import Stretches
from cachesim.clock.timing import Workshop, time_run
from cachesim.config import CacheConfig
from cachesim.fast_lru import LruCounts
from cachesim.prefetch import parse_prefetch
from cachesim.replay import replay
from cachesim.source import RunSource
from cachesim.stack_distance import StackDistances
from tests.bench.measure import ratio, times
from tests.bench.parts import bench_parts
from traces.din import export_din
from traces.reader import Run

_ROOT = Path(__file__).resolve().parents[2]

#: The four caches of Table I.
TABLE1 = [CacheConfig(size, ways) for size in (8192, 16384) for ways in (1, 2)]


def demand_lines(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """Return all accesses of a run as 32-byte lines and labels, prefetches labelled 11, in memory."""
    shift = 5 - run.footer.tree.node_bytes.bit_length() + 1
    pieces = [(node >> np.uint32(shift), kind) for node, kind in run.batches()]
    lines = np.concatenate([np.asarray(line, np.uint32) for line, _ in pieces])
    labels = np.where(np.concatenate([kind for _, kind in pieces]) == 3, np.uint8(11), np.uint8(0))
    return lines, labels


def bench_run(run: Run, repeat: int) -> dict[str, float]:
    """Return the ratios of stage 2 for one run."""
    lines, labels = demand_lines(run)
    n = len(lines)

    config = CacheConfig(8192, 2)
    functions = {
        "one way": lambda: LruCounts(CacheConfig(8192, 1)).step(lines, labels),
        "two ways": lambda: LruCounts(config).step(lines, labels),
        "decode": lambda: sum(len(node) for node, _ in run.batches()),
        "from Parquet": lambda: replay(run, [config], prefetch="none", threads=1),
        "four": lambda: replay(run, TABLE1, threads=1),
        "four, unfiltered": lambda: replay(run, TABLE1, threads=1, is_filtered=False),
    }
    # CPU time of all threads: what decodes, looks up and replays at the same time is added up.
    taken = times(functions, repeat, time.process_time)
    two = sorted(taken["two ways"])[repeat // 2]
    out = {
        "1-way, ns per access": sorted(taken["one way"])[repeat // 2] / n * 1e9,
        "2-way, ns per access": two / n * 1e9,
        "decode node + kind, M accesses/s": n / sorted(taken["decode"])[repeat // 2] / 1e6,
        "replay from Parquet / 2-way from memory": ratio(taken["from Parquet"], taken["two ways"]),
        "replay of 4 caches, unfiltered / filtered": ratio(taken["four, unfiltered"], taken["four"]),
    }
    out |= bench_sweep(lines, labels, taken["two ways"], repeat)
    out |= {f"clock, {rays} rays, ns per access": clock_ns(run, rays, repeat) for rays in (1, 64)}
    out |= bench_dinero(run, two / n)
    return out | bench_parts(run, lines, labels, repeat)


def clock_ns(run: Run, rays: int, repeat: int) -> float:
    """Return what a row of the demand stream costs the clock without prefetches, in ns of CPU time, the rows in memory."""
    source, clock = RunSource(run), PRESETS["paper"].clock.with_numbers(rays=rays, mshrs=64)
    workshop, none, found = Workshop(source, threads=1), parse_prefetch("none"), []
    for _ in range(repeat):
        job, stretches = workshop.job(CacheConfig(8192, 2), clock, none), Stretches(source)
        assert job is not None
        seconds, n_rows = 0.0, 0
        for rows in stretches:
            n_rows = max(n_rows, rows.first_row + rows.nodes.size)
            began = time.process_time()
            job.step(rows)
            seconds += time.process_time() - began
            ray = min(job.first_needed, rows.first_ray + rows.waits_for.size)
            stretches.keep(int(rows.first[ray - rows.first_ray]), ray)
        found.append(seconds / n_rows * 1e9)
    return sorted(found)[repeat // 2]


def bench_comparison(run: Run) -> dict[str, float]:
    """Time whole comparisons of a run: all policies with their baselines, and 24 configurations by two threads and by one."""
    clock, cache = PRESETS["paper"].clock, CacheConfig(8192, 2)
    machines = [clock.with_numbers(miss=miss) for miss in (50, 100, 200, 300)]
    functions = {
        "compare": lambda: compare(run, cache, clock, threads=2),
        "policies": lambda: compare(run, cache, clock, has_baselines=False, threads=2),
        "two": lambda: time_run(run, TABLE1[:3], machines, ["push"], threads=2),
        "one": lambda: time_run(run, TABLE1[:3], machines, ["push"], threads=1),
    }
    taken = times(functions, 3, time.perf_counter)
    return {
        "compare, s": sorted(taken["compare"])[1],
        "compare --no-baselines, s": sorted(taken["policies"])[1],
        "24 configurations, one thread / two": ratio(taken["one"], taken["two"]),
    }


def bench_sweep(lines: np.ndarray, labels: np.ndarray, two_ways: list[float], repeat: int) -> dict[str, float]:
    """One pass for 128 caches, and exact stack distances, in units of one 2-way replay."""
    corners = [CacheConfig(16 * 32, 1), CacheConfig(2048 * 16 * 32, 16)]  # 2^4 to 2^11 sets, 1 to 16 ways
    functions = {
        "pass": lambda: SetCounts(corners).step(lines, labels),
        "stack": lambda: StackDistances().step(lines, labels, int(lines.max()) + 1),
    }
    taken = times(functions, repeat, time.process_time)
    return {
        "128 caches in one pass / one 2-way": ratio(taken["pass"], two_ways),
        "stack distances / one 2-way": ratio(taken["stack"], two_ways),
    }


def bench_dinero(run: Run, ours: float) -> dict[str, float]:
    """DineroIV named by $DINERO on the same trace as din text, user time; pycachesim by the Python named by $PYCACHESIM.

    Of the reads alone, whole processes too: ``npcache replay`` straight from Parquet, and DineroIV; CPU times, in turn.
    """
    out = {}
    program, python = os.environ.get("DINERO"), os.environ.get("PYCACHESIM")
    with tempfile.TemporaryDirectory() as name:
        trace, reads = Path(name) / "x.din", Path(name) / "reads.din"
        n = export_din(run, trace) if program or python else 0
        if program:
            export_din(run, reads, prefetch="omit")
            theirs = [program, "-informat", "d", "-l1-usize", "8k", "-l1-ubsize", "32", "-l1-uassoc", "2"]
            replay_ = [str(run.path), "--size", "8K", "--assoc", "2", "--prefetch", "none"]
            npcache = [sys.executable, "-c", "import cli; cli.npcache()", "replay", *replay_]
            out["DineroIV text / 2-way"] = cpu_seconds(theirs, trace)[0] / n / ours
            pairs = [(cpu_seconds(theirs, reads), cpu_seconds(npcache)) for _ in range(3)]
            out["DineroIV / npcache replay"] = statistics.median(sum(a) / sum(b) for a, b in pairs)
        if python:
            # Elsewhere than here: its import name is that of our own package, and Python looks in the working folder first.
            environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
            done = subprocess.run(
                [python, "-c", _PYCACHESIM, str(trace)], cwd=name, env=environment, capture_output=True, text=True, check=True
            )
            out["pycachesim / 2-way"] = float(done.stdout) / ours
    return out


def cpu_seconds(command: Sequence[str], stdin: Path | None = None) -> tuple[float, float]:
    """Run a command of this project's folder; return its seconds of user and of system time."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    before = os.times()
    with open(stdin or os.devnull, "rb") as file:
        subprocess.run(command, stdin=file, capture_output=True, check=True, cwd=_ROOT, env=environment)
    after = os.times()
    return after.children_user - before.children_user, after.children_system - before.children_system


_PYCACHESIM = """
import sys, time
from cachesim import Cache, CacheSimulator, MainMemory
memory = MainMemory()
cache = Cache("L1", 128, 2, 32, "LRU")
memory.load_to(cache)
memory.store_from(cache)
simulator = CacheSimulator(cache, memory)
addresses = [int(line.split()[1], 16) for line in open(sys.argv[1])]
start = time.process_time()
simulator.load(addresses, length=1)
print((time.process_time() - start) / len(addresses))
"""


_FIRST_RAY = """
import cli
import numpy as np
from rtrace.scenes.stand_ins import stand_in
from rtrace.trees.tree_cache import cached_tree
from rtrace.chunk import primary_rays
from rtrace.traverse import trace_recorded
scene = stand_in("blob", detail=0.1)
rays = primary_rays(scene.camera.frame(1, 1), np.zeros(1, np.uint32), 1)
trace_recorded(cached_tree(scene, "bvh"), rays)
"""


_LEAST = """
import gc, os
gc.set_threshold(300_000, 50, 50)
os.environ["OPENBLAS_NUM_THREADS"] = "1"
import numba, numpy, pyarrow.parquet

@numba.njit(cache=True)
def first(values):
    return values[0]

first(numpy.zeros(1))
"""


def bench_start() -> dict[str, float]:
    """Cold compilation of everything, in seconds and CPU seconds, and warm starts to a first traced ray and a first count."""
    with tempfile.TemporaryDirectory() as name:
        environment = {**os.environ, "XDG_CACHE_HOME": name, "NUMBA_CACHE_DIR": name, "PYTHONPATH": str(_ROOT)}
        environment |= {"PYTHONPYCACHEPREFIX": f"{name}/python"}  # Python's own compiled files are kept, as they usually are
        environment.pop("PYTHONDONTWRITEBYTECODE", None)

        def seconds(*command: str) -> tuple[float, float]:
            start, before = time.perf_counter(), os.times()
            subprocess.run([sys.executable, *command], cwd=name, env=environment, capture_output=True, check=True)
            after = os.times()
            cpu = after.children_user + after.children_system - before.children_user - before.children_system
            return time.perf_counter() - start, cpu

        cold, cold_cpu = seconds("-c", "import cli; cli.nptrace()", "compile")
        least = Path(name) / "least.py"
        least.write_text(_LEAST)
        seconds("-c", "import cli; cli.nptrace()", "render", "blob", "--accel", "bvh", "--pixels", "16x16")
        replay_ = ("replay", "--size", "8K", "--assoc", "2", "--prefetch", "none")
        programs = [("-c", _FIRST_RAY), ("-c", "import cli; cli.npcache()", *replay_), (str(least),)]
        for program in programs:  # builds the tree, and writes Python's own compiled files
            seconds(*program)
        taken = [[seconds(*program)[1] for program in programs] for _ in range(7)]
        warm, first, floor = (sorted(each)[3] for each in zip(*taken, strict=True))
    return {
        "cold compile of everything, s": cold,
        "cold compile of everything, CPU s": cold_cpu,
        "warm start to the first ray, s": warm,
        "warm start to a first replay, s": first,
        "warm start of an empty program, s": floor,
    }
