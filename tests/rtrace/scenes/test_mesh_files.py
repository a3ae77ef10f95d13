"""Mesh files from practice: each legal oddity is read, each other one is refused in a sentence that helps."""

# ruff: noqa: E501

import gzip
import json
import re
import struct
import zipfile

import numpy as np
import pytest

from rtrace.scenes.catalog import load_archive
from rtrace.scenes.meshes.polygons import strips, triangulate
from rtrace.scenes.meshes.text import Text
from rtrace.scenes.scene import SceneError, load_mesh
from tests.rtrace.scenes.test_mesh_corpus import areas

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
ARROW = [(0, 0, 0), (4, 0, 0), (4, 4, 0), (2, 1, 0), (0, 4, 0)]  # area 16 - 6
PLY = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n"
PLY += "property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n1 1 0\n3 0 1 2\n"
FACET = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 1 1 0\nendloop\nendfacet\n"


def load(tmp_path, name, data):
    (tmp_path / name).write_bytes(data if isinstance(data, bytes) else data.encode())
    return load_mesh(tmp_path / name)


def gltf(**more):
    """A glTF file of one triangle; a key as ``meshes__0__primitives__0__mode`` changes or adds something deep in it."""
    data = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0]], "<f4").tobytes() + struct.pack("<4H", 0, 1, 2, 0)
    tree = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"},
        ],
        "bufferViews": [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 6}],
        "buffers": [{"byteLength": 44, "uri": "data:," + "".join(f"%{byte:02x}" for byte in data)}],
    }
    for key, value in more.items():
        *path, last = [int(part) if part.isdigit() else part for part in key.split("__")]
        place = tree
        for part in path:
            place = place[part]
        place[last] = value
    return json.dumps(tree).encode()


def glb(text, length=None, magic=b"glTF", version=2):
    text += b"\0" * (-len(text) % 4)
    return struct.pack("<4sIII4s", magic, version, length or 20 + len(text), len(text), b"JSON") + text


LEGAL_FILES = [
    ("m.obj", f"# C:\\scans\\\n{SQUARE}# part \\\nf 1 2 3\nf 1 3 4\n", 1),
    ("m.obj", f"{SQUARE}f 1 2 \\ \n3 4#end \\\nf 1 2 3\\", 1.5),
    ("m.obj", f"{SQUARE}f 1 2 \\\n \\\n3 # three\n", 0.5),
    ("m.obj", f"{SQUARE}f -4/1 -3/1#/2\\\n -2\n".replace("#/2", " "), 0.5),
    ("m.obj", f"{SQUARE}v 0_0 1 2\n".replace("0_0", "-1.#IND00") + "f 1 2 3\nf 1 2 5#NaN\n", 0.5),
    ("m.obj", f"{SQUARE}v nan(ind) 1 -nan(snan)\nf 1 2 3\n", 0.5),
    ("m.obj", f"\n{SQUARE}f 1 2 3\n".encode("utf-16"), 0.5),
    ("m.obj", f"# x\n{SQUARE}f 1 2 3\n".encode("utf-16-be"), 0.5),
    ("m.obj.gz", gzip.compress(f"{SQUARE}f 1 2 3\n".encode()), 0.5),
    ("m.off", "OFF4 1 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n", 0.5),
    ("m.off", "\ufeffoff 3 1\r0 0 0\r1 0 0\r1 1 0\r3 0 1 2", 0.5),
    ("m.ply", PLY.replace("\n", "\r"), 0.5),
    ("m.ply", PLY.replace("element vertex", "comment no end_header \x85 here\nelement vertex").encode("latin-1"), 0.5),
    ("m.ply", "\ufeff" + PLY, 0.5),
    ("m.ply", PLY.replace("face 1", "tristrips 1").replace("3 0 1 2", "7 0 1 2 -1 2 0 1"), 1),
    ("m.stl", f"solid vertex 9 9 9\n{FACET}{FACET}end solid vertex 9 9 9\n", 1),
    ("m.stl", f"solid\n{FACET.upper()}color 1 0 0\n{FACET}endsolid\n\nSOLID b\n{FACET}ENDSOLID", 1.5),
    ("m.stl", f"{FACET}{FACET}", 1),
    ("m.stl", f"solid q\n{FACET.replace('endloop', 'vertex 0 1 0' + chr(10) + 'endloop')}endsolid", 1),
    ("m.gltf", gltf(), 0.5),
    ("m.glb", gltf(), 0.5),
    ("m.glb", glb(gltf()), 0.5),
    ("m.gltf", gltf(nodes__0__scale=[2, 2, 2], nodes__0__camera=0), 2),
    ("m.gltf", gltf(scenes=[]), 0.5),
    ("m.gltf", gltf(meshes__0__primitives__0__extensions={"KHR_draco_mesh_compression": {}}), 0.5),
    ("m.gltf", gltf(extensionsRequired=["KHR_materials_unlit"]), 0.5),
]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "data", "area"), LEGAL_FILES, ids=[f"{k} {name}" for k, (name, *_) in enumerate(LEGAL_FILES)]
)
def test_legal_oddities_are_read(tmp_path, name, data, area):
    scene = load(tmp_path, name, data)
    assert areas(scene.triangles).sum() == pytest.approx(area)
    assert scene.name == "m"
    assert scene.notes[:-1] == () and all("steps" in note for note in scene.notes)


