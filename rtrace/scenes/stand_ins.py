"""Built-in scenes of the same kind and size as the benchmark scenes, for when those cannot be found; and small test shapes.

A name -> a Scene: ``blob`` for the bunny, ``room`` for the conference room, ``nave`` for the cathedral, ``court`` for the
atrium. They use no random numbers and no files: the same name gives the same triangles, bit for bit.
"""

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from nptrace_base.errors import NptraceError
from rtrace.camera import Camera, Point
from rtrace.scenes.building_parts import Steps, baluster, bay, bow, column, groin, windowed
from rtrace.scenes.scene import Scene, scene_from_triangles
from rtrace.scenes.shapes import (
    between,
    box,
    boxes,
    circle,
    cushion,
    geodesic,
    height_field,
    icosphere,
    moved,
    rectangle,
    solid,
    soup,
    tube,
    turned,
)

__all__ = ["STAND_INS", "boxes", "height_field", "icosphere", "soup", "stand_in"]

Parts = Iterator[np.ndarray]


class StandIn(NamedTuple):
    """A built-in scene: what it is, how it is built, and where it is seen from. Units are metres, y up."""

    title: str
    build: Callable[[Steps], Parts]
    fineness: float  # scales every number of steps, so that the scene has about as many triangles as the one it replaces
    camera: Camera
    light: Point


def stand_in(name: str, detail: float = 1.0) -> Scene:
    """Return the built-in scene ``name``, one of ``STAND_INS``.

    ``detail``, 0 < detail <= 1, is about the share of the triangles to make; flat and very small parts keep theirs.
    """
    if name not in STAND_INS:
        raise NptraceError(f"{name!r} is not a built-in scene; choose one of {', '.join(STAND_INS)}")
    if not 0.0 < detail <= 1.0:
        raise NptraceError(f"detail is {detail!r} but must be above 0 and at most 1")
    made = STAND_INS[name]

    def steps(n: int) -> int:
        return max(3, round(n * made.fineness * detail**0.6))

    triangles = solid(*made.build(steps))
    return scene_from_triangles(triangles, name, camera=made.camera, light=made.light, source=name, stand_in=True)


def _blob(steps: Steps) -> Parts:
    """Yield a seated animal's outline: a ball pushed out by bumps (head, ears, paws, tail) under a relief of small ones."""
    bumps = [  # direction, how far out, how wide
        ((0.75, 0.75, 0.0), 0.75, 0.18),
        ((0.62, 1.0, 0.28), 0.95, 0.022),
        ((0.62, 1.0, -0.28), 0.95, 0.022),
        ((1.0, -0.55, 0.45), 0.55, 0.06),
        ((1.0, -0.55, -0.45), 0.55, 0.06),
        ((-1.0, -0.35, 0.0), 0.35, 0.03),
        ((-0.35, -0.3, 0.8), 0.25, 0.2),
        ((-0.35, -0.3, -0.8), 0.25, 0.2),
    ]
    bumps += [(tuple(p), 0.02 * (1 + k % 3), 0.03) for k, p in enumerate(geodesic(2).mean(axis=1))]

    def radius(directions: np.ndarray) -> np.ndarray:
        x, y, z = directions.T
        far = np.full(x.size, 0.8)
        for (cx, cy, cz), out, width in bumps:
            away = 2.0 - 2.0 * (x * cx + y * cy + z * cz) / math.sqrt(cx * cx + cy * cy + cz * cz)
            fall = width / (width + away)
            far += out * fall * fall * fall
        return far

    yield geodesic(steps(59), radius)


