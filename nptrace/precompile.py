"""Compiling every kernel ahead of its first use, by doing each command's work on a tiny scene; two processes share it."""

import gc
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from cachesim.by_group import events_by, replay_by
from cachesim.clock.by_pixel import cycles_by_pixel
from cachesim.clock.compare import usual_policies
from cachesim.clock.parameters import PRESETS
from cachesim.clock.stretches import Stretches
from cachesim.clock.timing import Workshop, time_run
from cachesim.config import CacheConfig
from cachesim.layout import addresses, parse_layout
from cachesim.parts import cut, pass_through
from cachesim.prefetch import Prefetch, parse_prefetch
from cachesim.replay import Replay, replay
from cachesim.sampling.estimate import estimate
from cachesim.sampling.target import Target
from cachesim.source import RunSource
from cachesim.sweep import Sweep, sweep
from nptrace_base import compiling
from rtrace.checks.embree import compare
from rtrace.ray_source import RayUnits
from rtrace.render import Shooting, footer_of, render
from rtrace.scenes.scene import Scene
from rtrace.scenes.stand_ins import stand_in
from rtrace.traverse import PACKET_KERNELS
from rtrace.trees.tree import BVH_NODE, KD_NODE, LEAF_AXIS, Tree, in_format, node_table
from rtrace.trees.tree_cache import TREES, build_tree
from traces.din import export_din
from traces.format import BOX, LEAF, PUSH
from traces.reader import Run, open_run
from traces.writer import RunWriter

#: What each process runs, with the number of its part.
PROGRAM = "from nptrace.precompile import compile_part; compile_part"


def compile_all(watch: Callable[[int, bool], object] = lambda n_compiled, is_busy: None) -> int:
    """Compile every kernel of the commands that is not in the cache; return how many were compiled.

    ``watch`` is called with the number of kernels begun so far, and whether any is being compiled.
    """
    # Numba's global lock lets threads compile only one after another. A fork may inherit locks that other threads hold.
    # They are in separate sessions, so Ctrl-C reaches this process alone.
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    children = [
        subprocess.Popen(
            [sys.executable, "-P", "-c", f"{PROGRAM}({part})"], env=environment, text=True,
            stdout=subprocess.PIPE, start_new_session=True,
        )
        for part in range(len(PARTS))
    ]  # fmt: skip
    with ThreadPoolExecutor(len(children)) as pool:
        try:
            printed = list(pool.map(_Follower(watch), children))
        except BaseException:
            _end(children)  # then the threads end too
            raise
    watch(0, False)
    if any(child.returncode for child in children):
        raise RuntimeError("compiling failed, as printed above")
    total = 0
    for n_compiled, lost in map(json.loads, printed):
        total += n_compiled
        for what, sentence in lost.items():
            compiling.lose(what, sentence)
    return total


#: What a process prints when it begins a kernel.
BEGUN = "+\n"


class _Follower:
    """Reads what a process prints: counts the kernels it begins, for ``watch``, and returns the last line."""

    def __init__(self, watch: Callable[[int, bool], object]) -> None:
        self._watch, self._n_begun = watch, 0

    def __call__(self, child: subprocess.Popen[str]) -> str:
        last = ""
        for last in child.stdout or ():
            if last == BEGUN:
                self._n_begun += 1
                self._watch(self._n_begun, True)
        child.wait()
        return last


def _end(children: Sequence[subprocess.Popen[str]]) -> None:
    """End processes: give them a moment to delete incomplete files."""
    for child in children:
        child.terminate()
    for child in children:
        try:
            child.wait(2)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()


def _leave(number: int, frame: object) -> None:
    """End this process; quietly too where LLVM calls back and the exit cannot be raised."""
    sys.unraisablehook = lambda error: None
    sys.exit(128 + number)


def compile_part(part: int) -> None:
    """Compile one of ``PARTS`` in this process.

    Prints ``BEGUN`` for each kernel; at last how many kernels it compiled and what it could not store, as JSON.
    """
    signal.signal(signal.SIGTERM, _leave)
    gc.set_threshold(*compiling.GC_THRESHOLD)
    n_told = 0

    def tell(n_compiled: int, is_busy: bool) -> None:
        nonlocal n_told
        print(BEGUN * (n_compiled - n_told), end="", flush=True)
        n_told = n_compiled

    compiling.watch = tell
    PARTS[part]()
    compiling.watch = None
    print(json.dumps([compiling.n_compiled, compiling.lost]))


#: The clock is compiled for each policy's unit: those of these share units.
OF_THE_STACK = ("none", "perfect", "stack", "oracle")


def building_and_sweeping() -> None:
    """Run the kernels of the builders, of layouts, of sweeps, and of the clock with half of the policies."""
    scene = stand_in("blob", detail=0.1)
    for kind in TREES:
        tree = build_tree(scene.triangles, kind)
        nodes = node_table(tree)
        for layout in ("bfs", "dfs", "veb", "treelet:256"):
            addresses(nodes, tree.nodes.itemsize, layout)
    build_tree(scene.triangles, "bvh", builder="binned")
    with tempfile.TemporaryDirectory() as name:
        trace = Path(name) / "reads.din"
        trace.write_text("0 1000\n0 1020\n")
        sweep(trace, [CacheConfig(512, ways, 16) for ways in (1, 2, 32)], threads=1)
        run = _smallest_run(scene, Path(name) / "run")
        workshop, clock = Workshop(RunSource(run, parse_layout("stored")), 1), PRESETS["paper"].clock
        for prefetch in _timed(of_the_stack=False):
            job = workshop.job(CacheConfig(512, 2, 32), clock, prefetch)
            assert job is not None
            workshop.run_all([job], Stretches(RunSource(run, parse_layout("stored"))))
        _join(run, Sweep((CacheConfig(512, 2, 16), CacheConfig(512, 32, 16))))


