"""Scenes: mesh file or triangles -> Scene, checked, with a camera and a light."""

import hashlib
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rtrace.camera import Camera, Point, fit_camera, fit_light
from rtrace.scenes.float32_check import Precision, measure
from rtrace.scenes.float32_check import notes as float32_notes
from rtrace.scenes.mesh_file import SceneError as SceneError
from rtrace.scenes.mesh_file import read_mesh
from traces.identity import camera_text, point_text, short_hash

_N_FIRST = 5  # a message names this many dropped triangles


class Dropped(NamedTuple):
    """Triangles left out for one reason: how many, and the numbers (in the file, from 0) of the first ones."""

    reason: str
    n: int
    first: tuple[int, ...]


class Scene(NamedTuple):
    """Triangles with a camera and a light; immutable.

    Attributes
    ----------
    name : str
        Usable as a file name; ``label`` is the form to print.
    triangles : (n, 3, 3) float32
        C-contiguous, all finite, n >= 1, in the order of the file.
    bounds : (2, 3) float32
        Lower and upper corner of the box of all triangles.
    camera : Camera
    light : 3 floats
        Position of the point light.
    source : str
        The file, or another origin of the triangles.
    sha256 : str
        Of the bytes of ``triangles``, little-endian.
    dropped : tuple of Dropped
        Triangles of the file that were left out.
    stand_in : bool
        Built in, in place of a scene that was not found.
    notes : tuple of str
        Notes for a reader of the results; one sentence each.
    view : str
        What its camera and light add to the name of a run; empty for the scene's own.
    precision : Precision
        Whether float32 resolves the scene, measured before its vertices were rounded.
    """

    name: str
    triangles: np.ndarray
    bounds: np.ndarray
    camera: Camera
    light: Point
    source: str
    sha256: str
    dropped: tuple[Dropped, ...] = ()
    stand_in: bool = False
    notes: tuple[str, ...] = ()
    precision: Precision | None = None
    view: str = ""

    def __repr__(self) -> str:
        return f"<Scene {self.label}: {len(self.triangles):,} triangles, from {self.source}>"

    @property
    def label(self) -> str:
        """The name as printed beside results."""
        return f"{self.name} (stand-in)" if self.stand_in else self.name


def load_mesh(path: str | Path, *, strict: bool = False, fans: bool = False) -> Scene:
    """Return the scene in a mesh file (OBJ, PLY, STL, GLB, glTF, OFF) with a camera and a light fitted to it, +y up.

    All objects of the file are merged, each in its place; materials, textures and normals are not read. Convex polygons
    become fans of triangles, and so do all others with ``fans``; without it they are cut so that no notch is covered. Vertices
    that no triangle uses are ignored.

    Triangles with NaN or infinite vertices (also those that float32 cannot hold) and with vertex numbers out of range are
    dropped and counted in ``Scene.dropped``. SceneError if nothing is left, if any is dropped and ``strict``, or if the file
    cannot be read.
    """
    path = Path(path)
    vertices, faces, notes = read_mesh(path, fans=fans)
    stray = np.any((faces < 0) | (faces >= len(vertices)), axis=1)
    if stray.all():
        triangles = np.zeros((len(faces), 3, 3), np.float32)
    else:
        triangles = vertices[np.where(stray[:, None], 0, faces) if stray.any() else faces]
    stem = path.stem.removesuffix(Path(path.stem).suffix) if path.suffix.lower() == ".gz" else path.stem
    name = re.sub(r"[^\w.-]+", "-", stem).strip(".-") or "scene"
    said = tuple(f"{path.name}: {note}" for note in notes)
    return scene_from_triangles(triangles, name, source=path.name, strict=strict, stray=stray, notes=said)


def scene_from_triangles(
    triangles: np.ndarray,
    name: str,
    *,
    camera: Camera | None = None,
    light: Point | None = None,
    source: str = "triangles",
    strict: bool = False,
    stray: np.ndarray | None = None,
    stand_in: bool = False,
    notes: tuple[str, ...] = (),
) -> Scene:
    """Return a scene of ``triangles``, (n, 3, 3) of any float type, without those that are invalid.

    ``stray``, (n,) bool, marks triangles whose vertex numbers were out of range. A camera and a light are fitted if None.
    Raises SceneError as ``load_mesh`` does.
    """
    given = np.asarray(triangles)
    with np.errstate(over="ignore", invalid="ignore"):
        triangles = np.ascontiguousarray(given, np.float32)
    if triangles.ndim != 3 or triangles.shape[1:] != (3, 3):
        raise SceneError(f"{source}: triangles have the shape {triangles.shape} but must have (n, 3, 3)")
    n = len(triangles)
    if stray is None:
        stray = np.zeros(n, bool)
    endless = ~np.isfinite(triangles.reshape(n, 9)).all(axis=1) & ~stray
    dropped = _dropped("with NaN or infinite vertices", endless) + _dropped("with vertex numbers out of range", stray)
    if dropped:
        if strict:
            raise SceneError(f"{_dropped_text(source, dropped, n)}; repair the mesh, or leave out --strict to use the rest")
        triangles, given = triangles[~(endless | stray)], given[~(endless | stray)]
    if not len(triangles):
        what = _dropped_text(source, dropped, n) if dropped else f"{source}: no triangle"
        raise SceneError(f"{what}; nothing is left to render; repair the mesh")
    carried = measure(given)
    bounds = np.stack([triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))])
    camera = camera or fit_camera(bounds)
    sha256 = hashlib.sha256(np.ascontiguousarray(triangles, "<f4").data).hexdigest()
    notes += float32_notes(carried)
    light = light or fit_light(camera, bounds)
    return Scene(name, triangles, bounds, camera, light, source, sha256, dropped, stand_in, notes, carried)


def seen_from(scene: Scene, camera: Camera | None, light: Point | None) -> Scene:
    """Return the scene with another camera or light; a light that was fitted to the camera is fitted to the new one."""
    view = []
    if camera is not None and camera != scene.camera:
        view.append(f"camera-{short_hash(camera_text(camera))}")
    if light is not None and light != scene.light:
        view.append(f"light-{short_hash(point_text(light))}")
    if camera is not None and light is None and scene.light == fit_light(scene.camera, scene.bounds):
        light = fit_light(camera, scene.bounds)
    return scene._replace(camera=camera or scene.camera, light=light or scene.light, view="-".join(view))


def dropped_sentence(scene: Scene) -> str | None:
    """Return the sentence about dropped triangles, or None if there are none."""
    if not scene.dropped:
        return None
    n_all = len(scene.triangles) + sum(d.n for d in scene.dropped)
    return _dropped_text(scene.source, scene.dropped, n_all) + "; the others are used"


def _dropped(reason: str, mask: np.ndarray) -> tuple[Dropped, ...]:
    count = int(np.count_nonzero(mask))
    return (Dropped(reason, count, tuple(np.flatnonzero(mask)[:_N_FIRST].tolist())),) if count else ()


def _dropped_text(source: str, dropped: tuple[Dropped, ...], n_all: int) -> str:
    parts = []
    for reason, count, first in dropped:
        more = ", ..." if count > len(first) else ""
        parts.append(f"{count} {reason} (number {', '.join(map(str, first))}{more})")
    return f"{source}: {sum(d.n for d in dropped)} of {n_all} triangles cannot be used: {' and '.join(parts)}"
