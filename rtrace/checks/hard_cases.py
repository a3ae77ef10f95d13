"""Scenes and rays that are hard for floats, with answers from exact arithmetic or geometry -> what each structure gets wrong.

Nothing here is compared with another tracer: a closed mesh seen from inside must be hit, a plane's distance is known, and
``checks.exact_answers`` decides the rest. Where rounding may decide, the geometry tells; such rays are counted as ambiguous.
"""

import itertools
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import NamedTuple

import numpy as np

from rtrace.checks.exact_answers import T_BOUND, Answer, exact_answer, units
from rtrace.scenes.shapes import box, boxes, height_field, icosphere, rectangle
from rtrace.shading import OFFSET, shadow_rays
from rtrace.traverse import Hits, Rays, make_rays, trace, trace_all
from rtrace.trees.bvh import build_bvh
from rtrace.trees.kdtree import build_kdtree
from rtrace.trees.tree import BVH_NODE, Tree
from rtrace.trees.tree_cache import build_tree

#: Brute force is run for up to so many pairs of ray and triangle.
_BRUTE_PAIRS = 3 * 10**7

Point = tuple[float, float, float]
Tracer = Callable[[Rays, bool], Hits]
Structures = Mapping[str, Callable[[np.ndarray], Tracer]]


class Case(NamedTuple):
    """A scene and its rays.

    Attributes
    ----------
    triangles : (n, 3, 3) float32
    rays : Rays
    answer : Answer
        In a case with a light ``is_hit`` tells whether the point that a ray hits is dark.
    bound : float
        Largest error of t, in ``exact.units``: 0 where float64 computes without rounding (then nothing is ambiguous),
        infinite where t is not tested.
    light : 3 floats, optional
        The rays have one origin, the eye; the shadow rays of their hits are what is judged.
    name : str
        Key in ``CASES``.
    """

    triangles: np.ndarray
    rays: Rays
    answer: Answer
    bound: float = T_BOUND
    light: Point | None = None
    name: str = ""


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
    "BVH, 64-byte nodes": partial(_traced, partial(build_tree, kind="bvh64")),
    "brute force": _brute_force,
}

#: Name -> a function of ``long`` (more triangles and rays, minutes instead of seconds) that makes the case.
CASES: dict[str, Callable[[bool], Case]] = {}


def cases(long: bool = False) -> Iterator[Case]:
    """Make the cases one after another, so that only one is in memory."""
    for name, make in CASES.items():
        yield make(long)._replace(name=name)


def run_all(long: bool = False) -> Iterator[Row]:
    """Run every case through every structure."""
    for case in cases(long):
        yield from run_case(case)


def run_case(case: Case, structures: Structures = STRUCTURES) -> list[Row]:
    """Run one case; brute force only where it is affordable."""
    case = case._replace(rays=Rays(*map(np.array, case.rays)))  # writable: Numba compiles anew for read-only arrays
    judge = _judge_hits if case.light is None else partial(_judge_shadows, light=case.light)
    is_affordable = len(case.rays.t_min) * len(case.triangles) <= _BRUTE_PAIRS
    first = judge(case, _brute_force(case.triangles))[1] if is_affordable else None
    rows = []
    for structure, build in structures.items():
        if build is _brute_force and not is_affordable:
            continue
        counts, found = judge(case, build(case.triangles))
        first = first or found
        unlike = np.any([a != b for a, b in zip(found, first, strict=True)], axis=0)
        ambiguous = int(case.answer.is_ambiguous.sum())
        rows.append(Row(case.name, structure, len(unlike), *counts, case.bound, int(unlike.sum()), ambiguous))
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
        unit = units(case.triangles, Rays(*(a[chosen] for a in rays)), hits.prim[chosen])
        worst = max(worst, float((off[off > 0] / unit[off > 0]).max(initial=0.0)))
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


def exact_case(triangles, rays: Rays, *, rounds: bool = True, is_closed: bool = False) -> Case:
    """Return the case with its answer from exact arithmetic (the options are those of ``exact_answer``)."""
    triangles = np.ascontiguousarray(triangles, np.float32)
    answer = exact_answer(triangles, rays, rounds=rounds, is_closed=is_closed)
    return Case(triangles, rays, answer, T_BOUND if rounds else 0.0)


def known_case(triangles, rays: Rays, is_hit) -> Case:
    """Return a case for which geometry tells which rays hit; at what t is not tested."""
    n = len(rays.t_min)
    answer = Answer(np.broadcast_to(is_hit, n), np.zeros(n, bool))
    return Case(np.ascontiguousarray(triangles, np.float32), rays, answer, np.inf)


