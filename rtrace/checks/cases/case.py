"""A hard case: a scene, rays and the answer; and what cases are made of: lattices, a ball's vertices, rays at targets."""

import itertools
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from rtrace.checks.exact_answers import T_BOUND, Answer, exact_answer
from rtrace.rays import Rays, make_rays
from rtrace.scenes.shapes import rectangle
from traces.frame import Point


class Case(NamedTuple):
    """A scene and its rays.

    Attributes
    ----------
    triangles : (n, 3, 3) float32
    rays : Rays
    answer : Answer
        In a case with a light ``is_hit`` tells whether the point that a ray hits is dark.
    bound : float
        Largest error of t, in ``exact_answers.rounding_of_t``: 0 where float64 computes without rounding (then nothing is
        ambiguous), infinite where t is not tested.
    light : 3 floats, optional
        The rays have one origin, the eye; the shadow rays of their hits are what is judged.
    name : str
        Key in ``CASES``.
    """

    triangles: np.ndarray
    rays: Rays
    answer: Answer
    bound: float = T_BOUND
    light: Point | None = None
    name: str = ""


class Cases(dict[str, Callable[[bool], Case]]):
    """Name -> a function of ``long`` (more triangles and rays, minutes instead of seconds) that makes the case."""

    def enter(self, name: str, *args):
        """Return a decorator that enters a function (*args, long) -> Case under a name."""

        def enter(make):
            self[name] = partial(make, *args)
            return make

        return enter


def exact_case(triangles, rays: Rays, *, rounds: bool = True, is_closed: bool = False) -> Case:
    """Return the case with its answer from exact arithmetic (the options are those of ``exact_answer``)."""
    triangles = np.ascontiguousarray(triangles, np.float32)
    answer = exact_answer(triangles, rays, rounds=rounds, is_closed=is_closed)
    return Case(triangles, rays, answer, T_BOUND if rounds else 0.0)


def known_case(triangles, rays: Rays, is_hit) -> Case:
    """Return a case for which geometry tells which rays hit; at what t is not tested."""
    n = len(rays.t_min)
    answer = Answer(np.broadcast_to(is_hit, n), np.zeros(n, bool))
    return Case(np.ascontiguousarray(triangles, np.float32), rays, answer, np.inf)


def aimed(origins, targets, **interval) -> Rays:
    """Return the rays from every origin to every target, in float32."""
    origins, targets = np.atleast_2d(np.float32(origins)), np.atleast_2d(np.float32(targets))
    origin = np.repeat(origins, len(targets), axis=0)
    direction = np.tile(targets, (len(origins), 1)) - origin
    there = direction.any(axis=1)
    return make_rays(origin[there], direction[there], **interval)


#: Direction components whose quotients are exact, so that the shear does not round; and others.
EXACT, ROUNDING = (0.0, -0.0, 1.0, -1.0, 2.0, -2.0, 4.0), (0.0, -0.0, 1.0, -1.0, 3.0, -5.0, 7.0)
#: The six axis directions, with either zero in the other components.
AXES = np.array([np.roll(d, k) for k in range(3) for d in itertools.product((1.0, -1.0), (0.0, -0.0), (0.0, -0.0))])
INSIDE = np.array([[0.0, 0.0, 0.0], [0.1, -0.05, 0.2], [0.3, 0.4, -0.2]])  # of a ball of radius 1
OUTSIDE = np.array([[3.0, 0.5, -2.0], [-1.5, 1.5, 1.5]])
QUAD = rectangle((-4, -4, 0), (8, 0, 0), (0, 8, 0)).astype(np.float32)  # in the plane z = 0
OCTAHEDRON = 12 * np.array([[(x, 0, 0), (0, y, 0), (0, 0, z)] for x in (1, -1) for y in (1, -1) for z in (1, -1)], np.float32)


def corners_and_middles(triangles: np.ndarray) -> np.ndarray:
    """Return the vertices and the middles of the edges, each once, (n, 3) float32."""
    middles = (triangles + np.roll(triangles, 1, axis=1)) / 2
    return np.unique(np.concatenate([triangles, middles]).reshape(-1, 3).astype(np.float32), axis=0)


def lattice(seed: int, shape, low: int, high: int, step: float = 1.0) -> np.ndarray:
    """Return float32 multiples of ``step``, from low to high steps, picked at random."""
    return (np.random.default_rng(seed).integers(low, high, shape, endpoint=True) * step).astype(np.float32)


def random_rays(seed: int, origin: np.ndarray, components) -> Rays:
    """Return a ray from each origin, its direction's components picked from a list."""
    direction = np.random.default_rng(seed).choice(components, origin.shape)
    there = direction.any(axis=1)
    return make_rays(origin[there], direction[there])
