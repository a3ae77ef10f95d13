"""Only what a scene needs: what trees from the cache, narrow numbers, stacks by depth and fewer shadow rays save."""

import tempfile
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from rtrace.chunk import primary_rays
from rtrace.scenes.scene import Scene
from rtrace.shading import shadow_rays
from rtrace.traverse import trace, trace_recorded
from rtrace.trees.tree_cache import TREES, build_tree, cached_tree
from tests.bench.measure import ratio, times
from traces.format import ENCODING

#: Entries of a traversal stack that would serve any tree: what programs take that do not look at theirs.
USUAL_STACK = 128


def bench_savings(scene: Scene, size: int, repeat: int) -> dict[str, float]:
    """Return ratios: the more wasteful way over ours, in time, entries or rays."""
    out: dict[str, float] = {}
    frame = scene.camera.frame(size, size)
    primary = primary_rays(frame, np.arange(size * size, dtype=np.uint32), size)
    with tempfile.TemporaryDirectory() as name:
        for kind in TREES:
            tree = cached_tree(scene, kind, Path(name))
            taken = times(
                {
                    "built": lambda kind=kind: build_tree(scene.triangles, kind),
                    "kept": lambda kind=kind: cached_tree(scene, kind, Path(name)),
                },
                max(1, repeat // 3),
                time.process_time,
            )
            out[f"{kind}: built instead of taken from the cache, CPU time"] = ratio(taken["built"], taken["kept"])
            out[f"{kind}: a stack of {USUAL_STACK} entries instead of the tree's levels"] = USUAL_STACK / tree.max_level
            hits = trace(tree, primary)
            needed = shadow_rays(tree, primary, hits, scene.light)[0]
            out["a shadow ray for every pixel, not only where a surface faces the light, rays"] = (
                size * size / len(needed.t_max)
            )
            _, _, events = trace_recorded(tree, primary)
            nodes = events[: 1 << 20] >> np.uint32(2)
            addresses = nodes.astype(np.uint64) * np.uint64(tree.nodes.dtype.itemsize)
            files = {what: Path(name) / f"{what}.parquet" for what in ("narrow", "wide")}
            tables = {"narrow": pa.table({"node": nodes}), "wide": pa.table({"node": addresses})}
            taken = times(
                {
                    what: lambda table=tables[what], file=files[what]: pq.write_table(table, file, **ENCODING)
                    for what in ("narrow", "wide")
                },
                repeat,
            )
            out[f"{kind}: 64-bit addresses instead of 32-bit node numbers, bytes on disk"] = (
                files["wide"].stat().st_size / files["narrow"].stat().st_size
            )
            out[f"{kind}: 64-bit addresses instead of 32-bit node numbers, time of writing"] = ratio(
                taken["wide"], taken["narrow"]
            )
    return out