def _chair(steps: Steps) -> np.ndarray:
    """Return a chair on the origin that faces +z: cushions, bent arms with pads, a column on four feet with castors."""
    bend = circle(steps(28), 0.5, -0.5)  # from the back over the top to the front
    arm = np.stack([np.full(len(bend), 0.27), 0.48 + 0.2 * np.sqrt(bend[:, 1].clip(0)), 0.2 * bend[:, 0]], axis=1)
    side = [tube(arm, 0.014, steps(20)), moved(cushion((0.06, 0.035, 0.3), steps(40), steps(22)), (0.27, 0.7, 0.0))]
    feet = [
        box((-0.02, 0.05, 0.0), (0.02, 0.08, 0.28)),
        moved(cushion((0.05, 0.06, 0.05), steps(14), steps(8)), (0, 0.03, 0.27)),
    ]
    column = [(0.0, 0.1), (0.05, 0.1), (0.05, 0.14), (0.025, 0.16), (0.025, 0.36), (0.09, 0.4), (0.0, 0.42)]
    return solid(
        moved(cushion((0.5, 0.1, 0.48), steps(76), steps(36)), (0, 0.46, 0)),
        moved(cushion((0.48, 0.42, 0.07), steps(76), steps(36)), (0, 0.8, -0.24)),
        *side,
        *(moved(part, mirror=0) for part in side),
        *(moved(part, quarter_turns=turn) for part in feet for turn in range(4)),
        turned(column, steps(24)),
        box((-0.03, 0.44, -0.27), (0.03, 0.7, -0.25)),
    )


def _room(steps: Steps) -> Parts:
    """Yield a meeting room, 10.8 x 6.9 x 2.75: long table, 20 chairs, lamps, windows with blinds, doors, a board."""
    length, width, height = 10.8, 6.9, 2.75
    for y in (0.0, height):
        yield rectangle((0, y, 0), (length, 0, 0), (0, 0, width))
    for x in (0.0, length):
        yield rectangle((x, 0, 0), (0, height, 0), (0, 0, width))
    yield rectangle((0, 0, 0), (length, 0, 0), (0, height, 0))
    yield rectangle((0, 0, width), (length, 0, 0), (0, 0.9, 0))  # below and above the windows
    yield rectangle((0, 2.4, width), (length, 0, 0), (0, height - 2.4, 0))
    yield rectangle((0, 0.9, width + 0.3), (length, 0, 0), (0, 1.5, 0))
    yield box((0, 0.86, width - 0.15), (length, 0.9, width + 0.3))  # window sill
    for x in np.arange(6) * 2.12:
        yield box((x, 0.9, width - 0.05), (x + 0.2, 2.4, width + 0.3))
    for x in np.linspace(0, 10.75, steps(150)):  # blinds, half open
        yield rectangle((x, 0.95, width - 0.02), (0.04, 0, 0.035), (0, 1.45, 0))
    for x in 0.9 + np.arange(5) * 2.0:  # lamps: a tray and its louvres
        for z in (1.6, 4.7):
            yield box((x, 2.66, z), (x + 1.3, height, z + 0.6))
            yield from (box((x + d, 2.6, z), (x + d + 0.01, 2.66, z + 0.6)) for d in np.linspace(0, 1.29, steps(14)))
    for z in (0.0, 0.02):
        yield box((1.0, 0, z), (1.95, 2.1, z + 0.03))  # door in its frame
    yield box((1.08, 1.0, 0.05), (1.2, 1.03, 0.1))
    yield box((3.0, 0.9, 0), (6.4, 2.1, 0.03))
    yield from (box((3.0, y, 0.0), (6.4, y + 0.04, 0.08)) for y in (0.86, 2.1))
    yield box((9.2, 0, 0.05), (10.6, 1.1, 0.6))  # sideboard, boxes on it
    yield from (box((9.3 + 0.3 * i, 1.1, 0.15), (9.5 + 0.3 * i, 1.2 + 0.05 * i, 0.45)) for i in range(4))
    yield from (box((0, y, z), (length, y + 0.1, z + 0.02)) for y, z in ((0.0, 0.0), (0.0, width - 0.02)))
    yield moved(cushion((5.4, 0.06, 1.7), steps(160), steps(12)), (5.4, 0.74, 3.45))
    for x in (3.6, 5.4, 7.2):
        yield moved(
            turned([(0, 0), (0.35, 0), (0.33, 0.04), (0.06, 0.08), (0.06, 0.68), (0.2, 0.72)], steps(40)), (x, 0, 3.45)
        )
    chair = _chair(steps)
    for x in 2.97 + 0.695 * np.arange(8):
        yield moved(chair, (x, 0, 2.35))
        yield moved(chair, (x, 0, 4.55), 2)
    for z in (3.05, 3.85):
        yield moved(chair, (2.3, 0, z), 1)
        yield moved(chair, (8.5, 0, z), 3)


