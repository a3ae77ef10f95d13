"""Camera, light and tree -> one chunk of traced rays: primary rays, a shadow ray where one is needed, and the shaded pixels.

A chunk is a run of consecutive pixels in shooting order. Chunks do not depend on one another, so any number of threads
gives the same rays, accesses and picture.
"""

import math
import threading
from typing import NamedTuple

import numpy as np

from nptrace_base.jit import kernel
from rtrace.traverse import Hits, Rays, Room, trace, trace_recorded
from rtrace.trees.tree import Tree
from traces.format import PREFETCH, PRIMARY, SHADOW
from traces.writer import empty_column

#: Shadow rays start this far from the surface, and end this far before the light, relative to the largest coordinate: four
#: units in the last place of float32. No fixed distance is right at every scale (docs/correctness.md).
OFFSET = 2.0 * 2.0**-22
#: A hit near the world's origin has small coordinates, but not a small error: the eye and the triangle's corners enter it in
#: float64, of which this share of their coordinates is a generous bound.
LEAST = 2.0**-16
#: Events of one type of rays that a chunk holds at most, unless a single ray has more: 8 MB, and 19 MB of columns. Usual
#: chunks hold an eighth of it.
MOST_EVENTS = 2**21


_local = threading.local()  # the memory for the events of this thread's chunk, one Room for each type of rays


class Chunk(NamedTuple):
    """The rays of some pixels, as columns of the run's tables; ray numbers and first rows start at 0."""

    rays: dict[str, np.ndarray]
    accesses: dict[str, np.ndarray]
    pixels: np.ndarray  # (n,) uint32: y * width + x
    colours: np.ndarray  # (n, 3) uint8
    n_prefetches: int
    n_hits: int  # primary rays that hit something
    n_shadow: int
    n_shadowed: int
    is_shaded: bool  # not so after a pass of primary rays, which sees no shadows


