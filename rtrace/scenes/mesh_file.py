"""A mesh file -> vertices and triangles exactly as the file has them: in order, nothing merged, repaired or left out.

The readers are ours because no other returns exactly what these files hold: `python -m tests.bench.mesh_readers` counts how
many files of the corpus each of the usual ones reads right (docs/correctness.md). mapbox-earcut cuts the ears of polygons.
"""

import io
import zlib
from collections.abc import Callable
from gzip import BadGzipFile, GzipFile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from nptrace_base.errors import NptraceError
from rtrace.scenes.meshes.gltf import read_gltf
from rtrace.scenes.meshes.obj import read_obj
from rtrace.scenes.meshes.off import read_off
from rtrace.scenes.meshes.ply import read_ply
from rtrace.scenes.meshes.polygons import fan, triangulate
from rtrace.scenes.meshes.raw import MeshError, RawMesh
from rtrace.scenes.meshes.stl import read_stl


class SceneError(NptraceError):
    """A mesh or scene that cannot be read or rendered; the message states the problem and the way out."""


#: How each kind of file is read, by suffix; gzip (.obj.gz) is detected by content.
READERS: dict[str, Callable[[bytes, Path], RawMesh]] = {
    ".obj": read_obj,
    ".ply": read_ply,
    ".stl": read_stl,
    ".glb": read_gltf,
    ".gltf": read_gltf,
    ".off": read_off,
}
MAX_UNPACKED_BYTES = 1 << 32
_PACKED = {
    b"PK\3\4": "a zip archive",
    b"\x28\xb5\x2f\xfd": "compressed by zstd",
    b"BZh": "compressed by bzip2",
    b"\xfd7zXZ": "compressed by xz",
}


class Mesh(NamedTuple):
    """The triangles of a mesh file, not yet checked.

    Attributes
    ----------
    vertices : (n_vertices, 3) float32 or float64
        May hold NaN and infinities.
    faces : (n_faces, 3) int64
        Vertex numbers from 0; may be negative or too large.
    notes : tuple of str
        How the file was read where its author may expect otherwise; clauses about the file.
    """

    vertices: np.ndarray
    faces: np.ndarray
    notes: tuple[str, ...] = ()


def read_mesh(path: Path, *, fans: bool = False) -> Mesh:
    """Read a mesh file of one of the kinds in ``READERS``, chosen by its suffix. Raises SceneError.

    With ``fans`` every polygon becomes a fan of triangles, even one whose fan covers a notch.
    """
    suffix = Path(path.stem).suffix if path.suffix.lower() == ".gz" else path.suffix
    reader = READERS.get(suffix.lower())
    if reader is None:
        raise SceneError(f"{path}: unknown kind of file {path.suffix!r}; convert the mesh to one of {', '.join(READERS)}")
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise SceneError(f"{path}: no such file; check the spelling") from None
    except (OSError, ValueError) as error:  # a folder, no permission, a NUL in the name
        reason = getattr(error, "strerror", None) or error
        raise SceneError(f"{path}: cannot be read ({reason}); name a readable file") from None
    kind = suffix[1:].upper()
    try:
        data = _unpacked(data)
        if not data.strip():
            raise MeshError("the file is empty")
        with np.errstate(all="ignore"):  # vertices that are no numbers are found and counted later
            mesh = reader(data, path)
            faces, notes = (fan(mesh.lengths, mesh.corners), ()) if fans else triangulate(*mesh[:3])
    except MeshError as error:
        raise SceneError(f"{path}: cannot be read as {kind}: {error}; {error.way_out}") from error
    if not faces.size:
        raise SceneError(f"{path}: this {kind} file has no triangle or polygon; export a surface, not points or lines")
    return Mesh(mesh.vertices, faces, mesh.notes + notes)


def _unpacked(data: bytes) -> bytes:
    """Return the content of a gzip file, or other data unchanged; MeshError names another compression."""
    for mark, what in _PACKED.items():
        if data.startswith(mark):
            raise MeshError(f"it is {what}", "unpack it")
    if not data.startswith(b"\x1f\x8b\x08"):
        return data
    try:
        with GzipFile(fileobj=io.BytesIO(data)) as packed:
            data = packed.read(MAX_UNPACKED_BYTES + 1)
    except (BadGzipFile, EOFError, zlib.error) as error:
        raise MeshError(f"it is a damaged or truncated gzip file ({error})", "pack it again") from None
    if len(data) > MAX_UNPACKED_BYTES:
        raise MeshError(f"it decompresses to more than {MAX_UNPACKED_BYTES:,} bytes", "unpack it")
    return data
