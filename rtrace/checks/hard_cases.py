"""Scenes and rays that are hard for floats, with answers from exact arithmetic or geometry -> what each structure gets wrong.

Nothing here is compared with another tracer: a closed mesh seen from inside must be hit, a plane's distance is known, and
``checks.exact_answers`` decides the rest. Where rounding may decide, the geometry tells; such rays are counted as ambiguous.
"""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import NamedTuple

import numpy as np

from nptrace_base.pools import thread_pool
from rtrace.checks.cases import degenerate, edges, lattices, limits, shadows, strays
from rtrace.checks.cases.case import Case
from rtrace.checks.exact_answers import rounding_of_t
from rtrace.rays import Hits, Rays
from rtrace.shading import shadow_rays
from rtrace.traverse import trace, trace_all
from rtrace.trees.bvh import build_bvh
from rtrace.trees.kdtree import build_kdtree
from rtrace.trees.tree import BVH_NODE, Tree
from rtrace.trees.tree_cache import build_tree
from traces.frame import Point

#: Brute force is run for up to so many pairs of ray and triangle.
_BRUTE_PAIRS = 3 * 10**7

Tracer = Callable[[Rays, bool], Hits]
Structures = Mapping[str, Callable[[np.ndarray], Tracer]]


class CaseRow(NamedTuple):
    """One case through one structure, closest-hit and any-hit rays together.

    ``wrong`` counts hits of another triangle than the nearest, of a higher number than its equal, or outside t_min to
    t_max; ``unlike`` the rays answered otherwise, in any bit, than by brute force (where that takes too long: than by the
    first structure). ``lost`` shadow rays are leaks, ``invented`` ones acne.
    """

    case: str
    structure: str
    n_rays: int
    lost: int
    invented: int
    wrong: int
    t_error: float
    bound: float
    unlike: int
    ambiguous: int

    @property
    def is_good(self) -> bool:
        """Whether nothing is lost, invented, wrong or unlike brute force, and t is within its bound."""
        return not (self.lost or self.invented or self.wrong or self.unlike) and self.t_error <= self.bound


def _traced(build: Callable[[np.ndarray], Tree], triangles: np.ndarray) -> Tracer:
    tree = build(triangles)
    return lambda rays, any_hit: trace(tree, rays, any_hit=any_hit)


def _brute_force(triangles: np.ndarray) -> Tracer:
    return lambda rays, any_hit: trace_all(triangles, rays)


#: What every case is run through: triangles -> a function of (rays, any_hit) -> Hits.
STRUCTURES: Structures = {
    "kd-tree": partial(_traced, build_kdtree),
    "kd-tree, 3 levels": partial(_traced, partial(build_kdtree, max_level=3)),
    "BVH": partial(_traced, build_bvh),
    "BVH, binned": partial(_traced, partial(build_bvh, builder="binned")),
    "BVH, 64-byte nodes": partial(_traced, partial(build_tree, kind="bvh64")),
    "brute force": _brute_force,
}

#: All cases by name, in the order in which they are reported.
CASES = {**edges.CASES, **lattices.CASES, **degenerate.CASES, **limits.CASES, **strays.CASES, **shadows.CASES}


def cases(long: bool = False) -> Iterator[Case]:
    """Make the cases one after another, so that only one is in memory."""
    for name, make in CASES.items():
        yield make(long)._replace(name=name)


def run_all(long: bool = False, threads: int = 1) -> Iterator[CaseRow]:
    """Run every case through every structure."""
    for case in cases(long):
        yield from run_case(case, threads=threads)


def run_case(case: Case, structures: Structures = STRUCTURES, *, threads: int = 1) -> list[CaseRow]:
    """Run one case, its structures in ``threads``; brute force only where it is affordable."""
    case = case._replace(rays=Rays(*map(np.array, case.rays)))  # writable: Numba compiles anew for read-only arrays
    judge = _judge_hits if case.light is None else partial(_judge_shadows, light=case.light)
    is_affordable = len(case.rays.t_min) * len(case.triangles) <= _BRUTE_PAIRS
    first = judge(case, _brute_force(case.triangles))[1] if is_affordable else None
    rows = []
    chosen = {name: build for name, build in structures.items() if build is not _brute_force or is_affordable}
    with thread_pool(threads) as pool:
        judged = list(pool.map(lambda build: judge(case, build(case.triangles)), chosen.values()))
    for structure, (counts, found) in zip(chosen, judged, strict=True):
        first = first or found
        unlike = np.any([a != b for a, b in zip(found, first, strict=True)], axis=0)
        ambiguous = int(case.answer.is_ambiguous.sum())
        rows.append(CaseRow(case.name, structure, len(unlike), *counts, case.bound, int(unlike.sum()), ambiguous))
    return rows


def _judge_hits(case: Case, tracer: Tracer) -> tuple[tuple[int, int, int, float], list[np.ndarray]]:
    """Return ((lost, invented, wrong, error of t), what must equal brute force)."""
    rays, answer = case.rays, case.answer
    closest, first_met = tracer(rays, False), tracer(rays, True)
    lost = invented = wrong = 0
    worst = 0.0
    for hits, right in ((closest, answer.nearest), (first_met, answer.met)):
        got, sure = hits.prim >= 0, ~answer.is_ambiguous
        lost += int((sure & answer.is_hit & ~got).sum())
        invented += int((sure & ~answer.is_hit & got).sum())
        wrong += int((got & ~((rays.t_min <= hits.t) & (hits.t <= rays.t_max))).sum())
        if right is None:
            continue
        chosen = np.array([i for i in np.flatnonzero(got) if hits.prim[i] in right[i]], int)
        wrong += int((got & (answer.is_hit | answer.is_ambiguous)).sum()) - len(chosen)
        low, high = np.array([right[i][hits.prim[i]] for i in chosen]).reshape(-1, 2).T
        off = np.maximum(low - hits.t[chosen], hits.t[chosen] - high).clip(0.0)
        rounding = rounding_of_t(case.triangles, Rays(*(a[chosen] for a in rays)), hits.prim[chosen])
        worst = max(worst, float((off[off > 0] / rounding[off > 0]).max(initial=0.0)))
    return (lost, invented, wrong, worst), [closest.prim, closest.t, first_met.prim >= 0]


def _judge_shadows(case: Case, tracer: Tracer, light: Point) -> tuple[tuple[int, int, int, float], list[np.ndarray]]:
    """Return the same for shadow rays; a point is dark if it faces away from the light, or its shadow ray meets anything."""
    no_nodes, no_prims, nowhere = np.empty(0, BVH_NODE), np.empty(0, np.int32), np.zeros((2, 3), np.float32)
    bare = Tree("none", no_nodes, no_prims, case.triangles[:0], case.triangles, nowhere, nowhere, 0, {})
    hits = tracer(case.rays, False)
    rays, owner, (facing, _) = shadow_rays(bare, case.rays, hits, light)
    dark = ~(facing > 0.0)
    dark[owner[tracer(rays, True).prim >= 0]] = True
    sure, is_dark = ~case.answer.is_ambiguous, case.answer.is_hit
    lost, invented = (sure & is_dark & ~dark).sum(), (sure & ~is_dark & dark).sum()
    return (int(lost), int(invented), int((hits.prim < 0).sum()), 0.0), [hits.prim, hits.t, dark]
