"""STL, text or binary (detected by content), all its solids one after another."""

import re
from pathlib import Path

import numpy as np

from rtrace.scenes.meshes.raw import MeshError, RawMesh, show
from rtrace.scenes.meshes.text import Text, plain_text

_HEAD, _RECORD = 84, np.dtype([("normal", "<f4", 3), ("vertices", "<f4", (3, 3)), ("attribute", "<u2")])
_TEXT = re.compile(rb"\s*(?:solid|facet)\b", re.IGNORECASE)
_STATEMENT = re.compile(rb"^[ \t]*(?:facet|end ?solid)\b", re.IGNORECASE | re.MULTILINE)
#: Counts of writers that do not know the number of triangles beforehand.
_UNKNOWN = (0, 0xFFFFFFFF)


def read_stl(data: bytes, path: Path) -> RawMesh:
    """Read an STL file. Raises MeshError.

    Neither the first word nor the count tells text from binary: binary files begin with "solid" too, and have wrong counts. A
    file that begins with a statement, has others at the start of lines and no NUL byte is text; a count has NUL bytes.
    """
    text = plain_text(data)
    if _TEXT.match(text) and b"\0" not in text and _STATEMENT.search(text.replace(b"\r", b"\n")):
        return _read_text(text)
    return _read_binary(data, int.from_bytes(data[80:84], "little"))


def _read_binary(data: bytes, n: int) -> RawMesh:
    promised, left = _HEAD + n * _RECORD.itemsize, len(data) - _HEAD
    what = f"its header promises {n:,} triangles = {promised:,} bytes, and it has {len(data):,}"
    notes: tuple[str, ...] = ()
    if left < 0:
        raise MeshError(f"it is neither text (solid, facet, ...) nor {_HEAD} bytes of a binary header")
    if n in _UNKNOWN and left > 0 and left % _RECORD.itemsize == 0:
        n = left // _RECORD.itemsize
        notes = (f"{what}: all {n:,} triangles are read",)
    elif (n == 0 and left > 0) or promised > len(data):
        raise MeshError(f"{what}: it is truncated, or not an STL file")
    elif promised < len(data):
        notes = (f"{what}: the {len(data) - promised:,} bytes after the triangles are not read",)
    vertices = np.frombuffer(data, _RECORD, n, _HEAD)["vertices"].reshape(-1, 3)
    return RawMesh(vertices, np.full(n, 3), np.arange(3 * n, dtype=np.int64), notes)


def _read_text(data: bytes) -> RawMesh:
    """Read text line by line: a facet lies between 'outer loop' and 'endloop'; names may be any words."""
    text = Text(data)
    coordinates: list[bytes] = []
    lines: list[int] = []  # of the vertices
    ends: list[int] = []  # the number of vertices above each endloop
    solid, in_loop, line = b"", 0, 0
    notes: list[str] = []
    for line, words in text.rows():
        key = words[0].lower()
        if key == b"vertex":
            if not in_loop:
                raise MeshError(f"line {line}: this vertex is outside a loop ('outer loop' to 'endloop')")
            if len(words) != 4:
                raise MeshError(f"line {line}: {show(b' '.join(words))} does not have three coordinates")
            coordinates += words[1:]
            lines.append(line)
        elif key == b"outer":
            if in_loop:
                raise MeshError(f"line {line}: the loop of line {in_loop} does not end before another begins")
            if len(words) > 2:
                raise MeshError(f"line {line}: each statement needs a separate line")
            in_loop = line
        elif key == b"endloop":
            n = len(lines) - (ends[-1] if ends else 0)
            if not in_loop or n < 3:
                what = f"this loop has {n} vertices, and a facet needs three" if in_loop else "no loop ends here"
                raise MeshError(f"line {line}: {what}")
            ends.append(len(lines))
            in_loop = 0
        elif in_loop:
            raise MeshError(f"line {line}: {show(b' '.join(words))} is in the loop of line {in_loop}, which does not end")
        elif key == b"solid":
            notes += _unended(solid, line)
            solid = b" ".join(words)
        elif key == b"endsolid" or (key == b"end" and words[1:2] and words[1].lower() == b"solid"):
            solid = b""
    if in_loop:
        raise MeshError(f"the loop of line {in_loop} does not end: {_called(solid)} is truncated after line {line}")
    notes += _unended(solid, line + 1)
    vertices = text.floats(coordinates, lambda k: f"line {lines[k // 3]}").reshape(-1, 3)
    lengths = np.diff(np.array(ends, np.int64), prepend=0)
    return RawMesh(vertices, lengths, np.arange(len(vertices), dtype=np.int64), tuple(notes[:3]))


def _called(solid: bytes) -> str:
    return show(solid) if solid else "the file"


def _unended(solid: bytes, line: int) -> list[str]:
    return [f"{_called(solid)} has no endsolid before line {line} and may be truncated"] if solid else []
