"""Invariance under units, axes, mirrors, orders and copies of a scene; and random bits as a scene."""

from itertools import permutations, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtrace.rays import make_rays
from rtrace.scenes.scene import SceneError, scene_from_triangles
from rtrace.scenes.shapes import boxes, height_field, icosphere, soup
from rtrace.traverse import trace, trace_recorded
from rtrace.trees.bvh import build_bvh
from rtrace.trees.kdtree import build_kdtree
from tests.rtrace.trees.test_kdtree import needles

BUILDERS = {
    "kdtree": build_kdtree,
    "bvh sweep": build_bvh,
    "bvh binned": lambda triangles: build_bvh(triangles, builder="binned"),
}
SCENES = {"soup": soup(250, seed=3), "ball": icosphere(2), "hills": height_field(9), "boxes": boxes(2), "needles": needles(80)}

pairs = pytest.mark.parametrize(("scene", "builder"), list(product(SCENES, BUILDERS)))


def aimed_rays(triangles, n=300, seed=5):
    """Rays from around the scene at points of its box and of its triangles. Directions are not of unit length."""
    rng = np.random.default_rng(seed)
    low, high = triangles.min(axis=(0, 1)).astype(float), triangles.max(axis=(0, 1)).astype(float)
    origin = rng.uniform(low - (high - low), high + (high - low), (n, 3)).astype(np.float32)
    at = rng.uniform(low, high, (n, 3))
    weights = rng.dirichlet((1, 1, 1), n)[::2]
    at[::2] = (weights[:, :, None] * triangles[rng.integers(0, len(triangles), len(weights))]).sum(axis=1)
    return origin, at.astype(np.float32) - origin


def shot(builder, triangles, origin, direction, **options):
    tree = BUILDERS[builder](np.ascontiguousarray(triangles, np.float32))
    return trace(tree, make_rays(origin, direction, **options))


def unchanged(got, want, factor=1.0):
    np.testing.assert_array_equal(got.prim, want.prim)
    np.testing.assert_array_equal(got.t, want.t * factor)


@pairs
def test_units(scene, builder):
    """Lengths times 2^k: the same hits; t the same bits for scaled directions, scaled itself for directions left alone."""
    triangles = SCENES[scene]
    origin, direction = aimed_rays(triangles)
    want = shot(builder, triangles, origin, direction)
    assert (want.prim >= 0).sum() > 20
    for k in (-80, -31, -1, 1, 40, 90):
        f = np.float32(2.0**k)
        unchanged(shot(builder, triangles * f, origin * f, direction * f), want)
        unchanged(shot(builder, triangles * f, origin * f, direction), want, 2.0**k)


@pairs
def test_the_length_of_a_direction(scene, builder):
    """A direction 2^k times as long: t is 2^-k of what it was, bit by bit; three times as long: within rounding."""
    triangles = SCENES[scene]
    origin, direction = aimed_rays(triangles)
    want = shot(builder, triangles, origin, direction)
    for k in (-60, -3, 5, 60):
        unchanged(shot(builder, triangles, origin, direction * np.float32(2.0**k)), want, 2.0**-k)
    is_hit = want.prim >= 0
    got = shot(builder, triangles, origin, 3 * direction)
    assert (got.prim >= 0).sum() == pytest.approx(is_hit.sum(), abs=3)  # 3 d is rounded: it is another ray, a bit
    same = is_hit & (got.prim == want.prim)
    np.testing.assert_allclose(3 * got.t[same], want.t[same], rtol=1e-3)


SYMMETRIES = [(axes, signs) for axes in permutations(range(3)) for signs in product((1, -1), repeat=3)]


@pairs
def test_axes_and_mirrors(scene, builder):
    """All 48 ways to permute and mirror the axes: the same triangles, t bit by bit."""
    triangles = SCENES[scene]
    origin, direction = aimed_rays(triangles, n=120)
    want = shot(builder, triangles, origin, direction)
    for axes, signs in SYMMETRIES:
        move = lambda points, axes=axes, signs=signs: np.ascontiguousarray(points[..., list(axes)] * np.float32(signs))
        unchanged(shot(builder, move(triangles), move(origin), move(direction)), want)


@pairs
def test_the_order_of_the_triangles(scene, builder):
    """Shuffled triangles: t bit by bit, and the same triangle unless several are hit at this very t."""
    triangles = SCENES[scene]
    origin, direction = aimed_rays(triangles)
    want = shot(builder, triangles, origin, direction)
    for seed in range(3):
        order = np.random.default_rng(seed).permutation(len(triangles))
        got = shot(builder, triangles[order], origin, direction)
        np.testing.assert_array_equal(got.t, want.t)
        for i in np.flatnonzero(want.prim >= 0):
            mine = order[got.prim[i]]
            if mine != want.prim[i]:
                alone = shot(builder, triangles[[mine, want.prim[i]]], origin[[i, i]], direction[[i, i]])
                assert alone.t[0] == want.t[i] and alone.prim[0] == 0


@pairs
def test_copies_and_far_company(scene, builder):
    """Every triangle twice, or a triangle behind all rays' hits added: nothing changes, the first copy wins."""
    triangles = SCENES[scene]
    origin, direction = aimed_rays(triangles)
    want = shot(builder, triangles, origin, direction)
    unchanged(shot(builder, np.concatenate([triangles, triangles[::-1]]), origin, direction), want)
    far = np.float32([[[1e6, 1e6, 1e6], [1e6 + 1, 1e6, 1e6], [1e6, 1e6 + 1, 1e6]]])
    unchanged(shot(builder, np.concatenate([triangles, far]), origin, direction), want)


