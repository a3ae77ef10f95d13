"""Perfect splits: a triangle and a cell -> the bounds of the triangle's part on either side of a plane through the cell.

Positions are passed and returned as *ranks*: integers in the same order as the float32 numbers (a float32 has a sign and a
magnitude, a rank is plus or minus that magnitude). So -0.0 and +0.0 have the same rank, the float32 after x has rank + 1, and
comparisons, sorting and outward rounding are integer arithmetic.
"""

from typing import NamedTuple

import numpy as np

from nptrace_base.jit import kernel

# Indices are unsigned: Numba tests a signed one for wrap-around at every access, 7 % of a build.
ZERO, ONE, AXES = (np.uint64(k) for k in (0, 1, 3))
#: Numbers of a point, a box (a lower, then an upper corner) and a triangle; where vertices, and an upper corner, start.
POINT, BOX, CORNERS = AXES, np.uint64(6), np.uint64(9)
SECOND, THIRD, UPPER = POINT, np.uint64(6), POINT

#: Numbers of the largest polygon. A convex one has 3 vertices and one more for each of the 6 planes that cut it. Rounding can
#: bend a thin one so that a plane cuts it more than twice, which adds at most half its vertices: 3 * 1.5**6 < 36.
POLYGON = np.uint64(3 * 36)


class PartBounds(NamedTuple):
    """Bounds of triangles cut at a plane, as int32 ranks: six a triangle, its lower, then its upper corner."""

    whole: np.ndarray  # of the part in the cell ...
    below: np.ndarray  # ... and of its parts on either side of the plane
    above: np.ndarray


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
    for k in range(AXES):
        points[out + k] = points[a + k] + (points[b + k] - points[a + k]) * t
    points[out + axis] = plane


@kernel
def _cut(points, first, n, axis, plane, side, out):
    """Write to points[out:] the part below (side -1) or above (+1) the plane of the polygon of n points at ``first``.

    Return how many points it has.
    """
    end = out
    for i in range(n):
        a = first + POINT * i
        b = a + POINT if i + ONE < n else first
        here, there = points[a + axis] - plane, points[b + axis] - plane
        if here * side >= 0.0:
            for k in range(AXES):
                points[end + k] = points[a + k]
            end += POINT
        if (here < 0.0 and there > 0.0) or (here > 0.0 and there < 0.0):
            _cross(points, a, b, axis, plane, end)
            end += POINT
    return (end - out) // POINT


@kernel
def _include(points, a, box):
    """Widen points[box : box + 6], a lower and an upper corner, to hold point a."""
    for k in range(AXES):
        x = points[a + k]
        points[box + k] = min(points[box + k], x)
        points[box + UPPER + k] = max(points[box + UPPER + k], x)


@kernel
def _write_bounds(points, box, slack, lo, hi, out, at):
    """Write the ranks of points[box] and points[box + 3], a lower and an upper bound, moved outward, kept inside lo and hi.

    If nothing is left (by rounding: clipped to another cell, the triangle just reached this one), lo and hi remain.
    """
    lower, upper = points[box], points[box + UPPER]
    if lower <= upper:
        inner_lo, inner_hi = max(lo, _rank_below(lower - slack)), min(hi, _rank_above(upper + slack))
        if inner_lo <= inner_hi:
            lo, hi = inner_lo, inner_hi
    out[at], out[at + UPPER] = lo, hi


# Without counting references (_nrt=False): unpacking the tuples would count one for each array, at every triangle.
@kernel(_nrt=False)
def split_bounds(vertices, triangle, cell, plane, bounds, at, points, slack=0.0):
    """Clip one triangle to a cell, cut it at a plane and bound both parts.

    Parameters
    ----------
    vertices : (9 n,) float32
        All triangles.
    triangle : int
        Which one.
    cell : (float64 array, int)
        Boxes, and where the cell's lower, then its upper corner starts in them.
    plane : (int, int)
        Its axis, and its position as a rank.
    bounds, at : PartBounds, int
        Input: ``whole[at : at + 6]``, the triangle's bounds in the cell. Output at the same place of ``below`` and ``above``:
        the bounds of the two parts, inside ``whole`` and on their side of the plane.
    points : (3 POLYGON,) float64
        Scratch.
    slack : float
        How far around the triangle its part reaches: 0, but for strays (``rtrace.trees.strays``).
    """
    boxes, corner, axis, split = cell[0], np.uint64(cell[1]), np.uint64(plane[0]), plane[1]
    whole, below, above = bounds
    at, v = np.uint64(at), CORNERS * np.uint64(triangle)
    for k in range(CORNERS):
        points[k] = vertices[v + k]
    n, first, out = AXES, ZERO, POLYGON  # three points
    for k in range(AXES):
        a, b, c = vertices[v + k], vertices[v + SECOND + k], vertices[v + THIRD + k]
        for side in range(-1, 2, 2):
            face = boxes[corner + k] - slack if side > 0 else boxes[corner + UPPER + k] + slack
            if min(a, b, c) < face if side > 0 else max(a, b, c) > face:
                n = _cut(points, first, n, k, face, side, out)
                first, out = out, first
    position = value(split)
    lowest, highest = np.inf, -np.inf
    for i in range(n):
        x = points[first + POINT * i + axis]
        lowest, highest = min(lowest, x), max(highest, x)
    # Rounding may leave a part without a point on its side. Then it gets the nearest points, so that its bounds stay near it.
    low_plane, high_plane = position - slack, position + slack
    top_of_below, bottom_of_above = max(high_plane, lowest), min(low_plane, highest)
    crossing = POLYGON + POLYGON
    in_below = crossing + POINT
    in_above = in_below + BOX
    for k in range(AXES):  # empty boxes
        points[in_below + k] = points[in_above + k] = np.inf
        points[in_below + UPPER + k] = points[in_above + UPPER + k] = -np.inf
    for i in range(n):
        a = first + POINT * i
        b = a + POINT if i + ONE < n else first
        x, y = points[a + axis], points[b + axis]
        if x <= top_of_below:
            _include(points, a, in_below)
        if x >= bottom_of_above:
            _include(points, a, in_above)
        if (x < high_plane and y > high_plane) or (x > high_plane and y < high_plane):
            _cross(points, a, b, axis, high_plane, crossing)
            _include(points, crossing, in_below)
            if slack == 0.0:
                _include(points, crossing, in_above)
        if slack > 0.0 and ((x < low_plane and y > low_plane) or (x > low_plane and y < low_plane)):
            _cross(points, a, b, axis, low_plane, crossing)
            _include(points, crossing, in_above)
    for k in range(AXES):
        lo, hi = np.int64(whole[at + k]), np.int64(whole[at + UPPER + k])
        _write_bounds(points, in_below + k, slack, lo, min(hi, split) if k == axis else hi, below, at + k)
        _write_bounds(points, in_above + k, slack, max(lo, split) if k == axis else lo, hi, above, at + k)
