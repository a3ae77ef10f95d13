"""All structures are right on all hard cases, exact arithmetic is right where the answer is known, broken rules are caught."""

import functools
import math
from fractions import Fraction
from functools import partial

import numpy as np
import pytest

from rtrace.checks import exact_answers, hard_cases
from rtrace.checks.cases.case import Case, exact_case
from rtrace.checks.exact_answers import exact_answer, exact_hits, whole_numbers
from rtrace.checks.hard_cases import STRUCTURES, CaseRow, run_case
from rtrace.rays import Hits, Rays, make_rays
from rtrace.scenes.shapes import icosphere
from rtrace.shading import shadow_rays
from rtrace.traverse import trace, trace_recorded
from rtrace.trees.bvh import build_bvh
from rtrace.trees.kdtree import build_kdtree
from tests.hard_cases import CASES


@functools.cache
def case_of(name) -> Case:
    return CASES[name](False)._replace(name=name)


@functools.cache
def rows_of(name) -> dict[str, CaseRow]:
    return {row.structure: row for row in run_case(case_of(name))}


@pytest.mark.parametrize("structure", STRUCTURES)
@pytest.mark.parametrize("name", CASES)
def test_nothing_is_lost_invented_or_unlike_brute_force(name, structure):
    row = rows_of(name).get(structure)
    assert row.is_good if row else structure == "brute force", row  # which takes too long in the largest


def test_the_catalogue_covers_both_outcomes_and_excuses_little():
    cases = list(map(case_of, CASES))
    assert len(cases) > 90 and len({case.name for case in cases}) == len(cases)
    n = sum(len(case.rays.t_min) for case in cases)
    assert sum(int(case.answer.is_hit.sum()) for case in cases) > 0.3 * n
    assert sum(int((~case.answer.is_hit & ~case.answer.is_ambiguous).sum()) for case in cases) > 0.2 * n
    assert sum(int(case.answer.is_ambiguous.sum()) for case in cases) < 0.1 * n
    assert not any(case.answer.is_ambiguous.any() for case in cases if case.bound == 0.0)


# Exact arithmetic, on what a hand can compute.

ONE = np.float32([[[0, 0, 2], [4, 0, 2], [0, 4, 2]]])


def line(origin, direction, triangles=ONE):
    return exact_hits(np.float32(triangles), make_rays([origin], [direction]))[0]


@pytest.mark.parametrize(
    "origin, direction, t, is_firm",
    [
        ([1, 1, 0], [0, 0, 1], 2, True),
        ([1, 1, 0], [0, 0, -4], Fraction(-1, 2), True),
        ([1, 1, 0], [0, 0, 3], Fraction(2, 3), True),
        ([0, 0, 0], [1, 1, 5], Fraction(2, 5), True),
        ([2, 2, 0], [0, 0, 1], 2, False),  # on its long edge, which nothing shares
        ([0, 4, 0], [0, 0, 1], 2, False),  # its corner
        ([0, 4, 2], [1, 2, 7], 0, False),  # starts in the corner
        ([1, 1, 0], [0, 0, 1e-30], 2 / Fraction(float(np.float32(1e-30))), True),
    ],
)
def test_a_line_meets_a_triangle_at_an_exact_t(origin, direction, t, is_firm):
    found = line(origin, direction)
    assert found.t == {0: t} and found.is_firm == {t: is_firm} and found.touched == {}


@pytest.mark.parametrize(
    "origin, direction, touched",
    [
        ([3, 3, 0], [0, 0, 1], {}),  # beside it
        ([-1, 1, 2], [1, 0, 0], {0: (1, 5)}),  # in its plane, through it
        ([-1, 5, 2], [1, 0, 0], {}),  # in its plane, beside it
        ([-1, 4, 2], [2, 0, 0], {0: (0.5, 2.5)}),  # in its plane, through a corner
        ([2, 2 + 1e-15, 0], [0, 0, 1], {}),  # as far as float32 goes this is the edge
        ([0, -1e-20, 0], [0, 0, 2], {0: (1, 1)}),  # misses a corner by less than rounding moves it
        ([0, -1e-12, 0], [0, 0, 2], {}),  # by more
    ],
)
def test_what_is_not_met_may_be_touched(origin, direction, touched):
    found = line(origin, direction)
    assert found.t == {} or origin[1] > 2
    assert found.touched.keys() == touched.keys()
    for got, want in zip(found.touched.values(), touched.values(), strict=True):
        assert got == pytest.approx(want, rel=1e-12)


