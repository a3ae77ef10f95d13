"""PLY, text or binary of either byte order: its vertices, faces and triangle strips."""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rtrace.scenes.meshes.polygons import strips
from rtrace.scenes.meshes.raw import MeshError, RawMesh, show
from rtrace.scenes.meshes.text import Text, plain_text

_OLD_NAMES = dict(char="i1", uchar="u1", short="i2", ushort="u2", int="i4", uint="u4", float="f4", double="f8")
_NEW_NAMES = dict(int8="i1", uint8="u1", int16="i2", uint16="u2", int32="i4", uint32="u4", float32="f4", float64="f8")
#: PLY's number types as NumPy names them; programs based on NumPy add the 64-bit types.
_TYPES = {name.encode(): code for name, code in (_OLD_NAMES | _NEW_NAMES | dict(int64="i8", uint64="u8")).items()}
_ORDERS = {b"ascii": "", b"binary_little_endian": "<", b"binary_big_endian": ">"}
_LINE_END = re.compile(rb"\r\n|\n|\r")


class _Property(NamedTuple):
    name: bytes
    dtype: np.dtype
    length: np.dtype | None  # type of a list's length; None: a single number


class _Element(NamedTuple):
    name: bytes
    n: int
    properties: list[_Property]


class _Body:
    """The body of a PLY file, read from front to back."""

    def __init__(self, numbers: bytes) -> None:
        self.rest = memoryview(numbers)

    def take(self, dtype: np.dtype, n: int, element: str) -> np.ndarray:
        """Return the next n values."""
        size = n * dtype.itemsize
        if size > len(self.rest):
            raise MeshError(f"it ends before all that its header promises, in {element}: it is truncated")
        values, self.rest = np.frombuffer(self.rest[:size], dtype), self.rest[size:]
        return values

    def next_element(self, properties: list[_Property], element: str) -> list[np.ndarray]:
        """Return the values of the next element, one array per property."""
        return [self.take(p.dtype, 1 if p.length is None else self._length(p.length, element), element) for p in properties]

    def _length(self, dtype: np.dtype, element: str) -> int:
        length = self.take(dtype, 1, element)[0]
        if not (0 <= length < 1 << 31 and length == int(length)):
            raise MeshError(f"{element} has a list of length {length}; it must be a whole number from 0")
        return int(length)

    def elements(self, element: _Element) -> dict[bytes, tuple[np.ndarray, np.ndarray]]:
        """Return, per property of an element, the (n,) lengths (1 unless a list) and all values in one array."""
        name, n, properties = element
        label = name.decode("latin-1")
        start = self.rest
        sizes = [values.size for values in self.next_element(properties, f"{label} number 0")]
        self.rest = start
        # Nearly always all lists are as long as the first element's: then the body is one array of records.
        fields: list[tuple] = []
        for k, (p, size) in enumerate(zip(properties, sizes, strict=True)):
            fields += [(f"length {k}", p.length)] if p.length is not None else []
            fields += [(f"values {k}", p.dtype, (size,))]
        lists = [k for k, p in enumerate(properties) if p.length is not None]
        record = np.dtype(fields)
        if n * record.itemsize <= len(start) or not lists:
            rows = self.take(record, n, f"the {n:,} elements {label}")
            if all(np.all(rows[f"length {k}"] == sizes[k]) for k in lists):
                return {p.name: (np.full(n, sizes[k]), rows[f"values {k}"].ravel()) for k, p in enumerate(properties)}
            self.rest = start
        columns = list(zip(*(self.next_element(properties, f"{label} number {k}") for k in range(n)), strict=True))
        return {p.name: (np.array([v.size for v in c]), np.concatenate(c)) for p, c in zip(properties, columns, strict=True)}


def read_ply(data: bytes, path: Path) -> RawMesh:
    """Read the surface of a PLY file. Raises MeshError."""
    data = plain_text(data) if data[:3].lower() != b"ply" else data  # a mark, or UTF-16
    rows, body, is_text = _split(data)
    layout = _layout(rows)
    rest = _Body(_text_numbers(body, len(rows)).tobytes() if is_text else body)
    found = {e.name: rest.elements(e) for e in layout if e.n > 0 and e.properties}
    if bytes(rest.rest).strip(b"\0\t\n\r \x1a"):
        raise MeshError("it has more numbers than its header promises")
    vertex = found.get(b"vertex", {})
    if vertex and any(axis not in vertex or len(vertex[axis][0]) != len(vertex[axis][1]) for axis in (b"x", b"y", b"z")):
        raise MeshError("its vertices have no x, y and z")
    vertices = np.stack([vertex[axis][1] for axis in (b"x", b"y", b"z")], axis=1) if vertex else np.zeros((0, 3))
    lengths, corners = _lists(found, b"face")
    if b"tristrips" in found:
        faces = strips(*_lists(found, b"tristrips"))
        lengths, corners = np.append(lengths, np.full(len(faces), 3)), np.append(corners, faces)
    return RawMesh(vertices, lengths, corners)


