"""A run from scene to disk: the same bytes for any threads, consistent tables, shadow rays where they are needed."""

import numpy as np
import pytest

from rtrace.camera import ORDERS, Camera
from rtrace.chunk import primary_rays
from rtrace.render import Shooting, render
from rtrace.scenes.scene import scene_from_triangles
from rtrace.scenes.shapes import boxes, icosphere
from rtrace.shading import shadow_rays
from rtrace.traverse import trace, trace_recorded
from rtrace.trees.tree_cache import build_tree
from tests.reference.traversal import events_of
from traces.format import FILES, LEAF, PREFETCH, PUSH
from traces.reader import open_run

TREES = ("kdtree", "bvh")


@pytest.fixture(scope="module")
def scene():
    return scene_from_triangles(np.concatenate([boxes(), icosphere(3) + np.float32([0, 3, 0])]), "things")


def columns(run):
    batches = list(run.batches(("ray", "node", "kind")))
    return [np.concatenate(c) for c in zip(*batches, strict=True)]


@pytest.mark.parametrize("tree", TREES)
@pytest.mark.parametrize("shooting", [Shooting(90, 70), Shooting(65, 66, "hilbert", 64), Shooting(70, 64, "random", 0, 5)])
def test_bytes_do_not_depend_on_threads_or_repetition(tmp_path, scene, tree, shooting):
    built = build_tree(scene.triangles, tree)
    for name, threads in (("one", 1), ("two", 2), ("five", 5)):
        render(scene, built, shooting, tmp_path / name, threads=threads)
    for name in FILES:
        want = (tmp_path / "one" / name).read_bytes()
        assert (tmp_path / "two" / name).read_bytes() == want
        assert (tmp_path / "five" / name).read_bytes() == want


@pytest.mark.parametrize("tree", TREES)
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("batch", [1, 64, 0])
def test_tables_agree_with_one_another(tmp_path, scene, tree, order, batch):
    """Every ray's accesses start where ``first`` says and are what tracing that ray alone gives."""
    shooting = Shooting(70, 66, order, batch)
    built = build_tree(scene.triangles, tree)
    render(scene, built, shooting, tmp_path / "run")
    run = open_run(tmp_path / "run")
    rays, nodes = run.columns("rays"), run.columns("nodes")
    ray, node, kind = columns(run)
    n = len(rays["ray"])
    np.testing.assert_array_equal(rays["ray"], np.arange(n))
    np.testing.assert_array_equal(rays["first"], np.cumsum(rays["count"]) - rays["count"])
    np.testing.assert_array_equal(ray, np.repeat(rays["ray"], rays["count"]))
    assert run.n_accesses == len(node)

    primary = rays["type"] == 0
    pixels = rays["y"].astype(int) * 70 + rays["x"]
    assert sorted(pixels[primary]) == list(range(70 * 66))
    shadow_of = {p: i for i, p in zip(np.flatnonzero(~primary), pixels[~primary], strict=True)}
    position = {p: i for i, p in zip(np.flatnonzero(primary), pixels[primary], strict=True)}
    assert 100 < len(shadow_of) < 70 * 66
    for p, i in shadow_of.items():  # no shadow ray before its primary ray
        assert i == position[p] + 1 if batch == 1 else i > position[p]
    if batch == 0:
        assert not primary[primary.sum() :].any()

    frame = scene.camera.frame(70, 66)
    all_primary = primary_rays(frame, np.arange(70 * 66, dtype=np.uint32), 70)
    hits, count, events = trace_recorded(built, all_primary)
    ends = np.cumsum(count)
    for p in range(0, 70 * 66, 97):
        row = position[p]
        got = slice(int(rays["first"][row]), int(rays["first"][row] + rays["count"][row]))
        assert list(zip(node[got].tolist(), kind[got].tolist(), strict=True)) == events_of(
            events[ends[p] - count[p] : ends[p]]
        )
        assert rays["prim"][row] == hits.prim[p] and rays["t"][row] == np.float32(hits.t[p])

    # The contract of the demand stream: a push is followed by a child; a request follows a non-empty leaf or a request.
    after_push = np.flatnonzero(kind == PUSH)
    assert (nodes["parent"][node[after_push + 1]] == node[after_push]).all()
    requests = np.flatnonzero(kind == PREFETCH)
    before = kind[requests - 1]
    assert np.isin(before, (LEAF, PREFETCH)).all()
    assert (nodes["n_prims"][node[requests[before == LEAF] - 1]] > 0).all()
    assert len(requests) > 1000


