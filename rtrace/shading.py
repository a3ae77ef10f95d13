"""Hits and a light -> the shadow rays, of the hits that face it or of more pixels, and the shaded pixels."""

import math
from typing import NamedTuple

import numpy as np

from nptrace_base.jit import kernel
from rtrace.rays import Hits, Rays
from rtrace.shooting import SHADOWS
from rtrace.trees.tree import Tree

#: Shadow rays start this far from the surface, and end this far before the light, relative to the largest coordinate: four
#: units in the last place of float32. No fixed distance is right at every scale (docs/correctness.md).
OFFSET = 2.0 * 2.0**-22
LIT, ALL = SHADOWS.index("lit"), SHADOWS.index("all")
#: A hit near the world's origin has small coordinates, but not a small error: the eye and the triangle's corners enter it in
#: float64, of which this share of their coordinates is a generous bound.
LEAST = 2.0**-16


class Surface(NamedTuple):
    """The surfaces that a batch of rays hit, as shading needs them.

    Attributes
    ----------
    facing : (n,) float64
        Cosine between the normal and the light, 0 where it does not face the light or nothing was hit.
    normal : (n, 3) float64
        Unit normal towards the viewer; undefined where nothing was hit.
    """

    facing: np.ndarray
    normal: np.ndarray


@kernel
def _normal(tri, c):
    """Return the unit geometric normal of triangle ``c``."""
    ax, ay, az = np.float64(tri[c, 0, 0]), np.float64(tri[c, 0, 1]), np.float64(tri[c, 0, 2])
    ux, uy, uz = tri[c, 1, 0] - ax, tri[c, 1, 1] - ay, tri[c, 1, 2] - az
    vx, vy, vz = tri[c, 2, 0] - ax, tri[c, 2, 1] - ay, tri[c, 2, 2] - az
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    # Scaled by the largest component first: the squares of a tiny triangle's normal would vanish.
    top = max(abs(nx), abs(ny), abs(nz))
    if top == 0.0:
        return 0.0, 0.0, 0.0
    nx, ny, nz = nx / top, ny / top, nz / top
    scale = 1.0 / np.sqrt(nx * nx + ny * ny + nz * nz)
    return nx * scale, ny * scale, nz * scale


@kernel
def _way_out(eye, direction, bounds):
    """Return where a ray leaves the box ``bounds``, and if it passes the box by, its point nearest to the box's middle."""
    near, far, along, length = 0.0, np.inf, 0.0, 0.0
    for k in range(3):
        low, high, d = bounds[0, k] - eye[k], bounds[1, k] - eye[k], direction[k]
        along += 0.5 * (low + high) * d
        length += d * d
        if d != 0.0:
            near, far = max(near, min(low / d, high / d)), min(far, max(low / d, high / d))
        elif low > 0.0 or high < 0.0:
            far = -1.0
    t = far if near <= far else max(along / length, 0.0)
    return eye[0] + t * direction[0], eye[1] + t * direction[1], eye[2] + t * direction[2]


@kernel
def _shadow_rays(triangles, eye, lamp, directions, hits, surface, rays, owner):
    """Write a shadow ray for each hit on a surface that faces the light, or for more pixels; return their number.

    ``lamp`` is where the light is, which pixels send a ray (a place in ``SHADOWS``), and the scene's box. ``rays`` gets the
    shadow rays, ``owner`` the index of each one's primary ray, ``surface`` a row for every primary ray.
    """
    light, senders, bounds = lamp
    prim, t = hits
    facing, normal = surface
    origin, to_light, _, t_max = rays
    n_shadow = 0
    light_size = max(abs(light[0]), abs(light[1]), abs(light[2]))
    eye_size = LEAST * max(abs(eye[0]), abs(eye[1]), abs(eye[2]))
    for i in range(prim.size):
        facing[i] = 0.0
        dx, dy, dz = np.float64(directions[i, 0]), np.float64(directions[i, 1]), np.float64(directions[i, 2])
        if prim[i] < 0:
            if senders != ALL:
                continue
            px, py, pz = _way_out(eye, (dx, dy, dz), bounds)
            nx, ny, nz, cosine = 0.0, 0.0, 0.0, 0.0
            size = max(eye_size, abs(px), abs(py), abs(pz))
        else:
            nx, ny, nz = _normal(triangles, prim[i])
            if nx * dx + ny * dy + nz * dz > 0.0:
                nx, ny, nz = -nx, -ny, -nz
            normal[i, 0], normal[i, 1], normal[i, 2] = nx, ny, nz
            px, py, pz = eye[0] + t[i] * dx, eye[1] + t[i] * dy, eye[2] + t[i] * dz
            lx, ly, lz = light[0] - px, light[1] - py, light[2] - pz
            cosine = nx * lx + ny * ly + nz * lz
            if not cosine > 0.0:
                if senders == LIT:
                    continue
                if cosine < 0.0:
                    nx, ny, nz = -nx, -ny, -nz  # the ray starts on the side of the surface where the light is
            size = max(eye_size, abs(px), abs(py), abs(pz))
            for corner in range(3):
                for k in range(3):
                    size = max(size, LEAST * abs(triangles[prim[i], corner, k]))
        off = OFFSET * size
        ox, oy, oz = np.float32(px + nx * off), np.float32(py + ny * off), np.float32(pz + nz * off)
        lx, ly, lz = np.float32(light[0] - ox), np.float32(light[1] - oy), np.float32(light[2] - oz)
        reach = max(abs(lx), abs(ly), abs(lz))
        if not reach > 0.0:
            continue
        if cosine > 0.0:
            facing[i] = cosine / np.sqrt((light[0] - px) ** 2 + (light[1] - py) ** 2 + (light[2] - pz) ** 2)
        last = 1.0 - OFFSET * max(size, light_size) / reach
        if last <= 0.0:
            continue  # the light is as near as float32 can tell: nothing can stand between
        origin[n_shadow, 0], origin[n_shadow, 1], origin[n_shadow, 2] = ox, oy, oz
        to_light[n_shadow, 0], to_light[n_shadow, 1], to_light[n_shadow, 2] = lx, ly, lz
        t_max[n_shadow] = last
        owner[n_shadow] = i
        n_shadow += 1
    return n_shadow


