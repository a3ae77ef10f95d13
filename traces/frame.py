"""The frame of a picture: a camera, as numbers, and a size in pixels -> the vectors that make its primary rays.

The renderer shoots by it, and what reads a run finds the rays again from the camera in the footer.
"""

import math
from typing import Protocol

import numpy as np

Point = tuple[float, float, float]


class View(Protocol):
    """A camera: ``footer.CameraFacts``, or the renderer's own, which is checked."""

    @property
    def eye(self) -> Point: ...  # noqa: D102
    @property
    def look_at(self) -> Point: ...  # noqa: D102
    @property
    def up(self) -> Point: ...  # noqa: D102
    @property
    def fov(self) -> float: ...  # noqa: D102


def unit(vector) -> np.ndarray:
    """Return ``vector``, not zero, at length 1; scaled first, so that no length over- or underflows."""
    scaled = np.asarray(vector, np.float64) / np.abs(vector).max()
    return scaled / math.hypot(*scaled)


def axes(view: View) -> np.ndarray:
    """Return (3, 3) float64: the unit vectors to the right, up and forward in the picture, one per row."""
    forward = unit(np.subtract(view.look_at, view.eye))
    right = unit(np.cross(forward, unit(view.up)))
    return np.array([right, np.cross(right, forward), forward])


def frame(view: View, width: int, height: int) -> np.ndarray:
    """Return the vectors that make the rays of a picture of ``width`` x ``height`` pixels.

    Returns
    -------
    frame : (4, 3) float64
        Rows eye, corner, du, dv: the ray through the centre of pixel (x, y), y counted down from the top, starts at
        ``eye`` and has the direction ``corner + x * du + y * dv`` (not of unit length).
    """
    right, up, forward = axes(view)
    half = math.tan(math.radians(view.fov) / 2)
    du = right * (2 * half / height)  # square pixels: the same step both ways
    dv = up * (-2 * half / height)
    corner = forward - du * ((width - 1) / 2) - dv * ((height - 1) / 2)
    return np.array([view.eye, corner, du, dv])
