"""Rays and triangles -> the hits that exact arithmetic finds, and what a test that rounds must answer and may.

A float32 is a whole number times a power of two, so with a common power taken out every sign and every comparison here is
integer arithmetic, and t is a Fraction: nothing is rounded. Slow (microseconds per ray and triangle); for small scenes.
"""

import itertools
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from rtrace.checks.embree import kappa
from rtrace.rays import Rays

#: Largest error of t where float64 rounds, in ``rounding_of_t`` (docs/correctness.md).
T_BOUND = 16.0
#: By how much rounding may move a triangle sideways, as a share of its greatest distance from the ray's origin along an
#: axis: 4 units of 2^-53 for its vertices, sheared; the rest is margin.
REACH = 2.0**-49

_AFTER, _BEFORE = [1, 2, 0], [2, 0, 1]  # of each vertex

#: Whole numbers up to this size keep every term below 2^62: the largest, the sum of the weights, is 72 times their cube.
_FITS_INT64 = 2**18


class ExactHits(NamedTuple):
    """What the line of one ray meets, at any t.

    Attributes
    ----------
    t : dict of int to Fraction
        Where it meets each triangle. Edges and vertices belong to a triangle; one that is seen edge-on, or has no area, is
        not met.
    is_firm : dict of Fraction to bool
        For each t: whether a test must find a hit there that rounds, but computes each edge from vertices that neighbours
        share. So it is where the line goes through the inside of a triangle, through an edge that two triangles share from
        opposite sides, or through a vertex that they surround, and their other edges are farther away than ``REACH``.
    touched : dict of int to (float, float)
        Those not met, but by less than ``REACH``, the ones seen edge-on included: such a test may take them for met. The
        least and the largest t of their vertices, measured along the direction's largest component, and REACH beyond.
    """

    t: dict[int, Fraction]
    is_firm: dict[Fraction, bool]
    touched: dict[int, tuple[float, float]]


class Answer(NamedTuple):
    """What n rays must find.

    Attributes
    ----------
    is_hit : (n,) bool
        Whether the ray hits anything.
    is_ambiguous : (n,) bool
        Whether rounding may decide that.
    nearest, met : list of n dicts of int to (float, float), or None
        The triangles that a closest-hit ray, an any-hit ray may report, and the range of t at each. None: not tested.
    """

    is_hit: np.ndarray
    is_ambiguous: np.ndarray
    nearest: list[dict[int, tuple[float, float]]] | None = None
    met: list[dict[int, tuple[float, float]]] | None = None


def whole_numbers(values: np.ndarray) -> tuple[np.ndarray, int]:
    """Return (whole, exponent) with ``values == whole * 2**exponent`` exactly; int64, or Python's integers where large."""
    mantissa, exponent = np.frexp(np.asarray(values, np.float64))
    mantissa, exponent = (mantissa * 2.0**24).astype(np.int64), exponent.astype(np.int64) - 24
    zeros = np.log2((mantissa & -mantissa).clip(1)).astype(np.int64)  # trailing ones are taken out: 3.0 becomes 3
    mantissa, exponent = mantissa >> zeros, exponent + zeros
    if not mantissa.any():
        return mantissa, 0
    lowest = int(exponent[mantissa != 0].min())
    shift = np.where(mantissa == 0, 0, exponent - lowest)
    if (np.abs(mantissa) * np.exp2(shift.astype(np.float64))).max() <= _FITS_INT64:
        return mantissa << shift, lowest
    whole = [int(m) << int(s) for m, s in zip(mantissa.reshape(-1), shift.reshape(-1), strict=True)]
    return np.array(whole, object).reshape(mantissa.shape), lowest


def exact_hits(triangles: np.ndarray, rays: Rays) -> list[ExactHits]:
    """Return what the line of every ray meets among (n, 3, 3) float32 triangles."""
    points, exponent = whole_numbers(np.concatenate([triangles.reshape(-1, 3), rays.origin]))
    corners, origins = points[: 3 * len(triangles)].reshape(-1, 3, 3), points[3 * len(triangles) :]
    found = []
    for i, (origin, direction) in enumerate(zip(origins, rays.direction, strict=True)):
        along, step = whole_numbers(direction)
        moved = corners - origin
        if along.dtype != moved.dtype:
            along, moved = along.astype(object), moved.astype(object)
        near = _is_near(triangles - rays.origin[i].astype(np.float64), direction.astype(np.float64))
        found.append(_hits_of_one(moved, along, near, Fraction(2) ** (exponent - step)))
    return found


