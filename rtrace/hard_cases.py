"""Scenes and rays that are hard for floats, each with its answer from exact arithmetic or geometry -> what each structure gets wrong.

Nothing here is compared with another tracer: a closed mesh seen from inside must be hit, a plane's distance is known, and
``rtrace.exact`` decides the rest. Where rounding may decide, the geometry tells; such rays are counted as ambiguous.
"""

import itertools
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import NamedTuple

import numpy as np

from rtrace.bvh import build_bvh
from rtrace.exact import ExactHits, exact_hits
from rtrace.kdtree import build_kdtree
from rtrace.nodes import BVH_NODE, Tree
from rtrace.shapes import box, boxes, height_field, icosphere, rectangle
from rtrace.shoot import OFFSET, shadow_rays
from rtrace.traverse import Hits, Rays, make_rays, trace, trace_all
from rtrace.verify import kappa

#: Largest error of t where float64 rounds, in units of 2^-52 max|v - o| |e1| |e2| |d| / |n . d| (docs/correctness.md).
T_BOUND = 16.0
_UNIT = 2.0**-29  # of verify.kappa, which is meant for float32

#: Brute force is run for up to so many pairs of ray and triangle.
_BRUTE_PAIRS = 10**8

Point = tuple[float, float, float]
Range = tuple[float, float]
Tracer = Callable[[Rays, bool], Hits]
Structures = Mapping[str, Callable[[np.ndarray], Tracer]]


class Answer(NamedTuple):
    """What n rays must find.

    Attributes
    ----------
    is_hit : (n,) bool
        Whether the ray hits; in a case with a light, whether the point that it hits is dark.
    is_ambiguous : (n,) bool
        Whether rounding may decide that.
    nearest, met : list of n dicts of int to (float, float), or None
        The triangles that a closest-hit ray, an any-hit ray may report, and the range of t at each. None: not tested.
    """

    is_hit: np.ndarray
    is_ambiguous: np.ndarray
    nearest: list[dict[int, Range]] | None = None
    met: list[dict[int, Range]] | None = None


class Case(NamedTuple):
    """A scene, (n, 3, 3) float32 triangles, and its rays; with a ``light``, the shadow rays of their hits are judged.

    ``bound`` is the largest error of t, in the unit of ``T_BOUND``; it is 0 where float64 computes without rounding, and
    there nothing is ambiguous.
    """

    triangles: np.ndarray
    rays: Rays
    answer: Answer
    bound: float = T_BOUND
    light: Point | None = None


class Row(NamedTuple):
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
    "brute force": _brute_force,
}

#: Name -> a function of ``long`` (more triangles and rays, minutes instead of seconds) that makes the case.
CASES: dict[str, Callable[[bool], Case]] = {}


def cases(long: bool = False) -> Iterator[tuple[str, Case]]:
    """Yield (name, case), one after another, so that only one is in memory."""
    for name, make in CASES.items():
        yield name, make(long)


def run_all(long: bool = False) -> Iterator[Row]:
    """Run every case through every structure."""
    for name, case in cases(long):
        yield from run_case(name, case)


def run_case(name: str, case: Case, structures: Structures = STRUCTURES) -> list[Row]:
    """Run one case; brute force only where it is affordable."""
    judge = _judge_hits if case.light is None else _judge_shadows
    first, rows = None, []
    if len(case.rays.t_min) * len(case.triangles) <= _BRUTE_PAIRS:
        first = judge(case, _brute_force(case.triangles))[1]
    for structure, build in structures.items():
        if build is _brute_force and first is None:
            continue
        counts, found = judge(case, build(case.triangles))
        first = first or found
        unlike = np.any([a != b for a, b in zip(found, first, strict=True)], axis=0)
        ambiguous = int(case.answer.is_ambiguous.sum())
        rows.append(Row(name, structure, len(unlike), *counts, case.bound, int(unlike.sum()), ambiguous))
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
        unit = kappa(case.triangles, Rays(*(a[chosen] for a in rays)), hits.prim[chosen]) * _UNIT
        worst = max(worst, float((off[off > 0] / unit[off > 0]).max(initial=0.0)))
    return (lost, invented, wrong, worst), [closest.prim, closest.t, first_met.prim >= 0]