@kernel
def _primary_directions(frame, pixels, width, direction):
    """Write unit directions through the pixel centres; ``frame`` is Camera.frame: eye, corner, du, dv."""
    for i in range(pixels.size):
        x, y = np.float64(pixels[i] % width), np.float64(pixels[i] // width)
        dx = frame[1, 0] + x * frame[2, 0] + y * frame[3, 0]
        dy = frame[1, 1] + x * frame[2, 1] + y * frame[3, 1]
        dz = frame[1, 2] + x * frame[2, 2] + y * frame[3, 2]
        scale = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
        direction[i, 0], direction[i, 1], direction[i, 2] = dx * scale, dy * scale, dz * scale


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
def _shadow_rays(tri, eye, direction, prim, t, light, origin, to_light, t_max, owner, facing, normal):
    """Write a shadow ray for each hit on a surface that faces the light; return their number.

    ``owner`` is the index of the primary ray; ``normal`` (towards the viewer) and ``facing`` (its cosine to the light) are
    filled for every hit and needed for shading.
    """
    n_shadow = 0
    light_size = max(abs(light[0]), abs(light[1]), abs(light[2]))
    eye_size = LEAST * max(abs(eye[0]), abs(eye[1]), abs(eye[2]))
    for i in range(prim.size):
        facing[i] = 0.0
        if prim[i] < 0:
            continue
        nx, ny, nz = _normal(tri, prim[i])
        dx, dy, dz = np.float64(direction[i, 0]), np.float64(direction[i, 1]), np.float64(direction[i, 2])
        if nx * dx + ny * dy + nz * dz > 0.0:
            nx, ny, nz = -nx, -ny, -nz
        normal[i, 0], normal[i, 1], normal[i, 2] = nx, ny, nz
        px, py, pz = eye[0] + t[i] * dx, eye[1] + t[i] * dy, eye[2] + t[i] * dz
        lx, ly, lz = light[0] - px, light[1] - py, light[2] - pz
        cosine = nx * lx + ny * ly + nz * lz
        if not cosine > 0.0:
            continue
        size = max(eye_size, abs(px), abs(py), abs(pz))
        for corner in range(3):
            for k in range(3):
                size = max(size, LEAST * abs(tri[prim[i], corner, k]))
        off = OFFSET * size
        ox, oy, oz = np.float32(px + nx * off), np.float32(py + ny * off), np.float32(pz + nz * off)
        lx, ly, lz = np.float32(light[0] - ox), np.float32(light[1] - oy), np.float32(light[2] - oz)
        reach = max(abs(lx), abs(ly), abs(lz))
        if not reach > 0.0:
            continue
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
def _shade(prim, direction, normal, facing, owner, occluder, colours):
    """Lambert shading, tinted by the normal so that every edge shows; shadowed surfaces keep an ambient part."""
    lit = np.ones(prim.size, np.uint8)
    for k in range(owner.size):
        if occluder[k] >= 0:
            lit[owner[k]] = 0
    for i in range(prim.size):
        if prim[i] < 0:
            colours[i, 0], colours[i, 1], colours[i, 2] = 34, 38, 46
            continue
        head_on = abs(normal[i, 0] * direction[i, 0] + normal[i, 1] * direction[i, 1] + normal[i, 2] * direction[i, 2])
        light = 0.10 + 0.16 * head_on + 0.74 * facing[i] * lit[i]
        for k in range(3):
            colours[i, k] = np.uint8(255.0 * np.sqrt(min(light * (0.80 + 0.20 * normal[i, k]), 1.0)))


@kernel
def _sequence(n, owner, batch, sequence):
    """Write the order of the rays: ``batch`` primaries, then their shadow rays (numbered from ``n`` on), and so on."""
    at, shadow = 0, 0
    for start in range(0, n, batch):
        end = min(start + batch, n)
        for i in range(start, end):
            sequence[at] = i
            at += 1
        while shadow < owner.size and owner[shadow] < end:
            sequence[at] = n + shadow
            at += 1
            shadow += 1


@kernel
def _ray_columns(sequence, n, pixels, owner, width, count, shadow_count, prim, shadow_prim, t, shadow_t,
                 x, y, type_, first, counts, prims, ts):  # fmt: skip
    """Write the columns of both kinds of rays in the order of ``sequence``; return how many primary, shadow rays hit."""
    row, n_hits, n_shadowed = np.uint64(0), 0, 0
    for i in range(sequence.size):
        s = sequence[i]
        if s < n:
            pixel, c, p, distance = pixels[s], count[s], prim[s], t[s]
            n_hits += p >= 0
            type_[i] = PRIMARY
        else:
            s -= n
            pixel, c, p, distance = pixels[owner[s]], shadow_count[s], shadow_prim[s], shadow_t[s]
            n_shadowed += p >= 0
            type_[i] = SHADOW
        x[i], y[i] = pixel % width, pixel // width
        first[i], counts[i], prims[i], ts[i] = row, c, p, distance
        row += np.uint64(c)
    return n_hits, n_shadowed


@kernel
def _accesses(sequence, n, count, events, shadow_count, shadow_events, ray, node, kind):
    """Write the accesses of both kinds of rays in the order of ``sequence``, both event lists being in ray order.

    Return the number of pre-fetch requests.
    """
    at, primary_at, shadow_at = np.uint64(0), np.uint64(0), np.uint64(0)
    n_prefetches = 0
    for r in range(sequence.size):
        s = sequence[r]
        if s < n:
            k, source, length = primary_at, events, np.uint64(count[s])
            primary_at += length
        else:
            k, source, length = shadow_at, shadow_events, np.uint64(shadow_count[s - n])
            shadow_at += length
        for j in range(length):
            event = source[k + j]
            ray[at + j] = r
            node[at + j] = event >> np.uint32(2)
            kind[at + j] = event & np.uint32(3)
            n_prefetches += event & np.uint32(3) == PREFETCH
        at += length
    return n_prefetches


def primary_rays(frame: np.ndarray, pixels: np.ndarray, width: int) -> Rays:
    """Return one ray through the centre of each pixel (``y * width + x``), of unit direction, from the eye to infinity."""
    n = len(pixels)
    direction = np.empty((n, 3), np.float32)
    _primary_directions(frame, pixels, np.uint32(width), direction)
    origin = np.broadcast_to(frame[0].astype(np.float32), (n, 3)).copy()
    return Rays(origin, direction, np.zeros(n), np.full(n, np.inf))


def shadow_rays(
    tree: Tree, primary: Rays, hits: Hits, light: tuple[float, float, float]
) -> tuple[Rays, np.ndarray, np.ndarray, np.ndarray]:
    """Return the shadow rays of hits that face the light.

    Returns
    -------
    rays : Rays
        From the surface (offset along the normal) to the light; direction = light - origin, not of unit length.
    owner : (m,) int32
        The primary ray of each.
    facing : (n,) float64
        Cosine between the normal and the light, 0 where it does not face the light or nothing was hit.
    normal : (n, 3) float64
        Unit normal towards the viewer; undefined where nothing was hit.
    """
    n = len(hits.prim)
    origin, to_light = np.empty((n, 3), np.float32), np.empty((n, 3), np.float32)
    t_max, owner = np.empty(n), np.empty(n, np.int32)
    facing, normal = np.empty(n), np.empty((n, 3))
    eye = primary.origin[0].astype(np.float64) if n else np.zeros(3)
    at = np.array(light, np.float64)
    # A light that float32 cannot hold is brought nearer by a power of two: seen from any scene, it stays where it was.
    at *= 2.0 ** min(0, 126 - math.frexp(float(np.abs(at).max()))[1])
    m = _shadow_rays(
        tree.triangles, eye, primary.direction, hits.prim, hits.t, at, origin, to_light, t_max, owner, facing, normal
    )
    return Rays(origin[:m], to_light[:m], np.zeros(m), t_max[:m]), owner[:m], facing, normal


def shoot(
    tree: Tree,
    frame: np.ndarray,
    light: tuple[float, float, float],
    pixels: np.ndarray,
    width: int,
    batch: int,
    pass_: int | None,
    most: int | None = None,
) -> Chunk:
    """Trace the rays of ``pixels`` and shade them.

    Parameters
    ----------
    frame : (4, 3) float64
        ``Camera.frame``.
    pixels : (n,) uint32
    batch : int
        Primary rays shot before their shadow rays.
    pass_ : {None, PRIMARY, SHADOW}
        Record both types of rays, or only one (all primaries first takes two passes).
    most : int, optional
        Events of one type of rays that are taken into memory, unless a single ray has more; NoRoomError is raised beyond.
    """
    if not hasattr(_local, "rooms"):
        _local.rooms = Room(), Room()
    rooms = _local.rooms
    for room in rooms:
        room.most = most
    primary = primary_rays(frame, pixels, width)
    nothing = np.zeros(len(pixels), np.uint32), np.empty(0, np.uint32)
    if pass_ == SHADOW:
        hits, (count, events) = trace(tree, primary), nothing
    else:
        hits, count, events = trace_recorded(tree, primary, room=rooms[PRIMARY])
    rays, owner, facing, normal = shadow_rays(tree, primary, hits, light)
    if pass_ == PRIMARY:
        shadow, (shadow_count, shadow_events) = Hits(np.empty(0, np.int32), np.empty(0)), nothing
        owner = owner[:0]
    else:
        shadow, shadow_count, shadow_events = trace_recorded(tree, rays, any_hit=True, room=rooms[SHADOW])
    colours = np.empty((len(pixels), 3), np.uint8)
    _shade(hits.prim, primary.direction, normal, facing, owner, shadow.prim, colours)

    n = len(pixels)
    sequence = np.empty(n + len(owner), np.int32)
    _sequence(n, owner, batch, sequence)
    if pass_ == SHADOW:
        sequence = sequence[sequence >= n]
    n_rays, total = len(sequence), len(events) + len(shadow_events)
    accesses: dict[str, np.ndarray] = {
        "ray": empty_column(total, np.uint32),
        "node": empty_column(total, np.uint32),
        "kind": empty_column(total, np.uint8),
    }
    n_prefetches = _accesses(sequence, n, count, events, shadow_count, shadow_events, *accesses.values())
    columns: dict[str, np.ndarray] = {
        "x": np.empty(n_rays, np.uint16),
        "y": np.empty(n_rays, np.uint16),
        "type": np.empty(n_rays, np.uint8),
        "first": np.empty(n_rays, np.uint64),
        "count": np.empty(n_rays, np.uint32),
        "prim": np.empty(n_rays, np.int32),
        "t": np.empty(n_rays, np.float32),
    }
    n_hits, n_shadowed = _ray_columns(
        sequence, n, pixels, owner, np.uint32(width), count, shadow_count, hits.prim, shadow.prim, hits.t, shadow.t,
        *columns.values()
    )  # fmt: skip
    columns["ray"] = np.arange(n_rays, dtype=np.uint32)
    n_shadow = n_rays if pass_ == SHADOW else n_rays - n
    return Chunk(columns, accesses, pixels, colours, n_prefetches, n_hits, n_shadow, n_shadowed, pass_ != PRIMARY)


def smaller_pieces(start: int, stop: int, batch: int, pass_: int | None) -> list[tuple[int, int, int | None]]:
    """Return the (start, stop, pass) of pixels that together make the rows of a chunk, in order, and take less memory.

    Halves of whole batches; a single batch is traced twice, first its primary rays, then its shadow rays.
    """
    n_batches = -(-(stop - start) // batch)
    if pass_ is None and n_batches == 1:
        return [(start, stop, PRIMARY), (start, stop, SHADOW)]
    middle = start + (n_batches // 2 * batch if pass_ is None else (stop - start) // 2)
    return [(start, middle, pass_), (middle, stop, pass_)]