def aimed(origins, targets, **interval) -> Rays:
    """Return the rays from every origin to every target, in float32."""
    origins, targets = np.atleast_2d(np.float32(origins)), np.atleast_2d(np.float32(targets))
    origin = np.repeat(origins, len(targets), axis=0)
    direction = np.tile(targets, (len(origins), 1)) - origin
    there = direction.any(axis=1)
    return make_rays(origin[there], direction[there], **interval)


#: Direction components whose quotients are exact, so that the shear does not round; and others.
_EXACT, _ROUNDING = (0.0, -0.0, 1.0, -1.0, 2.0, -2.0, 4.0), (0.0, -0.0, 1.0, -1.0, 3.0, -5.0, 7.0)
#: The six axis directions, with either zero in the other components.
_AXES = np.array([np.roll(d, k) for k in range(3) for d in itertools.product((1.0, -1.0), (0.0, -0.0), (0.0, -0.0))])
_INSIDE = np.array([[0.0, 0.0, 0.0], [0.1, -0.05, 0.2], [0.3, 0.4, -0.2]])  # of a ball of radius 1
_OUTSIDE = np.array([[3.0, 0.5, -2.0], [-1.5, 1.5, 1.5]])
_QUAD = rectangle((-4, -4, 0), (8, 0, 0), (0, 8, 0)).astype(np.float32)  # in the plane z = 0
_OCTAHEDRON = 12 * np.array([[(x, 0, 0), (0, y, 0), (0, 0, z)] for x in (1, -1) for y in (1, -1) for z in (1, -1)], np.float32)


def _enter(name: str, *args):
    """Return a decorator that enters a function (*args, long) -> Case into the catalogue."""

    def enter(make):
        CASES[name] = partial(make, *args)
        return make

    return enter


def _corners_and_middles(triangles: np.ndarray) -> np.ndarray:
    """Return the vertices and the middles of the edges, each once, (n, 3) float32."""
    middles = (triangles + np.roll(triangles, 1, axis=1)) / 2
    return np.unique(np.concatenate([triangles, middles]).reshape(-1, 3).astype(np.float32), axis=0)


def _lattice(seed: int, shape, low: int, high: int, step: float = 1.0) -> np.ndarray:
    """Return float32 multiples of ``step``, from low to high steps, picked at random."""
    return (np.random.default_rng(seed).integers(low, high, shape, endpoint=True) * step).astype(np.float32)


def _random_rays(seed: int, origin: np.ndarray, components) -> Rays:
    """Return a ray from each origin, its direction's components picked from a list."""
    direction = np.random.default_rng(seed).choice(components, origin.shape)
    there = direction.any(axis=1)
    return make_rays(origin[there], direction[there])


@_enter("ball from inside, at vertices and edges")
def _ball_from_inside_vertices_edges(long):
    ball = icosphere(2 if long else 1)
    return exact_case(ball, aimed(_INSIDE, _corners_and_middles(ball)), is_closed=True)


@_enter("ball from outside, at vertices and edges")
def _ball_from_outside_vertices_edges(long):
    ball = icosphere(1)
    return exact_case(ball, aimed(_OUTSIDE, _corners_and_middles(ball)))


@_enter("ball from just inside, at grazing angles")
def _ball_from_just_inside_grazing_angles(long):
    ball = icosphere(1)
    origins = ball[:: 10 if long else 40, 0] * np.float32(1 - 2.0**-20)
    return exact_case(ball, aimed(origins, _corners_and_middles(ball)), is_closed=True)


@_enter("large ball from inside, at vertices and edges")
def _large_ball_from_inside_vertices_edges(long):
    ball = icosphere(6 if long else 3)
    return known_case(ball, aimed(_INSIDE[1:2], _corners_and_middles(ball)[:: 16 if long else 1]), True)


def _scaled_ball(scale, long):
    ball = icosphere(1)
    points = np.concatenate([_corners_and_middles(ball), icosphere(0).mean(axis=1)])
    return exact_case(ball * np.float32(scale), aimed(_INSIDE * scale, points * np.float32(scale)), is_closed=True)


for _scale in (2.0**-140, 1e-30, 1e-12, 1e12, 1e30, 1.5e38):
    _enter(f"ball from inside, radius {_scale:.3g}", _scale)(_scaled_ball)


def _moved_ball(extents, long):
    # float32 moves the vertices, all triangles of one alike, by less than the distance from the origins to the surface.
    away = 2 * extents * np.array([1.0, -0.7, 0.4])
    ball = (icosphere(1) + away).astype(np.float32)
    return exact_case(ball, aimed(away + np.array([[0, 0, 0], [0.25, -0.25, 0]]), _corners_and_middles(ball)), is_closed=True)


for _extents in (1e4, 1e6):
    _enter(f"ball from inside, {_extents:g} extents away", _extents)(_moved_ball)