def _judge_shadows(case: Case, tracer: Tracer) -> tuple[tuple[int, int, int, float], list[np.ndarray]]:
    """Return the same for shadow rays; a point is dark if it faces away from the light, or its shadow ray meets anything."""
    no_nodes, no_prims = np.empty(0, BVH_NODE), np.empty(0, np.int32)
    bare = Tree("none", no_nodes, no_prims, case.triangles, np.zeros((2, 3), np.float32), 0, {})
    hits = tracer(case.rays, False)
    rays, owner, facing, _ = shadow_rays(bare, case.rays, hits, case.light)
    dark = ~(facing > 0.0)
    dark[owner[tracer(rays, True).prim >= 0]] = True
    sure, is_dark = ~case.answer.is_ambiguous, case.answer.is_hit
    lost, invented = (sure & is_dark & ~dark).sum(), (sure & ~is_dark & dark).sum()
    return (int(lost), int(invented), int((hits.prim < 0).sum()), 0.0), [hits.prim, hits.t, dark]


def exact_case(triangles: np.ndarray, rays: Rays, *, rounds: bool = True, is_closed: bool = False) -> Case:
    """Return the case with its answer from exact arithmetic.

    Parameters
    ----------
    rounds : bool
        False: no step of the triangle test rounds, so ties, ends of the interval and silhouettes are decided exactly.
    is_closed : bool
        The mesh is closed and every origin is inside, so that no ray may miss, whatever edges and vertices it meets.
    """
    triangles = np.ascontiguousarray(triangles, np.float32)
    n = len(rays.t_min)
    answer = Answer(np.empty(n, bool), np.empty(n, bool), [], [])
    copy_of = _lowest_equal(triangles)
    for i, found in enumerate(exact_hits(triangles, rays)):
        one = Rays(*(a[i : i + 1] for a in rays))
        sure, maybe = _in_interval(triangles, one, found, rounds, is_closed)
        answer.is_hit[i], answer.is_ambiguous[i] = bool(sure), bool(maybe) and not sure
        first, slack = min(sure.values(), key=lambda hit: hit[0], default=(np.inf, 0.0))
        near = {p: (float(t), float(t)) for p, (t, s) in (sure | maybe).items() if t - s - slack <= first}
        if not rounds and near:
            near = {min(near): near[min(near)]}
        met = {p: (float(t), float(t)) for p, (t, _) in (sure | maybe).items()}
        if rounds:
            low, high = one.t_min[0], one.t_max[0]
            edge_on = {p: ends for p, ends in found.edge_on.items() if ends[0] <= high and ends[1] >= low}
            near |= {p: ends for p, ends in edge_on.items() if ends[0] <= first}
            met |= edge_on
            answer.is_ambiguous[i] |= bool(edge_on) and not sure
        answer.nearest.append({p: ends for p, ends in near.items() if copy_of[p] == p})
        answer.met.append(met)
    return Case(triangles, rays, answer, T_BOUND if rounds else 0.0)


def _in_interval(triangles, ray: Rays, found: ExactHits, rounds: bool, is_closed: bool):
    """Return two dicts, triangle -> (t, error that t may have): what must be found, and what rounding decides about."""
    sure, maybe = {}, {}
    t_min, t_max = ray.t_min[0], ray.t_max[0]
    if t_min > t_max or not found.t:
        return sure, maybe
    slacks = T_BOUND * _UNIT * kappa(triangles, ray, np.array(list(found.t))) if rounds else np.zeros(len(found.t))
    for (p, t), slack in zip(found.t.items(), slacks.tolist(), strict=True):
        slack = slack or 0  # adding the integer leaves t exact
        if t_min <= t - slack and t + slack <= t_max and (not rounds or is_closed or found.is_surrounded[t]):
            sure[p] = t, slack
        elif t_min <= t + slack and t - slack <= t_max:
            maybe[p] = t, slack
    return sure, maybe


