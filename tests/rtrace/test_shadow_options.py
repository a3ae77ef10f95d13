"""Which pixels send shadow rays and from where, which child they search first, and what is read after their hits."""

from itertools import pairwise

import numpy as np
import pytest
from click.testing import CliRunner

import cli
from cachesim.config import CacheConfig
from cachesim.replay import replay
from nptrace_base.errors import NptraceError
from rtrace.camera import Camera
from rtrace.chunk import primary_rays
from rtrace.render import render
from rtrace.scenes.scene import scene_from_triangles, seen_from
from rtrace.scenes.shapes import boxes, icosphere
from rtrace.shading import shadow_rays
from rtrace.shooting import Shooting
from rtrace.traverse import Together, trace, trace_all, trace_recorded
from rtrace.trees.rtsah import cheaper_children
from rtrace.trees.tree_cache import build_tree
from tests.reference.traversal import PREFETCH, PUSH, READ, events_of
from traces.format import FILES
from traces.reader import open_run

TREES = ("kdtree", "bvh")
SIZE = 48


@pytest.fixture(scope="module")
def scene():
    return scene_from_triangles(np.concatenate([boxes(), icosphere(3) + np.float32([0, 3, 0])]), "things")


def traced(scene, tree, senders):
    rays = primary_rays(scene.camera.frame(SIZE, SIZE), np.arange(SIZE * SIZE, dtype=np.uint32), SIZE)
    hits = trace(tree, rays)
    return rays, hits, *shadow_rays(tree, rays, hits, scene.light, senders)


def test_the_pixels_that_send_a_shadow_ray(scene):
    tree = build_tree(scene.triangles, "bvh")
    _, hits, lit, lit_of, lit_surface = traced(scene, tree, "lit")
    _, _, hit, hit_of, hit_surface = traced(scene, tree, "hit")
    _, _, every, of_every, _ = traced(scene, tree, "all")
    assert lit_of.tolist() == np.flatnonzero(lit_surface.facing > 0).tolist()
    assert hit_of.tolist() == np.flatnonzero(hits.prim >= 0).tolist()
    assert of_every.tolist() == list(range(SIZE * SIZE))
    assert 100 < len(lit_of) < len(hit_of) - 100 < SIZE * SIZE - 200
    for more, of in ((hit, hit_of), (every, of_every)):  # those there were are the same
        for a, b in zip(more, lit, strict=True):
            np.testing.assert_array_equal(a[np.isin(of, lit_of)], b)
    np.testing.assert_array_equal(lit_surface.facing, hit_surface.facing)  # the picture stays as it is
    light = np.array(scene.light)
    np.testing.assert_allclose(every.origin + every.direction, np.broadcast_to(light, every.origin.shape), rtol=1e-5)
    assert (every.t_max < 1).all() and (every.t_max > 0.999).all()


def test_a_surface_that_faces_away_does_not_stop_its_own_ray(scene):
    tree = build_tree(scene.triangles, "bvh")
    rays, hits, hit, of, surface = traced(scene, tree, "hit")
    away = np.flatnonzero(surface.facing[of] == 0)
    assert len(away) > 100
    for i in away[::10]:
        triangle = scene.triangles[hits.prim[of[i]]]
        alone = type(rays)(*(values[i : i + 1] for values in hit))
        assert trace_all(triangle[None], alone).prim[0] == -1
        point = rays.origin[of[i]] + hits.t[of[i]] * rays.direction[of[i]].astype(np.float64)
        assert np.dot(hit.origin[i] - point, surface.normal[of[i]]) < 0  # on the other side than the viewer


@pytest.mark.parametrize("inside", [False, True])
def test_where_the_ray_of_a_pixel_without_a_hit_begins(scene, inside):
    if inside:
        scene = seen_from(scene, Camera((1.8, 3.9, 1.8), (0.0, 2.9, 0.0)), None)
    tree = build_tree(scene.triangles, "bvh")
    rays, hits, every, _, _ = traced(scene, tree, "all")
    lower, upper = tree.bounds.astype(np.float64)
    middle, passed = (lower + upper) / 2, 0
    for i in np.flatnonzero(hits.prim < 0):
        start, way = rays.origin[i].astype(np.float64), rays.direction[i].astype(np.float64)
        at = every.origin[i].astype(np.float64)
        t = np.dot(at - start, way) / np.dot(way, way)
        assert t >= 0
        np.testing.assert_allclose(start + t * way, at, atol=2e-6)
        with np.errstate(divide="ignore"):
            ends = np.sort([(lower - start) / way, (upper - start) / way], axis=0)
        if max(ends[0].max(), 0) <= ends[1].min():
            assert np.isclose(t, ends[1].min(), rtol=1e-5)
        else:
            passed += 1
            assert abs(np.dot(middle - at, way)) < 1e-5 * np.linalg.norm(middle - start) or t == 0
    assert passed == 0 if inside else passed > 100


@pytest.mark.parametrize("kind", TREES)
def test_the_order_changes_no_answer_and_no_primary_ray(tmp_path, scene, kind):
    tree = build_tree(scene.triangles, kind)
    for name, knobs in (("usual", {}), ("cheaper", {"shadow_order": "cheaper"}), ("drain", {"shadow_end": "drain"})):
        render(scene, tree, Shooting(SIZE, SIZE, **knobs), tmp_path / name)
    usual, *others = (open_run(tmp_path / name) for name in ("usual", "cheaper", "drain"))
    wanted, primary = usual.columns("rays"), usual.columns("rays")["type"] == 0
    for run in others:
        rays = run.columns("rays")
        for name in ("x", "y", "type"):
            np.testing.assert_array_equal(rays[name], wanted[name])
        for name in ("count", "prim", "t"):
            np.testing.assert_array_equal(rays[name][primary], wanted[name][primary])
        np.testing.assert_array_equal(rays["prim"] >= 0, wanted["prim"] >= 0)
        assert (rays["count"] != wanted["count"]).any()
        assert (run.path / "image.png").read_bytes() == (usual.path / "image.png").read_bytes()


