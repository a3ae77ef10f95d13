"""Trees and rays that are more than their numbers can tell apart are one sentence; the limits are lowered for it."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from nptrace_base.errors import NptraceError
from rtrace import ray_file
from rtrace.scenes.shapes import icosphere
from rtrace.trees import tree
from rtrace.trees.bvh import build_bvh
from rtrace.trees.kdtree import build_kdtree

BUILDERS = {
    "sweep": build_bvh, "binned": lambda triangles: build_bvh(triangles, builder="binned"), "kdtree": build_kdtree
}  # fmt: skip


@pytest.mark.parametrize("builder", BUILDERS)
@pytest.mark.parametrize("limit", ["MOST_NODES", "MOST_LEVEL"])
def test_a_tree_that_is_too_large(monkeypatch, builder, limit):
    built = BUILDERS[builder](icosphere(1))
    most = {"MOST_NODES": len(built.nodes), "MOST_LEVEL": built.max_level}[limit]
    monkeypatch.setattr(tree, limit, most)
    BUILDERS[builder](icosphere(1))
    monkeypatch.setattr(tree, limit, most - 1)
    with pytest.raises(NptraceError, match=f"of {len(built.nodes)} nodes and {built.max_level} levels is too large"):
        BUILDERS[builder](icosphere(1))


def test_a_file_of_too_many_rays(tmp_path, monkeypatch):
    assert (ray_file.MOST_RAYS - 1) // ray_file.WIDTH <= np.iinfo(np.uint16).max < ray_file.MOST_RAYS // ray_file.WIDTH
    pq.write_table(pa.table({"origin": [[0.0, 0, 0]] * 3, "direction": [[0.0, 0, 1]] * 3}), tmp_path / "x.parquet")
    monkeypatch.setattr(ray_file, "MOST_RAYS", 3)
    assert ray_file.read_rays(tmp_path / "x.parquet").n_rays == 3
    monkeypatch.setattr(ray_file, "MOST_RAYS", 2)
    with pytest.raises(NptraceError, match="has 3 rays, and the most is 2; split it into several files"):
        ray_file.read_rays(tmp_path / "x.parquet")