def _lowest_equal(triangles: np.ndarray) -> np.ndarray:
    """Return for each triangle the lowest number of one with the same bytes: only that one is ever reported."""
    as_bytes = triangles.reshape(len(triangles), 9).view("V36")[:, 0]
    _, first, which = np.unique(as_bytes, return_index=True, return_inverse=True)
    return first[which]


def known_case(triangles: np.ndarray, rays: Rays, is_hit, nearest=None, **more) -> Case:
    """Return a case whose answer geometry gives: hit or miss for all rays or each."""
    n = len(rays.t_min)
    answer = Answer(np.broadcast_to(is_hit, n).copy(), np.zeros(n, bool), nearest)
    return Case(np.ascontiguousarray(triangles, np.float32), rays, answer, **more)


def aimed(origins, targets, **interval) -> Rays:
    """Return the rays from every origin to every target, in float32."""
    origins, targets = np.atleast_2d(np.float32(origins)), np.atleast_2d(np.float32(targets))
    origin = np.repeat(origins, len(targets), axis=0)
    direction = np.tile(targets, (len(origins), 1)) - origin
    there = direction.any(axis=1)
    return make_rays(origin[there], direction[there], **interval)


def _register(name: str, *args) -> Callable:
    """Enter a function (*args, long) -> Case into the catalogue."""

    def keep(make):
        CASES[name] = partial(make, *args)
        return make

    return keep


def _corners_and_middles(triangles: np.ndarray) -> np.ndarray:
    """Return the vertices and the middles of the edges, each once, (n, 3) float32."""
    middles = (triangles + np.roll(triangles, 1, axis=1)) / 2
    return np.unique(np.concatenate([triangles.reshape(-1, 3), middles.reshape(-1, 3)]).astype(np.float32), axis=0)


def _lattice(seed: int, shape, low: int, high: int, step: float = 1.0) -> np.ndarray:
    """Return float32 multiples of ``step`` between low and high, picked at random."""
    return (np.random.default_rng(seed).integers(low, high, shape, endpoint=True) * step).astype(np.float32)


def _lattice_rays(seed: int, n: int, low: int, high: int, components, **interval) -> Rays:
    """Return rays from multiples of 1/2 in [low, high]^3, with direction components picked from a list."""
    origin = _lattice(seed, (n, 3), 2 * low, 2 * high, 0.5)
    direction = np.random.default_rng(seed + 1).choice(components, (n, 3))
    there = direction.any(axis=1)
    return make_rays(origin[there], direction[there], **interval)


#: The six axis directions with both zeros in the other components.
_AXES = np.array([np.roll([s, *zeros], k) for k in range(3) for s in (1.0, -1.0) for zeros in itertools.product((0.0, -0.0), repeat=2)])
#: Direction components whose quotients are exact, so that the shear does not round; and others.
_EXACT, _ROUNDING = (0.0, -0.0, 1.0, -1.0, 2.0, -2.0, 4.0), (0.0, -0.0, 1.0, -1.0, 3.0, -5.0, 7.0)

_INSIDE = [[0.0, 0.0, 0.0], [0.1, -0.05, 0.2], [0.3, 0.4, -0.2]]  # of the unit ball
_OUTSIDE = [[3.0, 0.5, -2.0], [-1.5, 1.5, 1.5]]
_OCTAHEDRON = 12 * np.array([[(x, 0, 0), (0, y, 0), (0, 0, z)] for x in (1, -1) for y in (1, -1) for z in (1, -1)], np.float32)


@_register("ball from inside, at vertices and edges")
def _(long):
    ball = icosphere(2 if long else 1)
    return exact_case(ball, aimed(_INSIDE, _corners_and_middles(ball)), is_closed=True)


@_register("ball from outside, at vertices and edges")
def _(long):
    ball = icosphere(1)
    return exact_case(ball, aimed(_OUTSIDE, _corners_and_middles(ball)))


@_register("ball from just inside, at grazing angles")
def _(long):
    ball = icosphere(1)
    points = _corners_and_middles(ball)
    return exact_case(ball, aimed(ball[:: 40 if not long else 10, 0] * np.float32(1 - 2.0**-20), points), is_closed=True)