def _nave(steps: Steps) -> Parts:
    """Yield a church, 40 long: nave and aisles under vaults, a crossing with transepts and a dome, an apse with an altar."""
    yield rectangle((-20, 0, -8.5), (40, 0, 0), (0, 0, 17))
    yield from (box((-20, 0, z), (12, 0.02, z + 0.4)) for z in (-3.2, 2.8))
    bays = [-20 + 4 * k for k in range(6)] + [12]  # where each begins; the crossing is between 4 and 12
    pillar, pier, bar = column(0.45, 4.2, steps, 36, 16), column(0.8, 12.0, steps, 40, 20), baluster(0.9, 0.09, steps)
    arcade = bay(4.0, 0.3, 4.2, 7.5, 0.8, steps)
    clerestory, aisle_wall = windowed(4.0, 8.6, 12.0, steps), windowed(4.0, 0.0, 7.5, steps)
    aisle_vault = groin(4.0, 4.5, 4.6, 2.2, steps(18))
    rib = tube(
        np.stack([0 * (c := circle(steps(36), 0.0, 0.5))[:, 0], 12 + 3.9 * c[:, 1], 3.9 * c[:, 0]], axis=1), 0.2, steps(10)
    )
    for side in (None, 2):  # the half at z > 0, and its mirror image
        half: list[np.ndarray] = []
        for x in bays:
            half += [moved(arcade, (x, 0, 3.6)), moved(clerestory, (x, 0, 4.0)), moved(aisle_wall, (x, 0, 8.5))]
            half += [
                moved(aisle_vault, (x, 0, 4.0)),
                box((x, 7.5, 3.3), (x + 4, 7.7, 4.1)),
                box((x, 8.6, 3.4), (x + 4, 8.75, 3.6)),
            ]
            half += [moved(bar, (x + at, 7.7, 3.5)) for at in np.linspace(0.25, 3.75, steps(8))]
            half.append(rectangle((x, 7.5, 4.0), (4, 0, 0), (0, 1.1, 0)))
        half += [moved(pillar, (x, 0, 4.0)) for x in bays[1:6]] + [moved(pier, (x, 0, 4.0)) for x in (4, 12)]
        half += [moved(bow(8.0, 12.0, 4.0, 0.35, steps(40), steps(12)), (4, 0, 0))]
        # The transept: end wall with three windows and a rose, side walls above the aisles, a barrel vault.
        half += [moved(windowed(8 / 3, 2.0, 9.0, steps), (4 + 8 * k / 3, 0, 8.5)) for k in range(3)]
        half += [rectangle((4, 0, 8.5), (8, 0, 0), (0, 2, 0)), rectangle((4, 9, 8.5), (8, 0, 0), (0, 7, 0))]
        rose = circle(steps(48))
        for r in (0.5, 1.2, 1.8):
            half.append(
                tube(np.stack([8 + r * rose[:, 0], 12.2 + r * rose[:, 1], 0 * rose[:, 0] + 8.45], axis=1), 0.1, steps(8))
            )
        half += [rectangle((x, 7.5, 4.0), (0, 4.5, 0), (0, 0, 4.5)) for x in (4, 12)]
        barrel = circle(steps(32), 0.5, -0.5)
        edge = np.stack([8 + 4 * barrel[:, 0], 12 + 4 * barrel[:, 1], 0 * barrel[:, 0] + 4], axis=1)
        half.append(between(edge, moved(edge, (0, 0, 4.5)), steps(8)))
        for x in np.linspace(-18, 0, steps(13)):  # pews
            half += [box((x, 0.4, 0.9), (x + 0.45, 0.45, 2.7)), box((x, 0.45, 0.9), (x + 0.05, 0.95, 2.7))]
            half += [box((x, 0, z), (x + 0.45, 0.4, z + 0.06)) for z in (0.9, 2.64)]
        yield moved(solid(*half), mirror=side)
    vault = circle(steps(40), 0.0, 0.5)
    for x0, x1 in ((-20.0, 4.0), (12.0, 16.0)):
        edge = np.stack([0 * vault[:, 0] + x0, 12 + 4 * vault[:, 1], 4 * vault[:, 0]], axis=1)
        yield between(edge, moved(edge, (x1 - x0, 0, 0)), steps(int(2 * (x1 - x0))))
    yield from (moved(rib, (x, 0, 0)) for x in (-16, -12, -8, -4, 0, 4, 12, 16))
    # The crossing: from the square of its arches to a circle, a drum with a cornice, the dome and its lantern.
    turn = circle(steps(96))
    square = 4 * turn / np.abs(turn).max(axis=1, keepdims=True)
    low = 12 + np.sqrt(16 - np.abs(square).min(axis=1) ** 2)
    foot = np.stack([8 + square[:, 0], low, square[:, 1]], axis=1)
    yield between(foot, np.stack([8 + 3.7 * turn[:, 0], 0 * low + 16.4, 3.7 * turn[:, 1]], axis=1), steps(8))
    drum = [(3.7, 16.4), (3.5, 16.5), (3.5, 16.7), (3.7, 16.8), (3.7, 19.4), (3.5, 19.5), (3.5, 19.7), (3.7, 19.8)]
    quarter = circle(steps(30), 0.0, 0.22)
    dome = [(3.7 * c, 19.8 + 3.7 * s) for c, s in quarter]
    yield moved(turned(drum + dome, steps(72)), (8, 0, 0))
    yield moved(turned([dome[-1], (dome[-1][0], 25.0), (0.0, 25.4)], steps(36)), (8, 0, 0))
    for c, s in circle(8, 1 / 16)[:8]:
        yield moved(column(0.18, 2.6, steps, 14), (8 + 3.45 * c, 16.8, 3.45 * s))
    # The apse: half a cylinder with a half dome, blind arcade, steps and altar; and the west wall with its door and rose.
    yield moved(
        turned([(4, 0), (4, 5), (3.85, 5.1), (3.85, 5.3), (4, 5.4), (4, 9)], steps(48), turns=0.5, start=-0.25), (16, 0, 0)
    )
    shell = [(4 * c, 9 + 4 * s) for c, s in circle(steps(24), 0.0, 0.25)]
    yield moved(turned(shell, steps(48), turns=0.5, start=-0.25), (16, 0, 0))
    conch = np.stack([0 * vault[:, 0] + 16, 9 + 4 * vault[:, 1], 4 * vault[:, 0]], axis=1)
    yield between(conch, moved(conch, (0, 3, 0)), 1)
    for c, s in circle(10, -0.25, 0.5)[1:-1]:
        yield moved(column(0.2, 5.0, steps, 16), (16 + 3.7 * c, 0, 3.7 * s))
    for k in range(5):
        yield moved(
            turned([(0, 0.15 * k + 0.15), (3.4 - 0.4 * k, 0.15 * k + 0.15), (3.4 - 0.4 * k, 0.15 * k)], steps(48)), (15, 0, 0)
        )
    yield box((14.6, 0.75, -1.1), (15.4, 1.75, 1.1))
    yield rectangle((-20, 0, -8.5), (0, 0, 17), (0, 16, 0))
    yield moved(bay(3.0, 0.5, 3.0, 5.2, 0.5, steps), (-19.9, 0, 1.5), 1)
    rose = circle(steps(64))
    for r in (0.4, 1.0, 1.6, 2.0):
        yield tube(np.stack([0 * rose[:, 0] - 19.9, 10 + r * rose[:, 1], r * rose[:, 0]], axis=1), 0.12, steps(10))