DEEP = {"nodes": [{"children": [1]}, {"children": [0], "mesh": 0}]}
BAD_FILES = [
    ("m.obj", f"{SQUARE}\nv 0,5 1 2\nf 1 2 3\n", "line 6: '0,5' is not a number; write decimals with a point"),
    ("m.obj", f"{SQUARE}v 1.0D+00 1 2\nf 1 2 3\n", "line 5: '1.0D.00' is not a number; write exponents with an E"),
    ("m.obj", f"{SQUARE}v 1_0 1 2\nf 1 2 3\n", "line 5: '1_0' is not a number"),
    ("m.obj", f"{SQUARE}f 1 2 3\n\nf 1 2_1 3\n", "line 7: '2_1' is not a whole number"),
    ("m.obj", f"{SQUARE}f 1 2.0 3\n", "line 5: '2.0' is not a whole number"),
    ("m.obj", "v 0 0\nf 1 1 1\n", "line 1: vertex 'v 0 0' has fewer than three coordinates"),
    ("m.obj", f"{SQUARE}cstype bezier\nsurf 0 1 0 1 1 2 3 4\n", "line 6: 'surf' has a shape that is free-form and not read; export"),
    ("m.obj", b"\x1f\x8b\x08\0\0", "damaged or truncated gzip"),
    ("m.obj", b"PK\3\4....", "it is a zip archive; unpack it"),
    ("m.off", "4OFF\n1 1 0\n", "line 1: '4OFF' does not have vertices of three coordinates"),
    ("m.off", "nOFF\n4\n1 1 0\n", "line 1: 'nOFF' does not have vertices of"),
    ("m.off", "OFF BINARY\n1 1 0\n", "line 1: it is binary OFF"),
    ("m.off", "# hm\nFOO\n1 1 0\n", "line 2: it starts with 'FOO', not with OFF"),
    ("m.off", "OFF\n4 x 0\n", "line 2: 'x' is not a whole number"),
    ("m.off", "OFF\n", "line 1: the numbers of vertices and faces are missing"),
    ("m.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n", "line 2 promises 3 vertices and 1 faces, but 2 lines follow: it is truncated"),
    ("m.off", "OFF\n1 1 0\n0 0\n3 0 0 0\n", "line 3: vertex '0 0' has fewer"),
    ("m.off", "OFF\n1 1 0\n0 0 0\n4 0 0 0\n", "line 4: face '4 0 0 0' does not have the 4 vertex numbers"),
    ("m.ply", PLY.replace("int vertex", "int128 vertex"), "line 8: .*: 'int128' is not a PLY type"),
    ("m.ply", PLY.replace("float y", "y"), "line 5: 'property y' is not a property"),
    ("m.ply", PLY.replace("vertex 3", "vertex -3"), "line 3: 'element vertex -3' is not 'element', a name and a count"),
    ("m.ply", PLY.replace("element face", "elements face"), "line 7: 'elements face 1' is not a line of a PLY header"),
    ("m.ply", PLY.replace("ascii", "text"), "line 2: 'format text 1.0' is not one of the formats ascii"),
    ("m.ply", PLY.replace("format ascii 1.0\n", ""), "no line 'format' above its elements"),
    ("m.ply", PLY.replace("end_header", "end_of_header"), "its header does not end"),
    ("m.ply", PLY.replace("float z", "float w"), "its vertices have no x, y and z"),
    ("m.ply", PLY.replace("vertex_indices", "corners"), "its element face has no list vertex_indices"),
    ("m.ply", PLY.replace("1 1 0\n3", "1 l 0\n3"), "line 12: 'l' is not a number"),
    ("m.ply", PLY.replace("3 0 1 2", "3 0 1 2.5"), "face number 0: the vertex number 2.5 is not a whole number"),
    ("m.ply", PLY.replace("3 0 1 2", "-3 0 1 2"), "face number 0 has a list of length -3"),
    ("m.ply", PLY.replace("3 0 1 2", "3 0 1"), "ends before all that its header promises, in face number 0: it is truncated"),
    ("m.ply", PLY + "7\n", "it has more numbers than its header promises"),
    ("m.ply", PLY.replace("vertex 3", f"vertex {10**17}"), "ends before"),
    ("m.ply", "PLX\n", "its first line is not 'ply'"),
    ("m.stl", f"solid s\n{FACET}{FACET[:43]}", "the loop of line 10 does not end: 'solid s' is truncated after line 11"),
    ("m.stl", f"solid s\n{FACET.replace('vertex 1 1 0', '')}endsolid", "line 7: this loop has 2 vertices, and a facet needs three"),
    ("m.stl", f"solid s\n{FACET.replace('vertex 1 0 0', 'vertex 1 0')}endsolid", "line 5: 'vertex 1 0' does not have three coordinates"),
    ("m.stl", f"solid s\n{FACET.replace('1 0 0', '1 a 0')}endsolid", "line 5: 'a' is not a number"),
    ("m.stl", f"solid s\nvertex 1 2 3\n{FACET}endsolid", "line 2: this vertex is outside a loop"),
    ("m.stl", f"solid s\n{FACET.replace('endloop', '')}endsolid", "line 8: 'endfacet' is in the loop of line 3"),
    ("m.stl", f"solid s\n{FACET.replace(chr(10) + 'vertex', ' vertex')}endsolid", "line 3: each statement needs a separate line"),
    ("m.stl", b"\0" * 80 + struct.pack("<I", 5) + b"\0" * 70, "promises 5 triangles = 334 bytes, and it has 154: it is truncated"),
    ("m.stl", b"\0" * 80 + struct.pack("<I", 0) + b"\0" * 70, "promises 0 triangles = 84 bytes, and it has 154"),
    ("m.stl", b"hello", "it is neither text"),
    ("m.gltf", gltf(asset={"version": "1.0"}), "it is glTF 1.0; only 2.0 is read; export glTF 2.0"),
    ("m.gltf", gltf(asset={"version": "2.0", "minVersion": "3.0"}), "it is glTF 3.0; only 2.0"),
    ("m.gltf", gltf(buffers__0__uri="not%20here.bin"), "the file 'not%20here.bin' of buffer 0 is missing; put it beside"),
    ("m.gltf", gltf(buffers__0__uri="https://a.b/c.bin"), "only data: URIs and files beside it are read"),
    ("m.gltf", gltf(buffers__0__uri="data:;base64,????"), "the data: URI of buffer 0 is not base64"),
    ("m.gltf", gltf(buffers__0__uri="data:,ab"), "buffer 0 has 2 bytes of the 44 promised: it is truncated"),
    ("m.gltf", gltf(buffers__0__uri="."), "the file '.' of buffer 0 cannot be read"),
    ("m.gltf", gltf(extensionsRequired=["KHR_draco_mesh_compression"]), "needs the extension KHR_draco_mesh_compression, which"),
    ("m.gltf", gltf(bufferViews__0__extensions={"EXT_meshopt_compression": {}}), "compressed by EXT_meshopt_compression"),
    ("m.gltf", gltf(nodes__0__mesh=3), "node 0 names mesh 3; the file has 1"),
    ("m.gltf", gltf(nodes__0__mesh="3"), 'node 0 has mesh "3"; it must be a whole number from 0'),
    ("m.gltf", gltf(nodes__0__skin=0), "node 0 names skin 0; the file has 0"),
    ("m.gltf", gltf(nodes__0__weights=[1]), "primitive 0 of mesh 0 has 0 morph targets for 1 weights"),
    ("m.gltf", gltf(nodes__0__matrix=[1, 2]), "node 0 has matrix a list of 2; it must be a list of 16 numbers"),
    ("m.gltf", gltf(nodes__0__rotation=[0, 0, 0, 0]), "node 0 has a rotation that is not a quaternion"),
    ("m.gltf", gltf(**DEEP), "node 0 is in its scene twice, or within itself"),
    ("m.gltf", gltf(nodes__0__children=[0]), "node 0 is the child of itself or of two nodes"),
    ("m.gltf", gltf(scenes__0__nodes=[0, 0]), "node 0 is in its scene twice"),
    ("m.gltf", gltf(accessors__0__count=4), "accessor 0 ends at byte 48 of bufferView 0, which has 36"),
    ("m.gltf", gltf(accessors__1__componentType=5126), "must be SCALAR of unsigned integers, accessor 1 is SCALAR of"),
    ("m.gltf", gltf(accessors__1__count=2), "primitive 0 of mesh 0 has 2 vertex numbers, and triangles need three each"),
    ("m.gltf", gltf(meshes__0__primitives__0__mode=7), "primitive 0 of mesh 0 has mode 7"),
    ("m.gltf", gltf(meshes__0__primitives__0__mode=1), "its scene has no mesh with triangles"),
    ("m.gltf", gltf()[:-3], "line 1, column .*: it is not JSON"),
    ("m.gltf", b"[" * 100_000, "nested too deeply"),
    ("m.gltf", b"[1]", "the file is a list of 1 and must be an object"),
    ("m.glb", glb(gltf())[:-4], "its header promises .* bytes, and it has .*: it is truncated"),
    ("m.glb", glb(gltf())[:18], "it is truncated after 18 bytes"),
    ("m.glb", glb(gltf(), magic=b"gltf"), "it begins with 'gltf', not with 'glTF'"),
    ("m.glb", glb(gltf(), version=1), "it is GLB version 1; only 2 is read"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "data", "words"), BAD_FILES, ids=[f"{name[2:]}: {words[:50]}" for name, _, words in BAD_FILES]
)
def test_what_cannot_be_read_is_reported_with_the_place_and_the_way_out(tmp_path, name, data, words):
    with pytest.raises(SceneError, match=words) as error:
        load(tmp_path, name, data)
    said = str(error.value)
    assert said.startswith(f"{tmp_path / name}: ") and "; " in said and "\n" not in said


