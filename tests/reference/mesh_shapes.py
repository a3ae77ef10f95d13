"""Shapes with known area and volume, for files that a test writes.

All coordinates are multiples of 1/64, which every format holds exactly.
"""

import math
from random import Random
from typing import NamedTuple

import numpy as np


class Shape(NamedTuple):
    """Polygons, their area, and the volume they enclose (None: they enclose none)."""

    name: str
    vertices: list[tuple[float, float, float]]
    polygons: list[list[int]]
    area: float
    volume: float | None
    is_convex: bool

    def fans(self) -> np.ndarray:
        """Return the triangles that a reader must make of convex polygons, (n, 3, 3) float32."""
        corners = [[p[0], p[k], p[k + 1]] for p in self.polygons for k in range(1, len(p) - 1)]
        return np.array([[self.vertices[i] for i in each] for each in corners], np.float32)


def soup(rng: Random) -> Shape:
    """Triangles anywhere; the area is that of Heron's formula."""
    n = rng.randint(1, 9)
    vertices = [tuple(rng.randint(-640, 640) / 64 for _ in range(3)) for _ in range(n + 2)]
    polygons = [rng.sample(range(n + 2), 3) for _ in range(n)]
    area = 0.0
    for p in polygons:
        a, b, c = (math.dist(vertices[p[k]], vertices[p[k - 1]]) for k in range(3))
        area += math.sqrt(max(0.0, (a + b + c) * (b + c - a) * (a + c - b) * (a + b - c))) / 4
    return Shape("soup", vertices, polygons, area, None, True)


def box(rng: Random) -> Shape:
    """A box of six quads."""
    x, y, z = (rng.randint(1, 500) / 64 for _ in range(3))
    vertices = [(x * (k & 1), y * (k >> 1 & 1), z * (k >> 2)) for k in range(8)]
    quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    return Shape("box", vertices, quads, 2 * (x * y + y * z + z * x), x * y * z, True)


def prism(rng: Random) -> Shape:
    """A prism over a polygon that is not convex: the area and the volume are by the shoelace formula and the height."""
    outline = rng.choice([star, comb, spiral, ring])(rng)
    n, height = len(outline), rng.randint(1, 300) / 64
    following = [*outline[1:], outline[0]]
    base = sum(a[0] * b[1] - a[1] * b[0] for a, b in zip(outline, following, strict=True)) / 2
    lean_x, lean_y = rng.choice([(0, 0), (1, 0), (0.5, 2), (-2, 1)])  # both ends lie in the plane z = lean_x x + lean_y y
    low = [(x, y, lean_x * x + lean_y * y) for x, y in outline]
    high = [(x, y, z + height) for x, y, z in low]
    walls = [[k, (k + 1) % n, n + (k + 1) % n, n + k] for k in range(n)]
    start = rng.randrange(n)
    bottom = [(start - k) % n for k in range(n)]
    top = [n + (start + k) % n for k in range(n)]
    around = sum(math.dist(a, b) for a, b in zip(outline, following, strict=True)) * height
    area = 2 * base * math.sqrt(1 + lean_x**2 + lean_y**2) + around
    return Shape("prism", [*low, *high], [bottom, *walls, top], area, base * height, False)


Outline = list[tuple[float, float]]


def star(rng: Random) -> Outline:
    """Corners all round, near and far from the middle."""
    n = rng.randint(5, 14)
    angles = [2 * math.pi * (k + rng.uniform(-0.3, 0.3)) / n for k in range(n)]
    radii = [rng.choice([1, 2, 5, 9]) + rng.random() for _ in range(n)]
    return [(round(64 * r * math.cos(a)) / 64, round(64 * r * math.sin(a)) / 64) for a, r in zip(angles, radii, strict=True)]


def comb(rng: Random) -> Outline:
    """Teeth that point up."""
    n = rng.randint(2, 6)
    teeth = [p for k in range(n, 0, -1) for p in ((k, 2 + rng.randint(0, 64) / 64), (k - 0.5, 0.5))]
    return [(0.0, 0.0), (float(n), 0.0), *((float(x), float(y)) for x, y in teeth)]


def spiral(rng: Random) -> Outline:
    """A passage that winds inwards; no point of it sees all of it."""
    return [(0, 0), (8, 0), (8, 8), (2, 8), (2, 4), (4, 4), (4, 6), (6, 6), (6, 2), (0, 2)]


def ring(rng: Random) -> Outline:
    """A square with a square hole, which an edge that is gone both ways joins to the outside."""
    return [(0, 0), (6, 0), (6, 6), (0, 6), (0, 0), (2, 2), (2, 4), (4, 4), (4, 2), (2, 2)]


def shape(rng: Random) -> Shape:
    """Return a shape by chance."""
    return rng.choice([soup, box, prism, prism])(rng)
