"""The rays that are found again from a run are those that were traced."""

import numpy as np
import pytest

from rtrace.chunk import primary_rays
from rtrace.render import Shooting, render
from rtrace.scenes.stand_ins import stand_in
from rtrace.shading import shadow_rays
from rtrace.traverse import trace
from rtrace.trees.tree_cache import TREES, build_tree
from tests.reference.traces import make_trace, write
from traces.footer import CameraFacts
from traces.format import RunError
from traces.rays import traced_rays
from traces.reader import open_run


@pytest.mark.parametrize("kind", TREES)
@pytest.mark.parametrize("batch", [0, 1, 7])
def test_they_are_those_that_were_traced(kind, batch, tmp_path):
    scene = stand_in("blob", detail=0.2)
    tree = build_tree(scene.triangles, kind)
    render(scene, tree, Shooting(24, 16, order="random", batch=batch, seed=3), tmp_path / "run", threads=1)
    run = open_run(tmp_path / "run")
    rows = run.columns("rays")
    read = rows["count"] > 0
    found = traced_rays(run)
    assert len(found.origin) == len(found.direction) == len(found.is_hit) == read.sum()
    assert np.array_equal(found.is_hit, (rows["prim"] >= 0)[read])

    pixels = np.arange(24 * 16, dtype=np.uint32)
    primary = primary_rays(scene.camera.frame(24, 16), pixels, 24)
    shadow, owner, _ = shadow_rays(tree, primary, trace(tree, primary), scene.light)
    shadow_of = np.full(pixels.size, -1)
    shadow_of[owner] = np.arange(owner.size)
    pixel, is_shadow = (rows["y"].astype(int) * 24 + rows["x"])[read], (rows["type"] == 1)[read]
    assert is_shadow.any() and not is_shadow.all()
    assert np.array_equal(found.origin[~is_shadow], primary.origin[pixel[~is_shadow]])
    assert np.array_equal(found.direction[~is_shadow], primary.direction[pixel[~is_shadow]])
    size = max(np.abs(scene.bounds).max(), np.abs(scene.camera.eye).max(), np.abs(scene.light).max())
    of = shadow_of[pixel[is_shadow]]
    assert np.abs(found.origin[is_shadow] - shadow.origin[of]).max() < 2.0**-20 * size
    assert np.abs(found.direction[is_shadow] - shadow.direction[of]).max() < 2.0**-20 * size


def test_a_shadow_ray_of_nothing_is_refused(tmp_path):
    run = write(make_trace("bvh", 3, n_rays=4), tmp_path / "run")
    with pytest.raises(RunError, match=r"rays.parquet, column 'type', row 1: 1 breaks the rule that a shadow ray begins"):
        traced_rays(run)


@pytest.mark.parametrize("change", [{"look_at": (0.0, 0.0, 0.0)}, {"up": (0.0, 0.0, 2.0)}, {"fov": float("inf")}])
def test_a_camera_that_shows_nothing_is_refused(change, tmp_path):
    values = {"eye": (0.0, 0.0, 0.0), "look_at": (0.0, 0.0, 1.0), "up": (0.0, 1.0, 0.0), "fov": 45.0}
    run = write(make_trace("bvh", 3, n_rays=4), tmp_path / "run", camera=CameraFacts(**(values | change)))
    with pytest.raises(RunError, match="has a camera or light in its footer that shows nothing; render it again"):
        traced_rays(run)