def _court(steps: Steps) -> Parts:
    """Yield an open court, 34 x 15, with arcades on two floors around it, vaults behind them and a roof open to the sky."""
    yield rectangle((-17, 0, -7.7), (34, 0, 0), (0, 0, 15.4))
    strong, slim = column(0.42, 4.0, steps, 36), column(0.24, 2.7, steps, 32, 12)
    for floor, pillar, springing, top in ((0.0, strong, 4.0, 6.3), (7.0, slim, 9.7, 11.8)):
        wide = bay(3.0, 0.2, springing, top, 0.7, steps)
        deep = bay(3.6, 0.2, springing, top, 0.7, steps)
        for x in -12 + 3.0 * np.arange(8):
            yield moved(wide, (x, 0, 3.6))
            yield moved(wide, (x, 0, -4.3))
        for z in (0.0, 3.6):
            yield moved(deep, (12.0, 0, z), 1)
            yield moved(deep, (-12.7, 0, z), 1)
        for x in -12 + 3.0 * np.arange(9):
            yield moved(pillar, (x, floor, 3.95))
            yield moved(pillar, (x, floor, -3.95))
        for x in (-12.35, 12.35):
            yield moved(pillar, (x, floor, 0))
        vault = groin(3.0, 3.4, springing, top - springing - 0.1, steps(14))
        for x in -12 + 3.0 * np.arange(8):
            yield moved(vault, (x, 0, 4.3))
            yield moved(vault, (x, 0, -7.7))
        for x in (-17.0, 12.7):
            for z in (-7.7, -4.3, 0.0, 4.3):
                yield moved(
                    groin(4.3, 4.3 if z in (-4.3, 0.0) else 3.4, springing, top - springing - 0.1, steps(14)), (x, 0, z)
                )
    # The upper floor with its parapet, the cornice and the sloping roofs: frames around the court.
    for y0, y1, out in ((6.3, 7.0, 0.15), (7.0, 7.9, -0.35), (7.9, 8.0, -0.3), (11.8, 12.2, 0.1), (12.2, 12.4, 0.3)):
        inner, depth = 3.6 - out, 4.1 if y1 == 7.0 else 0.9 + out
        for z in (inner, -inner - depth):
            yield box((-17, y0, z), (17, y1, z + depth))
        for x in (12.0 - out, -12.0 + out - depth):
            yield box((x, y0, -inner), (x + depth, y1, inner))
    for z, outward in ((3.4, 1), (-3.4, -1)):
        yield rectangle((-17, 12.4, z), (34, 0, 0), (0, 1.6, 4.3 * outward), 34, 1)
    for x, outward in ((11.8, 1), (-11.8, -1)):
        yield rectangle((x, 12.4, -3.4), (5.2 * outward, 1.6, 0), (0, 0, 6.8))
    yield from _outer_walls(steps)


