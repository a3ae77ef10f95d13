"""Triangles in one plane that overlap: the least t as computed, of equal ones the lowest number, in every structure."""

import numpy as np
import pytest

from rtrace.rays import make_rays
from rtrace.traverse import trace, trace_all
from rtrace.trees.bvh import build_bvh
from rtrace.trees.kdtree import build_kdtree

_PLANE = np.float32(
    [
        [[0, 0, 0.3], [3, 0, 0.3], [3, 2, 0.3]],
        [[0, 0, 0.3], [3, 2, 0.3], [0, 2, 0.3]],
        [[1, 0.5, 0.3], [4, 0.5, 0.3], [1, 3, 0.3]],
        [[4, 0.5, 0.3], [4, 3, 0.3], [1, 3, 0.3]],
    ]
)
_ONE = np.float32([[0.1, 0.2, 0.3], [1.3, 0.4, 0.9], [0.2, 1.1, 0.7]])
_COPIES = np.stack([_ONE, _ONE[[1, 2, 0]], _ONE[[2, 1, 0]], _ONE])


@pytest.mark.parametrize("triangles, least", [(_PLANE, 100), (_COPIES, 100)])
def test_rounding_may_decide_between_triangles_in_one_plane(triangles, least):
    """docs/correctness.md says so: t of other corners, or corners in another order, differs in its last bits."""
    rng = np.random.default_rng(1)
    weights = rng.dirichlet([1, 1, 1], 5000)
    origin = rng.uniform(-2, 6, (5000, 3))
    targets = (triangles[rng.integers(len(triangles), size=5000)] * weights[..., None]).sum(axis=1)
    rays = make_rays(origin, targets - origin)
    each = np.stack([trace_all(triangles[i : i + 1].copy(), rays).t for i in range(len(triangles))])
    want = np.where(np.isfinite(each.min(axis=0)), each.argmin(axis=0), -1)  # the first, so the lowest, of the least
    for hits in (trace_all(triangles, rays), trace(build_kdtree(triangles), rays), trace(build_bvh(triangles), rays)):
        np.testing.assert_array_equal(hits.prim, want)
    first = np.isfinite(each).argmax(axis=0)
    met = np.isfinite(each)
    assert ((want != first) & (met.sum(axis=0) > 1)).sum() > least  # a higher number, nearer by rounding alone
    spread = np.where(met, each, -np.inf).max(axis=0) - each.min(axis=0)
    both = met.sum(axis=0) > 1
    assert np.nanmax(spread[both] / each.min(axis=0)[both]) < 1e-9
