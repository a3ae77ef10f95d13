"""The two tests of a ray: against a triangle (watertight) and against a box or plane (never wrongly missed).

Both compute in float64 on float32 data: a difference of two float32 is (nearly) exact, no product over- or underflows, so
scenes of any scale and rays of any length need no normalisation.

The triangle test decides. A triangle it reports holds a point, the mean of its corners by the test's own weights, that lies
at the reported t and beside the ray by less than its ``margins``. Boxes and planes moved by the margins therefore contain
that point's t, so a tree finds what testing every triangle finds (docs/correctness.md has the bounds).
"""

import numpy as np

from nptrace_base.jit import inlined, kernel

#: Margin of the culling tests, relative to the extent of the scene's core as seen from the ray's origin. Rounding moves the
#: point that a hit stands for by at most 2^-46 of its triangle's extent from there (``THIN`` times the rounding of an edge
#: function), the culling tests themselves by 2^-51 of the plane's distance; float32 coordinates resolve 2^-24, so only rays
#: that touch a box or plane exactly visit more. Triangles beyond the core have room of their own (``strays``).
PAD = 2.0**-44
#: Rounding of origin + margin, relative to the origin.
ORIGIN_PAD = 2.0**-50
#: Keeps the margin of a ray in a plane, whose sums may vanish, above zero; times ``HUGE`` it is beyond any t.
LEAST_PAD = 1e-100
#: The inverse of a zero of either sign: finite, so that no product with it is undefined. With it a ray is inside a slab, by
#: its margin, from before any t to after any t, or never.
HUGE = float(np.finfo(np.float64).max)

#: A projected area below this share of the products it is the sum of: its edge functions are computed without cancellation.
THIN = 2.0**-6

#: Larger than any triangle number: the number of "no hit yet", so that the lowest number wins among equal t.
NO_PRIM = np.int32(2**31 - 1)

#: Coordinates of a point, and how many a point and a triangle have in a flat array; unsigned, as ``traverse`` says.
X, Y, Z = (np.uint64(k) for k in range(3))
POINT_FLOATS, CORNER_FLOATS = np.uint64(3), np.uint64(9)
_SECOND, _THIRD = POINT_FLOATS, np.uint64(6)  # where a triangle's second and third vertex start
_LOWER, _UPPER = np.uint64(0), POINT_FLOATS  # where a box's corners start
_SPLITTER = 2.0**27 + 1.0


@inlined
def inverse(d):
    """Return 1 / d, for either zero the same huge number."""
    return 1.0 / d if d != 0.0 else HUGE


@inlined
def end_of(t_max, origin, direction):
    """Return where a ray ends: ``t_max``, or NaN, which no t reaches, if it is none (not finite, or without a direction)."""
    ox, oy, oz = origin
    dx, dy, dz = direction
    total = ox + oy + oz + dx + dy + dz  # of float32 numbers: it does not overflow
    return t_max if total - total == 0.0 and (dx != 0.0 or dy != 0.0 or dz != 0.0) else np.nan


@kernel
def shear(origin, direction, inverses):
    """Return (axes, origin, shears) of a ray, three numbers each: how its direction becomes +z, as ``triangle_t`` needs it.

    ``axes`` is the permutation (kx, ky, kz), in which the origin's coordinates are returned; ``shears`` is (sx, sy, sz).

    Woop, Benthin, Wald 2013, "Watertight Ray/Triangle Intersection", Sec. 3: kz is the axis of the largest component.
    """
    ox, oy, oz = origin
    dx, dy, dz = direction
    ix, iy, iz = inverses
    ax, ay, az = abs(dx), abs(dy), abs(dz)
    if ax >= ay and ax >= az:
        return (Y, Z, X), (oy, oz, ox), (dy * ix, dz * ix, ix)
    if ay >= az:
        return (Z, X, Y), (oz, ox, oy), (dz * iy, dx * iy, iy)
    return (X, Y, Z), (ox, oy, oz), (dx * iz, dy * iz, iz)