@_register("large ball from inside, at vertices and edges")
def _(long):
    ball = icosphere(6 if long else 4)
    return known_case(ball, aimed(_INSIDE[1:2], _corners_and_middles(ball)), True)


@_register("octahedron from inside, exactly through vertices and edges")
def _(long):
    steps = np.arange(12)[:, None, None]
    along = (_OCTAHEDRON[:, [0, 1, 2]] * (12 - steps[:, None]) + _OCTAHEDRON[:, [1, 2, 0]] * steps[:, None]) / 12
    return exact_case(_OCTAHEDRON, aimed([[1, 2, -1], [3, -2, 5], [0, 0, 0]], np.unique(along.reshape(-1, 3), axis=0)), is_closed=True)


@_register("height field, exactly through vertices and edges")
def _(long):
    field = height_field(6)
    origins = _lattice(3, (30 if long else 6, 3), -7, 13) + np.float32([0, 12, 0])
    return exact_case(field, aimed(origins, _corners_and_middles(field)))


@_register("flat grid at grazing angles")
def _(long):
    grid = rectangle((0, 0, 0), (8, 0, 0), (0, 0, 8), 8, 8)
    low = [[-1, 2.0**-k, 3.5] for k in ((4, 10, 16, 20) if long else (4, 20))]
    return exact_case(grid, aimed(low, _corners_and_middles(np.float32(grid))))


@_register("boxes, axis-parallel rays in face planes")
def _(long):
    triangles = boxes(3)
    rays = _lattice_rays(5, 6000 if long else 1500, -2, 8, [0.0])
    origin = _lattice(5, (6000 if long else 1500, 3), -4, 16, 0.5)
    return exact_case(triangles, make_rays(origin, np.resize(_AXES, origin.shape)), rounds=False)


@_register("boxes, rays in planes and on edges")
def _(long):
    return exact_case(boxes(3), _lattice_rays(6, 6000 if long else 1500, -2, 8, _EXACT), rounds=False)


@_register("height field, rays on grid lines")
def _(long):
    origin = _lattice(7, (6000 if long else 1500, 3), 0, 8)
    direction = np.resize(np.concatenate([_AXES, [[0, -1, 2], [1, -1, -0.0], [-4, 1, 2], [1, 2, 1], [-0.0, 1, 1], [1, 0, 1]]]), origin.shape)
    return exact_case(height_field(8), make_rays(origin, direction), rounds=False)


@_register("checkerboard floor, rays in it and through its corners")
def _(long):
    floor = rectangle((0, 0, 0), (8, 0, 0), (0, 0, 8), 8, 8).reshape(8, 8, 6, 3)[::2, ::2].reshape(-1, 3, 3)
    rays = _lattice_rays(8, 1500, -1, 9, _EXACT)
    origin = rays.origin * np.float32([1, 0.25, 1])
    return exact_case(floor, make_rays(origin, rays.direction), rounds=False)


@_register("lattice soup, flat ones and copies among them")
def _(long):
    soup = _lattice(9, (80, 3, 3), -2, 2)
    return exact_case(soup, _lattice_rays(10, 12000 if long else 3000, -3, 3, _EXACT), rounds=False)


@_register("lattice soup, slopes that round")
def _(long):
    soup = _lattice(9, (80, 3, 3), -2, 2)
    return exact_case(soup, _lattice_rays(11, 12000 if long else 2000, -3, 3, _ROUNDING))


_QUAD = rectangle((-4, -4, 0), (8, 0, 0), (0, 8, 0)).astype(np.float32)  # in the plane z = 0
_DOWN = _lattice_rays(20, 200, -5, 5, [0.0, 1.0, -1.0, -2.0])


@_register("origins on faces, edges and vertices")
def _(long):
    triangles = boxes(2)
    points = _corners_and_middles(triangles)
    origin = np.repeat(points, 40, axis=0)
    direction = np.concatenate([_AXES, np.array(list(itertools.product((1, -1), (2, -1), (4, -2, 0))), float)])
    direction = np.resize(direction, (len(points), 36, 3))
    return exact_case(triangles, make_rays(np.repeat(points, 36, axis=0), direction), rounds=False)
