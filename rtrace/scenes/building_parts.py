"""Parts of stone buildings: columns, arcades, walls with windows, vaults; as triangles, y up, in metres.

``steps`` everywhere turns a number of steps along a curve, at full detail, into the number wanted.
"""

from collections.abc import Callable

import numpy as np

from rtrace.scenes.shapes import arch, box, circle, moved, patch, rectangle, solid, tube, turned

Steps = Callable[[int], int]


def column(radius: float, height: float, steps: Steps, sides: int, flutes: int = 0) -> np.ndarray:
    """Return a column on the origin: plinth, rounded base, shaft (with ``flutes`` grooves), capital, slab."""
    base = [(1.4, 0.15), (1.45, 0.22), (1.4, 0.3), (1.2, 0.34), (1.25, 0.42), (1.15, 0.48), (1.0, 0.52)]
    shaft = [(1.0, 0.52), (0.98, 0.7), (0.96, 0.9), (0.92, 1.1), (0.88, 1.3), (0.86, 1.5)]  # the height is fitted below
    top = [(0.86, -0.9), (1.0, -0.86), (0.95, -0.8), (0.95, -0.7), (1.05, -0.5), (1.3, -0.3), (1.4, -0.2)]
    shaft = [(r, 0.52 + (y - 0.52) / 0.98 * (height / radius - 1.42)) for r, y in shaft]
    top = [(r, height / radius + y) for r, y in top]
    r, n, slab = radius, steps(sides), 1.5 * radius
    return solid(
        turned(radius * _thinned(base, steps), n),
        turned(radius * _thinned(shaft, steps), n, flutes=flutes if n >= 2 * flutes else 0),
        turned(radius * _thinned(top, steps), n),
        box((-slab, 0, -slab), (slab, 0.15 * r, slab)),
        box((-slab, height - 0.2 * r, -slab), (slab, height, slab)),
    )


def baluster(height: float, radius: float, steps: Steps) -> np.ndarray:
    """Return a small turned post on the origin."""
    profile = [(1.0, 0.0), (1.0, 0.1), (0.6, 0.15), (1.0, 0.4), (0.5, 0.8), (1.0, 0.9), (1.0, 1.0)]
    return solid(turned(_thinned(profile, steps) * [radius, height], steps(12)))


def _thinned(profile: list[tuple[float, float]], steps: Steps) -> np.ndarray:
    """Return a profile with as many of its points as the detail asks for, its ends among them."""
    n = min(steps(len(profile)), len(profile))
    return np.array(profile)[np.round(np.linspace(0, len(profile) - 1, n)).astype(int)]


def bow(span: float, springing: float, z: float, thick: float, n: int, sides: int) -> np.ndarray:
    """Return a half-round moulding over an arch: a tube along the half circle, x from 0 to span."""
    curve = circle(n, 0.5, -0.5)
    path = np.stack([span / 2 * (1 + curve[:, 0]), springing + span / 2 * curve[:, 1], np.full(n + 1, z)], axis=1)
    return tube(path, thick, sides)


def bay(span: float, pier: float, springing: float, top: float, depth: float, steps: Steps) -> np.ndarray:
    """Return a bay of an arcade, x from 0 to span, without its columns: an arch between half piers, with mouldings."""
    inner = span - 2 * pier
    parts = [moved(arch(inner, springing, top, depth, steps(22), steps(3)), (pier, 0, 0))]
    for x in (0.0, span - pier):
        parts.append(box((x, springing, 0), (x + pier, top, depth)))
    parts += [moved(bow(inner + 0.2, springing, z, 0.07, steps(20), steps(8)), (pier - 0.1, 0, 0)) for z in (0.0, depth)]
    return solid(*parts)


def windowed(span: float, bottom: float, top: float, steps: Steps, opening: float = 1.4) -> np.ndarray:
    """Return a wall, x from 0 to span, with a round-headed window in a niche behind it (to z = 0.5)."""
    side, sill, springing = (span - opening) / 2, bottom + 0.3 * (top - bottom), bottom + 0.65 * (top - bottom)
    parts = [
        moved(arch(opening, springing, top, 0.5, steps(14)), (side, 0, 0)),
        rectangle((0, bottom, 0), (span, 0, 0), (0, sill - bottom, 0)),
    ]
    for x in (0.0, span - side):
        parts += [rectangle((x, sill, 0), (side, 0, 0), (0, top - sill, 0)), box((x, sill, 0.0), (x + side, springing, 0.5))]
    parts += [
        box((side, sill - 0.1, -0.1), (span - side, sill, 0.5)),
        rectangle((side, sill, 0.5), (opening, 0, 0), (0, top - sill, 0)),
    ]
    parts += [
        box((side + opening * k / 4 - 0.03, sill, 0.4), (side + opening * k / 4 + 0.03, top - 0.3, 0.46)) for k in (1, 2, 3)
    ]
    return solid(*parts)


def groin(width: float, depth: float, springing: float, rise: float, n: int) -> np.ndarray:
    """Return a cross vault over x from 0 to width, z from 0 to depth."""
    u = circle(n, 0.5, -0.5)[:, 0]  # even steps along the curve
    lift = np.maximum(np.sqrt(1 - u * u)[:, None], np.sqrt(1 - u * u)[None, :])
    x, z = np.meshgrid(width / 2 * (1 + u), depth / 2 * (1 + u), indexing="ij")
    return patch(np.stack([x, springing + rise * lift, z], axis=2))
