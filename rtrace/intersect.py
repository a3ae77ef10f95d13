"""The two tests of a ray: against a triangle (watertight) and against a box (never wrongly missed).

Both compute in float64 on float32 data: a difference of two float32 is (nearly) exact, no product over- or underflows, so
scenes of any scale and rays of any length need no normalisation.
"""

import numpy as np

from jit import inlined, kernel

#: How far the culling tests are widened, relative to the distance and, for hits near the origin, to the ray's ``slack``: boxes
#: and cells whose entry lies beyond the best hit by less are still visited. Far above the rounding of the tests themselves
#: (2^-50), so that hits that differ by rounding, found through different boxes, are all compared; far below the resolution
#: of float32 coordinates (2^-24), so it costs no visits.
PAD = 2.0**-40
WIDER = 1.0 + PAD
NARROWER = 1.0 - PAD

#: Bound of the relative rounding of a triangle's projected area and corners.
NOISE = 2.0**-48

#: Larger than any triangle number: the number of "no hit yet", so that the lowest number wins among equal t.
NO_PRIM = np.int32(2**31 - 1)


X, Y, Z, SECOND, THIRD = (np.uint64(k) for k in (0, 1, 2, 3, 6))  # unsigned: see traverse.py


@kernel
def shear(dx, dy, dz):
    """Return ((kx, ky, kz), (sx, sy, sz)): the axis permutation and shear that take the direction to +z.

    Woop, Benthin, Wald 2013, "Watertight Ray/Triangle Intersection", Sec. 3: kz is the axis of the largest component.
    """
    ax, ay, az = abs(dx), abs(dy), abs(dz)
    if ax >= ay and ax >= az:
        return (Y, Z, X), (dy / dx, dz / dx, 1.0 / dx)
    if ay >= az:
        return (Z, X, Y), (dz / dy, dx / dy, 1.0 / dy)
    return (X, Y, Z), (dx / dz, dy / dz, 1.0 / dz)


@inlined
def slack(bounds, ox, oy, oz, dx, dy, dz):
    """Return the absolute margin of a ray's culling tests, in t: PAD x its largest distance to the box / its direction.

    The t of a triangle is rounded relative to the distance of its corners, not to t: a relative margin alone vanishes where t
    does. ``bounds[0:6]`` is the box of all triangles.
    """
    x = max(abs(bounds[X] - ox), abs(bounds[SECOND] - ox))
    y = max(abs(bounds[Y] - oy), abs(bounds[SECOND + Y] - oy))
    z = max(abs(bounds[Z] - oz), abs(bounds[SECOND + Z] - oz))
    return PAD * max(x, y, z) / max(abs(dx), abs(dy), abs(dz))


@kernel
def triangle_t(tri, v, kx, ky, kz, ox, oy, oz, sx, sy, sz):
    """Return the ray parameter at which the ray's line meets the triangle whose nine floats start at ``tri[v]``; NaN for none.

    ``ox``, ``oy``, ``oz`` is the origin, its axes permuted by (kx, ky, kz).

    Every edge function is computed from sheared vertices that neighbouring triangles share, and a*b - c*d without
    contraction changes its sign exactly when the edge is walked the other way: no ray passes between two triangles with a
    common edge. Edges belong to both. A triangle seen edge-on, or without area, is not hit, unless rounding opens it: then
    between its ends, at the depth of its corners.
    """
    az, bz, cz = tri[v + kz] - oz, tri[v + SECOND + kz] - oz, tri[v + THIRD + kz] - oz
    ax, ay = (tri[v + kx] - ox) - sx * az, (tri[v + ky] - oy) - sy * az
    bx, by = (tri[v + SECOND + kx] - ox) - sx * bz, (tri[v + SECOND + ky] - oy) - sy * bz
    cx, cy = (tri[v + THIRD + kx] - ox) - sx * cz, (tri[v + THIRD + ky] - oy) - sy * cz
    u = cx * by - cy * bx
    v_ = ax * cy - ay * cx
    w = bx * ay - by * ax
    # Smallest and largest first, then one branch: three sign tests each mispredict, which took twice the time.
    low = u if u < v_ else v_
    low = w if w < low else low
    high = u if u > v_ else v_
    high = w if w > high else high
    if low < 0.0 and high > 0.0:
        return np.nan
    det = u + v_ + w
    if det == 0.0:
        return np.nan
    # Edge-on, or without area, a triangle is a line in the sheared plane: on all of that line the edge functions are rounding
    # noise, of any sign. Only between its ends may it be taken for a hit (and must: its neighbours saw the ray outside).
    wide, tall = max(abs(ax), abs(bx), abs(cx)), max(abs(ay), abs(by), abs(cy))
    if abs(det) <= NOISE * wide * tall:
        if min(ax, bx, cx) > NOISE * wide or max(ax, bx, cx) < -NOISE * wide:
            return np.nan
        if min(ay, by, cy) > NOISE * tall or max(ay, by, cy) < -NOISE * tall:
            return np.nan
    # A weighted mean of the corners' depths: rounding may not take it out of them, or a triangle that is edge-on but for
    # rounding would be hit anywhere along the ray.
    depth = (u * az + v_ * bz + w * cz) / det
    return sz * max(min(depth, max(az, bz, cz)), min(az, bz, cz))
