"""All builders on the scenes that break builders: steps counted, memory poisoned, leaves exact, hits those of brute force."""

import hashlib
from functools import partial

import numpy as np
import pytest

from rtrace.rays import make_rays
from rtrace.scenes.shapes import height_field, rectangle, soup
from rtrace.trees import kd_cells
from rtrace.trees.bvh import build_bvh
from rtrace.trees.kdtree import build_kdtree
from tests.reference.builders import checked, poisoned
from tests.reference.tree_checks import BUILDERS, SCENES, check_hits, check_listing, check_tree, rays_at

KD = {name: build for name, build in BUILDERS.items() if name.startswith("kd")}


def scenes(kind, n, first=0):
    """The first n scenes of a kind that can be built."""
    found = (SCENES[kind](np.random.default_rng([first, seed])) for seed in range(2 * n))
    return [triangles for triangles in found if len(triangles) and np.isfinite(triangles).all()][:n]


def digest(tree):
    return hashlib.sha256(tree.nodes.tobytes() + tree.prims.tobytes() + tree.corners.tobytes()).hexdigest()


def floor_and_slivers(n):
    """A floor of n strips that ends at x = 0, where three slivers begin that end at cos(pi/2)."""
    sliver = [[0, 0, 0], [np.cos(np.pi / 2), 0, 0], [0, 0, 1]]
    return np.concatenate([rectangle((-1, 0, 0), (1, 0, 0), (0, 0, 1), 1, n), [sliver] * 3]).astype(np.float32)


@pytest.mark.parametrize("n", [1, 2, 5, 40, 200])
def test_a_floor_that_ends_a_hair_before_its_cell_is_built_in_few_levels(n):
    """Many triangles end in one plane above which lies 2^-54 of the cost: by its rounding they seemed to reach beyond."""
    triangles = floor_and_slivers(n)
    with poisoned(0x55):
        tree = build_kdtree(triangles)
    check_tree(tree)
    check_listing(tree)
    assert tree.max_level <= 10 and len(tree.prims) < 3 * len(triangles)


@pytest.mark.parametrize("kind", SCENES)
def test_every_split_counts_what_it_parts(kind, record_property):
    n_splits = 0
    for triangles in scenes(kind, 12):
        for build in KD.values():
            want = digest(build(triangles))
            with checked() as steps:
                assert digest(build(triangles)) == want
            n_splits += steps.n_splits
    record_property("cases", n_splits)
    assert n_splits > 500


@pytest.mark.parametrize("kind", SCENES)
@pytest.mark.parametrize("builder", BUILDERS)
def test_memory_that_was_never_set_is_never_read(builder, kind):
    for triangles in scenes(kind, 8, first=1):
        want = digest(BUILDERS[builder](triangles))
        for byte in (0x55, 0xFF):
            with poisoned(byte):
                assert digest(BUILDERS[builder](triangles)) == want


def test_poison_is_noticed(monkeypatch):
    """A leaf that lists more triangles than were written for it takes the others from memory."""
    whole = kd_cells.list_triangles
    monkeypatch.setattr(kd_cells, "list_triangles", lambda events, begin, end, fresh: whole(events, begin, begin + 1, fresh))
    with poisoned(0x55), pytest.raises(OverflowError, match=str(0x5555555555555555)):
        build_kdtree(soup(30, seed=1), max_level=0)


@pytest.mark.parametrize("builder", BUILDERS)
def test_what_was_built_before_changes_nothing(builder):
    """Memory that one build leaves behind is the next one's scratch."""
    others = [soup(700, seed=2), height_field(20).astype(np.float32), np.repeat(soup(1, seed=3), 900, axis=0)]
    floors = list(map(floor_and_slivers, (5, 40, 200)))
    inputs = [*scenes("slivers", 15, first=2), *floors, *scenes("any bits", 10, first=2), *others]
    forwards = [digest(BUILDERS[builder](triangles)) for triangles in inputs]
    backwards = [digest(BUILDERS[builder](triangles)) for triangles in inputs[::-1]]
    again = [[digest(BUILDERS[builder](triangles)) for _ in range(2)] for triangles in inputs]
    assert forwards == backwards[::-1]
    assert again == [[each, each] for each in forwards]


@pytest.mark.parametrize("kind", SCENES)
def test_leaves_list_exactly_what_reaches_into_them(kind, record_property):
    """By clipping in whole numbers: nothing is lost, nothing listed that misses its cell, but for float64's rounding."""
    tried = scenes(kind, 15, first=3)
    for triangles in tried:
        for build in KD.values():
            check_listing(build(triangles))
    record_property("cases", len(tried) * len(KD))


@pytest.mark.parametrize("kind", SCENES)
@pytest.mark.parametrize("builder", BUILDERS)
def test_trees_are_sound_and_hits_those_of_brute_force(builder, kind, record_property):
    n_hits = n_rays = 0
    for seed, triangles in enumerate(scenes(kind, 80, first=4)):
        tree = BUILDERS[builder](triangles)
        check_tree(tree)
        rays = rays_at(triangles, 24, np.random.default_rng(seed))
        n_hits += check_hits(tree, rays)
        n_rays += len(rays.t_min)
    record_property("cases", n_rays)
    assert 0.3 * n_rays < n_hits < 0.9 * n_rays


def every_power(k=126):
    """A triangle at every power of two from 2^-k to 2^k; each holds the origin's side of the one before."""
    return np.exp2(np.arange(-k, k + 1.0))[:, None, None].astype(np.float32) * np.eye(3, dtype=np.float32)


@pytest.mark.parametrize("build", [build_kdtree, build_bvh, partial(build_bvh, builder="binned")])
def test_trees_deeper_than_64_find_what_brute_force_finds(build):
    """A stack as deep as the tree: nearest first and, from the other side, the whole stack at once."""
    triangles = every_power()
    tree = build(triangles)
    check_tree(tree)
    assert tree.max_level > 64
    origins = np.float32([[-1, -1, -1], [-1e-38] * 3, [3e38, 2e38, 1e38], [1e-3, 1e-20, 1e30], [0, 0, 0]])
    directions = np.float32([[1, 1, 1], [-1, -1, -1], [1, 2, 4], [-4, -2, -1], [1e-20, 1, 1e-30], [1, 0, 0], [-1, -0.0, -0.0]])
    rays = make_rays(np.repeat(origins, len(directions), axis=0), np.tile(directions, (len(origins), 1)))
    aimed = rays_at(triangles, 2000, np.random.default_rng(0))
    assert check_hits(tree, rays) > 0
    assert check_hits(tree, aimed) > 500
