"""Wavefront OBJ: its ``v`` and ``f`` lines; materials, normals, textures, points and lines are ignored."""

from pathlib import Path

import numpy as np

from rtrace.scenes.meshes.raw import MeshError, RawMesh, show
from rtrace.scenes.meshes.text import Text

#: Statements that describe a shape without polygons, and their kind.
_UNREAD = dict.fromkeys((b"surf", b"curv", b"curv2", b"bzp", b"bsp", b"cdc", b"cdp"), "free-form")
_UNREAD |= dict.fromkeys((b"call", b"csh"), "in another file")
#: Lines that are skipped unread, often most of a file.
_SKIPPED = (b"vn ", b"vt ")
#: Statements whose last word is a name, in which a backslash seldom continues the line.
_NAMES = frozenset((b"g", b"o", b"usemtl", b"mtllib", b"usemap", b"maplib"))


def read_obj(data: bytes, path: Path) -> RawMesh:
    """Read the polygons of a Wavefront OBJ. Raises MeshError."""
    text = Text(data)
    coordinates: list[bytes] = []
    corner_words: list[bytes] = []
    n_corners: list[int] = []  # of each face
    vertex_lines: list[int] = []
    face_lines: list[int] = []
    notes: list[str] = []
    unread: dict[bytes, int] = {}
    for line, words in text.rows(joins=True, skip=_SKIPPED):
        key = words[0]
        if key == b"v":
            if len(words) < 4:
                raise MeshError(f"line {line}: vertex {show(b' '.join(words))} has fewer than three coordinates")
            coordinates += words[1:4]
            vertex_lines.append(line)
        elif key == b"f" or key == b"fo":  # the old name of f
            corner_words += words[1:]
            n_corners.append(len(words) - 1)
            face_lines.append(line)
        elif key in _UNREAD:
            unread.setdefault(key, line)
        elif key in _NAMES and line in text.joined:
            notes.append(f"line {line} ends with a backslash: the next line is part of {show(key)} and is not read separately")
    for key, line in unread.items():
        what = f"line {line}: {show(key)} has a shape that is {_UNREAD[key]} and not read"
        if not face_lines:
            raise MeshError(what, "export polygons")
        notes.append(what)
    lengths = np.array(n_corners, np.int64)
    if b"/" in data:  # numbers of texture coordinates and normals follow
        corner_words = [word.partition(b"/")[0] for word in corner_words]
    ends = np.cumsum(lengths)
    numbers = text.whole_numbers(corner_words, lambda k: f"line {face_lines[np.searchsorted(ends, k, 'right')]}")
    # Numbers count from 1; negative ones backwards from the latest vertex. 0 is invalid and becomes -1, out of range.
    corners = numbers - 1
    if numbers.size and numbers.min() < 0:
        known = np.searchsorted(np.array(vertex_lines, np.int64), np.array(face_lines, np.int64))  # vertices above each face
        corners = np.where(numbers < 0, np.repeat(known, lengths) + numbers, corners)
    vertices = text.floats(coordinates, lambda k: f"line {vertex_lines[k // 3]}").reshape(-1, 3)
    return RawMesh(vertices, lengths, corners, _few(notes))


def _few(notes: list[str], most: int = 3) -> tuple[str, ...]:
    """Return the first notes, and the number of the others."""
    return tuple(notes) if len(notes) <= most else (*notes[:most], f"{len(notes) - most} more lines like these")