def to_light(scene, tree):
    return traced(scene, tree, "lit")[2]


def told(tree, rays, *, any_hit=True, **how):
    hits, count, events = trace_recorded(tree, rays, any_hit=any_hit, together=Together(**how))
    return hits, [events_of(each) for each in np.split(events, np.cumsum(count)[:-1])]


def test_a_bvh_drains_its_stack(scene):
    """What waits when a ray hits is read, one node after the other from the top, and its children are not."""
    tree = build_tree(scene.triangles, "bvh")
    rays = to_light(scene, tree)
    (hits, stopped), (same, drained) = told(tree, rays), told(tree, rays, drains=True)
    np.testing.assert_array_equal(hits.prim, same.prim)
    longer = 0
    for prim, short, long in zip(hits.prim, stopped, drained, strict=True):
        assert long[: len(short)] == short
        stack = []
        for (node, kind), following in zip([row for row in short if row[1] != PREFETCH], [
            *[row[0] for row in short if row[1] != PREFETCH][1:], None], strict=True):  # fmt: skip
            if node in stack:
                stack = stack[: stack.index(node)]
            if kind == PUSH:
                stack.append(((following - 1) ^ 1) + 1)
        assert long[len(short) :] == ([(node, READ) for node in reversed(stack)] if prim >= 0 else [])
        longer += len(long) > len(short)
    assert longer > 20


def test_a_drained_kdtree_ray_is_a_closest_hit_ray(scene):
    tree = build_tree(scene.triangles, "kdtree")
    rays = to_light(scene, tree)
    (hits, drained), (closest, wanted) = told(tree, rays, drains=True), told(tree, rays, any_hit=False)
    assert drained == wanted and drained != told(tree, rays)[1]
    np.testing.assert_array_equal(hits.prim, closest.prim)


@pytest.mark.parametrize("kind", TREES)
def test_the_cheaper_child_comes_first(scene, kind):
    """A ray that pushes goes on in the child that the tree names, and any-hit rays alone do."""
    built = build_tree(scene.triangles, kind)
    tree = built._replace(cheaper=cheaper_children(built))
    first = tree.nodes["meta"] >> 2 if kind == "kdtree" else tree.nodes["child"]
    rays, n_pushes = to_light(scene, tree), 0
    for rows in told(tree, rays, cheaper=True)[1]:
        rows = [row for row in rows if row[1] != PREFETCH]
        for (node, kind_), (following, _) in pairwise(rows):
            if kind_ == PUSH:
                n_pushes += 1
                assert following == first[node] + tree.cheaper[node]
    assert n_pushes > 200
    assert told(tree, rays)[1] == told(built, rays)[1]


@pytest.mark.parametrize("kind", TREES)
@pytest.mark.parametrize("packet", [1, 16])
def test_every_option_together(tmp_path, scene, kind, packet):
    """The stack that a replay rebuilds makes the requests of the run, and threads make no difference."""
    tree = build_tree(scene.triangles, kind)
    shooting = Shooting(SIZE, SIZE, packet=packet, shadow="all", shadow_order="cheaper", shadow_end="drain")
    for i in (1, 3):
        render(scene, tree, shooting, tmp_path / str(i), threads=i)
    for name in FILES:
        assert (tmp_path / "1" / name).read_bytes() == (tmp_path / "3" / name).read_bytes()
    traced, rebuilt = (
        replay(str(tmp_path / "1"), [CacheConfig(1024, 1, 32)], prefetch=text)[0] for text in ("traced", "stack")
    )
    assert (traced.prefetch_accesses, traced.prefetch_misses, traced.demand_misses) == (
        rebuilt.prefetch_accesses, rebuilt.prefetch_misses, rebuilt.demand_misses
    )  # fmt: skip
    assert (open_run(tmp_path / "1").columns("rays")["type"] == 1).sum() == SIZE * SIZE


def test_the_predictor_needs_to_know_where_shadow_rays_begin(tmp_path, scene, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("hit", "all"):
        render(scene, build_tree(scene.triangles, "bvh"), Shooting(16, 16, shadow=name), tmp_path / name)
    for run, prefetch, code in (("hit", "predictor", 0), ("all", "stack", 0), ("all", "predictor", 2)):
        result = CliRunner().invoke(cli.npcache, ["time", run, "--prefetch", prefetch])
        assert result.exit_code == code, result.output
    assert result.stderr.splitlines()[-1] == (
        "Error: all has shadow rays of pixels without a hit, and where those start is not in a run; render it with "
        "--shadow hit or lit"
    )


@pytest.mark.parametrize(
    ("knobs", "sentence"),
    [
        ({"packet": 8}, "packet must be one of 1, 4, 16, 64 rays, got 8; write e.g. 64"),
        ({"shadow": "x"}, "shadow must be one of lit, hit, all, got 'x'"),
        ({"shadow_order": "x"}, "shadow_order must be one of sign, cheaper, got 'x'"),
        ({"shadow_end": "x"}, "shadow_end must be one of stop, drain, got 'x'"),
    ],
)
def test_unknown_values_are_refused(knobs, sentence):
    with pytest.raises(NptraceError) as error:
        Shooting(**knobs)
    assert str(error.value) == sentence
