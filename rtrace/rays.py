"""Batches of rays, and what they met."""

from typing import NamedTuple

import numpy as np

from nptrace_base.errors import NptraceError


class Rays(NamedTuple):
    """A batch of rays; points of a ray are origin + t direction, t_min <= t <= t_max.

    Attributes
    ----------
    origin, direction : (n, 3) float32
        Directions need not have unit length; not zero, all components finite.
    t_min, t_max : (n,) float64
        0 <= t_min; an interval with t_min > t_max is empty.
    """

    origin: np.ndarray
    direction: np.ndarray
    t_min: np.ndarray
    t_max: np.ndarray


class Hits(NamedTuple):
    """What a batch of rays met.

    Attributes
    ----------
    prim : (n,) int32
        Triangle number, -1 for none.
    t : (n,) float64
        Ray parameter of the hit, infinity for none.
    """

    prim: np.ndarray
    t: np.ndarray


def make_rays(
    origin: np.ndarray, direction: np.ndarray, t_min: float | np.ndarray = 0.0, t_max: float | np.ndarray = np.inf
) -> Rays:
    """Return checked rays; origins and intervals are broadcast to the directions.

    Raises
    ------
    ValueError
        A component is NaN or infinite, a direction is zero, or t_min is negative or NaN.
    """
    direction = np.ascontiguousarray(direction, np.float32).reshape(-1, 3)
    n = len(direction)
    # Copies: a broadcast array is read-only, for which Numba would compile the kernels once more.
    origin = np.broadcast_to(np.asarray(origin, np.float32), (n, 3)).copy()
    low = np.broadcast_to(np.asarray(t_min, np.float64), n).copy()
    high = np.broadcast_to(np.asarray(t_max, np.float64), n).copy()
    for name, bad, rule in (
        ("origin", ~np.isfinite(origin).all(axis=1), "all components must be finite"),
        ("direction", ~np.isfinite(direction).all(axis=1), "all components must be finite"),
        ("direction", ~direction.any(axis=1), "it must not be zero"),
        ("t_min", ~(low >= 0.0), "it must be 0 or more"),
        ("t_max", np.isnan(high), "it must be a number"),
    ):
        if bad.any():
            i = int(np.flatnonzero(bad)[0])
            values: dict[str, np.ndarray] = {"origin": origin, "direction": direction, "t_min": low, "t_max": high}
            raise NptraceError(f"ray {i} has {name} {values[name][i]}: {rule}; {int(bad.sum())} of {n} rays are bad")
    return Rays(origin, direction, low, high)


def flat(rays: Rays) -> Rays:
    """Return the rays as the kernels take them: points one after another."""
    return Rays(rays.origin.reshape(-1), rays.direction.reshape(-1), rays.t_min, rays.t_max)
