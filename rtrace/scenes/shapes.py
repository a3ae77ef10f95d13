"""Shapes to build scenes from, as (n, 3, 3) float32 triangles, y up: patches, boxes, turned and swept bodies, arches, spheres.

Plain arithmetic on a decimal grid of 1e-5 (``solid``), so that the same call gives the same bits on every machine.
"""

from collections.abc import Callable

import numpy as np


def solid(*parts: np.ndarray) -> np.ndarray:
    """Return all parts as one (n, 3, 3) float32 array, coordinates rounded to 1e-5, without triangles shrunk to a line."""
    triangles = np.concatenate([np.asarray(part, np.float64).reshape(-1, 3, 3) for part in parts])
    # The last bit of a sine differs between machines; this rounding hides it.
    triangles = np.round(triangles, 5).astype(np.float32) + np.float32(0.0)  # -0 becomes 0
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    flat = (a == b).all(axis=1) | (b == c).all(axis=1) | (c == a).all(axis=1)
    return np.ascontiguousarray(triangles[~flat]) if flat.any() else triangles


def patch(points: np.ndarray) -> np.ndarray:
    """Return the (2 (n-1) (m-1), 3, 3) triangles of a surface through (n, m, 3) points."""
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    return np.stack([a, b, c, a, c, d], axis=2).reshape(-1, 3, 3)


def between(first: np.ndarray, last: np.ndarray, n: int) -> np.ndarray:
    """Return (2 n (m-1), 3, 3): the surface of n strips from one curve of (m, 3) points to another."""
    t = np.linspace(0.0, 1.0, n + 1)[:, None, None]
    return patch(first * (1 - t) + last * t)


def rectangle(corner, along, across, n: int = 1, m: int = 1) -> np.ndarray:
    """Return a flat rectangle or parallelogram of n x m cells from ``corner`` along two edge vectors."""
    s, t = np.linspace(0, 1, n + 1)[:, None, None], np.linspace(0, 1, m + 1)[None, :, None]
    return patch(np.array(corner) + s * np.array(along) + t * np.array(across))


def box(lower, upper) -> np.ndarray:
    """Return the 12 triangles of an axis-aligned box."""
    (x0, y0, z0), (x1, y1, z1) = lower, upper
    dx, dy, dz = (x1 - x0, 0, 0), (0, y1 - y0, 0), (0, 0, z1 - z0)
    low, high = (x0, y0, z0), (x1, y1, z1)
    back = [tuple(-v for v in d) for d in (dx, dy, dz)]
    sides = [
        (low, dx, dz),
        (low, dy, dx),
        (low, dz, dy),
        (high, back[2], back[0]),
        (high, back[0], back[1]),
        (high, back[1], back[2]),
    ]
    return np.concatenate([rectangle(*side) for side in sides])


def circle(n: int, start: float = 0.0, turns: float = 1.0) -> np.ndarray:
    """Return (n + 1, 2) points x, y on the unit circle, from ``start`` turns on; a full circle ends in its first point."""
    angle = 2 * np.pi * (start + np.linspace(0.0, turns, n + 1))
    points = np.round(np.stack([np.cos(angle), np.sin(angle)], axis=1), 9)
    if turns == 1.0:
        points[-1] = points[0]
    return points


def turned(profile, n: int, *, flutes: int = 0, turns: float = 1.0, start: float = 0.0) -> np.ndarray:
    """Return the body of revolution about the y axis of a ``profile`` of (radius, height) pairs, in n sides.

    ``flutes`` grooves run along it, 6 % deep.
    """
    profile = np.array(profile, np.float64)
    ring = circle(n, start, turns)
    if flutes:
        ring = ring * (1 - 0.06 * np.abs(circle(n, 0.0, flutes / 2)[:, 1:]))
    radius = profile[:, :1] * np.ones(n + 1)
    return patch(np.stack([radius * ring[:, 0], profile[:, 1:] * np.ones(n + 1), radius * ring[:, 1]], axis=2))


