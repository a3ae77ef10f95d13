"""Costs and the least and most triangles of a leaf, in every builder: against the slow ones, in the footer, in the cache."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtrace.scenes.scene import scene_from_triangles
from rtrace.scenes.shapes import boxes, height_field, icosphere, soup
from rtrace.traverse import trace, trace_all
from rtrace.trees.bvh import build_bvh
from rtrace.trees.kdtree import build_kdtree
from rtrace.trees.tree import LEAF_AXIS
from rtrace.trees.tree_cache import build_tree, cached_tree
from tests.reference.tree_checks import check_tree
from tests.rtrace.test_traverse import assert_same_hits, camera_rays
from tests.rtrace.trees.test_bvh import assert_is_reference, reference_binned, reference_sweep
from tests.rtrace.trees.test_kdtree import as_triangles, assert_same_tree, grids, slow_kdtree, triangle_lists

SCENES = {"ball": icosphere(2), "field": height_field(12), "boxes": boxes(), "soup": soup(300, seed=9)}

leaves = st.tuples(st.integers(0, 4), st.integers(0, 5) | st.none()).map(
    lambda pair: {"min_leaf": pair[0], "max_leaf": None if pair[1] is None else max(pair[0], 1) + pair[1]}
)
some_triangles = st.one_of(triangle_lists, grids).map(as_triangles)


def sizes(tree):
    return (tree.nodes["meta"] >> 2)[(tree.nodes["meta"] & 3) == LEAF_AXIS]


@given(some_triangles, leaves, st.sampled_from([0.0, 0.5, 1.0, 3.0]), st.sampled_from([1.0, 2.0]))
@settings(max_examples=60)
def test_bvhs_are_those_of_the_slow_builders(triangles, limits, c_trav, c_isect):
    for builder, slow in (("sweep", reference_sweep), ("binned", reference_binned)):
        tree = build_bvh(triangles, builder=builder, c_trav=c_trav, c_isect=c_isect, **limits)
        assert_is_reference(tree, slow(triangles, trav=c_trav / c_isect, **limits))
        check_tree(tree)


@given(some_triangles, leaves, st.sampled_from([0.0, 1.5, 20.0]), st.sampled_from([1.0, 0.5]), st.integers(1, 6))
@settings(max_examples=60)
def test_kdtrees_are_those_of_the_slow_builder(triangles, limits, c_trav, empty_bonus, refs_per_triangle):
    options = {"c_trav": c_trav, "empty_bonus": empty_bonus, "max_refs": refs_per_triangle * len(triangles), "max_level": 40}
    tree = build_kdtree(triangles, **options, **limits)
    assert_same_tree(tree, slow_kdtree(triangles, **options, **limits))
    check_tree(tree)


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("most", range(1, 9))
@pytest.mark.parametrize("builder", ["sweep", "binned"])
def test_every_largest_leaf_is_reached(name, builder, most):
    triangles = np.concatenate([SCENES[name], SCENES[name][:40]])  # copies, which no plane parts
    tree = build_bvh(triangles, builder=builder, min_leaf=most, max_leaf=most)
    assert most / 2 < sizes(tree).mean() <= sizes(tree).max() <= most and sizes(tree).sum() == len(triangles)
    assert name != "soup" or sizes(tree).max() == most
    assert_same_hits(trace(tree, camera_rays(triangles, 300, 5)), trace_all(triangles, camera_rays(triangles, 300, 5)))


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("most", [1, 2, 4, 8])
def test_a_kdtree_has_larger_leaves_only_where_nothing_parts_them(name, most):
    triangles = SCENES[name]
    tree, default = build_kdtree(triangles, max_leaf=most), build_kdtree(triangles)
    assert (sizes(tree) > most).mean() < 0.05 and sizes(tree).max() <= max(sizes(default).max(), most)
    assert (sizes(build_kdtree(triangles, min_leaf=most)) <= most).sum() <= (sizes(default) <= most).sum()
    assert_same_hits(trace(tree, camera_rays(triangles, 300, 5)), trace_all(triangles, camera_rays(triangles, 300, 5)))


@pytest.mark.parametrize("builder", ["sweep", "binned"])
def test_copies_are_halved(builder):
    tree = build_bvh(np.repeat(soup(1, seed=0), 40_000, axis=0), builder=builder, max_leaf=4)
    assert 2 < sizes(tree).min() <= sizes(tree).max() <= 4 and tree.max_level == 14
    assert sorted(tree.prims.tolist()) == list(range(40_000))


def test_defaults_are_not_written_and_others_are():
    triangles = SCENES["ball"]
    assert build_bvh(triangles).params == {"builder": "sweep"}
    assert build_bvh(triangles, c_trav=1, c_isect=1.0).params == {"builder": "sweep"}
    given = {"c_trav": 0.5, "c_isect": 1.0, "min_leaf": 2, "max_leaf": 4}
    assert build_bvh(triangles, **given).params == {"builder": "sweep", **given}
    assert "max_leaf" not in build_kdtree(triangles).params and "min_leaf" not in build_kdtree(triangles).params
    assert build_kdtree(triangles, max_leaf=3).params["max_leaf"] == 3


def test_the_cache_keeps_them_apart(tmp_path):
    scene = scene_from_triangles(SCENES["soup"], "soup")
    for kind in ("kdtree", "bvh", "bvh64"):
        for limits in ({}, {"max_leaf": 1}, {"min_leaf": 4}, {"min_leaf": 4, "max_leaf": 4}):
            for _ in range(2):
                tree = cached_tree(scene, kind, tmp_path, **limits)
                want = build_tree(scene.triangles, kind, **limits)
                assert tree.kind == kind and tree.params == want.params
                np.testing.assert_array_equal(tree.nodes, want.nodes)
                np.testing.assert_array_equal(tree.prims, want.prims)
    assert len(list(tmp_path.iterdir())) == 8  # both formats of a BVH are one tree


@pytest.mark.parametrize("build", [build_bvh, build_kdtree])
@pytest.mark.parametrize(
    ("option", "bad", "message"),
    [
        ("c_trav", -1.0, "c_trav must be finite and not negative, e.g. 1.5; got -1.0"),
        ("c_isect", 0.0, "c_isect must be finite and positive, e.g. 2; got 0.0"),
        ("c_trav", float("nan"), "c_trav must be finite"),
        ("max_leaf", 0, "max_leaf must be 1 to 2\\*\\*31 - 1, e.g. 4; got 0"),
        ("min_leaf", -1, "min_leaf must be 0 to max_leaf, 4; got -1"),
        ("min_leaf", 5, "min_leaf must be 0 to max_leaf, 4; got 5"),
    ],
)
def test_what_cannot_be_is_refused(build, option, bad, message):
    with pytest.raises(ValueError, match=message):
        build(SCENES["ball"], **({"max_leaf": 4} | {option: bad}))