@_enter("directions of length 1e-30 to 1e30")
def _directions_length_1e_30_to_1e30(long):
    ball = icosphere(1)
    rays = aimed(_INSIDE[1:2], _corners_and_middles(ball))
    lengths = np.resize(np.float32([1e-30, 1e-20, 1e-10, 1e10, 1e20, 1e30]), (len(rays.t_min), 1))
    return exact_case(ball, make_rays(rays.origin, rays.direction * lengths), is_closed=True)


@_enter("directions with subnormal components")
def _directions_with_subnormal_components(long):
    origin = _lattice(30, (1000 if long else 250, 3), -2, 12, 0.5)
    return exact_case(boxes(2), _random_rays(31, origin, [0.0, 1e-40, -1e-45, 1e-45, 1.0, -1.0]))


@_enter("octahedron from inside, exactly through vertices and edges")
def _octahedron_exactly_through_vertices_edges(long):
    s = np.arange(12)[:, None, None, None] / 12
    points = np.unique((_OCTAHEDRON * (1 - s) + np.roll(_OCTAHEDRON, 1, axis=1) * s).reshape(-1, 3), axis=0)
    return exact_case(_OCTAHEDRON, aimed([[1, 2, -1], [3, -2, 5], [0, 0, 0]], points), is_closed=True)


@_enter("height field, exactly through vertices and edges")
def _height_field_exactly_through_vertices_edges(long):
    field = height_field(6)
    origins = _lattice(3, (30 if long else 6, 3), -7, 13) + np.float32([0, 12, 0])
    return exact_case(field, aimed(origins, _corners_and_middles(field)))


@_enter("flat grid at grazing angles")
def _flat_grid_grazing_angles(long):
    grid = rectangle((0, 0, 0), (8, 0, 0), (0, 0, 8), 8, 8).astype(np.float32)
    low = [[-1, 2.0**-k, 3.5] for k in ((4, 10, 16, 20) if long else (4, 20))]
    return exact_case(grid, aimed(low, _corners_and_middles(grid)))


@_enter("triangles almost edge-on")
def _triangles_almost_edge_on(long):
    tilt = _lattice(33, (30, 3, 3), -64, 64) * np.float32([1, 1, 2.0**-23])
    origin = _lattice(34, (200, 3), -128, 128, 0.5) * np.float32([1, 1, 2.0**-20])
    direction = _lattice(35, (200, 3), -7, 7) * np.float32([1, 1, 2.0**-21]) + np.float32([8, 0, 0])
    return exact_case(tilt, make_rays(origin, direction))


@_enter("rays in the planes of triangles, past and through them")
def _rays_in_planes_of_triangles(long):
    rng = np.random.default_rng(44)
    triangles = rng.integers(-6, 7, (15, 3, 3))
    triangles[::3, 2] = 2 * triangles[::3, 1] - triangles[::3, 0]  # without area
    u, v = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    i, j, k, m = rng.integers(-4, 5, (4, 200 if long else 40, 1, 1))
    origin, direction = triangles[:, 0] + (i * u + j * v) / 2, k * u + m * v
    there = direction.any(axis=2)
    return exact_case(triangles, make_rays(origin[there], direction[there]))


@_enter("boxes, axis-parallel rays in face planes")
def _boxes_axis_parallel_rays_face_planes(long):
    origin = _lattice(5, (6000 if long else 600, 3), -4, 16, 0.5)
    return exact_case(boxes(3), make_rays(origin, np.resize(_AXES, origin.shape)), rounds=False)


@_enter("boxes, rays in face planes and on edges")
def _boxes_rays_face_planes_on_edges(long):
    origin = _lattice(6, (6000 if long else 600, 3), -4, 16, 0.5)
    return exact_case(boxes(3), _random_rays(6, origin, _EXACT), rounds=False)


@_enter("boxes from 2^40 away")
def _boxes_from_far_away(long):
    triangles = boxes(2)
    targets = _lattice(36, (200, 3), -3, 11, 0.5)
    direction = np.resize(_AXES, targets.shape)
    origin = np.where(direction == 0, targets, -direction * 2.0**40)
    return exact_case(triangles, make_rays(origin, direction), rounds=False)


@_enter("height field, rays on grid lines")
def _height_field_rays_on_grid_lines(long):
    origin = _lattice(7, (6000 if long else 600, 3), 0, 8)
    direction = np.concatenate([_AXES, [[0, -1, 2], [1, -1, -0.0], [-4, 1, 2], [1, 2, 1], [-0.0, 1, 1], [1, 0, 1]]])
    return exact_case(height_field(8), make_rays(origin, np.resize(direction, origin.shape)), rounds=False)