def _join(run: Run, question: Replay | Sweep) -> None:
    """Count the halves of a run and join them."""
    first, second = (pass_through(part, question) for part in cut(RunSource(run), 2))
    first.then(second)


def _timed(*, of_the_stack: bool) -> list[Prefetch]:
    """Return half of the policies that are timed."""
    found = map(parse_prefetch, usual_policies())
    return [prefetch for prefetch in found if (prefetch.kind in OF_THE_STACK) == of_the_stack]


def _smallest_run(scene: Scene, path: Path) -> Run:
    """Write a run of one ray by hand, so that no kernel that traces has to be compiled for it."""
    tree = _smallest_tree(scene, "bvh")
    with RunWriter(path, footer_of(scene, tree, Shooting(1, 1), ""), BOX) as run:
        run.append("nodes", lambda: [node_table(tree)])
        run.append("accesses", {"ray": np.zeros(3), "node": np.arange(3), "kind": np.array([PUSH, LEAF, LEAF])})
        one = {"ray": 0, "x": 0, "y": 0, "type": 0, "first": 0, "count": 3, "prim": -1, "t": np.inf}
        run.append("rays", {name: np.array([value]) for name, value in one.items()})
        run.image(b"")
    return open_run(path)


def tracing_and_replaying() -> None:
    """Run all other kernels."""
    scene = stand_in("blob", detail=0.1)
    trees = [_smallest_tree(scene, kind) for kind in TREES]
    compare(trees, scene, 16, 16, 100, 1)
    plain = [CacheConfig(512, ways, 16, policy) for ways in (1, 2, 4) for policy in ("lru", "fifo", "random")]
    known = [CacheConfig(512, ways, 16, "opt") for ways in (1, 2)]
    two_lines = [CacheConfig(512, 2, 8)]
    with tempfile.TemporaryDirectory() as name:
        for tree in trees:
            path = Path(name) / tree.kind
            if tree.kind in PACKET_KERNELS:
                render(scene, tree, Shooting(16, 16, packet=64, shadow_order="cheaper"), path, threads=1)
            for batch in (0, 1):
                render(scene, tree, Shooting(16, 16, batch=batch), path, threads=1)
            run = open_run(path)
            for prefetch in ("none", "traced", "stack:once", "next-line:tagged"):
                replay(run, plain + two_lines, prefetch=prefetch, threads=1)
                replay(run, plain, prefetch=prefetch, is_filtered=False, three_c=True, threads=1)
                for by in ("pixel", "level"):
                    replay_by(run, two_lines, by, prefetch=prefetch, threads=1)
            replay(run, known, threads=1)
            events_by(run, "pixel")
            cycles_by_pixel(RunSource(run), CacheConfig(512, 2, 16), PRESETS["paper"].clock)
            time_run(run, [CacheConfig(512, 2, 16)], [PRESETS["paper"].clock], _timed(of_the_stack=True), threads=1)
            sweep(run, [CacheConfig(64 * 16, 32, 16)], prefetch="stack", threads=1)
            for three_c in (False, True):
                _join(run, Replay(tuple(config for config in plain if config.policy == "lru"), three_c=three_c))
            for form in ("text", "binary"):
                export_din(run, path.with_suffix(".din"), fmt=form)
                replay(path.with_suffix(".din"), plain + two_lines, threads=1)
    for tree in trees:
        source = RayUnits(scene, tree, Shooting(64, 64))
        estimate(source, [CacheConfig(512, 2, 16)], Target(0.2, 0.01), exact_below=0.0, threads=1)


#: Together they reach every kernel; each takes about half of the time.
PARTS = building_and_sweeping, tracing_and_replaying


def _smallest_tree(scene: Scene, kind: str) -> Tree:
    """Return a root over two leaves that both list all triangles; it needs no builder, so none has to be compiled for it."""
    n = len(scene.triangles)
    nodes = np.zeros(3, KD_NODE if kind == "kdtree" else BVH_NODE)
    nodes["meta"] = 0, n << 2 | LEAF_AXIS, n << 2 | LEAF_AXIS
    if kind == "kdtree":
        nodes["first"] = 0, 0, n
        nodes["split"][0], nodes["meta"][0] = scene.bounds[:, 0].mean(), 1 << 2
    else:
        nodes["lower"], nodes["upper"] = scene.bounds
        nodes["child"] = 1, 0, n
    prims = np.concatenate([np.arange(n, dtype=np.int32)] * 2)
    corners, params = np.take(scene.triangles, prims, axis=0), {"builder": "by hand"}
    return in_format(Tree(kind, nodes, prims, corners, scene.triangles, scene.bounds, scene.bounds, 1, params), kind)
