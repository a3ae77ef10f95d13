"""Triangles -> the *strays* among them, far outside the scene, and the margin that a tree adds around each of these.

Rounding moves a hit by a share of its triangle's distance (``intersect``). A ray's margin is that share of the *core*, the
box of all triangles but the strays; what a stray needs beyond that is added to the stray itself: its box, and its part in
every cell of a kd-tree, is larger by ``SLACK`` of its largest coordinate. So a triangle at 1e13 costs a ray near the scene
nothing. Usual scenes have no strays, and their boxes are tight.
"""

from typing import NamedTuple

import numpy as np

from nptrace_base.jit import kernel
from rtrace.intersect import PAD
from rtrace.trees.tree import triangle_boxes

#: A stray has a coordinate more than FAR times the reference: of the sixteenth of the triangles that is nearest to the origin,
#: the largest coordinate. The margin is 2^-44 of the core, so at most 2^-28 of the reference.
FAR, NEAR = 2.0**16, 16
#: Share of a stray's largest coordinate that lies around it. With the corners V of the triangle, the farthest corner c of
#: the core, |c| <= |V|, and a slope of at most 1, V_k - o_k is at most 2 |V| + |c_k - o_k|: the first part, along both axes
#: that count, is 4 |V| times the 2^-46 of ``intersect.PAD``, the second is in the ray's margin. Half of this.
SLACK = 2.0**-43

#: A margin above this share of the median triangle's width gets a warning: visits then differ from those of the geometry.
LARGE = 2.0**-6

_SAMPLE = 4096  # triangles that give the reference
_LARGEST = float(np.finfo(np.float32).max)


class Extent(NamedTuple):
    """Where the triangles of a tree are.

    Attributes
    ----------
    bounds, core : (2, 3) float32
        Lower and upper corner of the box of all triangles, with the margins of strays; and of those that are not strays.
    limit : float
        Largest coordinate of a triangle that is not a stray; infinite if there are no strays.
    strays : (m,) int64
        Their numbers.
    """

    bounds: np.ndarray
    core: np.ndarray
    limit: float
    strays: np.ndarray


@kernel
def slack_of(corners, triangle, limit):
    """Return the margin around a triangle of a flat array: 0 unless it is a stray."""
    largest, v = 0.0, np.uint64(9) * np.uint64(triangle)
    for k in range(np.uint64(9)):
        largest = max(largest, abs(np.float64(corners[v + k])))
    return SLACK * largest if largest > limit else 0.0


def find_limit(triangles: np.ndarray, bounds: np.ndarray) -> float:
    """Return the largest coordinate of a triangle that is not a stray, infinity without strays; ``bounds``: the box of all."""
    farthest = float(np.abs(bounds).max())
    size = np.abs(triangles[:: max(1, len(triangles) // _SAMPLE)]).max(axis=(1, 2))
    size = np.sort(size[size > 0])
    limit = FAR * float(size[len(size) // NEAR]) if len(size) else np.inf
    # A box cannot reach beyond the largest float32: then every ray has the margin of the whole scene.
    return limit if limit < farthest < _LARGEST else np.inf


def make_room(triangles: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> Extent:
    """Return where the triangles are; add margins to the boxes of strays, rows of ``lower`` and ``upper``, (n, 3) float32."""
    bounds = np.stack((lower.min(axis=0), upper.max(axis=0)))
    limit = find_limit(triangles, bounds)
    if limit == np.inf:
        return Extent(bounds, bounds, limit, np.empty(0, np.int64))
    size = np.maximum(np.abs(lower), np.abs(upper)).max(axis=1)
    strays = np.flatnonzero(size > limit)
    near = np.ones(len(size), bool)
    near[strays] = False
    core = np.stack((lower[near].min(axis=0), upper[near].max(axis=0)))
    slack = SLACK * size[strays, None].astype(np.float64)
    lower[strays] = _rounded_down(lower[strays] - slack)
    upper[strays] = -_rounded_down(-(upper[strays] + slack))
    return Extent(np.stack((lower.min(axis=0), upper.max(axis=0))), core, limit, strays)


def margin_note(triangles: np.ndarray, bounds: np.ndarray, eye: tuple[float, float, float]) -> str | None:
    """Return a warning if the margin of rays from the eye is not small compared with the triangles, otherwise None.

    ``bounds`` is the box of all triangles, (2, 3) float32.
    """
    some = triangles[:: max(1, len(triangles) // _SAMPLE)]
    width = float(np.median((some.max(axis=1) - some.min(axis=1)).max(axis=1)))
    if 2 * PAD * _reach(bounds, eye) <= LARGE * width:
        return None
    margin = 2 * PAD * _reach(make_room(triangles, *triangle_boxes(triangles)).core, eye)
    if margin <= LARGE * width:
        return None
    return (
        f"boxes and planes are tested with a margin of up to {margin:.3g}, and half of the triangles are no wider than "
        f"{width:.3g}: rays visit nodes that they only pass by; move the camera closer, or remove the distant triangles"
    )


def _reach(box: np.ndarray, eye: tuple[float, float, float]) -> float:
    return float(np.abs(np.subtract(box, eye, dtype=np.float64)).max())


def _rounded_down(values: np.ndarray) -> np.ndarray:
    rounded = values.astype(np.float32)
    return np.where(rounded > values, np.nextafter(rounded, np.float32(-np.inf)), rounded)
