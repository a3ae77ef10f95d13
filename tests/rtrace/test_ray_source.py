"""What the estimator asks of the renderer: the same accesses however little is held in memory at a time."""

import os
import subprocess
import sys
import threading

import numpy as np
import pytest

from rtrace import chunk, ray_source
from rtrace.camera import Camera
from rtrace.ray_source import RayUnits
from rtrace.render import Shooting
from rtrace.scenes.scene import scene_from_triangles, seen_from
from rtrace.trees.tree_cache import build_tree
from tests.cachesim.sampling.test_estimate import SHOOTINGS


@pytest.fixture(scope="module", params=["bvh", "bvh64"])
def needles(request):
    """Long triangles in a heap: a ray visits hundreds of nodes."""
    a, along = np.random.default_rng(3).uniform(-1, 1, (2, 600, 3))
    scene = scene_from_triangles(np.stack([a, a + 4 * along, a + 4 * along + 1e-4], axis=1), "needles")
    scene = seen_from(scene, Camera((9.0, 4.0, 5.0), (0.0, 0.0, 0.0), fov=12.0), None)
    return scene, build_tree(scene.triangles, request.param)


def looked_at(source, cuts):
    """Return all that a source tells of a run, as bytes."""
    places, groups, positions = source.scout(0)
    stretches = [*source.trace(cuts), *source.trace(cuts[1:3]), *groups]
    told = [(each.nodes.tobytes(), each.kinds.tobytes(), each.n_rays) for each in stretches]
    return told, places.tobytes(), positions.tobytes(), source.probe(50, 1)


@pytest.mark.parametrize(("order", "batch"), SHOOTINGS)
def test_nothing_depends_on_how_much_is_held_at_a_time(needles, order, batch, monkeypatch):
    source = RayUnits(*needles, Shooting(48, 36, order, batch))
    cuts = [0, 60, 72, 480, 1728] + ([1800, 3456] if batch == 0 else [])
    wanted, calls = looked_at(source, cuts), []

    def counted(*args):
        calls.append(args)
        return shoot(*args)

    shoot = ray_source.shoot
    monkeypatch.setattr(ray_source, "shoot", counted)
    assert looked_at(source, cuts) == wanted
    n_whole = len(calls)
    for most in (5000, 1):
        calls.clear()
        monkeypatch.setattr(chunk, "_local", threading.local())  # memory once taken is used again
        monkeypatch.setattr(ray_source, "MOST_EVENTS", most)
        assert looked_at(source, cuts) == wanted
        assert len(calls) > 2 * n_whole


_PEAK = """
import resource
import numpy as np
from rtrace.camera import Camera
from rtrace.ray_source import RayUnits
from rtrace.render import Shooting
from rtrace.scenes.scene import scene_from_triangles, seen_from
from rtrace.trees.bvh import build_bvh
rng = np.random.default_rng(3)
a, along = rng.uniform(-1, 1, (2, 6000, 3))
long = np.stack([a, a + 4 * along, a + 4 * along + 1e-4], axis=1)
scene = seen_from(scene_from_triangles(long.astype(np.float32), "needles"), Camera((9, 4, 5), (0, 0, 0), fov=12), None)
source = RayUnits(scene, build_bvh(scene.triangles), Shooting(256, 64))
source.trace([0, 64])
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
(stretch,) = source.trace([0, 256 * 64])
print(before // 1024, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024, len(stretch.nodes))
"""


def test_peak_memory_is_little_more_than_the_answer():
    """5 bytes an access; tracing all at once takes its events and its other columns too, 13 bytes."""
    done = subprocess.run([sys.executable, "-c", _PEAK], capture_output=True, text=True, check=True, env=dict(os.environ))
    before, peak, n = map(int, done.stdout.split())
    assert n > 2e7, n
    assert peak - before < 5 * n / 2**20 + 100, done.stdout


def test_a_place_without_accesses_is_a_stretch(needles):
    source = RayUnits(*needles, Shooting(48, 36, batch=0))
    (empty,) = source.trace([5, 5])
    assert empty.nodes.dtype == np.uint32 and empty.kinds.dtype == np.uint8 and empty.n_rays == empty.nodes.size == 0
