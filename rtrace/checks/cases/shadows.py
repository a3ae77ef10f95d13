"""Shadow rays: rooms, balls and floors of which geometry tells what is dark."""

import numpy as np

from rtrace.checks.cases.case import Case, Cases, aimed, corners_and_middles
from rtrace.checks.exact_answers import Answer
from rtrace.scenes.shapes import box, icosphere, rectangle
from rtrace.shading import OFFSET

CASES = Cases()


def _shadow_case(triangles, eye, targets, light, is_dark, is_ambiguous) -> Case:
    """Return a case of rays from the eye to points that it sees, which are dark or lit."""
    answer = Answer(np.broadcast_to(is_dark, len(targets)), np.broadcast_to(is_ambiguous, len(targets)))
    x, y, z = (float(a) for a in light)
    return Case(triangles.astype(np.float32), aimed([eye], targets), answer, np.inf, (x, y, z))


def _room_case(light, is_dark, scale, long):
    """A closed room, seen from inside: all its walls are lit by a light inside, none by one outside."""
    rng = np.random.default_rng(40)
    inner = rng.uniform(0, 8, (2000 if long else 400, 3))
    inner[np.arange(len(inner)), rng.integers(0, 3, len(inner))] = rng.choice([0.0, 8.0], len(inner))
    points = np.concatenate([inner, corners_and_middles(box((0, 0, 0), (8, 8, 8)))])
    to_wall = np.sort(np.minimum(points, 8 - points), axis=1)[:, 1]  # of the other walls, the next one
    same_wall = ((points == light) & ((points == 0) | (points == 8))).any(axis=1)
    # A shadow ray starts that far from its wall; no nearer to another one can it tell on which side of that it starts.
    unsure = (to_wall <= 4 * 8 * OFFSET) | same_wall
    room = box((0, 0, 0), (8, 8, 8)) * scale
    return _shadow_case(room, np.array([3, 4, 5]) * scale, points * scale, np.array(light) * scale, is_dark, unsure)


def _ball_case(scale, away, long):
    """A ball, lit and seen from outside: a triangle is lit if it faces the light, whatever lies beside it."""
    eye, light = (np.array([3.0, 1.0, 2.0]) + away) * scale, (np.array([-1.0, 4.0, 2.0]) + away) * scale
    ball = ((icosphere(3 if long else 2) + away) * scale).astype(np.float32)
    shape = ball.astype(np.float64)
    middle, normal = shape.mean(axis=1), np.cross(shape[:, 1] - shape[:, 0], shape[:, 2] - shape[:, 0])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    seen = ((eye - middle) * normal).sum(axis=1) > 0.1 * scale
    cosine = ((light - middle) * normal).sum(axis=1)[seen] / scale
    targets = np.concatenate([middle[seen], (2 * middle + shape[:, 0])[seen] / 3])
    return _shadow_case(ball, eye, targets, light, np.tile(cosine <= 0, 2), np.tile(np.abs(cosine) < 0.02, 2))


def _floor_case(body, light, scale, is_dark, long):
    """A floor with a body above it that casts a known shadow; ``is_dark`` is None where rounding may decide."""
    x, z = (a.reshape(-1) for a in np.meshgrid(np.linspace(-7.9, 7.9, 40), np.linspace(-7.9, 7.9, 40)))
    floor = rectangle((-16, 0, -16), (0, 0, 32), (32, 0, 0), 4, 4)
    points = np.stack([x, 0 * x, z], axis=1)
    dark, unsure = is_dark(x, z)
    triangles = np.concatenate([floor, body]) * scale
    return _shadow_case(triangles, np.array([7.5, 0.5, 7.0]) * scale, points * scale, light, dark, unsure)


def _below(left, right):
    """Return the shadow of a box: x from left to right, z from -1 to 1."""

    def shadow(x, z):
        from_edge = np.minimum(np.minimum(x - left, right - x), 1 - np.abs(z))
        return from_edge > 0, np.abs(from_edge) < 1e-3

    return shadow


_FLYING = box((-1, 2, -1), (1, 3, 1))
for _scale in (1e-12, 1e-6, 1.0, 1e6, 1e12):
    CASES.enter(f"shadows: room with the light inside, scale {_scale:g}", (6, 2, 3), False, _scale)(_room_case)
    CASES.enter(f"shadows: room with the light outside, scale {_scale:g}", (-6, 20, 3), True, _scale)(_room_case)
    CASES.enter(f"shadows: ball, scale {_scale:g}", _scale, 0.0)(_ball_case)
    CASES.enter(f"shadows: light 1e30 away, scale {_scale:g}", _FLYING, (0, 1e30, 0), _scale, _below(-1, 1))(_floor_case)
CASES.enter("shadows: light 1e300 away", _FLYING, (0, 1e300, 0), 1.0, _below(-1, 1))(_floor_case)
CASES.enter("shadows: ball, 1e4 radii away", 1.0, np.array([1e4, -7e3, 4e3]))(_ball_case)
CASES.enter("shadows: light 1e30 away, slanted", _FLYING, (1e30, 1e30, 0), 1.0, _below(-4, -1))(_floor_case)
CASES.enter("shadows: light on a wall", (8, 3, 5), False, 1.0)(_room_case)
CASES.enter("shadows: light in a corner", (8, 8, 8), False, 1.0)(_room_case)
_BALL = icosphere(2) + np.array([0, 4, 0])
CASES.enter("shadows: light inside a ball", _BALL, (0.1, 4.2, 0.1), 1.0, lambda x, z: (True, False))(_floor_case)