@pairs
def test_any_hit_is_whether_there_is_a_nearest_hit(scene, builder):
    """For every end of the interval: also just before, at and just after the nearest hit."""
    triangles = SCENES[scene]
    origin, direction = aimed_rays(triangles)
    tree = BUILDERS[builder](triangles)
    t = trace(tree, make_rays(origin, direction)).t
    ends = np.where(np.isfinite(t), t, 1.0)
    for t_max in (np.inf, 0.5, ends, np.nextafter(ends, 0), np.nextafter(ends, np.inf)):
        rays = make_rays(origin, direction, t_max=t_max)
        np.testing.assert_array_equal(trace(tree, rays, any_hit=True).prim >= 0, trace(tree, rays).prim >= 0)


@pairs
def test_an_interval_that_ends_before_it_begins_holds_nothing(scene, builder):
    tree = BUILDERS[builder](SCENES[scene])
    origin, direction = aimed_rays(SCENES[scene])
    for any_hit in (False, True):
        rays = make_rays(origin, direction, t_min=np.nextafter(1.0, 2), t_max=1.0)
        assert (trace(tree, rays, any_hit=any_hit).prim == -1).all()


@pytest.mark.parametrize("builder", BUILDERS)
def test_a_direction_of_any_size_hits_the_same(builder):
    """Directions from 1e-38 to 1e38: the same triangles, t times the length the same to rounding."""
    triangles = SCENES["ball"]
    origin, direction = aimed_rays(triangles)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    want = shot(builder, triangles, origin, direction)
    for size in (1e-38, 1e-20, 1e20, 1e38):
        longer = (direction.astype(np.float64) * size).astype(np.float32)
        got = shot(builder, triangles, origin, longer)
        np.testing.assert_array_equal(got.prim >= 0, want.prim >= 0)
        is_hit = want.prim >= 0
        np.testing.assert_allclose(got.t[is_hit] * size, want.t[is_hit], rtol=1e-4)


@pytest.mark.parametrize("scene", SCENES)
def test_every_hit_lies_in_a_leaf_that_lists_its_triangle(scene, record_property):
    """All hits of all triangles, found one triangle at a time, not the nearest ones only."""
    triangles = SCENES[scene][:120]
    tree = build_kdtree(triangles, c_trav=0.3)
    origin, direction = aimed_rays(triangles, n=200)
    meta, n_hits = tree.nodes["meta"], 0
    for i in range(len(triangles)):
        t = trace(build_bvh(triangles[i : i + 1]), make_rays(origin, direction)).t
        for ray in np.flatnonzero(np.isfinite(t)):
            point = origin[ray].astype(float) + t[ray] * direction[ray].astype(float)
            slack, todo, listed = 1e-6 * float(np.abs(tree.bounds).max()), [0], set()
            while todo:
                node = todo.pop()
                axis = int(meta[node] & 3)
                if axis == 3:
                    first = int(tree.nodes["first"][node])
                    listed |= set(tree.prims[first : first + (meta[node] >> 2)].tolist())
                    continue
                side = point[axis] - float(tree.nodes["split"][node])
                child = int(meta[node] >> 2)
                todo += [child] * int(side <= slack) + [child + 1] * int(side >= -slack)
            assert i in listed
            n_hits += 1
    record_property("cases", n_hits)
    assert n_hits > 60


words = st.integers(0, (1 << 32) - 1) | st.sampled_from(
    [0, 0x80000000, 1, 0x80000001, 0x7F7FFFFF, 0xFF7FFFFF, 0x3F800000, 0xBF800000, 0x00800000, 0x7F800000, 0x7FC00000]
)


@settings(max_examples=300)
@given(st.lists(words, min_size=9, max_size=9 * 12), st.lists(words, min_size=6, max_size=6), st.booleans())
def test_a_mesh_of_any_bits_is_traced_or_refused(bits, ray_bits, any_hit):
    """No crash, no hang; what is hit is a triangle of the scene, at a t in the interval; accesses are nodes of the tree."""
    triangles = np.array(bits[: len(bits) // 9 * 9], np.uint32).view(np.float32).reshape(-1, 3, 3)
    ray = np.array(ray_bits, np.uint32).view(np.float32)
    try:
        scene = scene_from_triangles(triangles, "bits")
        with np.errstate(over="ignore"):
            towards = scene.triangles[0] - ray[:3]
        rays = make_rays(np.tile(ray[:3], (4, 1)), np.concatenate([ray[None, 3:], towards]))
    except (SceneError, ValueError) as error:
        assert "\n" not in str(error)
        return
    for build in BUILDERS.values():
        tree = build(scene.triangles)
        hits, count, events = trace_recorded(tree, rays, any_hit=any_hit)
        assert ((hits.prim >= -1) & (hits.prim < len(scene.triangles))).all()
        assert (hits.t[hits.prim >= 0] >= 0).all() and np.isinf(hits.t[hits.prim < 0]).all()
        assert len(events) == count.sum() and ((events >> 2) < len(tree.nodes)).all()