def _split(data: bytes) -> tuple[list[list[bytes]], bytes, bool]:
    """Return the words of the header's lines, what follows, and whether that is text.

    The header ends with a line that is end_header, the body begins after that line's own end. In a binary file whose lines
    end with CR the body may begin with a byte that looks like LF: the first line tells.
    """
    first = _LINE_END.search(data)
    if first is None or data[: first.start()].strip().lower() != b"ply":
        raise MeshError("it has no PLY header: its first line is not 'ply'")
    rows: list[list[bytes]] = []
    start = 0
    while found := _LINE_END.search(data, start):
        end = found.start() + 1 if first[0] == b"\r" else found.end()
        rows.append(data[start : found.start()].split())
        start = end
        if rows[-1] == [b"end_header"]:
            break
    else:
        if data[start:].strip() != b"end_header":
            raise MeshError("its header does not end: the line 'end_header' is missing")
        start = len(data)
    is_text = next((words[1:2] for words in rows if words[:1] == [b"format"]), []) == [b"ascii"]
    return rows, data[start:], is_text


def _layout(rows: list[list[bytes]]) -> list[_Element]:
    """Return the elements that a header promises."""
    encoding = b""
    layout: list[_Element] = []
    for line, words in enumerate(rows, 1):
        key, rest = (words[0], words[1:]) if words else (b"", [])
        said = f"line {line}: {show(b' '.join(words))}"
        if key == b"format":
            if len(rest) < 1 or rest[0] not in _ORDERS:
                formats = b", ".join(_ORDERS).decode()
                raise MeshError(f"{said} is not one of the formats {formats}")
            encoding = rest[0]
        elif key == b"element":
            if not encoding:
                break
            if len(rest) != 2 or not rest[1].isdigit() or len(rest[1]) > 18:
                raise MeshError(f"{said} is not 'element', a name and a count")
            if any(rest[0] == element.name for element in layout):
                raise MeshError(f"{said}: there are two elements of this name")
            layout.append(_Element(rest[0], int(rest[1]), []))
        elif key == b"property":
            if len(rest) != (4 if rest[:1] == [b"list"] else 2) or not layout:
                raise MeshError(f"{said} is not a property of an element: type and name, or list, two types and name")
            for kind in rest[-3:-1] if rest[0] == b"list" else rest[:1]:
                if kind not in _TYPES:
                    raise MeshError(f"{said}: {show(kind)} is not a PLY type ({b', '.join(_TYPES).decode()})")
            layout[-1].properties.append(_property(rest, encoding))
        elif key not in (b"ply", b"comment", b"obj_info", b"end_header", b""):
            raise MeshError(f"{said} is not a line of a PLY header")
    if not encoding:
        raise MeshError("its header has no line 'format' above its elements")
    return layout


def _property(rest: list[bytes], encoding: bytes) -> _Property:
    # In the text form every number is a float64, which holds a vertex number exactly.
    kinds = [
        np.dtype(_ORDERS[encoding] + _TYPES[kind] if encoding != b"ascii" else "f8") for kind in rest[:-1] if kind != b"list"
    ]
    return _Property(rest[-1], kinds[-1], kinds[0] if len(kinds) == 2 else None)


def _text_numbers(body: bytes, n_header_lines: int) -> np.ndarray:
    """Return all numbers of a body in text form."""
    words = body.split()
    if b"_" not in body and b"#" not in body:
        try:
            return np.array(words, np.float64)
        except ValueError:
            pass
    text = Text(body)
    rows = list(text.rows())
    lines = [n_header_lines + line for line, words in rows for _ in words]
    return text.floats([word for _, words in rows for word in words], lambda k: f"line {lines[k]}")


def _lists(found: dict[bytes, dict[bytes, tuple[np.ndarray, np.ndarray]]], name: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Return the lengths and the vertex numbers of the faces or strips."""
    if name not in found:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    kind = next((kind for kind in (b"vertex_indices", b"vertex_index") if kind in found[name]), None)
    if kind is None:
        raise MeshError(f"its element {name.decode()} has no list vertex_indices")
    lengths, corners = found[name][kind]
    if corners.dtype.kind == "f":
        bad = np.flatnonzero(corners != np.floor(corners))
        if bad.size or not np.isfinite(corners).all():
            at = bad[0] if bad.size else np.flatnonzero(~np.isfinite(corners))[0]
            face = np.searchsorted(np.cumsum(lengths), at, "right")
            raise MeshError(f"{name.decode()} number {face}: the vertex number {corners[at]:g} is not a whole number")
        corners = np.clip(corners, -(2.0**62), 2.0**62)
    elif corners.dtype.kind == "u" and corners.dtype.itemsize == 8:
        corners = np.minimum(corners, np.uint64(1 << 62))
    return lengths, corners.astype(np.int64)
