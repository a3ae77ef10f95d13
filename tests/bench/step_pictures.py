"""Pictures that mislead a sample: steps, strips, one hot tile, periods of the sampled unit, caches that nearly hold all.

A name of ``PICTURES`` -> the Picture: what is seen, how large, through which caches. No chance beyond fixed seeds is involved.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from cachesim.config import CacheConfig
from cachesim.report.table1 import caches
from rtrace.camera import Camera, Point
from rtrace.scenes.scene import Scene, scene_from_triangles
from rtrace.scenes.stand_ins import height_field, icosphere


class Picture(NamedTuple):
    """One picture to calibrate on."""

    build: Callable[[], Scene]
    width: int = 1024
    height: int = 1024
    configs: tuple[CacheConfig, ...] = tuple(caches())
    order: str = "scanline"


SMALL = (CacheConfig(1 << 10, 1), CacheConfig(2 << 10, 1), CacheConfig(2 << 10, 2))
NEAR = tuple(CacheConfig(size << 10, 4) for size in (8, 16, 32, 64))
#: Seen from far away through a narrow angle: the square from -1 to 1 in x and y at z = 0 fills the picture.
FAR = Camera((0.0, 0.0, 400.0), (0.0, 0.0, 0.0), fov=2 * float(np.degrees(np.arctan(1 / 400))))
LIGHT: Point = (1.5, 2.5, 15.0)
SQUARE = np.array([[[-1, -1], [1, -1], [1, 1]], [[-1, -1], [1, 1], [-1, 1]]], float)


def _flat(scene: np.ndarray, name: str, camera: Camera = FAR) -> Scene:
    return scene_from_triangles(scene, name, camera=camera, light=LIGHT)


def _grid(low: tuple[float, float], high: tuple[float, float], nx: int, ny: int, z: float = 0.0) -> np.ndarray:
    """Return a rectangle of nx x ny pairs of triangles."""
    x, y = np.linspace(low[0], high[0], nx + 1), np.linspace(low[1], high[1], ny + 1)
    x0, y0 = (a.ravel() for a in np.meshgrid(x[:-1], y[:-1]))
    x1, y1 = (a.ravel() for a in np.meshgrid(x[1:], y[1:]))
    flat = np.stack([x0, y0, x1, y0, x1, y1, x0, y0, x1, y1, x0, y1], 1).reshape(-1, 3, 2)
    return np.concatenate([flat, np.full((len(flat), 3, 1), z)], 2)


def steps() -> Scene:
    """Seven bands across the picture, from two triangles to 40,000."""
    edges = np.array([-1, -0.83, -0.61, -0.2, 0.07, 0.34, 0.41, 1.0])
    fine = [(1, 1), (300, 30), (8, 2), (700, 60), (2, 1), (250, 20), (40, 12)]
    return _flat(
        np.concatenate([_grid((-1, a), (1, b), *n) for a, b, n in zip(edges[:-1], edges[1:], fine, strict=True)]), "steps"
    )


def hot_tile() -> Scene:
    """A clump of 40,000 tiny triangles before an empty wall."""
    rng = np.random.default_rng(77)
    n = 40_000
    centres = np.stack([rng.uniform(0.30, 0.40, n), rng.uniform(0.37, 0.47, n), rng.uniform(0, 0.1, n)], 1)
    clump = centres[:, None] + rng.normal(0, 0.0024, (n, 3, 3))
    return _flat(np.concatenate([_grid((-1, -1), (1, 1), 1, 1, -0.01), clump]), "hot tile")


def strips(upright: bool) -> Scene:
    """Five thin strips of fine triangles on a coarse wall."""
    parts = [_grid((-1, -1), (1, 1), 6, 6, -0.01)]
    for at, width in ((-0.77, 0.011), (-0.31, 0.03), (0.02, 0.006), (0.4, 0.05), (0.9, 0.013)):
        low, high, n = (-1, at), (1, at + width), (900, 6)
        if upright:
            low, high, n = (low[1], low[0]), (high[1], high[0]), (n[1], n[0])
        parts.append(_grid(low, high, *n))
    return _flat(np.concatenate(parts), "upright strips" if upright else "flat strips")


def half_empty() -> Scene:
    """A rough field in the lower half, nothing in the upper one."""
    field = height_field(160).reshape(-1, 3).astype(float)
    low, high = field.min(axis=0), field.max(axis=0)
    unit = (field - low) / (high - low)
    flat = int(np.argmin(high - low))
    others = [k for k in range(3) if k != flat]
    points = np.stack([2 * unit[:, others[0]] - 1, unit[:, others[1]] - 1.02, 0.1 * unit[:, flat]], 1)
    return _flat(points.reshape(-1, 3, 3), "half empty")


def periodic(rows: int, n_rows: int = 1024) -> Scene:
    """Slats with a period of so many rows of the picture, half of it covered, by 64 pairs of triangles each."""
    pitch = 2.0 * rows / n_rows
    parts = [_grid((-1, -1), (1, 1), 16, 16, -0.01)]
    for k in range(n_rows // rows):
        top = 1 - k * pitch
        parts.append(_grid((-1, top - pitch / 2), (1, top), 24 + (k // 128) * 8, 1))
    return _flat(np.concatenate(parts), f"period {rows}")


def needles() -> Scene:
    """700 upright needles of many lengths, in a row."""
    rng = np.random.default_rng(3)
    parts = [_grid((-1, -1), (1, 1), 1, 1, -0.3)]
    for x in np.sort(rng.uniform(-1, 1, 700)):
        low, high = np.sort(rng.uniform(-1, 1, 2))
        parts.append(_grid((x, low), (x + 0.0006, high), 1, 30, float(rng.uniform(0, 0.2))))
    return _flat(np.concatenate(parts), "needles")


def forest(inside: bool = False) -> Scene:
    """900 round trees on a plain, seen from among them, or from inside one more ball around the camera."""
    rng = np.random.default_rng(77)
    ball = icosphere(2).astype(float)
    parts = [np.concatenate([SQUARE[..., :1] * 60, np.zeros((2, 3, 1)), SQUARE[..., 1:] * -60], 2)]
    for _ in range(900):
        x, z = rng.uniform(-50, 50, 2)
        radius, stem = rng.uniform(0.5, 1.6), rng.uniform(2, 4)
        parts.append(ball * [radius, 1.4 * radius, radius] + [x, stem + radius, z])
    eye = (-20.0, 3.0, -20.0)
    if inside:
        parts.append(ball * 1.5 + eye)
    camera = Camera(eye, (30.0, 2.0, 20.0), fov=55.0)
    return scene_from_triangles(
        np.concatenate(parts), "inside a ball" if inside else "forest", camera=camera, light=(0.0, 80.0, -20.0)
    )


def room() -> Scene:
    """A room of a hundred large triangles: walls, a floor, beams and tables."""
    rng = np.random.default_rng(5)
    parts = []
    shell = np.concatenate([_grid((-1, -1), (1, 1), 1, 1, -1.0), _grid((-1, -1), (1, 1), 1, 1, 1.0)])
    for turn in range(3):
        parts.append(np.roll(shell, turn, axis=2) * [4, 2, 6])
    cube = np.concatenate([np.roll(shell, turn, axis=2) for turn in range(3)])
    for _ in range(10):
        size, place = rng.uniform(0.1, 0.9, 3), rng.uniform([-3, -2, -4], [3, 1, 4])
        parts.append(cube * size + place)
    return scene_from_triangles(
        np.concatenate(parts), "room of few triangles", camera=Camera((-3.5, 0.5, 5.5), (2.0, -0.5, -4.0), fov=60.0),
        light=(0.0, 1.8, 0.0),
    )  # fmt: skip


def field() -> Scene:
    """Some hundred triangles, whose nodes take about as many bytes as the caches have."""
    return scene_from_triangles(icosphere(2), "near the footprint")


PICTURES = {
    "steps": Picture(steps),
    "one hot tile": Picture(hot_tile),
    "flat strips": Picture(lambda: strips(False)),
    "upright strips": Picture(lambda: strips(True)),
    "half empty": Picture(half_empty),
    "period of a unit": Picture(lambda: periodic(1)),
    "period of two units": Picture(lambda: periodic(2)),
    "period of a tile's strip": Picture(lambda: periodic(8), order="tile"),
    "needles": Picture(needles),
    "forest, 16x4096": Picture(forest, 16, 4096),
    "forest, 4096x16": Picture(forest, 4096, 16),
    "inside a ball": Picture(lambda: forest(True)),
    "few large triangles, 1K and 2K": Picture(room, configs=SMALL),
    "forest": Picture(forest),
    "caches near the footprint": Picture(field, configs=NEAR),
}