def test_both_trees_give_the_same_picture(tmp_path, scene):
    for tree in TREES:
        render(scene, build_tree(scene.triangles, tree), Shooting(64, 64), tmp_path / tree)
    assert (tmp_path / "bvh" / "image.png").read_bytes() == (tmp_path / "kdtree" / "image.png").read_bytes()


@pytest.mark.parametrize("scale", [1e-12, 1e-3, 1.0, 1e6, 1e12])
@pytest.mark.parametrize("tree", TREES)
def test_a_sphere_has_no_acne_and_no_leaks(tree, scale):
    """A convex body lit by one light: what faces the light is lit, at every scale."""
    triangles = icosphere(4) * np.float32(scale)
    light = (0.0, 3.0 * scale, 3.0 * scale)
    built = build_tree(triangles, tree)
    camera = Camera((0, 0, 4 * scale), (0, 0, 0), fov=40)
    primary = primary_rays(camera.frame(96, 96), np.arange(96 * 96, dtype=np.uint32), 96)
    hits = trace(built, primary)
    rays, owner, (facing, _) = shadow_rays(built, primary, hits, light)
    assert 2000 < len(owner) < (hits.prim >= 0).sum() < 96 * 96
    assert (trace(built, rays, any_hit=True).prim < 0).all()
    assert (facing[owner] > 0).all() and ((facing > 0).sum() == len(owner))


def test_a_light_on_a_surface_is_not_shadowed_by_it():
    """Floor z = 0, ceiling z = 2, a light lying in the ceiling: the floor is lit; a plate at z = 1 shadows it."""
    quad = np.float32([[[-9, -9, 0], [9, -9, 0], [9, 9, 0]], [[-9, -9, 0], [9, 9, 0], [-9, 9, 0]]])
    room = np.concatenate([quad, quad + np.float32([0, 0, 2])])
    plate = quad / np.float32(20) + np.float32([0, 0, 1])
    camera = Camera((0.5, 0.2, 0.5), (0, 0, 0), up=(0, 1, 0))
    primary = primary_rays(camera.frame(40, 40), np.arange(1600, dtype=np.uint32), 40)
    for tree in TREES:
        for triangles, lit in ((room, True), (np.concatenate([room, plate]), False)):
            built = build_tree(triangles, tree)
            rays, owner, _ = shadow_rays(built, primary, trace(built, primary), (0.0, 0.0, 2.0))
            assert len(owner) == 1600
            assert (trace(built, rays, any_hit=True).prim < 0).all() == lit


def test_light_at_the_surface_needs_no_ray():
    quad = np.float32([[[-9, -9, 0], [9, -9, 0], [0, 9, 0]]])
    built = build_tree(quad, "bvh")
    primary = primary_rays(Camera((0, 0, 1), (0, 0, 0)).frame(1, 1), np.zeros(1, np.uint32), 1)
    rays, owner, _ = shadow_rays(built, primary, trace(built, primary), (0.0, 0.0, 1e-30))
    assert len(owner) == 0 and len(rays.t_max) == 0


@pytest.mark.parametrize(
    "values, words",
    [({"width": 0}, "0x128"), ({"order": "zigzag"}, "zigzag"), ({"batch": -1}, "batch")],
)
def test_bad_shootings_are_named(values, words):
    with pytest.raises(ValueError, match=words):
        Shooting(**values)
