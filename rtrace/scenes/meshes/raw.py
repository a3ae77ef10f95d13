"""The result and the error of every reader of mesh files."""

from typing import NamedTuple

import numpy as np


class RawMesh(NamedTuple):
    """The content of a file, not yet checked.

    Attributes
    ----------
    vertices : (n_vertices, 3) float32 or float64
        May hold NaN and infinities.
    lengths : (n_polygons,) int
        How many corners each polygon has; may be fewer than three.
    corners : (sum(lengths),) int64
        The polygons' vertex numbers from 0, one polygon after another; may be negative or too large.
    notes : tuple of str
        How the file was read where its author may expect otherwise; clauses about the file.
    """

    vertices: np.ndarray
    lengths: np.ndarray
    corners: np.ndarray
    notes: tuple[str, ...] = ()


class MeshError(ValueError):
    """The problem of a file, as a clause about it, and the way out."""

    def __init__(self, what: str, way_out: str = "export the mesh again") -> None:
        super().__init__(what)
        self.way_out = way_out


def show(text: bytes) -> str:
    """Return the start of a piece of a file in quotes, whatever bytes it has."""
    more = "..." if len(text) > 40 else ""
    return repr(text[:40].decode("ascii", "backslashreplace") + more).replace("\\\\", "\\")