NOTED_FILES = [
    ("m.obj", f"{SQUARE}usemtl wood\\\nf 1 2 3\nf 1 3 4\n", 1, r"m.obj: line 5 ends with a backslash: .* 'usemtl'"),
    ("m.obj", f"{SQUARE}f 1 2 3\nsurf 0 1\n", 1, "line 6: 'surf' has a shape that is free-form and not read"),
    ("m.obj", f"{SQUARE}call more.obj\nf 1 2 3\n", 1, "line 5: 'call' has a shape that is in another file"),
    ("m.obj", f"{SQUARE}f 1 2\nf 1 2 3\n", 1, r"1 polygon \(number 0\) has fewer than three corners"),
    (
        "m.off",
        "OFF\n3 1 0\n0 0 0\n1 0 0\n1 1 0\n3 0 1 2\n3 0 1 2\n",
        1,
        "line 7 and later ones are beyond the promised",
    ),
    (
        "m.stl",
        f"solid a\n{FACET}endsolid\nsolid b\n{FACET}",
        2,
        "'solid b' has no endsolid before line 18 and may be truncated",
    ),
    ("m.gltf", gltf(nodes__0__extensions={"KHR_new_shape": {}}), 1, r"extension KHR_new_shape \(node 0, perhaps others\)"),
    ("m.gltf", gltf(scenes=[{"nodes": [0]}, {}]), 1, "it has 2 scenes: number 0 is read"),
]


