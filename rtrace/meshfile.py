"""A mesh file -> vertices and triangles exactly as the file has them: order kept, nothing merged, repaired or left out.

STL, GLB and glTF are read by trimesh. OBJ, PLY and OFF are read here, because trimesh 5.2 returns another mesh than the file
has or refuses a legal file: OBJ faces are regrouped by material, relative (negative) numbers count from the end of the file
instead of from their line, and number 0 becomes vertex 1; binary PLY with polygons of several sizes is refused; in all three
polygons come after the triangles; an OFF file with one bad vertex number is lost as a whole.
"""

import io
import json
import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np

from traces.errors import NptraceError


class SceneError(NptraceError):
    """A mesh or scene that cannot be read or rendered; the message has what is wrong and the way out."""


class RawMesh(NamedTuple):
    """What a file says, not yet checked.

    Attributes
    ----------
    vertices : (n_vertices, 3) float32 or float64
        May hold NaN and infinities.
    faces : (n_faces, 3) int64
        Vertex numbers from 0; may be negative or too large.
    """

    vertices: np.ndarray
    faces: np.ndarray


#: What a malformed file makes a reader raise; anything else is a mistake in this program and shows as such.
_BAD_FILE = (
    struct.error,
    ArithmeticError,
    AssertionError,
    AttributeError,
    MemoryError,
    NotImplementedError,
    OSError,
    TypeError,
    ValueError,
)


def read_mesh(path: Path) -> RawMesh:
    """Read a mesh file of one of the kinds in ``READERS``, chosen by its suffix. Raises SceneError."""
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise SceneError(f"{path}: unknown kind of file {path.suffix!r}; convert the mesh to one of {', '.join(READERS)}")
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise SceneError(f"{path}: no such file; check the spelling") from None
    except (OSError, ValueError) as error:  # a folder, no permission, a NUL in the name
        reason = getattr(error, "strerror", None) or error
        raise SceneError(f"{path}: cannot be read ({reason}); name a file that you may read") from None
    kind = path.suffix[1:].upper()
    if not data.strip():
        raise SceneError(f"{path}: the file is empty; export the mesh again")
    try:
        mesh = reader(data, path)
    except LookupError as error:
        raise SceneError(f"{path}: cannot be read as {kind}: it is cut off or malformed ({error}); export it again") from error
    except _BAD_FILE as error:
        reason = str(error) or type(error).__name__
        raise SceneError(f"{path}: cannot be read as {kind}: {reason}; export the mesh again") from error
    if not mesh.faces.size:
        raise SceneError(f"{path}: there is no triangle or polygon in this {kind} file; export a surface, not points or lines")
    return mesh