def _is_near(moved: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Return for the edges opposite each vertex whether the line from 0 passes within REACH, (n, 3) bool."""
    unit = along / np.abs(along).max()
    unit /= np.sqrt((unit * unit).sum())
    aside = moved - _dot(moved, unit)[..., None] * unit  # of every vertex, from the line
    p = aside[:, _AFTER]
    edge = aside[:, _BEFORE] - p
    squared = _dot(edge, edge)
    share = (-_dot(p, edge) / np.where(squared > 0, squared, 1)).clip(0, 1)
    gap = p + share[..., None] * edge
    return _dot(gap, gap) <= (REACH * np.abs(moved).max(axis=(1, 2))[:, None]) ** 2


def _hits_of_one(moved: np.ndarray, along: np.ndarray, near: np.ndarray, unit: Fraction) -> ExactHits:
    """Return what a line from 0 meets; ``unit`` is the t of a whole number."""
    weights = _dot(_cross(moved[:, _BEFORE], moved[:, _AFTER]), along)
    is_met = ((weights >= 0).all(axis=1) | (weights <= 0).all(axis=1)) & (weights != 0).any(axis=1)
    met = np.flatnonzero(is_met)
    a, b, c = (moved[met, k] for k in range(3))
    normal = _cross(b - a, c - a)
    ups, downs = _dot(a, normal), _dot(normal, along)
    t = {i: Fraction(int(up), int(down)) * unit for i, up, down in zip(met.tolist(), ups, downs, strict=True)}
    at: dict[Fraction, list[int]] = {}
    for i in t:
        at.setdefault(t[i], []).append(i)
    is_firm = (~near | (weights == 0)).all(axis=1)
    firm = {key: _is_firm(moved[tied], weights[tied], is_firm[tied]) for key, tied in at.items()}
    z = int(np.argmax(np.abs(along)))
    touched = {}
    for i in np.flatnonzero(near.any(axis=1) & ~is_met).tolist():
        ts = [float(Fraction(int(x), int(along[z])) * unit) for x in moved[i, :, z]]
        margin = REACH * max(map(abs, ts))
        touched[i] = min(ts) - margin, max(ts) + margin
    return ExactHits(t, firm, touched)


def _is_firm(corners: np.ndarray, weights: np.ndarray, is_firm: np.ndarray) -> bool:
    """Return whether one triangle's inside, or edges that triangles share all around, are sure to be met at this point."""
    starts, ends = set(), set()
    for triangle, weight, firm in zip(corners, weights, is_firm, strict=True):
        zero = weight == 0
        if firm and not zero.any():
            return True
        order = (0, 1, 2) if weight.sum() > 0 else (0, 2, 1)  # as seen along the line, all turn the same way
        p = [tuple(triangle[k]) for k in order]
        positive = [k for k in range(3) if not zero[order[k]]]
        if len(positive) == 1:  # through this vertex: from its one edge to its other
            v = positive[0]
            starts.add((p[v], p[(v + 1) % 3]))
            ends.add((p[v], p[(v + 2) % 3]))
        elif len(positive) == 2:  # through the edge that faces the vertex v
            v = 3 - sum(positive)
            starts.add((p[(v + 1) % 3], p[(v + 2) % 3]))
            ends.add((p[(v + 2) % 3], p[(v + 1) % 3]))
    return bool(starts) and starts == ends and bool(is_firm.all())


def rounding_of_t(triangles: np.ndarray, rays: Rays, prim: np.ndarray) -> np.ndarray:
    """Return the rounding unit of t for each hit, (n,) float64: ``kappa`` for float64, with 2^-52 for 2^-23."""
    return kappa(triangles, rays, prim) * 2.0**-29


def exact_answer(triangles: np.ndarray, rays: Rays, *, rounds: bool = True, is_closed: bool = False) -> Answer:
    """Return what exact arithmetic demands of a test that rounds.

    Parameters
    ----------
    triangles : (n, 3, 3) float32
    rays : Rays
    rounds : bool
        False: no step of the triangle test rounds here. Then ties, ends of the interval and silhouettes are decided.
    is_closed : bool
        The mesh is closed and every origin is inside: no ray may miss, whatever edges and vertices it meets.
    """
    n = len(rays.t_min)
    is_hit, is_ambiguous = np.empty(n, bool), np.empty(n, bool)
    every_near, every_met = [], []
    lowest = _lowest_equal(triangles)
    every_found = exact_hits(triangles, rays)
    slacks = iter(_slacks(triangles, rays, every_found)) if rounds else itertools.repeat(0)  # integers leave t exact
    for i, found in enumerate(every_found):
        low, high = float(rays.t_min[i]), float(rays.t_max[i])
        # Triangle -> (t, error that t may have): what must be found, and what rounding decides about.
        sure, maybe = {}, {}
        for p, t in found.t.items():
            slack = next(slacks)
            if low <= t - slack and t + slack <= high and (not rounds or found.is_firm[t]):
                sure[p] = t, slack
            elif low <= min(t + slack, high) and t - slack <= high:
                maybe[p] = t, slack
        first, slack = min(sure.values(), key=lambda hit: hit[0], default=(np.inf, 0))
        met = {p: (float(t), float(t)) for p, (t, _) in (sure | maybe).items()}
        near = {p: met[p] for p, (t, s) in (sure | maybe).items() if t - s - slack <= first}
        if rounds:
            touched = {p: ends for p, ends in found.touched.items() if low <= min(ends[1], high) and ends[0] <= high}
            near |= {p: ends for p, ends in touched.items() if ends[0] - slack <= first}
            met |= touched
        elif near:
            near = {min(near): near[min(near)]}
        every_near.append({p: ends for p, ends in near.items() if lowest[p] == p})
        every_met.append(met)
        is_hit[i] = bool(sure) or is_closed
        is_ambiguous[i] = bool(met) and not is_hit[i]
    return Answer(is_hit, is_ambiguous, every_near, every_met)


def _slacks(triangles: np.ndarray, rays: Rays, every_found: list[ExactHits]) -> list[float]:
    """Return the error that t may have at each hit, ray after ray."""
    prim = np.array([p for found in every_found for p in found.t], int)
    ray = np.repeat(np.arange(len(every_found)), [len(found.t) for found in every_found])
    return (T_BOUND * rounding_of_t(triangles, Rays(*(a[ray] for a in rays)), prim)).tolist()


def _lowest_equal(triangles: np.ndarray) -> np.ndarray:
    """Return for each triangle the lowest number of one with the same bytes: of equals only that one may be reported."""
    as_bytes = triangles.reshape(len(triangles), 9).view("V36")[:, 0]
    _, first, which = np.unique(as_bytes, return_index=True, return_inverse=True)
    return first[which]


def _cross(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return the cross product along the last axis (np.cross refuses Python's integers)."""
    x, y, z = p[..., 0], p[..., 1], p[..., 2]
    u, v, w = q[..., 0], q[..., 1], q[..., 2]
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)


def _dot(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    return (p * q).sum(axis=-1)
