"""A writer of glTF and GLB, independent of our reader: a shape's triangles, placed by glTF's means.

The expected triangles are computed here from the same moves in plain Python.
"""

import base64
import json
import math
import struct
from pathlib import Path
from random import Random
from urllib.parse import quote

import numpy as np

CODES = {"b": 5120, "B": 5121, "h": 5122, "H": 5123, "I": 5125, "f": 5126}
Triangles = list[list[tuple[float, float, float]]]


class Builder:
    """The JSON and the bytes of a file as they grow."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.tree: dict = {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": [], "nodes": [], "meshes": []}

    def view(self, rows: list, code: str, stride: int = 0) -> int:
        """Add rows of numbers; with a stride there is room between them."""
        self.data += b"\0" * (-len(self.data) % 4)
        packed = [struct.pack(f"<{len(row)}{code}", *row) for row in rows]
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": sum(max(stride, len(p)) for p in packed)}
        if stride:
            view["byteStride"] = stride
        self.data += b"".join(p.ljust(stride, b"\xff") for p in packed)
        self.tree["bufferViews"].append(view)
        return len(self.tree["bufferViews"]) - 1

    def accessor(self, rows: list, code: str, kind: str, stride: int = 0, **more) -> int:
        made = {"bufferView": self.view(rows, code, stride), "componentType": CODES[code], "count": len(rows), "type": kind}
        self.tree["accessors"].append(made | more)
        return len(self.tree["accessors"]) - 1

    def sparse(self, rows: list, changed: list[int], based: bool) -> int:
        """Add VEC3 rows of which some, or (without a base) all that are not zero, stand apart."""
        accessor: dict = {"componentType": 5126, "count": len(rows), "type": "VEC3"}
        if based:
            accessor["bufferView"] = self.view([(9, 9, 9) if k in changed else row for k, row in enumerate(rows)], "f")
        else:
            changed = list(range(len(rows)))
        accessor["sparse"] = {
            "count": len(changed),
            "indices": {"bufferView": self.view([(k,) for k in changed], "H"), "componentType": 5123},
            "values": {"bufferView": self.view([rows[k] for k in changed], "f")},
        }
        self.tree["accessors"].append(accessor)
        return len(self.tree["accessors"]) - 1

    def save(self, path: Path, how: str, rng: Random) -> None:
        buffer: dict = {"byteLength": len(self.data)}
        self.tree["buffers"] = [buffer]
        if how == "data":
            buffer["uri"] = "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()
        elif how == "percent data":
            buffer["uri"] = "data:," + quote(bytes(self.data))
        elif how in ("beside", "encoded"):
            name = "my mesh % é.bin" if how == "encoded" else "mesh.bin"
            buffer["uri"] = quote(name)
            (path.parent / name).write_bytes(self.data + b"more")
        text = json.dumps(self.tree).encode(rng.choice(["utf-8", "utf-8-sig"]) if how != "glb" else "utf-8")
        if how == "glb":
            text += rng.choice([b" ", b"\0"]) * (-len(text) % 4)
            body = bytes(self.data) + b"\0" * (-len(self.data) % 4)
            chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(body), b"BIN\0") + body
            text = struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
        path.write_bytes(text)


def turned(matrix: list[list[float]], triangles: Triangles) -> Triangles:
    return [[tuple(sum(m * x for m, x in zip(row, (*p, 1), strict=True)) for row in matrix) for p in t] for t in triangles]


def times(a: list[list[float]], b: list[list[float]]) -> list[list[float]]:
    full = [*b, [0, 0, 0, 1]]
    return [[sum(row[k] * full[k][j] for k in range(4)) for j in range(4)] for row in a]


def move(rng: Random) -> tuple[dict, list[list[float]]]:
    """Return a node's own move, written as TRS or as a matrix, and its three rows."""
    x, y, z = (float(rng.randint(-9, 9)) for _ in range(3))
    s = rng.choice([1.0, 2.0, 0.5])
    angle = rng.uniform(0, 2 * math.pi)
    c, d = math.cos(angle), math.sin(angle)
    rows = [[s * c, -s * d, 0, x], [s * d, s * c, 0, y], [0, 0, -s, z]]  # a turn about z, then mirrored in it
    if rng.random() < 0.5:
        columns = [[row[k] for row in rows] + [float(k == 3)] for k in range(4)]
        return {"matrix": [v for column in columns for v in column]}, rows
    half = [0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2)]
    return {"translation": [x, y, z], "rotation": half, "scale": [s, s, -s]}, rows


MEANS = [
    "nodes",
    "strip",
    "fan",
    "sparse",
    "sparse zeros",
    "morph",
    "node weights",
    "skin",
    "instances",
    "hidden",
    "short",
    "points",
]