def test_a_shared_edge_or_vertex_is_firm_only_if_triangles_lie_all_around_it():
    a, b, c, d = (0, 0, 1), (4, 0, 1), (0, 4, 1), (-4, -4, 1)
    fan = np.float32([[a, b, c], [a, c, d], [b, a, d]])
    third = Fraction(1, 3)
    assert line([0, 0, 0], [0, 0, 3], fan) == ({0: third, 1: third, 2: third}, {third: True}, {})
    assert line([0, 0, 0], [0, 0, 1], fan[:2]).is_firm == {1: False}
    assert line([0, 1, 0], [0, 0, 1], fan[:2]) == ({0: 1, 1: 1}, {1: True}, {})
    folded = np.concatenate([fan[:1], fan[1:2] * np.float32([-1, 1, 1])])  # both on one side of the edge: a silhouette
    assert line([0, 1, 0], [0, 0, 1], folded) == ({0: 1, 1: 1}, {1: False}, {})
    reversed_too = np.concatenate([fan, fan[:, ::-1]])
    assert line([0, 0, 0], [0, 0, 1], reversed_too).is_firm == {1: True}


def test_a_triangle_without_area_is_not_met():
    points = np.float32([[[1, 1, 1]] * 3, [[0, 0, 0], [2, 2, 2], [1, 1, 1]]])
    found = line([3, 1, 1], [-1, 0, 0], points)
    assert found.t == {} and found.touched.keys() == {0, 1}
    answer = exact_answer(points, make_rays([3, 1, 1], [[-1, 0, 0]]), rounds=False)
    assert not answer.is_hit[0] and not answer.is_ambiguous[0] and answer.met == [{}]


def test_small_and_large_whole_numbers_give_the_same():
    rng = np.random.default_rng(1)
    soup, origin = rng.integers(-3, 4, (20, 3, 3)), rng.integers(-5, 6, (60, 3))
    direction = rng.integers(-3, 4, (60, 3))
    direction[~direction.any(axis=1)] = 1
    small = exact_hits(np.float32(soup), make_rays(origin, direction))
    assert whole_numbers(np.float32(soup))[0].dtype == np.int64
    far = np.float32(np.full((1, 3, 3), 2.0**90))  # never met, but too large for int64
    large = exact_hits(np.concatenate([np.float32(soup), far]), make_rays(origin, direction))
    assert [found.t for found in small] == [found.t for found in large]
    assert sum(len(found.t) for found in small) > 30


@pytest.mark.parametrize("values", [[0, -0.0, 3, -5.5], [1e-45, 1], [3e38, -1e-45, 0.1], [2.0**17, 2.0**-1], [0, 0]])
def test_floats_are_whole_numbers_times_a_power_of_two(values):
    values = np.float32(values)
    whole, exponent = whole_numbers(values)
    assert [Fraction(int(w)) * Fraction(2) ** exponent for w in whole] == [Fraction(float(v)) for v in values]


def test_the_interval_and_the_lowest_number_decide():
    two = np.concatenate([ONE, ONE + np.float32([0, 0, 1]), ONE[:, ::-1]])
    below, above = np.nextafter(2, 0), np.nextafter(2, 3)
    for t_min, t_max, nearest in ((0, 9, 0), (2, 2, 0), (0, below, None), (above, 3, 1), (3, 2, None)):
        case = exact_case(two, make_rays([1, 1, 0], [[0, 0, 1]], t_min, t_max), rounds=False)
        assert list(case.answer.nearest[0]) == ([] if nearest is None else [nearest])
        assert case.answer.is_hit[0] == (nearest is not None)
    loose = exact_answer(two, make_rays([1, 1, 0], [[0, 0, 1]], 0, 2))
    assert loose.is_ambiguous[0] and loose.met[0].keys() == {0, 2}  # at the very end of the interval rounding may decide


# The catalogue reaches what it is there for.


def stack_heights(tree, rays):
    """Return for each ray the largest number of entries on the stack before its first leaf."""
    _, count, events = trace_recorded(tree, rays)
    ends = np.cumsum(count)
    heights = []
    for n, end in zip(count, ends, strict=True):
        kinds = events[end - n : end] & 3
        stop = np.flatnonzero(kinds != 1)
        heights.append(int(stop[0]) if len(stop) else 0)
    return heights