@_enter("checkerboard floor, rays in it and through its corners")
def _checkerboard_floor_rays_through_corners(long):
    floor = rectangle((0, 0, 0), (8, 0, 0), (0, 0, 8), 8, 8).reshape(8, 8, 6, 3)[::2, ::2].reshape(-1, 3, 3)
    origin = _lattice(8, (800, 3), -1, 18, 0.5) * np.float32([1, 0.25, 1])
    return exact_case(floor, _random_rays(8, origin, _EXACT), rounds=False)


@_enter("lattice soup, flat ones and equals among them")
def _lattice_soup_with_flat_ones_and_equals(long):
    soup = _lattice(9, (80, 3, 3), -2, 2)
    return exact_case(soup, _random_rays(10, _lattice(10, (9000 if long else 700, 3), -6, 6, 0.5), _EXACT), rounds=False)


@_enter("lattice soup, slopes that round")
def _lattice_soup_slopes_that_round(long):
    soup = _lattice(9, (80, 3, 3), -2, 2)
    return exact_case(soup, _random_rays(11, _lattice(11, (9000 if long else 700, 3), -6, 6, 0.5), _ROUNDING))


@_enter("lattice soup, zeros of both signs")
def _lattice_soup_zeros_both_signs(long):
    soup = _lattice(12, (80, 3, 3), -1, 1)
    soup[np.random.default_rng(12).random(soup.shape) < 0.5] *= np.float32(-1)
    origin = _lattice(13, (400, 3), -2, 2, 0.5)
    origin[::2] = -origin[::2]
    return exact_case(soup, _random_rays(13, origin, _EXACT), rounds=False)


@_enter("one triangle")
def _one_triangle(long):
    one = np.float32([[[0, 0, 0], [4, 0, 0], [0, 4, 0]]])
    return exact_case(one, _random_rays(14, _lattice(14, (800, 3), -4, 12, 0.5), _EXACT), rounds=False)


@_enter("origins on faces, edges and vertices")
def _origins_on_faces_edges_vertices(long):
    points = _corners_and_middles(boxes(2))[:: 1 if long else 2]
    slanted = list(itertools.product((1, -1), (2, -1), (4, -2, 0)))
    direction = np.concatenate([_AXES[:: 1 if long else 4], slanted])
    origin = np.repeat(points, len(direction), axis=0)
    # At every other ray what lies at t = 0 counts, at the others only what lies beyond.
    t_min = np.resize([0.0, 5e-324], len(origin))
    return exact_case(boxes(2), make_rays(origin, np.tile(direction, (len(points), 1)), t_min), rounds=False)


@_enter("origins a hair off a surface")
def _origins_hair_off_surface(long):
    rng = np.random.default_rng(15)
    origin = rng.choice(np.float32([0, 1e-20, -1e-20, 1e-40, -1e-40, 0.25, 1, 1.5]), (1500 if long else 300, 3))
    return exact_case(boxes(2), make_rays(origin, rng.uniform(-1, 1, origin.shape)))


@_enter("copies: a thousand, some of them reversed")
def _thousand_copies_some_reversed(long):
    triangles = np.concatenate([_QUAD - np.float32([0, 0, 3]), *[_QUAD, _QUAD[:, ::-1]] * 250])
    return exact_case(triangles, _random_rays(16, _lattice(16, (40, 3), -8, 8, 0.5), _EXACT), rounds=False)


@_enter("copies: a hundred thousand")
def _hundred_thousand_copies(long):
    rays = _random_rays(17, _lattice(17, (60, 3), -8, 8, 0.5), _EXACT)
    one = exact_case(_QUAD[:1], rays, rounds=False)
    return one._replace(triangles=np.repeat(_QUAD[:1], 100_000, axis=0), answer=one.answer._replace(met=None))


@_enter("overlapping triangles in two planes")
def _overlapping_triangles_two_planes(long):
    in_plane = _lattice(18, (60, 3, 3), -3, 3) * np.float32([1, 1, 0])
    triangles = np.concatenate([in_plane, np.roll(in_plane[::-1], 1, axis=2) + np.float32([1, 0, 0])])
    return exact_case(triangles, _random_rays(19, _lattice(19, (600, 3), -8, 8, 0.5), _EXACT), rounds=False)


@_enter("slivers, a hundred thousand times as long as wide and more")
def _slivers(long):
    rng = np.random.default_rng(21)
    a, along, across = rng.uniform(-1, 1, (3, 40, 3))
    width = 10.0 ** -rng.uniform(5, 7, (40, 1))
    slivers = np.stack([a, a + along, a + along / 2 + width * across], axis=1).astype(np.float32)
    inner = (slivers * rng.dirichlet([1, 1, 1], (6, 40))[..., None]).sum(axis=2).reshape(-1, 3)
    return exact_case(slivers, aimed(_OUTSIDE, inner))


_ALMOST_0 = np.cos(np.pi / 2)  # 6e-17


