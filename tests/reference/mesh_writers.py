"""Writers of OBJ, OFF, PLY and STL independent of our readers: each writes a shape in one of the usual ways."""

import gzip
import struct
from random import Random
from typing import NamedTuple

from tests.reference.mesh_shapes import Shape


class Written(NamedTuple):
    """A file, and the options by which it was written; ``plain`` if trimesh reads it right as well."""

    suffix: str
    data: bytes
    options: tuple[str, ...]
    plain: bool = False


def number(rng: Random, x: float) -> str:
    texts = [f"{x:.6f}", f"{x:g}", f"{x:.9e}", f"{x:+.12E}", repr(float(x))]
    return rng.choice([text for text in texts if float(text) == x])


def coded(rng: Random, lines: list[str], options: list[str]) -> bytes:
    """Return lines as bytes with line ends, a mark and packing as options say; adds what was chosen by chance."""
    end = rng.choice(["\n", "\n", "\r\n", "\r"])
    code = rng.choice(["utf-8"] * 5 + ["utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32"])
    options += [repr(end), code]
    text = end.join(lines) + rng.choice(["", end, end + "\x1a", end * 3])
    return packed(rng, text.encode(code), options)


def packed(rng: Random, data: bytes, options: list[str]) -> bytes:
    if rng.random() < 0.1:
        options.append("gzip")
        return gzip.compress(data)
    return data


def write_obj(rng: Random, shape: Shape) -> Written:
    options = [rng.choice(["v", "v/vt", "v//vn", "v/vt/vn"]), rng.choice(["absolute", "relative"])]
    options += [name for name in ("comments", "joined", "w", "colour", "groups", "late", "old") if rng.random() < 0.25]
    after = " 1.0" if "w" in options else " 0.5 0.25 1" if "colour" in options else ""
    vertices = ["v " + " ".join(number(rng, x) for x in v) + after for v in shape.vertices]
    n = len(vertices)
    lines = ["# made by a test, C:\\scans\\", "mtllib none.mtl", "#"] if "comments" in options else []
    lines += ["vt 0 0", "vn 0 0 1", *vertices]
    if "late" in options:  # the numbers of the faces stay those at the start
        lines.append("g all\\x y")
    for k, polygon in enumerate(shape.polygons):
        corners = [str(i - n if options[1] == "relative" else i + 1) for i in polygon]
        words = [i + {"v": "", "v/vt": "/1", "v//vn": "//1", "v/vt/vn": "/1/-1"}[options[0]] for i in corners]
        if "joined" in options:
            words.insert(rng.randrange(len(words) + 1), "\\" + rng.choice(["", " ", "  "]) + "\n")
        row = rng.choice(["f ", "f\t", "  f "]) + " ".join(words) if "old" not in options else "fo " + " ".join(words)
        row += rng.choice(["", " ", " # ok", "#ok \\"]) if "comments" in options else ""
        lines += [f"o part {k}", "usemtl m", "s off"] if "groups" in options else []
        lines += row.split("\n")
        lines += ["p 1", "l 1 2", "# \\"] if "comments" in options else []
    return Written(".obj", coded(rng, lines, options), tuple(options))


def write_off(rng: Random, shape: Shape) -> Written:
    options = [
        rng.choice(["OFF", "off", "Off", "COFF", "NOFF", "STOFF", "CNOFF", "none"]),
        rng.choice(["own line", "same", "glued"]),
    ]
    options += [name for name in ("comments", "no edges", "face colours", "blank lines") if rng.random() < 0.3]
    word = "" if options[0] == "none" else options[0]
    counts = f"{len(shape.vertices)} {len(shape.polygons)}" + ("" if "no edges" in options else " 0")
    join = {"own line": "\n", "same": " ", "glued": ""}[options[1]] if word else ""
    lines = ["# a comment", ""] if "comments" in options else []
    lines += (word + join + counts).split("\n")
    more = {"C": " 255 0 0 255", "N": " 0 0 1", "S": " 0.5 0.5"}.get(options[0][0], "") if len(word) > 3 else ""
    lines += [" ".join(number(rng, x) for x in v) + more + (" # v" if "comments" in options else "") for v in shape.vertices]
    lines += [""] if "blank lines" in options else []
    colour = " 10 20 30" if "face colours" in options else ""
    lines += [f"{len(p)}  {' '.join(map(str, p))}{colour}" for p in shape.polygons]
    return Written(".off", coded(rng, lines, options), tuple(options))


PLY_TYPES = {
    "char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d",
    "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "float32": "f", "float64": "d",
    "int64": "q", "uint64": "Q",
}  # fmt: skip