def write_gltf(rng: Random, folder: Path, triangles: np.ndarray) -> tuple[Path, np.ndarray, tuple[str, ...]]:
    """Write triangles, (n, 3, 3), and return the file, the triangles that it has, and the options by which it was written."""
    means, how = rng.choice(MEANS), rng.choice(["data", "percent data", "beside", "encoded", "glb", "glb"])
    indices = rng.choice(["B", "H", "I", "none"])
    here: Triangles = [[tuple(p) for p in t] for t in triangles.tolist()]
    if means in ("strip", "fan"):
        ring = [p for t in here for p in t][:7]
        here = []
        for k in range(len(ring) - 2):
            here.append(
                [ring[0], *ring[k + 1 : k + 3]] if means == "fan" else [ring[k + k % 2], ring[k + 1 - k % 2], ring[k + 2]]
            )
        points = ring
    else:
        points = [p for t in here for p in t]
    file = Builder()
    tree = file.tree
    primitive: dict = {"attributes": {}, "mode": {"strip": 5, "fan": 6}.get(means, 4)}
    node, rows = move(rng)
    node["mesh"] = 0
    if means.startswith("sparse"):
        primitive["attributes"]["POSITION"] = file.sparse(points, sorted(rng.sample(range(len(points)), 2)), means == "sparse")
    elif means == "short":  # multiples of 1/64 up to 30: the scale is 32767/64
        whole = [tuple(round(64 * x) for x in p) for p in points]
        primitive["attributes"]["POSITION"] = file.accessor(whole, "h", "VEC3", 8, normalized=True)
        here = [[tuple(round(64 * x) / 32767 for x in p) for p in t] for t in here]
        tree["extensionsUsed"] = tree["extensionsRequired"] = ["KHR_mesh_quantization"]
    else:
        primitive["attributes"]["POSITION"] = file.accessor(points, "f", "VEC3", rng.choice([0, 0, 16, 20]))
    if indices != "none":
        order = list(range(len(points)))
        primitive["indices"] = file.accessor([(k,) for k in order], indices, "SCALAR")
    mesh = {"primitives": [primitive]}
    if means in ("morph", "node weights"):
        deltas = [[tuple(float(rng.randint(-4, 4)) for _ in range(3)) for _ in points] for _ in range(2)]
        primitive["targets"] = [{"POSITION": file.accessor(d, "f", "VEC3")} for d in deltas]
        mesh["weights"] = [0.5, -1.0]
        if means == "node weights":
            mesh["weights"], node["weights"] = [7.0, 7.0], [0.5, -1.0]
        moved = [tuple(p[i] + 0.5 * a[i] - b[i] for i in range(3)) for p, a, b in zip(points, *deltas, strict=True)]
        here = [moved[3 * k : 3 * k + 3] for k in range(len(here))]
    tree["meshes"].append(mesh)
    parent, outer = move(rng)
    tree["nodes"] = [{**parent, "children": [1]}, node]
    tree["scenes"], tree["scene"] = [{"nodes": []}, {"nodes": [0]}], 1
    place = times(outer, rows)
    found = turned(place, here)
    if means == "instances":
        copies = [tuple(float(rng.randint(-9, 9)) for _ in range(3)) for _ in range(3)]
        attributes = {"TRANSLATION": file.accessor(copies, "f", "VEC3"), "SCALE": file.accessor([(2, 2, 2)] * 3, "f", "VEC3")}
        node["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
        tree["extensionsUsed"] = ["EXT_mesh_gpu_instancing"]
        found = []
        for x, y, z in copies:
            found += turned(times(place, [[2, 0, 0, x], [0, 2, 0, y], [0, 0, 2, z]]), here)
    elif means == "hidden":
        hidden = {"mesh": 0, "children": [3], "extensions": {"KHR_node_visibility": {"visible": False}}}
        tree["nodes"] += [hidden, {"mesh": 0}]
        tree["scenes"][1]["nodes"] = [2, 0]
    elif means == "points":  # a camera does not hide what is below it
        mesh["primitives"].insert(0, {"attributes": primitive["attributes"], "mode": 0})
        tree["nodes"][0]["camera"] = 0
        tree["cameras"] = [{"type": "perspective", "perspective": {"yfov": 1, "znear": 1}}]
    elif means == "skin":
        found = skinned(rng, file, primitive, node, points, outer)
    path = folder / ("m.glb" if how == "glb" else "m.gltf")
    file.save(path, how, rng)
    return path, np.array(found), (means, how, indices)


def skinned(rng: Random, file: Builder, primitive: dict, node: dict, points: list, outer: list) -> Triangles:
    """Give the mesh two joints, below the node's parent; return where the triangles are then."""
    joints = [move(rng), move(rng)]
    file.tree["nodes"] += [joint for joint, _ in joints]
    file.tree["nodes"][0]["children"] += [2, 3]
    shift = [[1.0, 0, 0, 0], [0, 1.0, 0, 0], [0, 0, 1.0, 0], [3.0, -2.0, 1.0, 1.0]]  # column by column
    inverse = file.accessor([[x for column in shift for x in column]] * 2, "f", "MAT4")
    file.tree["skins"] = [{"joints": [2, 3], "inverseBindMatrices": inverse}]
    node["skin"] = 0
    weights = [rng.choice([0.0, 0.25, 1.0]) for _ in points]
    primitive["attributes"]["JOINTS_0"] = file.accessor([(0, 1, 0, 0)] * len(points), "B", "VEC4")
    primitive["attributes"]["WEIGHTS_0"] = file.accessor([(1 - w, w, 0, 0) for w in weights], "f", "VEC4")
    back = [[1.0, 0, 0, 3.0], [0, 1.0, 0, -2.0], [0, 0, 1.0, 1.0]]
    first, second = (turned(times(times(outer, rows), back), [points])[0] for _, rows in joints)
    moved = [
        tuple((1 - w) * a + w * b for a, b in zip(p, q, strict=True)) for w, p, q in zip(weights, first, second, strict=True)
    ]
    return [moved[3 * k : 3 * k + 3] for k in range(len(moved) // 3)]