@_enter("slivers as wide as cos(pi/2) at the end of a floor")
def _slivers_at_the_end_of_a_floor(long):
    floor = rectangle((-1, 0, 0), (1, 0, 0), (0, 0, 1), 1, 200)
    floor = np.concatenate([floor, [[(0, 0, 0), (_ALMOST_0, 0, 0), (0, 0, 1)]] * 3]).astype(np.float32)
    targets = np.concatenate([floor[:: 1 if long else 6].mean(axis=1), floor[-40:, 1]])
    return exact_case(floor, aimed([[-0.25, 1, 0.5], [_ALMOST_0 / 2, 1, 0.25]], targets))


@_enter("half a disc, its diameter bent by cos(pi/2)")
def _half_disc_with_a_bent_diameter(long):
    angle = np.linspace(np.pi / 2, 3 * np.pi / 2, 160 if long else 40)
    rim = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)
    disc = np.stack([0 * rim[1:], rim[:-1], rim[1:]], axis=1).astype(np.float32)
    targets = np.concatenate([disc.mean(axis=1), disc[::8, 2], [[_ALMOST_0 / 2, 0, 0.5]]])
    return exact_case(disc, aimed([[-0.25, 1, 0.5], [_ALMOST_0 / 2, 1, 0.25], [0, -2, 0]], targets))


@_enter("triangles without area among others")
def _some_triangles_without_area(long):
    a, along = _lattice(22, (40, 3), -3, 3), _lattice(23, (40, 3), -2, 2)
    flat = np.stack([a, a + along, a - along], axis=1)
    flat[::3, 1:] = flat[::3, :1]
    triangles = np.concatenate([flat, _OCTAHEDRON])[np.random.default_rng(24).permutation(48)]
    steps = np.random.default_rng(25).choice(_EXACT, (20, 40, 3))
    steps[~steps.any(axis=2)] = 1
    return exact_case(triangles, make_rays((a - 2 * steps).reshape(-1, 3), steps.reshape(-1, 3)), rounds=False)


@_enter("only triangles without area")
def _only_triangles_without_area(long):
    a, along = _lattice(41, (30, 3), -3, 3), _lattice(42, (30, 3), -2, 2)
    flat = np.stack([a, a + along, a - along], axis=1)
    return exact_case(flat, _random_rays(43, np.repeat(a, 10, axis=0), _EXACT), rounds=False)


def _cone(apex, ring) -> np.ndarray:
    """Return the triangles from the apex to each side of a closed polygon of (n, 3) points."""
    return np.stack([np.broadcast_to(apex, ring.shape), ring, np.roll(ring, -1, axis=0)], axis=1).astype(np.float32)


