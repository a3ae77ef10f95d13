"""Triangles -> whether float32 vertices resolve them: the lengths of their edges in float32 steps.

A coordinate of size x is a multiple of its step, 2^-23 of the power of two below x, so rounding to float32 moves it by at most
half a step. Each component of an edge then moves by at most one step of the triangle's largest coordinate, and the edge by
sqrt(3) steps: an edge of n steps keeps its length and direction to sqrt(3) / n. What matters is the distance from the
origin over the shortest edge, not the unit of length: multiplying a scene by a power of two changes no count of steps, as
long as nothing falls below float32's smallest normal number.

All arithmetic on the vertices is in float64 (docs/correctness.md), so nothing else loses precision.
"""

import math
from typing import NamedTuple

import numpy as np

#: Steps an edge must be long. At 8, sqrt(3) / 8, more than a fifth of an edge, may be rounding: no scene to measure on.
LEAST_STEPS = 8.0
_TOLERATED = 1e-3  # share of the triangles that may have shorter edges without a warning: any large mesh has a sliver
_FAR = 1e4  # distances from the origin, in widths of the scene, from which a message gives the steps


class Precision(NamedTuple):
    """How float32 resolves some triangles. Edges of length 0 before rounding are left out.

    Attributes
    ----------
    n_triangles : int
    extent, reach : float
        Width of the scene along its widest axis, and largest coordinate.
    step : float
        Of float32 at ``reach``.
    least_steps : float
        Fewest steps in an edge, each counted in the step of its own triangle; infinite without any edge.
    n_beyond : int
        Triangles with an edge of fewer than ``LEAST_STEPS``.
    n_collapsed : int
        Triangles with an edge that rounding shortens to 0.
    """

    n_triangles: int
    extent: float
    reach: float
    step: float
    least_steps: float
    n_beyond: int
    n_collapsed: int

    @property
    def bound(self) -> float:
        """The part of its length by which rounding may have changed the least precise edge."""
        return math.sqrt(3.0) / self.least_steps if self.least_steps else math.inf


def steps_at(values: np.ndarray | np.float32) -> np.ndarray:
    """Return the distance of float32 numbers from their neighbours, float64 (np.spacing overflows at the largest)."""
    wide = np.asarray(values, np.float64)
    exponent = np.where(wide == 0.0, -125, np.frexp(wide)[1])
    return np.ldexp(1.0, np.maximum(exponent - 24, -149))


def measure(triangles: np.ndarray) -> Precision:
    """Return the precision of (n, 3, 3) float32 or float64 triangles, n >= 1, all finite in float32."""
    exact = np.asarray(triangles, np.float64)
    rounded = exact.astype(np.float32)
    low, high = exact.min(axis=(0, 1)), exact.max(axis=(0, 1))
    reach = float(np.abs(exact).max())
    length = np.linalg.norm(exact - np.roll(exact, 1, axis=1), axis=2)
    steps = steps_at(np.abs(rounded).max(axis=(1, 2)))
    has_length = length > 0
    counted = np.where(has_length, length / steps[:, None], np.inf)
    is_lost = has_length & ~(rounded != np.roll(rounded, 1, axis=1)).any(axis=2)
    return Precision(
        len(exact), float(np.max(high - low)), reach, float(steps_at(np.float32(reach))), float(counted.min()),
        int((counted < LEAST_STEPS).any(axis=1).sum()), int(is_lost.any(axis=1).sum()),
    )  # fmt: skip


def choice(precision: Precision) -> str:
    """Return the sentence that states the precision and its effect on the scene."""
    if math.isinf(precision.least_steps):
        return "float32 vertices, float64 arithmetic: no edge has a length"
    return (
        f"float32 vertices, float64 arithmetic: the shortest edge is {_short(precision.least_steps)} float32 steps long, "
        f"so rounding changes no edge by more than {_short(100 * precision.bound)} %"
    )


def notes(precision: Precision) -> tuple[str, ...]:
    """Return the warning for a scene that float32 does not resolve."""
    found = []
    if precision.extent and precision.reach > _FAR * precision.extent:
        found.append(
            f"the scene is {precision.extent:g} wide but lies {precision.reach:g} from the origin, where float32 has steps of "
            f"{precision.step:g}"
        )
    if precision.n_beyond > _TOLERATED * precision.n_triangles:
        lost = f", {precision.n_collapsed:,} of them have an edge of length 0 after rounding" if precision.n_collapsed else ""
        found.append(
            f"{precision.n_beyond:,} of {precision.n_triangles:,} triangles have an edge of less than {LEAST_STEPS:.0f} steps "
            f"of float32 (the shortest: {_short(precision.least_steps)}){lost}, so rounding may have changed their shape; "
            "move the scene to the origin, or remove such small triangles"
        )
    return tuple(found)


def power_of_two(triangles: np.ndarray) -> int:
    """Return the k for which the largest coordinate times 2^-k lies in [0.5, 1); 0 if all are 0."""
    return math.frexp(float(np.abs(triangles).max()))[1]


def normalised(triangles: np.ndarray) -> tuple[np.ndarray, int]:
    """Return float32 triangles times 2^-k, and the k of ``power_of_two``.

    Exact: only exponents change. Except for coordinates below 2^-125 of the largest, which lose bits but
    are negligible beside it.
    """
    k = power_of_two(triangles)
    return np.ldexp(np.asarray(triangles, np.float32), -k), k


def _short(value: float) -> str:
    return f"{value:,.0f}" if value >= 1000 else f"{value:.3g}"