@pytest.mark.parametrize(("name", "data", "n", "words"), NOTED_FILES, ids=[words for *_, words in NOTED_FILES])
def test_what_may_have_been_meant_otherwise_is_noted(tmp_path, name, data, n, words):
    scene = load(tmp_path, name, data)
    assert len(scene.triangles) == n
    assert [bool(re.search(words, note)) for note in scene.notes].count(True) == 1


@pytest.mark.parametrize(("count", "tail", "n"), [(2, b"\0" * 92, 2), (0, b"", 2), (0xFFFFFFFF, b"", 2), (1, b"", 1)])
def test_a_binary_stl_with_a_wrong_length_is_noted(tmp_path, count, tail, n):
    triangle = struct.pack("<12fH", 0, 0, 1, 0, 0, 0, 1, 0, 0, 1, 1, 0, 0)
    scene = load(tmp_path, "m.stl", b"solid x".ljust(80) + struct.pack("<I", count) + 2 * triangle + tail)
    assert len(scene.triangles) == n
    assert f"its header promises {count:,} triangles" in scene.notes[0]


def faces_of(points, *polygons):
    corners = np.concatenate(polygons)
    return triangulate(np.array(points, float), np.array([len(p) for p in polygons]), corners)


def test_a_fan_is_kept_where_it_is_right():
    """Convex polygons, and others whose first corner sees everything, are fans; so are collinear corners."""
    square = [*SQUARE_POINTS, (0.5, 0, 0)]
    np.testing.assert_array_equal(faces_of(square, [0, 4, 1, 2, 3])[0], [[0, 4, 1], [0, 1, 2], [0, 2, 3]])
    np.testing.assert_array_equal(faces_of(ARROW, [3, 4, 0, 1, 2])[0], [[3, 4, 0], [3, 0, 1], [3, 1, 2]])