@_enter("many triangles that share a vertex")
def _many_triangles_around_a_vertex(long):
    angle = np.linspace(0, 2 * np.pi, 1_000_000 if long else 20_000, endpoint=False)
    ring = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)
    share = np.array([0.3, 0.6, 0.9, 1.0])[:, None, None]
    on_edges = (share * np.array([0, 1, 0]) + (1 - share) * ring[:: len(ring) // 100]).reshape(-1, 3)
    in_base = _lattice(26, (100, 3), -1, 1, 0.5) * [1, 0, 1]  # which is open
    rays = aimed([[0.01, 0.25, 0.02]], np.concatenate([on_edges, in_base]))
    return known_case(_cone((0, 1, 0), ring), rays, rays.direction[:, 1] > 0)


@_enter("cone, exactly through its apex and edges")
def _cone_exactly_through_apex_edges(long):
    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    ring = np.round(np.stack([500 * np.cos(angle), 500 * np.sin(angle), 0 * angle], axis=1))
    cone = _cone((0, 0, 400), ring)
    points = np.concatenate([cone[:1, 0], cone[:, :2].mean(axis=1)])
    return exact_case(cone, aimed([[0, 0, 0], [7, -3, 10], [1, 2, 100]], points))


@_enter("triangles with one centre")
def _triangles_with_one_centre(long):
    i, r = np.arange(1, 61)[:, None], np.random.default_rng(27).integers(-1, 2, (60, 2))
    size = np.concatenate([i, 61 - i, i], axis=1)
    third = np.concatenate([r * size[:, :2], size[:, 2:]], axis=1)
    triangles = np.stack([-size, size * [1, 1, -1], third], axis=1)
    return exact_case(triangles, aimed(_lattice(28, (6 if long else 3, 3), -90, 90), triangles.mean(axis=1).round()))


@_enter("needles along a diagonal")
def _needles_along_diagonal(long):
    i = np.arange(3000)
    a = np.stack([i, 0 * i, 7 * i % 11], axis=1)
    needles = np.stack([a, a + 4096, a + np.array([4096, 4097, 4096])], axis=1)
    return exact_case(needles, aimed([[-500, 3000, 900], [9000, 1, 2]], needles[:: 60 if long else 150].mean(axis=1)))


@_enter("stack of sheets, the highest first")
def _stack_of_sheets(long):
    # So thin a stack that no split of a BVH pays: one leaf of all. Between sheets k and k + 1 a ray leaves for sheet k.
    n = 40_000 if long else 3_000
    sheet = np.roll(_QUAD, 1, axis=2) * np.float32(2.0**32)
    sheets = np.tile(sheet, (n, 1, 1))
    sheets[:, :, 0] = np.repeat(np.arange(n)[::-1], 2)[:, None]
    k = np.linspace(0, n - 1, 60).astype(int)
    origin = _lattice(29, (60, 3), -8, 8, 2.0**31) * np.float32([0, 1, 1]) + np.float32([0.5, 0, 0])
    one = exact_case(sheet, make_rays(origin, np.resize([[-1, 0.0, -0.0], [-1, -0.0, 0.0]], (60, 3))), rounds=False)
    nearest = [{2 * (n - 1 - at) + p: t for p, t in near.items()} for at, near in zip(k, one.answer.nearest, strict=True)]
    origin[:, 0] += k
    return Case(sheets, one.rays._replace(origin=origin), one.answer._replace(nearest=nearest, met=None), 0.0)


@_enter("ten boxes around each other, each twice as large")
def _ten_nested_boxes(long):
    nested = np.concatenate([box(3 * (-(2.0**k),), 3 * (2.0**k,)) for k in range(-5, 5)])
    return exact_case(nested, _random_rays(32, _lattice(32, (600, 3), -20, 20) * np.float32(2.0**-4), _EXACT), rounds=False)


@_enter("a triangle at every power of two")
def _triangle_every_power_two(long):
    powers = np.exp2(np.arange(-60.0, 60))[:, None, None] * np.eye(3)
    origins = -np.exp2([[-70.0], [-1.0], [40.0], [70.0]]) * np.ones(3)
    directions = np.array([[1, 1, 1], [1, 2, 4], [4, 1, 1], [3, 5, 7], [1, 0, 0.0]])
    there = np.repeat(origins, 5, axis=0), np.tile(directions, (4, 1))
    back = -there[0], -there[1]
    return exact_case(powers, make_rays(*(np.concatenate(pair) for pair in zip(there, back, strict=True))))


@_enter("t_min and t_max at a hit, and one ulp beside")
def _t_min_and_t_max_at_a_hit(long):
    triangles = np.concatenate([_QUAD + np.float32([0, 0, z]) for z in (1, 2, 2, 5)])
    ends = np.array([x for t in (0.25, 0.5, 1, 2, 5) for x in (np.nextafter(t, 0), t, np.nextafter(t, 9))])
    t_min, t_max = (a.reshape(-1) for a in np.meshgrid([0.0, *ends], [*ends, np.inf]))
    directions = np.array([[0, 0, 1], [1, -1, 2], [0, 1, 4.0]])
    rays = make_rays([0.5, 0.25, 0], np.repeat(directions, len(t_min), axis=0), np.tile(t_min, 3), np.tile(t_max, 3))
    return exact_case(triangles, rays, rounds=False)


@_enter("t_min above t_max")
def _t_min_above_t_max(long):
    return known_case(_QUAD, make_rays([0.5, 0.25, -1], np.resize([[0, 0, 1], [1, -1, 2]], (200, 3)), 2.0, 0.5), False)


@_enter("sheets one ulp apart")
def _sheets_one_ulp_apart(long):
    z = np.float32([1, 1e6])
    z = np.concatenate([np.nextafter(z, np.float32(0)), z, np.nextafter(z, np.float32(1e9))])
    sheets = np.concatenate([_QUAD * np.float32(100) + np.float32([0, 0, at]) for at in z])
    middle = (z[[0, 2, 4]] / 2)[:, None] * np.float32([0, 0, 1])
    origins = np.concatenate([middle, middle * 3, _OUTSIDE])
    return exact_case(sheets, aimed(origins, sheets.reshape(-1, 3) * np.float32([0.37, 0.11, 1])))


@_enter("boxes one ulp wide")
def _boxes_one_ulp_wide(long):
    ulp = 2.0**-23
    one, far = box((1, 1, 1), 3 * (1 + ulp,)), box((2, 1, 1), 3 * (2 + 2 * ulp,))
    points = 1 + _lattice(37, (600, 3), -1, 2, ulp)
    direction = np.resize(_AXES, points.shape)
    return exact_case(np.concatenate([one, far]), make_rays(points - 2 * direction, direction), rounds=False)


@_enter("a tiny ball in a huge box")
def _tiny_ball_in_a_huge_box(long):
    triangles = np.concatenate([icosphere(1) * np.float32(1e-12), box(3 * (-1e12,), 3 * (1e12,))])
    origins = np.concatenate([_INSIDE[1:] * 1e-12, _OUTSIDE[:1], _OUTSIDE[:1] * 1e11])
    return exact_case(triangles, aimed(origins, _corners_and_middles(icosphere(1) * np.float32(1e-12))), is_closed=True)


@_enter("soup of mixed magnitudes")
def _soup_mixed_magnitudes(long):
    rng = np.random.default_rng(38)
    values = np.float32([0, 1, -1, 1e-5, -1e-5, 1e-10, -1e-10, 1e-20, -1e-20])
    soup = rng.choice(values, (30, 3, 3))
    origin = rng.choice(values, (4000 if long else 800, 3))
    inner = (soup[rng.integers(0, 30, len(origin))] * rng.dirichlet([1, 1, 1], len(origin))[..., None]).sum(axis=1)
    return exact_case(soup, make_rays(origin, inner - origin))


@_enter("soup of random exponents")
def _soup_random_exponents(long):
    rng = np.random.default_rng(39)
    soup, origin, direction = (
        (rng.uniform(-2, 2, shape) * np.exp2(rng.integers(-100, 100, shape))).astype(np.float32)
        for shape in ((30, 3, 3), (400, 3), (400, 3))
    )
    direction[::2] = soup[np.resize(np.arange(30), 200), 0] - origin[::2]
    return exact_case(soup, make_rays(origin, direction))


# Strays: triangles far out of the scene.


def _stray_case(size, long):
    """A ball seen from inside and past it, and two triangles far away, one of them with a corner at the ball."""
    ball = icosphere(1)
    far = np.float32(size) * np.float32([[[1, 0, 0], [1, 1, 0], [1, 0, 1]], [[-1, -0.5, 0], [0, 0, 0], [-1, 0, -0.5]]])
    far[1, 1] = 0, 4, 0
    triangles = np.concatenate([ball, far])
    points = _corners_and_middles(ball)
    near = aimed(_INSIDE if long else _INSIDE[1:2], points), aimed(_OUTSIDE, points[:: 1 if long else 4])
    weights = np.random.default_rng(50).dirichlet([1, 1, 1], (60, 2))
    inner = (far * weights[..., None]).sum(axis=2).reshape(-1, 3)
    to_far = aimed(_OUTSIDE, inner), aimed(_OUTSIDE, _corners_and_middles(far))
    rays = Rays(*(np.concatenate(parts) for parts in zip(*near, *to_far, strict=True)))
    shrunk = rays.direction / np.maximum(np.abs(rays.direction).max(axis=1, keepdims=True), np.float32(1))
    return exact_case(triangles, make_rays(rays.origin, shrunk))


for _size in (1e9, 1e12, 1e13, 1e14, 1e20, 1e30, 1e38):
    _enter(f"strays: two triangles {_size:g} away", _size)(_stray_case)


@_enter("strays: triangles of sizes from 1 to 1e37 in one another")
def _strays_in_one_another(long):
    rng = np.random.default_rng(51)
    size = 10.0 ** np.concatenate([np.zeros(20), rng.uniform(5, 37, 20)])[:, None, None]
    soup = (rng.uniform(-1, 1, (40, 3, 3)) * size).astype(np.float32)
    soup[::7, 0] = rng.uniform(-1, 1, (6, 3))
    n = 1200 if long else 300
    inner = (soup[rng.integers(0, 40, n)].astype(float) * rng.dirichlet([1, 1, 1], n)[..., None]).sum(axis=1)
    origin = rng.uniform(-2, 2, (n, 3)).astype(np.float32)
    direction = inner - origin
    return exact_case(soup, make_rays(origin, direction / np.abs(direction).max(axis=1, keepdims=True)))


@_enter("rays that are none: not finite, or without a direction")
def _rays_that_are_none(long):
    rng = np.random.default_rng(52)
    n = 2000 if long else 400
    origin, direction = rng.uniform(-2, 2, (n, 3)).astype(np.float32), rng.uniform(-1, 1, (n, 3)).astype(np.float32)
    bad, axis = rng.choice(np.float32([np.nan, np.inf, -np.inf]), n), rng.integers(0, 3, n)
    for part, which in ((origin, slice(0, n, 3)), (direction, slice(1, n, 3))):
        part[np.arange(n)[which], axis[which]] = bad[which]
    direction[2::3] = 0.0
    return known_case(icosphere(1), Rays(origin, direction, np.zeros(n), np.full(n, np.inf)), False)


def _shadow_case(triangles, eye, targets, light, is_dark, is_ambiguous) -> Case:
    """Return a case of rays from the eye to points that it sees, which are dark or lit."""
    answer = Answer(np.broadcast_to(is_dark, len(targets)), np.broadcast_to(is_ambiguous, len(targets)))
    x, y, z = (float(a) for a in light)
    return Case(triangles.astype(np.float32), aimed([eye], targets), answer, np.inf, (x, y, z))


def _room_case(light, is_dark, scale, long):
    """A closed room, seen from inside: all its walls are lit by a light inside, none by one outside."""
    rng = np.random.default_rng(40)
    inner = rng.uniform(0, 8, (2000 if long else 400, 3))
    inner[np.arange(len(inner)), rng.integers(0, 3, len(inner))] = rng.choice([0.0, 8.0], len(inner))
    points = np.concatenate([inner, _corners_and_middles(box((0, 0, 0), (8, 8, 8)))])
    to_wall = np.sort(np.minimum(points, 8 - points), axis=1)[:, 1]  # of the other walls, the next one
    same_wall = ((points == light) & ((points == 0) | (points == 8))).any(axis=1)
    # A shadow ray starts that far from its wall; no nearer to another one can it tell on which side of that it starts.
    unsure = (to_wall <= 4 * 8 * OFFSET) | same_wall
    room = box((0, 0, 0), (8, 8, 8)) * scale
    return _shadow_case(room, np.array([3, 4, 5]) * scale, points * scale, np.array(light) * scale, is_dark, unsure)


def _ball_case(scale, away, long):
    """A ball, lit and seen from outside: a triangle is lit if it faces the light, whatever lies beside it."""
    eye, light = (np.array([3.0, 1.0, 2.0]) + away) * scale, (np.array([-1.0, 4.0, 2.0]) + away) * scale
    ball = ((icosphere(3 if long else 2) + away) * scale).astype(np.float32)
    shape = ball.astype(np.float64)
    middle, normal = shape.mean(axis=1), np.cross(shape[:, 1] - shape[:, 0], shape[:, 2] - shape[:, 0])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    seen = ((eye - middle) * normal).sum(axis=1) > 0.1 * scale
    cosine = ((light - middle) * normal).sum(axis=1)[seen] / scale
    targets = np.concatenate([middle[seen], (2 * middle + shape[:, 0])[seen] / 3])
    return _shadow_case(ball, eye, targets, light, np.tile(cosine <= 0, 2), np.tile(np.abs(cosine) < 0.02, 2))


def _floor_case(body, light, scale, is_dark, long):
    """A floor with a body above it that casts a known shadow; ``is_dark`` is None where rounding may decide."""
    x, z = (a.reshape(-1) for a in np.meshgrid(np.linspace(-7.9, 7.9, 40), np.linspace(-7.9, 7.9, 40)))
    floor = rectangle((-16, 0, -16), (0, 0, 32), (32, 0, 0), 4, 4)
    points = np.stack([x, 0 * x, z], axis=1)
    dark, unsure = is_dark(x, z)
    triangles = np.concatenate([floor, body]) * scale
    return _shadow_case(triangles, np.array([7.5, 0.5, 7.0]) * scale, points * scale, light, dark, unsure)


def _below(left, right):
    """Return the shadow of a box: x from left to right, z from -1 to 1."""

    def shadow(x, z):
        from_edge = np.minimum(np.minimum(x - left, right - x), 1 - np.abs(z))
        return from_edge > 0, np.abs(from_edge) < 1e-3

    return shadow


_FLYING = box((-1, 2, -1), (1, 3, 1))
for _scale in (1e-12, 1e-6, 1.0, 1e6, 1e12):
    _enter(f"shadows: room with the light inside, scale {_scale:g}", (6, 2, 3), False, _scale)(_room_case)
    _enter(f"shadows: room with the light outside, scale {_scale:g}", (-6, 20, 3), True, _scale)(_room_case)
    _enter(f"shadows: ball, scale {_scale:g}", _scale, 0.0)(_ball_case)
    _enter(f"shadows: light 1e30 away, scale {_scale:g}", _FLYING, (0, 1e30, 0), _scale, _below(-1, 1))(_floor_case)
_enter("shadows: light 1e300 away", _FLYING, (0, 1e300, 0), 1.0, _below(-1, 1))(_floor_case)
_enter("shadows: ball, 1e4 radii away", 1.0, np.array([1e4, -7e3, 4e3]))(_ball_case)
_enter("shadows: light 1e30 away, slanted", _FLYING, (1e30, 1e30, 0), 1.0, _below(-4, -1))(_floor_case)
_enter("shadows: light on a wall", (8, 3, 5), False, 1.0)(_room_case)
_enter("shadows: light in a corner", (8, 8, 8), False, 1.0)(_room_case)
_BALL = icosphere(2) + np.array([0, 4, 0])
_enter("shadows: light inside a ball", _BALL, (0.1, 4.2, 0.1), 1.0, lambda x, z: (True, False))(_floor_case)