def write_ply(rng: Random, shape: Shape) -> Written:
    form = rng.choice(["ascii", "binary_little_endian", "binary_big_endian"])
    real = rng.choice(["float", "double", "float32", "float64"])
    length = rng.choice(["uchar", "uint8", "char", "int", "ushort", "uint32"])
    index = rng.choice(["int", "uint", "int32", "uint16", "short", "uchar", "int64", "uint64"])
    end = rng.choice(["\n", "\n", "\r\n", "\r"])
    options = [form, real, length, index, repr(end)]
    options += [name for name in ("comments", "normals", "faces first", "edges", "face flags", "index") if rng.random() < 0.3]
    lists = "vertex_index" if "index" in options else "vertex_indices"
    vertex: list[tuple] = [(real, axis) for axis in "xyz"]
    if "normals" in options:
        vertex = [("uchar", "red"), *vertex, ("float", "nx"), ("list", "uchar", "short", "marks")]
    face: list[tuple] = [("list", length, index, lists)]
    if "face flags" in options:
        face = [("short", "flag"), *face, ("list", "uchar", "float", "texcoord")]
    rows_of_vertices = [
        [7, *v, 0.5, [1, 2, 3][: k % 3]] if "normals" in options else [*v] for k, v in enumerate(shape.vertices)
    ]
    rows_of_faces = [[-3, p, [0.5] * 6] if "face flags" in options else [p] for p in shape.polygons]
    elements = [("vertex", vertex, rows_of_vertices), ("face", face, rows_of_faces)]
    elements = elements[::-1] if "faces first" in options else elements
    if "edges" in options:
        elements.insert(rng.randrange(3), ("edge", [("int", "a"), ("list", "int", "uchar", "b")], [[0, [1, 2]], [1, []]]))
    header = ["ply", f"format {form} 1.0"]
    header += ["comment end_header in a comment", "obj_info 12\x85 property", "comment"] if "comments" in options else []
    for name, properties, rows in elements:
        header.append(f"element {name} {len(rows)}")
        header += ["property " + " ".join(p) for p in properties]
    head = (end.join([*header, "end_header"]) + end).encode("latin-1")
    body = b""
    for _, properties, rows in elements:
        body += b"".join(ply_row(form, properties, row, end) for row in rows)
    return Written(".ply", packed(rng, head + body, options), tuple(options))


def ply_row(form: str, properties: list[tuple], row: list, end: str) -> bytes:
    flat: list[tuple[str, float]] = []
    for kind, value in zip(properties, row, strict=True):
        flat += [(kind[1], len(value)), *((kind[2], v) for v in value)] if kind[0] == "list" else [(kind[0], value)]
    if form == "ascii":
        return (" ".join(repr(v) for _, v in flat) + end).encode()
    order = "<" if "little" in form else ">"
    return b"".join(struct.pack(order + PLY_TYPES[kind], v) for kind, v in flat)


def write_stl(rng: Random, shape: Shape) -> Written:
    """Write text (of any polygons) or binary (of triangles: the fans, so only for convex shapes)."""
    return binary_stl(rng, shape) if shape.is_convex and rng.random() < 0.4 else text_stl(rng, shape)


def binary_stl(rng: Random, shape: Shape) -> Written:
    options = ["binary", rng.choice(["blank", "solid", "text"]), rng.choice(["right", "right", "zero", "unknown", "tail"])]
    head = {"blank": b"", "solid": b"solid made by a CAD", "text": b"solid x\nfacet normal 0 0 1\n"}[options[1]].ljust(80)
    triangles = shape.fans().tolist()
    n = {"zero": 0, "unknown": 0xFFFFFFFF}.get(options[2], len(triangles))
    body = b"".join(struct.pack("<12fH", 0, 0, 1, *(x for corner in t for x in corner), 0) for t in triangles)
    tail = rng.choice([b"\0" * 92, b"end", b"\0" * 50]) if options[2] == "tail" else b""
    return Written(".stl", packed(rng, head + struct.pack("<I", n) + body + tail, options), tuple(options))


def text_stl(rng: Random, shape: Shape) -> Written:
    options = ["text", rng.choice(["solid", "vertex 9 9 9 8 8 8 7 7 7", "facet endsolid", ""]), rng.choice(["lower", "upper"])]
    options += [name for name in ("two", "end solid", "indent", "normals", "no end", "colour") if rng.random() < 0.25]
    word = str.upper if "upper" in options else str.lower
    normal = "-1.#IND -1.#IND nan(ind)" if "normals" in options else "0 0 1"
    last = word("end solid" if "end solid" in options else "endsolid")
    lines = [f"{word('solid')} {options[1]}"]
    for k, polygon in enumerate(shape.polygons):
        if "two" in options and k == 1:
            lines += [f"{last} {options[1]}", "", f"{word('solid')} second"]
        indent = "   " if "indent" in options else ""
        lines += [f"{word('facet normal')} {normal}", f"{indent}{word('outer loop')}"]
        lines += [f"{indent * 2}{word('vertex')} {' '.join(number(rng, x) for x in shape.vertices[i])}" for i in polygon]
        lines += [f"{indent}{word('endloop')}", word("endfacet"), *(["color 1 0 0"] if "colour" in options else [])]
    lines += [] if "no end" in options else [f"{last} {options[1]}"]
    return Written(".stl", coded(rng, lines, options), tuple(options))