def tube(path: np.ndarray, radius: float, n: int) -> np.ndarray:
    """Return a tube of n sides around a path of (m, 3) points in a plane that holds the y axis."""
    path = np.array(path, np.float64)
    along = np.gradient(path, axis=0)
    along /= np.sqrt((along**2).sum(axis=1, keepdims=True))
    side = np.cross(path[-1] - path[0] + [0.0, 1e-3, 0.0], path[len(path) // 2] - path[0])
    side /= np.sqrt((side**2).sum())
    up = np.cross(side, along)
    ring = radius * circle(n)
    return patch(path[:, None] + ring[None, :, :1] * side + ring[None, :, 1:] * up[:, None])


def cushion(size, n: int, m: int) -> np.ndarray:
    """Return a closed body between a ball and a box, of full ``size`` (3 lengths) about the origin, 2 n m triangles."""
    ring, height = circle(n), circle(m, -0.25, 0.5)
    x, y = ring[:, 0] * height[:, :1], height[:, 1:] * np.ones(n + 1)
    points = np.stack([x, y, ring[:, 1] * height[:, :1]], axis=2)
    return patch(np.sign(points) * np.sqrt(np.abs(points)) * (np.array(size) / 2))


def arch(span: float, springing: float, top: float, depth: float, n: int, m: int = 2) -> np.ndarray:
    """Return a wall with a round arch in it: x from 0 to span, z from 0 to depth, from the springing line up to ``top``.

    The arch is a half circle (flattened if the wall is too low for one) of n segments; m strips from it to the top edge.
    """
    curve = circle(n, 0.5, -0.5)
    rise = min(span / 2, 0.9 * (top - springing))
    x, y = span / 2 * (1 + curve[:, 0]), springing + rise * curve[:, 1]
    inner = np.stack([x, y, 0 * x], axis=1)
    outer = np.stack([x, np.full_like(x, top), 0 * x], axis=1)
    back = np.array([0, 0, depth])
    return np.concatenate([between(inner, outer, m), between(inner + back, outer + back, m), between(inner, inner + back, 2)])


def moved(triangles: np.ndarray, offset=(0.0, 0.0, 0.0), quarter_turns: int = 0, mirror: int | None = None) -> np.ndarray:
    """Return triangles turned about the y axis by quarter turns, mirrored at 0 on one axis, then moved."""
    for _ in range(quarter_turns % 4):
        triangles = np.stack([triangles[..., 2], triangles[..., 1], -triangles[..., 0]], axis=-1)
    if mirror is not None:
        sign = np.ones(3)
        sign[mirror] = -1
        triangles = triangles[:, ::-1] * sign  # the other way round, or the front would become the back
    return triangles + np.asarray(offset, np.float64)


#: Corner numbers of an icosahedron's faces, each ascending: shared edges are then walked the same way from both sides.
_ICO_FACES = [(0, i, i % 5 + 1) for i in range(1, 6)] + [(i, i % 5 + 1, i + 5) for i in range(1, 6)]
_ICO_FACES += [(i % 5 + 1, i + 5, i % 5 + 6) for i in range(1, 6)] + [(i + 5, i % 5 + 6, 11) for i in range(1, 6)]


def geodesic(frequency: int, radius: Callable[[np.ndarray], np.ndarray] | None = None) -> np.ndarray:
    """Return (20 frequency^2, 3, 3) float64 triangles of a watertight unit ball, front sides out.

    ``radius`` gives the distance from the middle for (n, 3) unit vectors, where it is not to be 1. Equal corners are equal in
    every bit, as they are computed from the same numbers in the same order on both sides of an edge.
    """
    low, ring = 1 / np.sqrt(5.0), 2 / np.sqrt(5.0)
    upper, lower = circle(5)[:5], circle(5, 0.1)[:5]
    points = [
        (0, 1, 0),
        *((ring * x, low, ring * z) for x, z in upper),
        *((ring * x, -low, ring * z) for x, z in lower),
        (0, -1, 0),
    ]
    a, b, c = np.array(points)[np.sort(np.array(_ICO_FACES), axis=1)].transpose(1, 0, 2)  # (20, 3) each
    i, j = np.meshgrid(np.arange(frequency + 1), np.arange(frequency + 1), indexing="ij")
    i, j = i[i + j <= frequency][:, None], j[i + j <= frequency][:, None]  # the grid of one face
    flat = (frequency - i - j) * a[:, None] + i * b[:, None] + j * c[:, None]
    ball = flat / np.sqrt((flat * flat).sum(axis=2, keepdims=True))
    if radius is not None:
        ball *= radius(ball.reshape(-1, 3)).reshape(20, -1, 1)
    number = np.full((frequency + 2, frequency + 2), -1)
    number[i[:, 0], j[:, 0]] = np.arange(len(i))
    here, right, down, over = number[:-1, :-1], number[1:, :-1], number[:-1, 1:], number[1:, 1:]
    cells = np.concatenate([np.stack([here, right, down], -1)[right >= 0], np.stack([right, over, down], -1)[over >= 0]])
    inward = (np.cross(b - a, c - a) * a).sum(axis=1) < 0
    faces = ball[:, cells]
    faces[inward] = faces[inward][:, :, ::-1]
    return faces.reshape(-1, 3, 3)


def icosphere(subdivisions: int) -> np.ndarray:
    """Return the (20 * 4^subdivisions, 3, 3) float32 triangles of a watertight ball of radius 1 about the origin."""
    return geodesic(2**subdivisions).astype(np.float32)


def height_field(n: int) -> np.ndarray:
    """Return (2 n^2, 3, 3) float32: a hilly floor of n x n cells with corners on whole numbers, y 0 to 4."""
    x, z = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
    return patch(np.stack([x, (7 * x + 13 * z + x * z) % 5, z], axis=2)).astype(np.float32)


def boxes(n: int = 3) -> np.ndarray:
    """Return (12 n^2 + 12, 3, 3) float32: n x n boxes on a plate, whole numbers, many faces in one plane, some touching."""
    sizes = [(i, k, 1 + (i + k) % 2, 1 + (3 * i + 5 * k) % 4) for i in range(n) for k in range(n)]
    parts = [box((2 * i, 0, 2 * k), (2 * i + w, h, 2 * k + w)) for i, k, w, h in sizes]
    return np.concatenate([box((-1, -1, -1), (2 * n + 1, 0, 2 * n + 1)), *parts]).astype(np.float32)


def soup(n: int, seed: int) -> np.ndarray:
    """Return (n, 3, 3) float32, the same for the same seed: centres anywhere in a unit cube, edges from 0.6 to 0.005 long."""
    bits = np.random.PCG64(seed).random_raw(12 * n)  # unlike a Generator's methods, these never change
    numbers = (bits >> np.uint64(11)).astype(np.float64).reshape(n, 12) * 2.0**-53
    size = 0.3 * 4.0 ** -np.floor(4 * numbers[:, :1])
    corners = numbers[:, 1:4].repeat(3, axis=0).reshape(n, 9) + size * (2 * numbers[:, 3:] - 1)
    return corners.reshape(n, 3, 3).astype(np.float32)
