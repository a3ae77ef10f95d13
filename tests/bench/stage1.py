"""Stage 1 against Embree and against scalar C++: hits, any hits, tracing, whole renders, builds."""

import ctypes
import shutil
import subprocess
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np

from rtrace.checks.embree import embree_scene
from rtrace.chunk import primary_rays
from rtrace.rays import Rays
from rtrace.render import CHUNK, Shooting, render
from rtrace.scenes.scene import Scene
from rtrace.shading import shadow_rays
from rtrace.traverse import Room, trace, trace_recorded
from rtrace.trees.bvh import build_bvh
from rtrace.trees.kdtree import build_kdtree
from rtrace.trees.tree import Tree, in_format, words
from tests.bench.measure import ratio, times
from traces.reader import open_run


def pieces(rays: Rays) -> list[Rays]:
    """Cut a batch as the renderer does, so that events stay in the cache."""
    return [Rays(*(a[i : i + CHUNK] for a in rays)) for i in range(0, len(rays.t_max), CHUNK)]


def bench_scene(scene: Scene, size: int, repeat: int, peer: ctypes.CDLL | None) -> dict[str, float]:
    """Return every ratio of stage 1 for one scene."""
    embree = embree_scene(scene.triangles)
    frame = scene.camera.frame(size, size)
    primary = primary_rays(frame, np.arange(size * size, dtype=np.uint32), size)
    out: dict[str, float] = {}
    for name, build in (("kdtree", build_kdtree), ("bvh", build_bvh)):
        tree = build(scene.triangles)
        shadow = shadow_rays(tree, primary, trace(tree, primary), scene.light)[0]
        for kind, rays, any_hit in (("closest", primary, False), ("any", shadow, True)):
            cut, room = pieces(rays), Room()
            far = rays.t_max.astype(np.float32)

            def ask_embree(rays=rays, far=far, any_hit=any_hit):
                if any_hit:
                    return embree.run(rays.origin, rays.direction, dists=far.copy(), query="OCCLUDED")
                return embree.run(rays.origin, rays.direction)

            def ours(cut=cut, tree=tree, any_hit=any_hit):
                for piece in cut:
                    trace(tree, piece, any_hit=any_hit)

            def traced(cut=cut, tree=tree, any_hit=any_hit, room=room):
                for piece in cut:
                    trace_recorded(tree, piece, any_hit=any_hit, room=room)

            functions = {"embree": ask_embree, "plain": ours, "traced": traced}
            if peer is not None:
                events = np.empty(CHUNK * 2 * (tree.max_level + 200), np.uint32)

                def peers(cut=cut, tree=tree, any_hit=any_hit, events=events):
                    for piece in cut:
                        call_peer(peer, tree, piece, any_hit, events)

                functions["c++"] = peers
            if name == "bvh":
                wide = in_format(tree, "bvh64")
                functions["64-byte nodes"] = partial(traced, tree=wide)
            taken = times(functions, repeat)
            if name == "bvh":
                out[f"{kind} bvh64 traced / embree"] = ratio(taken["embree"], taken["64-byte nodes"])
            out[f"{kind} {name} traced / embree"] = ratio(taken["embree"], taken["traced"])
            out[f"{kind} {name} cost of tracing"] = ratio(taken["traced"], taken["plain"])
            if peer is not None:
                out[f"{kind} {name} / c++"] = ratio(taken["c++"], taken["traced"])
        out |= bench_both(scene, tree, embree, primary, shadow, repeat)
        out |= bench_render(scene, tree, size, repeat)
    out |= bench_builds(scene, repeat)
    return out


def bench_both(scene: Scene, tree: Tree, embree, primary: Rays, shadow: Rays, repeat: int) -> dict[str, float]:
    """Primary and shadow rays traced into memory by two threads, against embreex on the same rays as called from Python."""
    far = shadow.t_max.astype(np.float32)

    rooms = threading.local()

    def one(rays: Rays, any_hit: bool) -> None:
        if not hasattr(rooms, "room"):
            rooms.room = Room()
        trace_recorded(tree, rays, any_hit=any_hit, room=rooms.room)

    def ours(threads=2):
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(lambda r: one(r, False), pieces(primary)))
            list(pool.map(lambda r: one(r, True), pieces(shadow)))

    def theirs():
        embree.run(primary.origin, primary.direction)
        embree.run(shadow.origin, shadow.direction, dists=far.copy(), query="OCCLUDED")

    taken = times({"embree": theirs, "ours": ours, "one thread": lambda: ours(1)}, repeat, time.perf_counter)
    return {
        f"both {tree.kind} two threads / embree": ratio(taken["embree"], taken["ours"]),
        f"both {tree.kind} two threads / one": ratio(taken["one thread"], taken["ours"]),
    }


def bench_render(scene: Scene, tree: Tree, size: int, repeat: int) -> dict[str, float]:
    """Whole renders on two threads: million accesses (prefetches included) per second of wall time."""
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "run"
        taken = times(
            {"render": lambda: render(scene, tree, Shooting(size, size), path, threads=2)}, repeat, time.perf_counter
        )
        n = open_run(path).n_accesses
    return {f"render {tree.kind} M accesses/s": n / sorted(taken["render"])[repeat // 2] / 1e6}


def bench_builds(scene: Scene, repeat: int) -> dict[str, float]:
    """CPU time of our builds over that of Embree's (all its threads)."""
    functions = {
        "embree": lambda: embree_scene(scene.triangles).run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32)),
        "binned": lambda: build_bvh(scene.triangles, builder="binned"),
        "sweep": lambda: build_bvh(scene.triangles),
        "kd": lambda: build_kdtree(scene.triangles),
    }
    taken = times(functions, max(1, repeat // 2), time.process_time)
    return {f"build {name} / embree": ratio(taken[name], taken["embree"]) for name in ("binned", "sweep", "kd")}


def build_peer(folder: Path, name: str = "traverse") -> ctypes.CDLL | None:
    """Compile a C++ peer, or return None where there is no compiler."""
    compiler = shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        return None
    source, library = Path(__file__).with_name(f"{name}.cpp"), folder / f"{name}.so"
    flags = ["-O3", "-march=native", "-ffp-contract=off", "-shared", "-fPIC"]
    subprocess.run([compiler, *flags, str(source), "-o", str(library)], check=True)
    return ctypes.CDLL(str(library))


def call_peer(peer: ctypes.CDLL, tree: Tree, rays: Rays, any_hit: bool, events: np.ndarray, how: str = "trace") -> np.ndarray:
    """Trace a batch with a C++ peer into ``events`` and return those written, which must be ours."""
    n = len(rays.t_max)
    prim, t, count = np.empty(n, np.int32), np.empty(n, np.float64), np.empty(n, np.uint32)
    arrays: list = [*words(tree), tree.prims, tree.corners, tree.core]
    if tree.kind == "kdtree":
        arrays.append(tree.bounds)
    inputs = [*arrays, tree.max_level, rays.origin, rays.direction, rays.t_min, rays.t_max, ctypes.c_int64(n), int(any_hit)]
    call = getattr(peer, f"{how}_{tree.kind}")
    call.restype = ctypes.c_int64
    written = call(*map(_argument, [*inputs, prim, t, count, events]))
    return events[:written]


def _argument(value):
    return ctypes.c_void_p(value.ctypes.data) if isinstance(value, np.ndarray) else value
