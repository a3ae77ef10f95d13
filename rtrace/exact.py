"""Rays and triangles -> the hits that exact arithmetic finds: the truth that the float kernels are measured against.

A float32 is a whole number times a power of two, so with a common power taken out every sign and every comparison here is
integer arithmetic, and t is a Fraction: nothing is rounded. Slow (microseconds per ray and triangle); for small scenes.
"""

from fractions import Fraction
from typing import NamedTuple

import numpy as np

from rtrace.traverse import Rays

#: Whole numbers up to this size keep every term below 2^62: the largest, the sum of the weights, is 72 times their cube.
_FITS_INT64 = 2**18


class ExactHits(NamedTuple):
    """What one ray meets.

    Attributes
    ----------
    t : dict of int to Fraction
        Where the ray's line meets each triangle, at any t. Edges and vertices belong to a triangle; one that is seen
        edge-on, or has no area, is not met.
    edge_on : dict of int to (float, float)
        Those that are seen edge-on, or have no area, and touch the line: least and largest t of their vertices, measured
        along the direction's largest component. A test that rounds may take them for met, and anywhere in between.
    is_surrounded : dict of Fraction to bool
        For each t: whether a test that rounds, but computes the edge functions from vertices that neighbours share, must
        find a hit there. So it is when the line goes through the inside of a triangle, through an edge that two triangles
        share from opposite sides, or through a vertex that triangles surround; at a silhouette it may go either way.
    """

    t: dict[int, Fraction]
    edge_on: dict[int, tuple[float, float]]
    is_surrounded: dict[Fraction, bool]


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
    for origin, direction in zip(origins, rays.direction, strict=True):
        along, step = whole_numbers(direction)
        moved = corners - origin
        if along.dtype != moved.dtype:
            along, moved = along.astype(object), moved.astype(object)
        found.append(_hits_of_one(moved, along, Fraction(2) ** (exponent - step)))
    return found


def _hits_of_one(moved: np.ndarray, along: np.ndarray, unit: Fraction) -> ExactHits:
    """Return what a line from 0 meets; ``unit`` is the t of a whole number."""
    a, b, c = moved[:, 0], moved[:, 1], moved[:, 2]
    weights = np.stack([_dot(_cross(c, b), along), _dot(_cross(a, c), along), _dot(_cross(b, a), along)], axis=1)
    is_met = (weights >= 0).all(axis=1) | (weights <= 0).all(axis=1)
    is_flat = (weights == 0).all(axis=1)
    met = np.flatnonzero(is_met & ~is_flat)
    normal = _cross((b - a)[met], (c - a)[met])
    ups, downs = _dot(a[met], normal), _dot(normal, along)
    t = {i: Fraction(int(up), int(down)) * unit for i, up, down in zip(met.tolist(), ups, downs, strict=True)}
    at: dict[Fraction, list[int]] = {}
    for i in t:
        at.setdefault(t[i], []).append(i)
    z = int(np.argmax(np.abs(along)))
    edge_on = {}
    for i in np.flatnonzero(is_flat).tolist():
        p, q, r = _cross(along, moved[i])  # all parallel: on which side of the line, in the triangle's plane, is each vertex?
        if min(_dot(p, q), _dot(q, r), _dot(r, p)) <= 0:
            ts = [float(Fraction(int(x), int(along[z])) * unit) for x in moved[i, :, z]]
            edge_on[i] = min(ts), max(ts)
    return ExactHits(t, edge_on, {key: _is_surrounded(moved[tied], weights[tied]) for key, tied in at.items()})


def _is_surrounded(corners: np.ndarray, weights: np.ndarray) -> bool:
    """Return whether triangles with a common point on the line share their edges there, all around it."""
    starts, ends = set(), set()
    for triangle, weight in zip(corners, weights, strict=True):
        zero = weight == 0
        if not zero.any():
            return True
        order = (0, 1, 2) if weight.sum() > 0 else (0, 2, 1)  # as seen along the line, all turn the same way
        p = [tuple(triangle[k]) for k in order]
        positive = [k for k in range(3) if not zero[order[k]]]
        if len(positive) == 1:  # through this vertex: from its one edge to its other
            v = positive[0]
            starts.add((p[v], p[(v + 1) % 3]))
            ends.add((p[v], p[(v + 2) % 3]))
        else:  # through the edge that faces the vertex v
            v = 3 - sum(positive)
            starts.add((p[(v + 1) % 3], p[(v + 2) % 3]))
            ends.add((p[(v + 2) % 3], p[(v + 1) % 3]))
    return starts == ends


def _cross(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return the cross product along the last axis (np.cross refuses Python's integers)."""
    x, y, z = p[..., 0], p[..., 1], p[..., 2]
    u, v, w = q[..., 0], q[..., 1], q[..., 2]
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)


def _dot(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    return (p * q).sum(axis=-1)
