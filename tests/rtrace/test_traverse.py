"""The traversal kernels against a slow reference (visits), brute force (hits), and themselves under exact transformations."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtrace.intersect import margins
from rtrace.rays import make_rays
from rtrace.scenes.shapes import boxes, height_field, icosphere, soup
from rtrace.traverse import trace, trace_all, trace_recorded
from rtrace.trees.bvh import build_bvh
from rtrace.trees.kdtree import build_kdtree
from rtrace.trees.tree_cache import build_tree
from tests.reference.traversal import Seen, events_of, traverse, triangle_hit

BUILDERS = {
    "kdtree": build_kdtree,
    "kdtree level 3": lambda triangles: build_kdtree(triangles, max_level=3),
    "bvh sweep": build_bvh,
    "bvh binned": lambda triangles: build_bvh(triangles, builder="binned"),
    "bvh64 sweep": lambda triangles: build_tree(triangles, "bvh64"),
    "bvh64 binned": lambda triangles: build_tree(triangles, "bvh64", builder="binned"),
}
SCENES = {"icosphere": icosphere(2), "height field": height_field(8), "boxes": boxes(), "soup": soup(200, seed=1)}

# Small integers make the cruel cases likely: rays in planes and edges, flat boxes, shared corners, duplicates.
small = st.integers(-3, 3).map(float)
point = st.tuples(small, small, small)
triangle_lists = st.lists(st.tuples(point, point, point), min_size=1, max_size=24)
directions = st.tuples(*[st.sampled_from([-2.0, -1.0, -0.0, 0.0, 1.0, 3.0])] * 3).filter(any)


def camera_rays(triangles, n, seed):
    """Rays from around the scene to points in it, and rays that start inside; a quarter parallel to an axis."""
    rng = np.random.default_rng(seed)
    lower, upper = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    size = upper - lower + 1e-3
    origin = lower + size * rng.uniform(-1, 2, (n, 3))
    direction = lower + size * rng.random((n, 3)) - origin
    for axis in range(3):
        direction[axis::12, axis], direction[axis::12, (axis + 1) % 3] = 0.0, -0.0
    return make_rays(origin, direction)


def assert_same_hits(got, want):
    np.testing.assert_array_equal(got.prim, want.prim)
    np.testing.assert_array_equal(got.t, want.t)  # bitwise: every structure runs the same triangle test


def hits_like_the_reference(tree, rays, any_hit=False):
    """Check every event and hit against the slow traverser; return the number of hits."""
    hits, count, events = trace_recorded(tree, rays, any_hit=any_hit)
    ends = np.cumsum(count)
    for i in range(len(count)):
        want_prim, want_t, want = traverse(tree, rays.origin[i], rays.direction[i], 0.0, rays.t_max[i], any_hit)
        assert events_of(events[ends[i] - count[i] : ends[i]]) == want
        assert (hits.prim[i], hits.t[i]) == (want_prim, want_t)
    return int((hits.prim >= 0).sum())


@pytest.mark.parametrize("builder", BUILDERS)
@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("any_hit", [False, True])
def test_visits_equal_the_reference(scene, builder, any_hit):
    triangles = SCENES[scene]
    tree = BUILDERS[builder](triangles)
    rays = camera_rays(triangles, 150, seed=7)
    rays = rays._replace(t_max=np.where(np.arange(150) % 3 == 0, 1.0, np.inf))
    assert 10 < hits_like_the_reference(tree, rays, any_hit) < 150


def test_more_than_eight_nodes_wait_at_a_leaf():
    """A ray along a pile of triangles pushes at every level."""
    triangles = np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 0]], np.float32) + np.zeros((4096, 1, 1), np.float32)
    triangles[:, :, 2] = np.arange(4096)[:, None]
    tree = build_bvh(triangles)
    rays = make_rays(np.array([[0.0, 0.0, -1.0], [0.1, -0.2, 4097.0]]), np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]))
    _, count, events = trace_recorded(tree, rays)
    assert all((part & 3 == 3).sum() > 9 for part in np.split(events, np.cumsum(count)[:-1]))
    assert hits_like_the_reference(tree, rays) == 2


@given(triangle_lists, point, directions, st.booleans(), st.sampled_from(sorted(BUILDERS)))
@settings(max_examples=300)
def test_visits_and_hits_on_a_lattice(corners, origin, direction, any_hit, builder):
    triangles = np.array(corners, np.float32)
    tree = BUILDERS[builder](triangles)
    rays = make_rays([origin], [direction])
    hits, _, events = trace_recorded(tree, rays, any_hit=any_hit)
    prim, t, want = traverse(tree, origin, direction, any_hit=any_hit)
    assert events_of(events) == want
    assert (hits.prim[0], hits.t[0]) == (prim, t)
    truth = trace_all(triangles, rays)
    if any_hit:
        assert (hits.prim[0] >= 0) == (truth.prim[0] >= 0)
    else:
        assert_same_hits(hits, truth)


@pytest.mark.parametrize("builder", BUILDERS)
@pytest.mark.parametrize("scene", SCENES)
def test_hits_equal_brute_force(scene, builder):
    triangles = SCENES[scene]
    rays = camera_rays(triangles, 3000, seed=11)
    tree = BUILDERS[builder](triangles)
    truth = trace_all(triangles, rays)
    assert_same_hits(trace(tree, rays), truth)
    np.testing.assert_array_equal(trace(tree, rays, any_hit=True).prim >= 0, truth.prim >= 0)


@pytest.mark.parametrize("builder", BUILDERS)
def test_rays_in_the_planes_of_boxes_equal_brute_force(builder):
    """Such rays visit both sides of a split plane, so entries lie on the stack out of order."""
    rng = np.random.default_rng(2)
    lower = rng.integers(0, 12, (40, 1, 1, 3))
    cube = boxes(1) - boxes(1).min(axis=(0, 1))
    size = rng.integers(1, 5, (40, 1, 1, 3)) / cube.max()
    triangles = np.float32(lower + cube * size).reshape(-1, 3, 3)
    origin = rng.integers(-2, 18, (6000, 3)).astype(np.float32)
    direction = rng.integers(-3, 4, (6000, 3)).astype(np.float32)
    direction[np.arange(6000), rng.integers(0, 3, 6000)] = 0.0  # in the plane of a face, as likely as not
    direction[~direction.any(axis=1), 0] = 1.0
    rays = make_rays(origin, direction)
    truth = trace_all(triangles, rays)
    assert_same_hits(trace(BUILDERS[builder](triangles), rays), truth)
    assert 1000 < (truth.prim >= 0).sum() < 5900


@pytest.mark.parametrize("builder", ["kdtree", "bvh sweep", "bvh64 sweep"])
def test_no_leaks_through_vertices_and_edges(builder):
    triangles = icosphere(3)
    corners = triangles.reshape(-1, 3)
    edges = (triangles + np.roll(triangles, 1, axis=1)).reshape(-1, 3) / 2
    rays = make_rays([0.1, -0.05, 0.2], np.concatenate([corners, edges]) - np.float32([0.1, -0.05, 0.2]))
    assert (trace(BUILDERS[builder](triangles), rays).prim >= 0).all()


@pytest.mark.parametrize("builder", ["kdtree", "bvh sweep", "bvh64 sweep"])
def test_scale_mirror_and_axis_order_change_nothing(builder):
    triangles = soup(300, seed=3)
    rays = camera_rays(triangles, 500, seed=5)
    want = trace(BUILDERS[builder](triangles), rays)
    for scale in (2.0**-60, 2.0**40):
        moved = make_rays(rays.origin * np.float32(scale), rays.direction)
        got = trace(BUILDERS[builder](triangles * np.float32(scale)), moved)
        np.testing.assert_array_equal(got.prim, want.prim)
        np.testing.assert_array_equal(got.t, want.t * scale)
    for axes, signs in (((1, 2, 0), (1, 1, 1)), ((0, 1, 2), (-1, 1, -1))):
        corners, origin, direction = (
            np.ascontiguousarray(points[..., list(axes)] * np.float32(signs))
            for points in (triangles, rays.origin, rays.direction)
        )
        got = trace(BUILDERS[builder](corners), make_rays(origin, direction))
        np.testing.assert_array_equal(got.prim, want.prim)
        np.testing.assert_allclose(got.t, want.t, rtol=1e-12)


def test_interval_ends_belong_to_the_interval():
    triangles = np.float32([[[0, 0, 2], [1, 0, 2], [0, 1, 2]]])
    for tree in (build_bvh(triangles), build_kdtree(triangles)):
        for t_min, t_max, hit in (
            (0, 2, True),
            (2, 9, True),
            (2, 2, True),
            (0, 1.9999999, False),
            (2.0000001, 9, False),
            (3, 1, False),
        ):
            for any_hit in (False, True):
                rays = make_rays([0.2, 0.2, 0], [[0, 0, 1]], t_min, t_max)
                assert (trace(tree, rays, any_hit=any_hit).prim[0] == 0) == hit


def test_the_lowest_number_wins_among_equal_hits():
    one = np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    triangles = np.stack([one + np.float32([0, 0, 1]), *[one] * 40, one[::-1]])
    rays = make_rays([0.2, 0.2, -1], [[0, 0, 1]])
    for build in BUILDERS.values():
        assert trace(build(triangles), rays).prim[0] == 1


def test_a_trace_longer_than_its_buffer_goes_on_in_another(monkeypatch):
    triangles = SCENES["soup"]
    rays = camera_rays(triangles, 400, seed=13)
    for build in (build_bvh, build_kdtree):
        tree = build(triangles)
        want = trace_recorded(tree, rays)
        monkeypatch.setattr("rtrace.traverse.EVENTS_PER_RAY", 0)
        got = trace_recorded(tree, rays)
        monkeypatch.undo()
        np.testing.assert_array_equal(got[1], want[1])
        np.testing.assert_array_equal(got[2], want[2])
        assert_same_hits(got[0], want[0])
        assert len(want[2]) > 400 and want[1].sum() == len(want[2])


@pytest.mark.parametrize(
    "origin, direction, t_min, words",
    [
        ([0, 0, 0], [[0, 0, 0]], 0, "must not be zero"),
        ([np.nan, 0, 0], [[0, 0, 1]], 0, "finite"),
        ([0, 0, 0], [[np.inf, 0, 1]], 0, "finite"),
        ([0, 0, 0], [[0, 0, 1]], -1, "0 or more"),
    ],
)
def test_bad_rays_are_refused(origin, direction, t_min, words):
    with pytest.raises(ValueError, match=words):
        make_rays(origin, direction, t_min)


@pytest.mark.parametrize("builder", BUILDERS)
def test_a_ray_exactly_the_margin_beside_a_plane(builder):
    """There plane - moved origin is 0, which times an infinite inverse would be no number."""
    rng = np.random.default_rng(7)
    triangles = rng.random((40, 3, 3)).astype(np.float32)
    triangles[:, :, 0] = rng.choice(np.float32([2.0**-44, 0.5, 1.0]), (40, 3))
    triangles[0, 0, 0], triangles[0, 1, 0] = 1.0, 2.0**-44
    for x, z in ((0.0, 1.0), (-0.0, 1.0), (0.0, -1.0), (2.0**-43, 1.0)):
        origin = np.stack([np.full(50, x), rng.random(50), np.full(50, -2.0 * z)], axis=1)
        rays = make_rays(origin, np.resize([[0.0, 0.0, z], [-0.0, 0.01, z]], (50, 3)))
        hits_like_the_reference(BUILDERS[builder](triangles), rays)


def test_margins_are_those_of_the_reference():
    """Also where visits do not tell: a scene flat along an axis, a slope times a long way, an origin far off, both zeros."""
    rng = np.random.default_rng(3)
    for _ in range(300):
        size = 10.0 ** rng.uniform(-6, 6, 3) * rng.choice([0.0, 1.0, 1.0, 1.0], 3)
        at = rng.choice([0.0, 1.0, -1e4], 3)
        triangles = (at + size * rng.random((4, 3, 3))).astype(np.float32)
        tree = build_bvh(triangles)
        origin = np.float64(np.float32(rng.choice([0.0, -2.0, 1e5], 3)))
        direction = np.float64(np.float32(rng.choice([0.0, -0.0, 1.0, -1e-3, 1e6], 3)))
        if not direction.any():
            continue
        seen = Seen(tree, origin.tolist(), direction.tolist())
        pads = margins(tree.core.reshape(-1), tuple(origin), tuple(direction), tuple(seen.inverse))
        signed = np.copysign(pads, seen.inverse)
        assert (origin + signed).tolist() == seen.near and (origin - signed).tolist() == seen.far


def bundle(rng, n_triangles, n_rays):
    """Triangles that lie nearly along one line, by any factor, and rays beside it: nothing is more nearly edge-on."""
    origin, along = rng.uniform(-1, 1, 3), rng.normal(size=3)
    depth = rng.uniform(1, 4, (n_triangles, 3, 1))
    aside = rng.normal(size=(n_triangles, 3, 3)) * 10.0 ** -rng.uniform(0, 9, (n_triangles, 1, 1))
    triangles = (origin + depth * along + aside).astype(np.float32)
    starts = origin + rng.normal(size=(n_rays, 3)) * 10.0 ** -rng.uniform(0, 9, (n_rays, 1))
    inner = (triangles[rng.integers(0, n_triangles, n_rays)] * rng.dirichlet([1, 1, 1], n_rays)[..., None]).sum(axis=1)
    at_corner = rng.random(n_rays) < 0.3
    inner[at_corner] = triangles[rng.integers(0, n_triangles, n_rays), rng.integers(0, 3, n_rays)][at_corner]
    return triangles, make_rays(starts, inner - starts.astype(np.float32))


@pytest.mark.parametrize("seed", range(12))
def test_nearly_edge_on_triangles_equal_brute_force(seed):
    triangles, rays = bundle(np.random.default_rng([seed, 4]), 40, 1000)
    truth = trace_all(triangles, rays)
    assert (truth.prim >= 0).sum() > 250
    for build in BUILDERS.values():
        tree = build(triangles)
        hits, shadow = trace(tree, rays), trace(tree, rays, any_hit=True)
        np.testing.assert_array_equal(hits.prim, truth.prim)
        np.testing.assert_array_equal(hits.t, truth.t)
        np.testing.assert_array_equal(shadow.prim >= 0, truth.prim >= 0)


def test_signs_of_edges_are_those_of_exact_arithmetic():
    """Rays that cross an edge exactly, or miss it by one step of float32: products are often equal by rounding alone."""
    rng = np.random.default_rng(3)
    n_hits = n_misses = n_wrong = 0
    while n_hits + n_misses < 4000:
        d, e = rng.integers(-9, 10, (2, 3))
        along, beside = rng.integers(1, 40, 2), (int(rng.integers(1, 9)), -int(rng.integers(1, 9)))
        a, b = (along[k] * d + beside[k] * e for k in range(2))
        corners = np.array([a, b, a + rng.integers(-40, 41, 3)], np.float32)
        if rng.random() < 0.25:
            corners[0, 0] = np.nextafter(corners[0, 0], np.float32(np.inf))
        if not d.any() or len(np.unique(corners, axis=0)) < 3:
            continue
        ray = make_rays(np.zeros((1, 3)), d[None].astype(np.float32))
        hits = trace_all(corners[None], ray)
        expected = triangle_hit(corners.astype(float).tolist(), [0.0] * 3, d.astype(float).tolist())
        expected = expected if expected is not None and expected >= 0.0 else None
        assert (None if hits.prim[0] < 0 else hits.t[0]) == expected, (corners, d)
        n_hits, n_misses = n_hits + (expected is not None), n_misses + (expected is None)
        n_wrong += signs_differ(corners.astype(float).tolist(), d.astype(float).tolist())
    assert n_hits > 500 and n_misses > 500 and n_wrong > 50


def signs_differ(corners, direction):
    """Return whether an edge function is 0 as computed and not exactly, on the same sheared corners; never the other sign."""
    kz = max(range(3), key=lambda k: abs(direction[k]))
    kx, ky = (kz + 1) % 3, (kz + 2) % 3
    scale = 1.0 / direction[kz]
    x, y = ([p[k] - direction[k] * scale * p[kz] for p in corners] for k in (kx, ky))
    for i, j in ((2, 1), (0, 2), (1, 0)):
        computed, exactly = x[i] * y[j] - y[i] * x[j], Fraction(x[i]) * Fraction(y[j]) - Fraction(y[i]) * Fraction(x[j])
        assert computed * exactly >= 0
        if computed == 0 != exactly:
            return True
    return False