@pytest.mark.parametrize("build, least", [(build_bvh, 40), (build_kdtree, 60), (partial(build_kdtree, max_level=3), 3)])
def test_the_stack_is_filled_to_its_last_entry(build, least, monkeypatch):
    """Inside every box, or crossing every plane, a ray pushes at every level down to the deepest leaf."""
    powers = case_of("a triangle at every power of two")
    # No triangle is a stray: with the margin of the whole scene, wider than most triangles, all planes are crossed.
    monkeypatch.setattr("rtrace.trees.strays.FAR", np.inf)
    tree = build(powers.triangles)
    assert max(stack_heights(tree, powers.rays)) == tree.max_level >= least


def test_an_exact_case_does_not_round():
    """The bound 0 is honest: the kernel's own steps, in Fractions, give what floats give."""
    for name in CASES:
        case = case_of(name)
        if case.bound > 0.0 or len(case.triangles) > 1000:
            continue
        for i in range(0, len(case.rays.t_min), max(1, len(case.rays.t_min) // 40)):
            d, o = case.rays.direction[i].astype(float).tolist(), case.rays.origin[i].astype(float).tolist()
            z = int(np.argmax(np.abs(d)))
            for x in ((z + 1) % 3, (z + 2) % 3):
                shear = d[x] / d[z]
                assert Fraction(shear) * Fraction(d[z]) == Fraction(d[x])
                for corner in case.triangles[:: max(1, len(case.triangles) // 20)].reshape(-1, 3).astype(float).tolist():
                    got = (corner[x] - o[x]) - shear * (corner[z] - o[z])
                    want = Fraction(corner[x]) - Fraction(o[x]) - Fraction(shear) * (Fraction(corner[z]) - Fraction(o[z]))
                    assert Fraction(got) == want


# A slow traverser whose rules can be broken, one at a time; with none broken it passes.

PAD, THIN = 2.0**-44, 2.0**-6


def divide(a, b):
    if b != 0.0:
        return a / b
    return math.nan if a == 0.0 else math.copysign(math.inf, a) * math.copysign(1.0, b)


def times(a, b):
    return math.nan if a == 0.0 and math.isinf(b) else a * b


def difference(a, b, c, d):
    return float(Fraction(a) * Fraction(b) - Fraction(c) * Fraction(d))


def cross(p, q):
    return p[[1, 2, 0]] * q[[2, 0, 1]] - p[[2, 0, 1]] * q[[1, 2, 0]]


def moeller_trumbore_t(a, b, c, o, d):
    s = o - a
    p, q = cross(d, c - a), cross(s, b - a)
    det = (b - a) @ p
    u, v = (s @ p) / det, (d @ q) / det
    return float(((c - a) @ q) / det) if u >= 0 and v >= 0 and u + v <= 1 else math.nan


def triangle_t(corners, o, d, broken):
    if broken == "Moeller-Trumbore":
        return moeller_trumbore_t(*map(np.array, (*corners, o, d)))
    z = max(range(3), key=lambda k: abs(d[k]))
    x, y = (z + 1) % 3, (z + 2) % 3
    number = np.float32 if broken == "float32 arithmetic" else float
    sx, sy = number(d[x]) / number(d[z]), number(d[y]) / number(d[z])
    moved = [[number(p[k]) - number(o[k]) for k in range(3)] for p in corners]
    (ax, ay), (bx, by), (cx, cy) = ((p[x] - sx * p[z], p[y] - sy * p[z]) for p in moved)
    u, v, w = cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax
    if min(u, v, w) < 0 < max(u, v, w) or (broken == "edges left out" and min(u, v, w) <= 0 <= max(u, v, w)):
        return math.nan
    size = sum(abs(p * q) for p, q in ((cx, by), (cy, bx), (ax, cy), (ay, cx), (bx, ay), (by, ax)))
    if broken not in ("zeros of rounding", "float32 arithmetic") and abs(u + v + w) <= THIN * size:
        u, v, w = difference(cx, by, cy, bx), difference(ax, cy, ay, cx), difference(bx, ay, by, ax)
        if min(u, v, w) < 0 < max(u, v, w):
            return math.nan
    det = u + v + w
    if det == 0.0 or (broken == "small areas left out" and abs(det) < 1e-12):
        return math.nan
    return float((u * moved[0][z] + v * moved[1][z] + w * moved[2][z]) / (number(d[z]) * det))


class Walk:
    """One ray through one tree."""

    def __init__(self, tree, origin, direction, t_min, t_max, any_hit, broken):
        self.tree, self.o, self.d, self.any_hit, self.broken = tree, origin, direction, any_hit, broken
        self.t_min, self.best, self.prim = t_min, math.inf if broken == "t_max ignored" else t_max, -1
        self.inverse = [divide(1.0, x) for x in direction]
        lower, upper = tree.bounds.astype(float).tolist()
        reach = [max(abs(lower[k] - origin[k]), abs(upper[k] - origin[k])) for k in range(3)]
        z = max(range(3), key=lambda k: abs(direction[k]))
        pads = [PAD * (reach[k] + reach[z] * abs(direction[k] / direction[z])) + 2.0**-50 * abs(origin[k]) for k in range(3)]
        pads = [math.copysign(p, i) for p, i in zip(pads, self.inverse, strict=True)]
        near = broken not in ("no margin", "margin at the far side only", "NaN misses")
        far = broken not in ("no margin", "margin at the near side only", "NaN misses")
        self.near = [origin[k] + near * pads[k] for k in range(3)]
        self.far = [origin[k] - far * pads[k] for k in range(3)]
        {"bvh": self.through_bvh, "kdtree": self.through_kdtree, "all": self.through_all}[tree.kind](lower, upper)

    def box(self, lower, upper):
        t0, t1 = self.t_min, self.best
        for k in range(3):
            backwards = self.d[k] < 0.0 if self.broken == "sign of the direction" else self.inverse[k] < 0.0
            a, b = (upper[k], lower[k]) if backwards else (lower[k], upper[k])
            a, b = times(a - self.near[k], self.inverse[k]), times(b - self.far[k], self.inverse[k])
            if self.broken == "NaN misses" and (math.isnan(a) or math.isnan(b)):
                return math.inf, -math.inf
            t0, t1 = (a if a > t0 else t0), (b if b < t1 else t1)
        return (t0, t1) if self.broken != "flat boxes missed" or t0 < t1 else (1.0, 0.0)

    def leaf(self, first, count):
        for prim in self.tree.prims[first : first + count].tolist():
            t = triangle_t(self.tree.corners[prim], self.o, self.d, self.broken)
            wins = t < self.best or (t == self.best and (self.prim < 0 or prim < self.prim))
            if self.broken == "first of equals wins":
                wins = t < self.best or (t == self.best and self.prim < 0)
            if self.broken == "t_max left out":
                wins = t < self.best or (t == self.best and 0 <= prim < self.prim)
            if wins and (t > self.t_min if self.broken == "t_min left out" else t >= self.t_min):
                self.best, self.prim = t, prim
                if self.any_hit:
                    return True
        return False

    def through_all(self, lower, upper):
        self.leaf(0, len(self.tree.prims))

    def through_bvh(self, lower, upper):
        stack = [0]
        while stack:
            node = stack.pop()
            lower, upper, child, meta = self.tree.boxes[node]
            t0, t1 = self.box(lower, upper)
            if not (t0 < t1 if self.broken == "equals culled" and self.prim >= 0 else t0 <= t1):
                continue
            if meta & 3 == 3:
                if self.leaf(child, meta >> 2):
                    return
            else:
                backwards = self.inverse[meta & 3] < 0.0
                stack += [child, child + 1] if backwards else [child + 1, child]

    def through_kdtree(self, lower, upper):
        stack = [(0, *self.box(lower, upper))]
        while stack:
            node, t0, t1 = stack.pop()
            is_beyond = self.prim >= 0 and (t0 >= self.best if self.broken == "equals culled" else t0 > self.best)
            if is_beyond or not t0 <= t1:
                if self.broken == "break on pop":
                    return
                continue
            split, first, meta = self.tree.splits[node]
            axis = meta & 3
            if axis == 3:
                if self.leaf(first, meta >> 2) or (self.broken == "stops at the first hit" and self.prim >= 0):
                    return
                continue
            child, o, inverse = meta >> 2, self.o[axis], self.inverse[axis]
            low, high = times(split - self.near[axis], inverse), times(split - self.far[axis], inverse)
            near, far = (child + 1, child) if inverse < 0.0 else (child, child + 1)
            if self.broken == "one side of a plane" and math.isinf(inverse):
                stack.append((child if o < split else child + 1, t0, t1))
            elif self.broken == "textbook comparison":
                at = times(split - o, inverse)
                if at >= t1 or at < 0 or math.isnan(at):
                    stack.append((child if o < split or (o == split and inverse < 0.0) else child + 1, t0, t1))
                elif at <= t0:
                    stack.append((far, t0, t1))
                else:
                    stack += [(far, at, t1), (near, t0, at)]
            else:
                visits_near, visits_far = not high < t0, not low > t1
                both = visits_near and visits_far
                if visits_far:
                    stack.append((far, low if both and low > t0 else t0, t1))
                if visits_near:
                    stack.append((near, t0, high if both and high < t1 else t1))


def slow(kind, broken):
    """Return a structure for ``run_case``: triangles -> tracer; of kind "all" it is brute force."""

    def build(triangles):
        parts = {"kind": kind, "corners": triangles.astype(float).tolist(), "prims": np.arange(len(triangles))}
        parts["bounds"] = np.stack([triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))])
        if kind == "bvh":
            tree = build_bvh(triangles)
            columns = (tree.nodes[c].tolist() for c in ("lower", "upper", "child", "meta"))
            parts |= {"boxes": list(zip(*columns, strict=True)), "prims": tree.prims}
        elif kind == "kdtree":
            tree = build_kdtree(triangles)
            columns = (tree.nodes[c].tolist() for c in ("split", "first", "meta"))
            parts |= {"splits": list(zip(*columns, strict=True)), "prims": tree.prims}
        plain = type("Plain", (), parts)

        def tracer(rays, any_hit):
            columns = (rays.origin.astype(float), rays.direction.astype(float), rays.t_min, rays.t_max)
            with np.errstate(all="ignore"):
                walks = [Walk(plain, *ray, any_hit, broken) for ray in zip(*(c.tolist() for c in columns), strict=True)]
            prim, t = np.array([w.prim for w in walks], np.int32), np.array([w.best for w in walks])
            return Hits(prim, np.where(prim >= 0, t, np.inf))

        return tracer

    return build


def some(case, n):
    """Return the case with n of its rays."""
    chosen = np.unique(np.linspace(0, len(case.rays.t_min) - 1, n).astype(int))
    answer = case.answer
    lists = (None if a is None else [a[i] for i in chosen] for a in (answer.nearest, answer.met))
    answer = exact_answers.Answer(answer.is_hit[chosen], answer.is_ambiguous[chosen], *lists)
    return case._replace(rays=Rays(*(a[chosen] for a in case.rays)), answer=answer)


#: Broken rule -> the trees it concerns, and a case that catches it.
RULES = {
    "no margin": ("kdtree bvh", "ball from inside, radius 1e-12"),
    "margin at the near side only": ("kdtree bvh", "origins a hair off a surface"),
    "margin at the far side only": ("kdtree bvh", "origins a hair off a surface"),
    "sign of the direction": ("bvh", "boxes, axis-parallel rays in face planes"),
    "NaN misses": ("bvh", "boxes, axis-parallel rays in face planes"),
    "flat boxes missed": ("bvh", "height field, rays on grid lines"),
    "equals culled": ("kdtree bvh", "height field, rays on grid lines"),
    "textbook comparison": ("kdtree", "boxes, rays in face planes and on edges"),
    "one side of a plane": ("kdtree", "boxes, axis-parallel rays in face planes"),
    "break on pop": ("kdtree", "height field, rays on grid lines"),
    "stops at the first hit": ("kdtree", "lattice soup, flat ones and equals among them"),
    "first of equals wins": ("kdtree bvh", "overlapping triangles in two planes"),
    "t_min left out": ("kdtree bvh", "origins on faces, edges and vertices"),
    "t_max left out": ("kdtree bvh", "t_min and t_max at a hit, and one ulp beside"),
    "t_max ignored": ("kdtree bvh", "t_min and t_max at a hit, and one ulp beside"),
    "Moeller-Trumbore": ("kdtree bvh", "ball from just inside, at grazing angles"),
    "float32 arithmetic": ("kdtree bvh", "ball from just inside, at grazing angles"),
    "edges left out": ("kdtree bvh", "ball from just inside, at grazing angles"),
    "small areas left out": ("kdtree bvh", "ball from inside, radius 1e-12"),
    "zeros of rounding": ("kdtree bvh", "rays in the planes of triangles, past and through them"),
}


def row_of(case, kind, broken):
    """Return the row of a slow tree, compared with slow brute force by the same triangle test."""
    return run_case(case, {"first": slow("all", broken), kind: slow(kind, broken)})[-1]


@pytest.mark.parametrize("kind, broken", [(kind, rule) for rule, (kinds, _) in RULES.items() for kind in kinds.split()])
def test_a_broken_rule_is_caught(monkeypatch, kind, broken):
    monkeypatch.setattr(hard_cases, "_BRUTE_PAIRS", -1)
    case = some(case_of(RULES[broken][1]), 300)
    assert row_of(case, kind, "nothing").is_good
    assert not row_of(case, kind, broken).is_good


def without_offset(rays, primary, hits, owner):
    return rays._replace(origin=(primary.origin + hits.t[:, None] * primary.direction)[owner].astype(np.float32))


def with_a_fixed_offset(rays, primary, hits, owner):
    at = (primary.origin + hits.t[:, None].astype(float) * primary.direction)[owner]
    out = rays.origin - at
    return rays._replace(origin=(at + 1e-4 * out / np.linalg.norm(out, axis=1)[:, None]).astype(np.float32))


def with_t_max(t):
    return lambda rays, *_: rays._replace(t_max=np.full_like(rays.t_max, t))


@pytest.mark.parametrize(
    "broken, name, column",
    [
        (without_offset, "shadows: ball, scale 1", "invented"),
        (with_a_fixed_offset, "shadows: room with the light outside, scale 1e-06", "lost"),
        (with_a_fixed_offset, "shadows: ball, 1e4 radii away", "invented"),
        (with_t_max(np.inf), "shadows: room with the light inside, scale 1", "invented"),
        (with_t_max(0.01), "shadows: room with the light outside, scale 1", "lost"),
        (with_t_max(1.0 + 1e-6), "shadows: light on a wall", "invented"),
    ],
)
def test_a_broken_shadow_ray_is_caught(monkeypatch, broken, name, column):
    def broken_rays(tree, primary, hits, light):
        rays, owner, surface = shadow_rays(tree, primary, hits, light)
        return broken(rays, primary, hits, owner), owner, surface

    monkeypatch.setattr(hard_cases, "shadow_rays", broken_rays)
    for row in run_case(case_of(name)):
        assert not row.is_good and getattr(row, column) > 0


def test_a_broken_tree_is_caught():
    """A box that is too small, and a triangle that a leaf does not list."""
    case = case_of("ball from inside, at vertices and edges")

    def shrunken(triangles):
        tree = build_bvh(triangles)
        nodes = tree.nodes.copy()
        nodes["upper"][7, 0] = np.nextafter(nodes["upper"][7, 0], np.float32(-9)) - np.float32(1e-3)
        return lambda rays, any_hit: trace(tree._replace(nodes=nodes), rays, any_hit=any_hit)

    def forgetful(triangles):
        tree = build_kdtree(triangles)
        prims = tree.prims.copy()
        prims[10] = prims[9]
        return lambda rays, any_hit: trace(tree._replace(prims=prims, corners=triangles[prims]), rays, any_hit=any_hit)

    for build in (shrunken, forgetful):
        (row,) = run_case(case, {"broken": build})
        assert not row.is_good and row.unlike > 0


def test_all_structures_are_run_and_brute_force_only_where_it_is_affordable(monkeypatch):
    case = case_of("one triangle")
    rows = run_case(case)
    assert [row.structure for row in rows] == list(STRUCTURES)
    assert {(row.case, row.n_rays, row.bound) for row in rows} == {("one triangle", len(case.rays.t_min), 0.0)}
    monkeypatch.setattr(hard_cases, "_BRUTE_PAIRS", 10)
    assert [row.structure for row in run_case(case)] == list(STRUCTURES)[:-1]
    monkeypatch.setattr(hard_cases, "CASES", {"one triangle": CASES["one triangle"]})
    assert [row.structure for row in hard_cases.run_all()] == list(STRUCTURES)[:-1]
    monkeypatch.setattr(hard_cases, "CASES", {"ball": lambda long: exact_case(icosphere(int(long)), case.rays)})
    assert [len(case.triangles) for long in (False, True) for case in hard_cases.cases(long)] == [20, 80]
