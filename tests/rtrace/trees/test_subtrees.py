"""A BVH built by several threads is that of one thread, byte for byte."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtrace.scenes.shapes import boxes, height_field, icosphere, soup
from rtrace.trees import subtrees
from rtrace.trees.bvh import build_bvh
from rtrace.trees.kdtree import build_kdtree
from rtrace.trees.tree_cache import build_tree

coordinate = st.integers(-3, 3).map(float)
triangle_lists = st.lists(st.lists(coordinate, min_size=9, max_size=9), min_size=1, max_size=60)


@pytest.fixture
def small_parts(monkeypatch):
    monkeypatch.setattr(subtrees, "LEAST_PART", 2)


def assert_same(triangles, threads, **options):
    for build in (build_bvh, build_kdtree):
        assert_same_tree(build(triangles, **options), build(triangles, threads=threads, **options))


def assert_same_tree(one, several):
    assert one.nodes.tobytes() == several.nodes.tobytes()
    assert one.prims.tobytes() == several.prims.tobytes()
    assert one.max_level == several.max_level and one.bounds.tobytes() == several.bounds.tobytes()


@settings(max_examples=60, deadline=None)
@given(triangle_lists, st.integers(2, 4), st.integers(0, 3), st.one_of(st.none(), st.integers(3, 5)))
def test_threads_change_nothing(triangles, threads, min_leaf, max_leaf):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(subtrees, "LEAST_PART", 2)
        array = np.array(triangles, np.float32).reshape(-1, 3, 3)
        array[::3] = -array[::3] * 0  # zeros of both signs
        assert_same(array, threads, min_leaf=min_leaf, max_leaf=max_leaf)


@pytest.mark.parametrize(
    "triangles", [soup(300, 1), icosphere(3), height_field(12), boxes(5)], ids=["soup", "ball", "hills", "boxes"]
)
def test_threads_change_nothing_on_scenes(small_parts, triangles):
    assert_same(triangles, 3)
    assert_same(np.concatenate([triangles] * 5), 2, max_leaf=2)


def test_a_large_scene_is_built_in_parts(monkeypatch):
    sizes = []
    build_in_parts = subtrees.build_in_parts

    def noted(step, whole, size, threads):
        return build_in_parts(lambda each, alone: sizes.append((size(each), alone)) or step(each, alone), whole, size, threads)

    monkeypatch.setattr("rtrace.trees.bvh.build_in_parts", noted)
    tree = build_tree(soup(70_000, 1), "bvh", threads=2)
    assert len(sizes) > 8 and any(alone for _, alone in sizes)
    assert len(tree.prims) == 70_000
    sizes.clear()
    build_tree(soup(1000, 1), "bvh", threads=2)
    assert sizes == [(1000, False)]


@pytest.mark.parametrize("max_refs", [None, 400, 330, 301])
def test_a_ceiling_of_references_is_that_of_one_thread(small_parts, max_refs):
    """Parts cannot share it: where it may matter, the tree is built by one thread."""
    triangles = soup(300, 2)
    one, several = (build_kdtree(triangles, max_refs=max_refs, threads=threads) for threads in (1, 3))
    assert_same_tree(one, several)
    assert max_refs is None or len(one.prims) <= max_refs
