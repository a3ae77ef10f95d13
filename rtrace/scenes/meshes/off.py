"""OFF as Geomview writes it, and in other dialects: normals, colours and texture coordinates are ignored."""

import re
from pathlib import Path

import numpy as np

from rtrace.scenes.meshes.raw import MeshError, RawMesh, show
from rtrace.scenes.meshes.text import Text

#: The keyword in any case; anything joined to it (as in ModelNet's files) is the first count.
_KEYWORD = re.compile(rb"(?:ST)?C?N?(4?)OFF(.*)", re.IGNORECASE)


def read_off(data: bytes, path: Path) -> RawMesh:
    """Read the polygons of an OFF text file. Raises MeshError."""
    text = Text(data)
    rows = list(text.rows())
    if not rows:
        raise MeshError("it has nothing but comments")
    line, words = rows[0]
    keyword = _KEYWORD.fullmatch(words[0])
    if keyword:
        if keyword[1] or b"nOFF" in words[0]:
            raise MeshError(
                f"line {line}: {show(words[0])} does not have vertices of three coordinates", "export OFF, not 4OFF or nOFF"
            )
        words = [*([keyword[2]] if keyword[2] else []), *words[1:]]
        if words and words[0].upper() == b"BINARY":
            raise MeshError(f"line {line}: it is binary OFF, which every program writes differently", "export text OFF or PLY")
        if words:
            rows[0] = line, words
        else:
            rows.pop(0)
    elif not words[0].isdigit():  # the keyword may be missing
        raise MeshError(f"line {line}: it starts with {show(words[0])}, not with OFF")
    if not rows or len(rows[0][1]) < 2:
        raise MeshError(f"line {rows[0][0] if rows else line}: the numbers of vertices and faces are missing")
    line, words = rows[0]
    n_vertices, n_faces = text.whole_numbers(words[:2], lambda k: f"line {line}").tolist()
    n_rows = len(rows) - 1
    if n_vertices < 0 or n_faces < 0 or n_rows < n_vertices + n_faces:
        raise MeshError(
            f"line {line} promises {n_vertices} vertices and {n_faces} faces, but {n_rows} lines follow: it is truncated"
        )
    notes = []
    if n_rows > n_vertices + n_faces:
        notes.append(f"line {rows[1 + n_vertices + n_faces][0]} and later ones are beyond the promised faces and are not read")
    for line, words in rows[1 : 1 + n_vertices]:
        if len(words) < 3:
            raise MeshError(f"line {line}: vertex {show(b' '.join(words))} has fewer than three coordinates")
    coordinates = [word for _, words in rows[1 : 1 + n_vertices] for word in words[:3]]
    vertices = text.floats(coordinates, lambda k: f"line {rows[1 + k // 3][0]}").reshape(-1, 3)
    polygons = rows[1 + n_vertices : 1 + n_vertices + n_faces]
    lengths = text.whole_numbers([words[0] for _, words in polygons], lambda k: f"line {polygons[k][0]}")
    for (line, words), length in zip(polygons, lengths.tolist(), strict=True):
        if not 0 <= length < len(words):
            raise MeshError(
                f"line {line}: face {show(b' '.join(words))} does not have the {length} vertex numbers it promises"
            )
    ends = np.cumsum(lengths)
    numbers = [word for (_, words), length in zip(polygons, lengths.tolist(), strict=True) for word in words[1 : 1 + length]]
    corners = text.whole_numbers(numbers, lambda k: f"line {polygons[np.searchsorted(ends, k, 'right')][0]}")
    return RawMesh(vertices, lengths, corners, tuple(notes))
