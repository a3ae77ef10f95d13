"""Perfect splits: a triangle and a cell -> the bounds of the triangle's part on either side of a plane through the cell.

Positions go in and come out as *ranks*: the float32 as an integer of the same order (a float32 has a sign and a
magnitude, a rank is plus or minus that magnitude). So -0.0 and +0.0 are one rank, the float32 next to x is rank + 1, and
comparing, sorting and rounding outward are integer arithmetic.
"""

import numpy as np

from jit import kernel

#: Room for a polygon, in numbers. A convex one has 3 vertices and one more per plane that cuts it (6 of them); rounding can
#: bend a thin one so that a plane cuts it more than twice, which adds half its vertices at most: 3 * 1.5**6 < 36.
POLYGON = 3 * 36


@kernel
def rank(x):
    """Return the rank of the float32 x, an int64 in -2**31 < rank < 2**31."""
    bits = np.int64(np.float32(x).view(np.int32))
    return bits if bits >= 0 else -2147483648 - bits


@kernel
def value(place):
    """Return the float32 of this rank, as float64."""
    bits = place if place >= 0 else -2147483648 - place
    return np.float64(np.int32(bits).view(np.float32))


@kernel
def _rank_below(x):
    """Return the rank of the largest float32 that is not above the float64 x."""
    place = rank(x)
    return place - 1 if value(place) > x else place


@kernel
def _rank_above(x):
    """Return the rank of the smallest float32 that is not below the float64 x."""
    place = rank(x)
    return place + 1 if value(place) < x else place


@kernel
def _cross(points, a, b, axis, plane, out):
    """Write to points[out:] where the edge from point a to point b crosses the plane.

    Both triangles at an edge must get the same point, so it is measured from the lower end whatever the direction; this
    form also keeps a coordinate that both ends share.
    """
    if points[a + axis] > plane:
        a, b = b, a
    t = (plane - points[a + axis]) / (points[b + axis] - points[a + axis])
    for k in range(3):
        points[out + k] = points[a + k] + (points[b + k] - points[a + k]) * t
    points[out + axis] = plane


@kernel
def _cut(points, first, n, axis, plane, side, out):
    """Write to points[out:] the part below (side -1) or above (+1) the plane of the polygon of n points at ``first``.

    Return how many points it has.
    """
    end = out
    for i in range(n):
        a = first + 3 * i
        b = a + 3 if i + 1 < n else first
        here, there = points[a + axis] - plane, points[b + axis] - plane
        if here * side >= 0.0:
            for k in range(3):
                points[end + k] = points[a + k]
            end += 3
        if (here < 0.0 and there > 0.0) or (here > 0.0 and there < 0.0):
            _cross(points, a, b, axis, plane, end)
            end += 3
    return (end - out) // 3


@kernel
def _write_bounds(lower, upper, lo, hi, out, at):
    """Write the ranks of lower and upper, rounded outward and kept inside lo and hi.

    Where nothing is left (by rounding: clipped to another cell, the triangle just reached this one) lo and hi stand.
    """
    if lower <= upper:
        inner_lo, inner_hi = max(lo, _rank_below(lower)), min(hi, _rank_above(upper))
        if inner_lo <= inner_hi:
            lo, hi = inner_lo, inner_hi
    out[at], out[at + 3] = lo, hi


@kernel
def split_bounds(vertices, triangle, cell, corner, axis, split, bounds, at, below, above, points):
    """Clip one triangle to a cell, cut it at a plane and bound both parts.

    Parameters
    ----------
    vertices : (9 n,) float32
        All triangles.
    triangle : int
        Which one.
    cell : float64 array
        ``cell[corner : corner + 6]``: the cell, lower, then upper corner.
    axis, split : int, int
        The plane; ``split`` is a rank.
    bounds : int32 array
        ``bounds[at : at + 6]``: ranks of the lower, then the upper corner of the triangle's bounds in the cell.
    below, above : int32 arrays
        Output at the same place: the bounds of the two parts, inside ``bounds`` and on their side of the plane.
    points : (3 POLYGON,) float64
        Scratch.
    """
    for k in range(9):
        points[k] = vertices[9 * triangle + k]
    n, first, out = np.int64(3), np.int64(0), np.int64(POLYGON)
    for k in range(3):
        a, b, c = vertices[9 * triangle + k], vertices[9 * triangle + 3 + k], vertices[9 * triangle + 6 + k]
        for side in range(-1, 2, 2):
            plane = cell[corner + k] if side > 0 else cell[corner + 3 + k]
            if min(a, b, c) < plane if side > 0 else max(a, b, c) > plane:
                n = _cut(points, first, n, k, plane, side, out)
                first, out = out, first
    plane = value(split)
    lowest, highest = np.inf, -np.inf
    for i in range(n):
        lowest, highest = min(lowest, points[first + 3 * i + axis]), max(highest, points[first + 3 * i + axis])
    # By rounding a part may have no point on its side: then it has the nearest ones, so that its bounds stay near it.
    top_of_below, bottom_of_above = max(plane, lowest), min(plane, highest)
    crossings, end = 2 * POLYGON, 2 * POLYGON
    for i in range(n):
        a = first + 3 * i
        b = a + 3 if i + 1 < n else first
        here, there = points[a + axis] - plane, points[b + axis] - plane
        if (here < 0.0 and there > 0.0) or (here > 0.0 and there < 0.0):
            _cross(points, a, b, axis, plane, end)
            end += 3
    for k in range(3):
        below_lo, below_hi = np.inf, -np.inf
        for i in range(crossings, end, 3):
            below_lo, below_hi = min(below_lo, points[i + k]), max(below_hi, points[i + k])
        above_lo, above_hi = below_lo, below_hi
        for i in range(first, first + 3 * n, 3):
            x = points[i + k]
            if points[i + axis] <= top_of_below:
                below_lo, below_hi = min(below_lo, x), max(below_hi, x)
            if points[i + axis] >= bottom_of_above:
                above_lo, above_hi = min(above_lo, x), max(above_hi, x)
        lo, hi = np.int64(bounds[at + k]), np.int64(bounds[at + 3 + k])
        _write_bounds(below_lo, below_hi, lo, min(hi, split) if k == axis else hi, below, at + k)
        _write_bounds(above_lo, above_hi, max(lo, split) if k == axis else lo, hi, above, at + k)