@inlined
def margins(core, origin, direction, inverses):
    """Return (x, y, z): how far the culling tests are moved along each axis.

    ``core`` is the flat box of all triangles but the strays. Rounding moves a corner beside the ray by a share of its
    distance along that axis and of its distance along the ray, times the slope.
    """
    ox, oy, oz = origin
    dx, dy, dz = direction
    ix, iy, iz = inverses
    x = max(abs(core[_LOWER + X] - ox), abs(core[_UPPER + X] - ox))
    y = max(abs(core[_LOWER + Y] - oy), abs(core[_UPPER + Y] - oy))
    z = max(abs(core[_LOWER + Z] - oz), abs(core[_UPPER + Z] - oz))
    ax, ay, az = abs(dx), abs(dy), abs(dz)
    if ax >= ay and ax >= az:
        along = x * abs(ix)
    elif ay >= az:
        along = y * abs(iy)
    else:
        along = z * abs(iz)
    px = PAD * (x + along * ax) + ORIGIN_PAD * abs(ox) + LEAST_PAD
    py = PAD * (y + along * ay) + ORIGIN_PAD * abs(oy) + LEAST_PAD
    pz = PAD * (z + along * az) + ORIGIN_PAD * abs(oz) + LEAST_PAD
    return px, py, pz


@inlined
def lost_by(a, b, product):
    """Return a * b - product exactly, for product = a * b rounded (Dekker 1971)."""
    t = _SPLITTER * a
    a_high = t - (t - a)
    a_low = a - a_high
    t = _SPLITTER * b
    b_high = t - (t - b)
    b_low = b - b_high
    return ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low


@inlined
def difference(a, b, c, d):
    """Return a * b - c * d with the sign of the exact value, and nearly its size."""
    p, q = a * b, c * d
    return (p - q) + (lost_by(a, b, p) - lost_by(c, d, q))


@kernel
def triangle_t(corners, first, line):
    """Return the ray parameter at which a ray's line meets the triangle whose nine floats start at ``first``; NaN for none.

    ``line`` is what ``shear`` returned for the ray.

    Every edge function is computed from sheared vertices that neighbouring triangles share, and its sign is that of the exact
    value, which changes when the edge is walked the other way: no ray passes between two triangles with a common
    edge. Edges belong to both. A triangle without area in the sheared plane, so one seen edge-on, is not hit.
    """
    (kx, ky, kz), (ox, oy, oz), (sx, sy, sz) = line
    second, third = first + _SECOND, first + _THIRD
    az, bz, cz = corners[first + kz] - oz, corners[second + kz] - oz, corners[third + kz] - oz
    ax, ay = (corners[first + kx] - ox) - sx * az, (corners[first + ky] - oy) - sy * az
    bx, by = (corners[second + kx] - ox) - sx * bz, (corners[second + ky] - oy) - sy * bz
    cx, cy = (corners[third + kx] - ox) - sx * cz, (corners[third + ky] - oy) - sy * cz
    u = cx * by - cy * bx
    v_ = ax * cy - ay * cx
    w = bx * ay - by * ax
    # Rounding is monotone: the difference of two rounded products has the sign of the exact one or is 0, never the other.
    # Smallest and largest first, then one branch: three sign tests each mispredict, which took twice the time.
    low = u if u < v_ else v_
    low = w if w < low else low
    high = u if u > v_ else v_
    high = w if w > high else high
    if low < 0.0 and high > 0.0:
        return np.nan
    det = u + v_ + w
    size = abs(cx * by) + abs(cy * bx) + abs(ax * cy) + abs(ay * cx) + abs(bx * ay) + abs(by * ax)
    if abs(det) <= THIN * size or min(abs(u), abs(v_), abs(w)) == 0.0:
        u, v_, w = difference(cx, by, cy, bx), difference(ax, cy, ay, cx), difference(bx, ay, by, ax)
        det = u + v_ + w
    if (min(u, v_, w) < 0.0 and max(u, v_, w) > 0.0) or det == 0.0:
        return np.nan
    return (u * az + v_ * bz + w * cz) / det * sz