def fan(lengths: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return polygons as triangles (v0, vk, vk+1), in the order of the polygons.

    Parameters
    ----------
    lengths : (n,) int
        Corners of each polygon; those with fewer than three give nothing.
    corners : (sum(lengths),) int

    Returns
    -------
    faces : (m, 3) int64
    """
    corners = np.asarray(corners, np.int64)
    if np.all(lengths == 3):
        return corners.reshape(-1, 3)
    lengths = np.asarray(lengths, np.int64)
    n_triangles = np.maximum(lengths - 2, 0)
    first = np.repeat(np.cumsum(lengths) - lengths, n_triangles)
    k = np.arange(first.size) - np.repeat(np.cumsum(n_triangles) - n_triangles, n_triangles)
    return np.stack([corners[first], corners[first + k + 1], corners[first + k + 2]], axis=1)


def _read_obj(data: bytes, path: Path) -> RawMesh:
    """Read the ``v`` and ``f`` lines of a Wavefront OBJ; all other elements are passed over."""
    vertices, faces, known = [], [], []  # known: how many vertices stand above each face
    text = data.removeprefix(b"\xef\xbb\xbf").replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")
    for line in text.splitlines():
        words = line.partition(b"#")[0].split()
        if not words:
            continue
        if words[0] == b"v":
            if len(words) < 4:
                raise ValueError(f"vertex line {_show(line)} has fewer than three coordinates")
            vertices += words[1:4]
        elif words[0] == b"f":
            faces.append([word.partition(b"/")[0] for word in words[1:]])
            known.append(len(vertices) // 3)
    lengths = np.array([len(face) for face in faces], np.int64)
    numbers = np.fromiter((int(word) for face in faces for word in face), np.int64, lengths.sum())
    # Numbers count from 1; negative ones backwards from the latest vertex. 0 is none and becomes -1, out of range.
    corners = np.where(numbers < 0, np.repeat(np.array(known, np.int64), lengths) + numbers, numbers - 1)
    return RawMesh(np.fromiter(map(float, vertices), np.float64, len(vertices)).reshape(-1, 3), fan(lengths, corners))


def _read_off(data: bytes, path: Path) -> RawMesh:
    """Read an OFF text file; normals, colours and texture coordinates are passed over."""
    rows = [words for line in data.splitlines() if (words := line.partition(b"#")[0].split())]
    kind = rows[0].pop(0) if rows else b""
    if kind not in (b"OFF", b"COFF", b"NOFF", b"CNOFF", b"STOFF", b"STCOFF", b"STNOFF", b"STCNOFF") or b"BINARY" in rows[0]:
        raise ValueError(f"it starts with {_show(kind)}, not with OFF (3 coordinates, text)")
    if not rows[0]:  # the counts may stand in the first line, after OFF
        rows.pop(0)
    n_vertices, n_faces = (int(word) for word in rows[0][:2])
    if n_vertices < 0 or n_faces < 0 or len(rows) - 1 < n_vertices + n_faces:
        raise ValueError(f"it promises {n_vertices} vertices and {n_faces} faces but has {len(rows) - 1} lines for them")
    vertices = np.array([[float(word) for word in row[:3]] for row in rows[1 : 1 + n_vertices]], np.float64)
    polygons = rows[1 + n_vertices : 1 + n_vertices + n_faces]
    lengths = np.array([int(row[0]) for row in polygons], np.int64)
    for row, length in zip(polygons, lengths, strict=True):
        if not 0 <= length < len(row):
            raise ValueError(f"face line {_show(b' '.join(row))} has fewer numbers than it promises")
    corners = [int(word) for row, length in zip(polygons, lengths, strict=True) for word in row[1 : 1 + length]]
    return RawMesh(vertices.reshape(-1, 3), fan(lengths, np.array(corners, np.int64)))


_PLY_OLD_NAMES = dict(char="i1", uchar="u1", short="i2", ushort="u2", int="i4", uint="u4", float="f4", double="f8")
_PLY_NEW_NAMES = dict(int8="i1", uint8="u1", int16="i2", uint16="u2", int32="i4", uint32="u4", float32="f4", float64="f8")
#: The names of PLY's number types as NumPy writes them.
_PLY_TYPES = _PLY_OLD_NAMES | _PLY_NEW_NAMES
_PLY_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


class _PlyProperty(NamedTuple):
    name: str
    dtype: np.dtype
    length: np.dtype | None  # type of a list's length; None: a single number


class _PlyBody:
    """What stands after the header of a PLY file, read from front to back."""

    def __init__(self, body: bytes, is_text: bool) -> None:
        # In the text form every number is a float64, which holds a vertex number exactly.
        self.rest = memoryview(np.array(body.split(), np.float64).tobytes() if is_text else body)

    def take(self, dtype: np.dtype, n: int) -> np.ndarray:
        """Return the next n values."""
        size = n * dtype.itemsize
        if not 0 <= size <= len(self.rest):
            raise ValueError("it ends before all the elements that its header promises")
        values, self.rest = np.frombuffer(self.rest[:size], dtype), self.rest[size:]
        return values

    def next_element(self, properties: list[_PlyProperty]) -> list[np.ndarray]:
        """Return the values of the next element, one array per property."""
        return [self.take(p.dtype, 1 if p.length is None else int(self.take(p.length, 1)[0])) for p in properties]

    def elements(self, n: int, properties: list[_PlyProperty]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return, per property of the next n elements, the (n,) lengths (1 unless a list) and all values in one array."""
        start = self.rest
        sizes = [values.size for values in self.next_element(properties)]
        self.rest = start
        # Nearly always all lists are as long as those of the first element: then all is one array of records.
        fields: list[tuple] = []
        for p, size in zip(properties, sizes, strict=True):
            fields += [(f"length of {p.name}", p.length)] if p.length is not None else []
            fields += [(p.name, p.dtype, (size,))]
        has_lists = len(fields) > len(properties)
        record = np.dtype(fields)
        if n * record.itemsize <= len(start) or not has_lists:
            rows = self.take(record, n)
            lists = [(p.name, size) for p, size in zip(properties, sizes, strict=True) if p.length is not None]
            if all(np.all(rows[f"length of {name}"] == size) for name, size in lists):
                return {p.name: (np.full(n, size), rows[p.name].ravel()) for p, size in zip(properties, sizes, strict=True)}
            self.rest = start
        columns = list(zip(*(self.next_element(properties) for _ in range(n)), strict=True))
        return {p.name: (np.array([v.size for v in c]), np.concatenate(c)) for p, c in zip(properties, columns, strict=True)}


def _read_ply(data: bytes, path: Path) -> RawMesh:
    """Read the vertices and faces of a PLY file, text or binary of either byte order."""
    header, mark, body = data.partition(b"end_header")
    lines = [line.split() for line in header.decode("latin-1").splitlines()]
    if not mark or lines[0] != ["ply"]:
        raise ValueError("it has no PLY header")
    encoding = next((words[1] for words in lines if words[:1] == ["format"]), "")
    if encoding not in _PLY_ORDERS:
        raise ValueError(f"its format is {encoding!r}, not one of {', '.join(_PLY_ORDERS)}")
    is_text, order = encoding == "ascii", _PLY_ORDERS[encoding]
    layout: list[tuple[str, int, list[_PlyProperty]]] = []
    for words in lines:
        if words[:1] == ["element"]:
            layout.append((words[1], int(words[2]), []))
        elif words[:1] == ["property"]:
            kinds = [np.dtype(np.float64 if is_text else order + _PLY_TYPES[kind]) for kind in words[1:-1] if kind != "list"]
            layout[-1][2].append(_PlyProperty(words[-1], kinds[-1], kinds[0] if words[1] == "list" else None))
    rest = _PlyBody(body.partition(b"\n")[2], is_text)
    found = {name: rest.elements(n, properties) for name, n, properties in layout if n > 0 and properties}
    if bytes(rest.rest).strip():
        raise ValueError("it has more numbers than its header promises")
    vertex, face = found.get("vertex", {}), found.get("face", {})
    if not face:
        return RawMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    lengths, corners = face["vertex_indices" if "vertex_indices" in face else "vertex_index"]
    if corners.dtype.kind == "f" and not np.all(corners == np.floor(corners)):
        raise ValueError("a vertex number in a face is not a whole number")
    vertices = np.stack([vertex[axis][1] for axis in "xyz"], axis=1) if vertex else np.zeros((0, 3))
    return RawMesh(vertices, fan(lengths, corners))


def _read_stl(data: bytes, path: Path) -> RawMesh:
    """Read an STL file, text or binary, all its solids one after another."""
    from trimesh.exchange.stl import load_stl

    loaded = load_stl(io.BytesIO(data))
    solids = [solid for solid in loaded.get("geometry", {"": loaded}).values() if len(solid["faces"])]
    if not solids:
        raise ValueError("it has no complete solid")
    vertices = np.concatenate([solid["vertices"] for solid in solids])
    return RawMesh(vertices, np.arange(len(vertices), dtype=np.int64).reshape(-1, 3))


#: Extensions of glTF that change no shape; any other that a file *requires* is more than trimesh reads.
_HARMLESS = ("KHR_materials_", "KHR_texture_", "KHR_lights_", "EXT_texture_", "KHR_mesh_quantization", "KHR_xmp")


def _plain_gltf(text: bytes) -> bytes:
    """Return the JSON part of a glTF file without what is not shape, its nodes in an order that trimesh keeps.

    Raises ValueError where trimesh would return another shape than the file has.
    """
    tree = json.loads(text)
    unread = [name for name in tree.get("extensionsRequired", []) if not name.startswith(_HARMLESS)]
    if unread:
        raise ValueError(f"it needs the extension {', '.join(unread)}, which is not supported")
    for mesh in tree.get("meshes", []):
        for primitive in mesh["primitives"]:
            if primitive.get("mode", 4) == 6:
                raise ValueError("it has triangle fans, which are not supported")
            used = [primitive["attributes"]["POSITION"], *([primitive["indices"]] if "indices" in primitive else [])]
            for accessor in (tree["accessors"][number] for number in used):
                if "sparse" in accessor or accessor.get("normalized"):
                    raise ValueError("it has sparse or normalized accessors, which are not supported")
    for node in tree.get("nodes", []):
        node.pop("camera", None)  # trimesh passes over the meshes below a camera
        node.get("children", []).reverse()  # trimesh takes the last child first
    for scene in tree.get("scenes", []):
        scene.get("nodes", []).reverse()
    return json.dumps(tree).encode()


def _read_gltf(data: bytes, path: Path) -> RawMesh:
    """Read the meshes of a glTF or GLB scene, one after another as its nodes come, each moved to its place."""
    from trimesh.exchange.gltf import load_glb, load_gltf
    from trimesh.resolvers import FilePathResolver

    resolver = FilePathResolver(str(path))  # for the .bin files of a .gltf
    if path.suffix.lower() == ".gltf":
        loaded = load_gltf(io.BytesIO(_plain_gltf(data)), resolver, skip_materials=True)
    else:
        magic, version, _, size, kind = struct.unpack("<4sII I4s", data[:20])
        if (magic, version, kind) != (b"glTF", 2, b"JSON"):
            raise ValueError("it has no header of GLB version 2")
        text = _plain_gltf(data[20 : 20 + size])
        text += b" " * (-len(text) % 4)
        rest = data[20 + size :]
        head = struct.pack("<4sII I4s", magic, version, 20 + len(text) + len(rest), len(text), kind)
        loaded = load_glb(io.BytesIO(head + text + rest), resolver, skip_materials=True)
    places = {loaded["base_frame"]: np.eye(4)}
    vertices, faces, count = [], [], 0
    for node in loaded["graph"]:  # parents stand before their children
        places[node["frame_to"]] = place = places[node["frame_from"]] @ node["matrix"]
        geometry = loaded["geometry"].get(node.get("geometry"), {})
        if "faces" in geometry:
            corners = np.asarray(geometry["vertices"], np.float64)
            with np.errstate(invalid="ignore", over="ignore"):  # infinite vertices are found later
                vertices.append(corners @ place[:3, :3].T + place[:3, 3])
            number = np.asarray(geometry["faces"], np.int64)
            # A number beyond this mesh must not reach into the next one.
            faces.append(np.where(number < len(corners), number + count, -1))
            count += len(corners)
    if not faces:
        raise ValueError("no mesh with triangles is in its scene")
    return RawMesh(np.concatenate(vertices), np.concatenate(faces))


def _show(text: bytes) -> str:
    """Return the start of a piece of a file in quotes, whatever bytes it has."""
    return repr(text[:40].decode("ascii", "backslashreplace"))


#: How each kind of file is read, by suffix.
READERS = {".obj": _read_obj, ".ply": _read_ply, ".stl": _read_stl, ".glb": _read_gltf, ".gltf": _read_gltf, ".off": _read_off}