@kernel
def _shade(prim, directions, surface, owner, occluder, colours):
    """Lambert shading, tinted by the normal so that every edge shows; shadowed surfaces keep an ambient part."""
    facing, normal = surface
    lit = np.ones(prim.size, np.uint8)
    for k in range(owner.size):
        if occluder[k] >= 0:
            lit[owner[k]] = 0
    for i in range(prim.size):
        if prim[i] < 0:
            colours[i, 0], colours[i, 1], colours[i, 2] = 34, 38, 46
            continue
        nx, ny, nz = normal[i, 0], normal[i, 1], normal[i, 2]
        head_on = abs(nx * directions[i, 0] + ny * directions[i, 1] + nz * directions[i, 2])
        light = 0.10 + 0.16 * head_on + 0.74 * facing[i] * lit[i]
        for k in range(3):
            colours[i, k] = np.uint8(255.0 * np.sqrt(min(light * (0.80 + 0.20 * normal[i, k]), 1.0)))


def shadow_rays(
    tree: Tree, primary: Rays, hits: Hits, light: tuple[float, float, float], senders: str = "lit"
) -> tuple[Rays, np.ndarray, Surface]:
    """Return the shadow rays of hits that face the light, or of more pixels.

    Parameters
    ----------
    senders : str
        ``shooting.SHADOWS``: ``hit`` adds those of surfaces that face away, which start on the far side of the surface, the
        light's; ``all`` those of pixels without a hit, which start where the primary ray leaves the scene's box, or, if it
        passes the box by, at its point nearest to the box's middle.

    Returns
    -------
    rays : Rays
        From the surface (offset along the normal) to the light; direction = light - origin, not of unit length. There is none
        from where the light is, as nearly as float32 can tell.
    owner : (m,) int32
        The primary ray of each.
    surface : Surface
    """
    n = len(hits.prim)
    rays = Rays(np.empty((n, 3), np.float32), np.empty((n, 3), np.float32), np.zeros(n), np.empty(n))
    owner, surface = np.empty(n, np.int32), Surface(np.empty(n), np.empty((n, 3)))
    eye = primary.origin[0].astype(np.float64) if n else np.zeros(3)
    at = np.array(light, np.float64)
    # A light that float32 cannot hold is brought nearer by a power of two: seen from any scene, it stays where it was.
    at *= 2.0 ** min(0, 126 - math.frexp(float(np.abs(at).max()))[1])
    lamp = at, np.uint8(SHADOWS.index(senders)), tree.bounds.astype(np.float64)
    m = _shadow_rays(tree.triangles, eye, lamp, primary.direction, hits, surface, rays, owner)
    return Rays(*(array[:m] for array in rays)), owner[:m], surface


def shade(primary: Rays, hits: Hits, surface: Surface, owner: np.ndarray, shadow: Hits) -> np.ndarray:
    """Return the colours of primary rays, (n, 3) uint8; ``owner`` and ``shadow`` are the shadow rays' primaries and hits."""
    colours = np.empty((len(hits.prim), 3), np.uint8)
    _shade(hits.prim, primary.direction, surface, owner, shadow.prim, colours)
    return colours
