"""The sort that both builders share: every length around its runs, every order, and a leaf too large to sort by insertion."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rtrace.trees.bvh import build_bvh
from rtrace.trees.kdtree import build_kdtree
from rtrace.trees.merge_sort import sort


@given(st.lists(st.integers(-50, 50), max_size=200), st.integers(0, 200), st.sampled_from([np.int32, np.int64]))
def test_the_first_keys_are_sorted_and_the_others_stay(values, n, dtype):
    keys = np.array(values, dtype)
    n = min(n, keys.size)
    want = np.concatenate([np.sort(keys[:n]), keys[n:]])
    sort(keys, n, np.empty(n, dtype))
    np.testing.assert_array_equal(keys, want)


@pytest.mark.parametrize("n", [1, 15, 16, 17, 32, 33, 64, 65, 1000])
def test_backwards(n):
    keys = np.arange(n)[::-1].copy()
    sort(keys, n, np.empty_like(keys))
    np.testing.assert_array_equal(keys, np.arange(n))


@pytest.mark.parametrize("build", [build_bvh, build_kdtree])
def test_a_stack_numbered_backwards_is_one_sorted_leaf(build):
    """100,000 wide triangles close above one another: no split pays. Insertion sort would move five billion numbers."""
    triangles = np.zeros((100_000, 3, 3), np.float32)
    triangles[:, 1, 1] = triangles[:, 2, 2] = 1e18
    triangles[:, :, 0] = np.arange(len(triangles))[::-1, None]
    tree = build(triangles, **({"max_level": 0} if build is build_kdtree else {}))
    assert len(tree.nodes) == 1
    np.testing.assert_array_equal(tree.prims, np.arange(len(triangles)))