SQUARE_POINTS = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]


@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
def test_ears_are_cut_between_the_other_polygons_at_any_scale(scale):
    points = np.array(ARROW, float) * scale
    faces, notes = faces_of(points, [0, 1, 2], [0, 1, 2, 3, 4], [4, 3, 2, 1, 0], [2, 1, 0])
    assert notes == ()
    assert len(faces) == 8 and faces[0].tolist() == [0, 1, 2] and faces[-1].tolist() == [2, 1, 0]
    a, b, c = points[faces].transpose(1, 0, 2) / scale
    turned = np.cross(b - a, c - a)[:, 2] / 2
    assert (turned[1:4] > 0).all() and (turned[4:7] < 0).all()  # as each polygon turns
    np.testing.assert_allclose([turned[1:4].sum(), turned[4:7].sum()], [10, -10])


@pytest.mark.parametrize(
    ("points", "words"),
    [
        ([(0, 0, 0), (1, 1, 0), (1, 0, 0), (0, 1, 0)], r"1 polygon \(number 0\) crosses itself or has no area"),
        ([(0, 0, 0), (4, 3, 0), (4, 0, 0), (0, 1, 0)], "crosses itself"),
        ([(np.cos(k), np.sin(k), 0) for k in 4 * np.pi / 5 * np.arange(5)], "crosses itself"),
        ([(0, 0, 0), (1, 0, 0), (1, 1, 0.25), (0, 1, 0)], r"is not planar \(off the plane by up to \d+ % of the size\)"),
    ],
)
def test_polygons_without_a_certain_shape_are_fans_and_noted(points, words):
    faces, (note,) = faces_of(points, list(range(len(points))))
    np.testing.assert_array_equal(faces, [[0, k, k + 1] for k in range(1, len(points) - 1)])
    assert re.search(words, note)


