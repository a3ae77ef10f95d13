"""Compiling every kernel ahead of its first use, by running each command's work on a tiny scene."""

import tempfile
from pathlib import Path

import compiling
from cachesim.config import CacheConfig
from cachesim.estimate import Target, estimate
from cachesim.replay import replay
from cachesim.sweep import sweep
from rtrace.procedural import stand_in
from rtrace.render import Shooting, render
from rtrace.treecache import TREES, build_tree
from rtrace.units import RayUnits
from rtrace.verify import compare
from traces.din import export_din
from traces.format import open_run


def compile_all() -> int:
    """Run every kernel of the commands on a tiny scene, which compiles what is not in the cache; return how many were."""
    before = compiling.n_compiled
    scene = stand_in("blob", detail=0.1)
    trees = [build_tree(scene.triangles, kind) for kind in TREES]
    build_tree(scene.triangles, "bvh", builder="binned")
    compare(trees, scene, 16, 16, 100, 1)
    plain = [CacheConfig(512, ways, 16, policy) for ways in (1, 2, 4) for policy in ("lru", "fifo", "random")]
    known = [CacheConfig(512, ways, 16, "opt") for ways in (1, 2)]
    two_lines = [CacheConfig(512, 2, 8)]
    for tree in trees:
        source = RayUnits(scene, tree, Shooting(64, 64))
        estimate(source, [CacheConfig(512, 2, 16)], Target(0.2, 0.01), exact_below=0.0, threads=1)
    with tempfile.TemporaryDirectory() as name:
        for tree in trees:
            path = Path(name) / tree.kind
            for batch in (0, 1):
                render(scene, tree, Shooting(16, 16, batch=batch), path, threads=1)
            run = open_run(path)
            for prefetch in ("none", "traced", "stack:once", "next-line:tagged"):
                replay(run, plain + two_lines, prefetch=prefetch, threads=1)
                replay(run, plain, prefetch=prefetch, is_filtered=False, three_c=True, threads=1)
            for layout in ("bfs", "dfs", "veb", "treelet:256"):
                replay(run, plain[:1], layout=layout, threads=1)
            sweep(run, [CacheConfig(512, ways, 16) for ways in (1, 2, 32)], threads=1)
            replay(run, known, threads=1)
            sweep(run, [CacheConfig(64 * 16, 32, 16)], prefetch="stack", threads=1)
            for form in ("text", "binary"):
                export_din(run, path.with_suffix(".din"), fmt=form)
                replay(path.with_suffix(".din"), plain + two_lines, threads=1)
    return compiling.n_compiled - before