def _outer_walls(steps: Steps) -> Parts:
    """Yield the court's outer walls: half columns, doors below, windows above, a lion's head at either end."""
    door, window = bay(2.0, 0.3, 2.0, 3.4, 0.3, steps), windowed(3.0, 7.0, 15.0, steps, 1.0)
    for z, turns in ((7.7, 0), (-7.7, 2)):
        flip = -1 if turns else 1
        yield rectangle((-17, 0, z), (34, 0, 0), (0, 7.0, 0))
        for k in range(8):
            x = -12 + 3.0 * k
            yield moved(window, (x if flip > 0 else x + 3, 0, z), turns)
            if k % 2:
                yield moved(door, (x + (0.5 if flip > 0 else 2.5), 0, z - 0.3 * flip), turns)
            for y in (3.7, 9.4):
                yield moved(cushion((0.5, 0.5, 0.4), steps(14), steps(10)), (x, y, z - 0.1 * flip))
        for x in (-17.0, 12.0):
            yield rectangle((x, 7, z), (5, 0, 0), (0, 8, 0))
    for x, flip in ((17.0, 1), (-17.0, -1)):
        yield rectangle((x, 0, -7.7), (0, 15, 0), (0, 0, 15.4))
        yield moved(cushion((0.6, 1.5, 1.5), steps(48), steps(36)), (x - 0.1 * flip, 3.2, 0))
        yield moved(cushion((0.9, 0.8, 0.8), steps(36), steps(24)), (x - 0.2 * flip, 3.2, 0))
        yield from (moved(column(0.3, 6.3, steps, 20), (x - 0.2 * flip, 0, z)) for z in (-4.0, 4.0))


#: The built-in scenes.
STAND_INS = {
    "blob": StandIn(
        "a displaced closed blob", _blob, 1.0, Camera((2.6, 1.7, 4.2), (0.1, 0.3, 0.0), fov=34.0), (-1.5, 4.5, 3.0)
    ),
    "room": StandIn("a meeting room", _room, 0.97, Camera((0.5, 1.9, 1.0), (5.6, 0.75, 3.7), fov=60.0), (5.6, 2.4, 3.0)),
    "nave": StandIn("a church nave", _nave, 0.815, Camera((-18.0, 4.5, 0.0), (8.0, 5.5, 0.0), fov=60.0), (6.0, 10.0, -1.0)),
    "court": StandIn(
        "an arcaded court", _court, 0.66, Camera((-11.0, 2.2, 0.5), (10.0, 3.4, 0.0), fov=60.0), (0.0, 14.0, 0.5)
    ),
}