def test_polygons_with_bad_corners_stay_fans():
    points = [*ARROW, (np.nan, 0, 0), (1e300, 0, 0)]
    for bad in (-1, 5, 6, 7, 1 << 62):
        faces, notes = faces_of(points, [0, 1, 2, 3, bad])
        assert faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 3, bad]] and notes == ()


def test_a_scene_that_is_known_by_its_fans_stays_so(tmp_path):
    text = "".join("v {} {} {}\n".format(*p) for p in ARROW) + "f 1 2 3 4 5\n"
    assert areas(load(tmp_path, "m.obj", text).triangles).sum() == pytest.approx(10)
    assert areas(load_mesh(tmp_path / "m.obj", fans=True).triangles).sum() == pytest.approx(14)


def test_the_fans_of_a_known_scene_in_an_archive_stay(tmp_path):
    text = "".join("v {} {} {}\n".format(*p) for p in ARROW) + "f 1 2 3 4 5\n"
    with zipfile.ZipFile(tmp_path / "known.zip", "w") as archive:
        archive.writestr("known.obj", text)
    assert areas(load_archive(tmp_path / "known.zip", "known.obj").triangles).sum() == pytest.approx(14)


def test_infinite_numbers_of_microsoft_are_infinite():
    words = [b"1.#INF00", b"-1.#INF", b"1.#QNAN0", b"-1.#IND"]
    found = Text(b"").floats(words, str)
    assert np.isinf(found).tolist() == [True, True, False, False] and np.isnan(found[2:]).all()


def test_the_first_byte_of_a_binary_ply_may_look_like_a_line_end(tmp_path):
    """Lines that end with CR, and a first coordinate whose lowest byte is LF."""
    header = PLY[: PLY.index("0 0 0")].replace("ascii", "binary_little_endian").replace("\n", "\r").encode()
    first = struct.unpack("<f", b"\n\0\0\x40")[0]
    scene = load(
        tmp_path, "m.ply", header + struct.pack("<9f", first, 0, 0, 1, 0, 0, 1, 1, 0) + struct.pack("<B3i", 3, 0, 1, 2)
    )
    assert scene.triangles[0, 0].tolist() == [first, 0, 0]


def test_strips_begin_anew_at_minus_one():
    found = strips(np.array([8, 2, 4]), np.array([0, 1, 2, -1, 2, 0, 1, 3, 4, 5, 9, 8, 7, 6]))
    assert found.tolist() == [[0, 1, 2], [2, 0, 1], [1, 0, 3], [9, 8, 7], [7, 8, 6]]


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({}, "1 with NaN or infinite vertices"),
        ({"rotation": [1e200, 0, 0, 1e200]}, "node 1 has a rotation that is not a quat"),
    ],
)
def test_transformations_beyond_all_numbers_are_refused_without_warnings(tmp_path, more, words):
    """Warnings are errors in tests."""
    nodes = [{"scale": [1e300] * 3, "children": [1]}, {"mesh": 0, "scale": [1e300] * 3, **more}]
    with pytest.raises(SceneError, match=words):
        load(tmp_path, "m.gltf", gltf(nodes=nodes))
