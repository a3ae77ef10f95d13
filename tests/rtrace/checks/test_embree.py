"""Agreement with Embree on the four scenes (see conftest.py) and on small shapes; a broken tree is noticed."""

import numpy as np
import pytest

from rtrace.checks.embree import compare
from rtrace.scenes.scene import scene_from_triangles
from rtrace.scenes.shapes import icosphere, soup
from rtrace.trees.bvh import build_bvh
from rtrace.trees.kdtree import build_kdtree


@pytest.mark.scenes
def test_trees_agree_with_embree_on_the_scenes(benchmark_scene):
    trees = [build_kdtree(benchmark_scene.triangles), build_bvh(benchmark_scene.triangles)]
    rows = compare(trees, benchmark_scene, 96, 96, 20_000, seed=3)
    assert len(rows) == 2 * (4 + 1 + 4) + 3
    assert {row.rays for row in rows} == {"primary", "shadow", "random"}
    assert [row for row in rows if not row.is_good] == []


@pytest.mark.parametrize("triangles", [icosphere(3), soup(2000, seed=1)], ids=["icosphere", "soup"])
def test_trees_agree_with_embree_on_small_shapes(triangles):
    scene = scene_from_triangles(triangles, "shape")
    rows = compare([build_bvh(triangles), build_kdtree(triangles)], scene, 64, 64, 20_000, seed=4)
    assert [row for row in rows if not row.is_good] == []


def test_a_broken_tree_is_seen():
    triangles = soup(2000, seed=2)
    scene = scene_from_triangles(triangles, "soup")
    tree = build_bvh(triangles)
    nodes = tree.nodes.copy()
    nodes["upper"][5:9] = nodes["lower"][5:9]
    broken = tree._replace(nodes=nodes)
    bad = {row.what for row in compare([build_kdtree(triangles), broken], scene, 64, 64, 5_000, seed=5) if not row.is_good}
    assert {"hit/miss differences", "rays unlike the kdtree"} <= bad
    moved = tree._replace(corners=tree.corners + np.float32(0.01))
    assert any(row.what == "largest |dt| in kappa" for row in compare([moved], scene, 64, 64, 5_000, 6) if not row.is_good)
