"""Mesh files as they are: every kind, polygons, bad triangles, and one sentence for each unreadable file."""

import json
import os
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtrace.camera import Camera, fit_light
from rtrace.scenes.mesh_file import READERS
from rtrace.scenes.scene import SceneError, dropped_sentence, load_mesh, scene_from_triangles, seen_from
from rtrace.scenes.shapes import icosphere

SQUARE = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
V = "".join("v {} {} {}\n".format(*p) for p in SQUARE)
BALL = icosphere(1)


def corners(*faces):
    return np.float32([[SQUARE[i] for i in face] for face in faces])


def load(tmp_path, name, data, **options):
    path = tmp_path / name
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return load_mesh(path, **options)


def ply(faces, form="ascii", vertices=SQUARE):
    header = f"ply\nformat {form} 1.0\ncomment made for a test\nelement vertex {len(vertices)}\n"
    header += "property float x\nproperty float y\nproperty float z\nproperty uchar red\n"
    header += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    if form == "ascii":
        body = "".join("{} {} {} 9\n".format(*p) for p in vertices)
        return header + body + "".join(f"{len(f)} {' '.join(map(str, f))}\n" for f in faces)
    order = "<" if "little" in form else ">"
    body = b"".join(struct.pack(order + "3fB", *p, 9) for p in vertices)
    return header.encode() + body + b"".join(struct.pack(f"{order}B{len(f)}i", len(f), *f) for f in faces)


def off(faces):
    lines = ["OFF", f"4 {len(faces)} 0", *("{} {} {}".format(*p) for p in SQUARE)]
    return "\n".join(lines + [f"{len(f)} {' '.join(map(str, f))}" for f in faces]) + "\n"


def obj(faces):
    return V + "".join(f"f {' '.join(str(i + 1) for i in f)}\n" for f in faces)


def stl(triangles):
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *t.reshape(-1), 0) for t in triangles)
    return b"\0" * 80 + struct.pack("<I", len(triangles)) + body


def glb(triangles, nodes):
    """A GLB file with one mesh of separate triangles, placed by ``nodes``."""
    data = np.ascontiguousarray(triangles, "<f4").tobytes()
    n = len(triangles) * 3
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": list(range(len(nodes)))}],
        "nodes": nodes,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": n, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": len(data)}],
        "buffers": [{"byteLength": len(data)}],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


WRITERS = {
    "m.obj": obj,
    "m.off": off,
    "a.ply": ply,
    "l.ply": lambda faces: ply(faces, "binary_little_endian"),
    "b.ply": lambda faces: ply(faces, "binary_big_endian"),
}


@pytest.mark.parametrize("name", WRITERS)
def test_polygons_become_fans_in_the_order_of_the_file(tmp_path, name):
    scene = load(tmp_path, name, WRITERS[name]([(0, 1, 2), (0, 1, 2, 3), (1, 2, 3), (3, 2, 1, 0)]))
    want = corners((0, 1, 2), (0, 1, 2), (0, 2, 3), (1, 2, 3), (3, 2, 1), (3, 1, 0))
    np.testing.assert_array_equal(scene.triangles, want)
    assert scene.triangles.dtype == np.float32
    assert scene.triangles.flags.c_contiguous
    assert scene.name == name[0]
    assert scene.dropped == ()


@pytest.mark.parametrize("name", WRITERS)
def test_bad_numbers_are_dropped_named_or_refused(tmp_path, name):
    bad = 99 if name != "m.obj" else 98
    data = WRITERS[name]([(0, 1, 2), (0, 1, bad), (1, 2, 3), (bad, 1, 2)])
    scene = load(tmp_path, name, data)
    np.testing.assert_array_equal(scene.triangles, corners((0, 1, 2), (1, 2, 3)))
    assert [(d.n, d.first) for d in scene.dropped] == [(2, (1, 3))]
    assert "2" in dropped_sentence(scene)
    assert "1, 3" in dropped_sentence(scene)
    with pytest.raises(SceneError, match="--strict"):
        load(tmp_path, name, data, strict=True)
    with pytest.raises(SceneError, match="nothing is left"):
        load(tmp_path, name, WRITERS[name]([(0, 1, bad)]))


def test_obj_numbers_may_count_backwards_from_their_line(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nf -3 -2 -1\nv 5 5 5\nv 6 5 5\nv 6 6 5\nf -3 -2 -1\nf 0 1 2\n"
    scene = load(tmp_path, "m.obj", text)
    want = np.float32([[(0, 0, 0), (1, 0, 0), (1, 1, 0)], [(5, 5, 5), (6, 5, 5), (6, 6, 5)]])
    np.testing.assert_array_equal(scene.triangles, want)
    assert scene.dropped[0].first == (2,)  # number 0 is no vertex


def test_materials_normals_and_textures_change_nothing(tmp_path):
    plain = load(tmp_path, "a.obj", obj([(0, 1, 2), (0, 2, 3), (1, 2, 3)]))
    rich = "mtllib nowhere.mtl\n" + V + "vt 0 0\nvn 0 0 1\no one\nusemtl a\nf 1/1/1 2/1/1 3/1/1\ng b\nusemtl b\ns 1\n"
    rich += "f 1//1 3//1 4//1 # a comment\nusemtl a\nf 2/1 \\\n3/1 4/1\n"
    scene = load(tmp_path, "b.obj", rich)
    np.testing.assert_array_equal(scene.triangles, plain.triangles)
    assert scene.sha256 == plain.sha256


def test_stl_and_glb(tmp_path):
    np.testing.assert_array_equal(load(tmp_path, "m.stl", stl(BALL)).triangles, BALL)
    nodes = [{"mesh": 0}, {"mesh": 0, "translation": [10, 0, 0], "scale": [2, 2, 2]}]
    scene = load(tmp_path, "m.glb", glb(BALL, nodes))
    np.testing.assert_allclose(scene.triangles, np.concatenate([BALL, BALL * 2 + [10, 0, 0]]), rtol=1e-6)


def test_vertices_that_are_no_numbers_are_dropped_and_unused_ones_never_matter(tmp_path):
    vertices = [*SQUARE, (np.nan, 0, 0), (np.inf, 0, 0), (1e30, 1e30, 1e30)]
    scene = load(tmp_path, "m.ply", ply([(0, 1, 2), (0, 1, 4), (1, 2, 5), (1, 2, 3)], vertices=vertices))
    np.testing.assert_array_equal(scene.triangles, corners((0, 1, 2), (1, 2, 3)))
    np.testing.assert_array_equal(scene.bounds, [(0, 0, 0), (1, 1, 0)])
    scene = load(tmp_path, "m.obj", "v 1e300 0 0\n" + obj([(0, 1, 2), (1, 2, 3)]))  # beyond float32
    assert scene.dropped[0].first == (0,)


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("m.obj", b"", "empty"),
        ("m.ply", b"  \n", "empty"),
        ("m.xyz", b"1 2 3", "unknown kind"),
        ("m", b"1 2 3", "unknown kind"),
        ("m.obj", b"\x89PNG\r\n\x1a\n" + bytes(range(256)), "m.obj"),
        ("m.ply", b"\x89PNG\r\n\x1a\n" + bytes(range(256)), "m.ply"),
        ("m.off", b"\x89PNG\r\n\x1a\n" + bytes(range(256)), "m.off"),
        ("m.stl", b"\x89PNG\r\n\x1a\n" + bytes(range(256)), "m.stl"),
        ("m.glb", b"\x89PNG\r\n\x1a\n" + bytes(range(256)), "m.glb"),
        ("m.obj", V.encode(), "no triangle"),
        ("m.ply", ply([]).encode(), "no triangle"),
        ("m.obj", b"v 0 0\nf 1 1 1\n", "fewer than three"),
        ("m.obj", b"v 0 0 zero\nf 1 1 1\n", "zero"),
        ("m.off", off([(0, 1, 2)])[:-8].encode(), "m.off"),
        ("m.ply", ply([(0, 1, 2)])[:-4].encode(), "ends before"),
    ],
)
def test_what_is_no_mesh_gets_one_sentence(tmp_path, name, data, words):
    with pytest.raises(SceneError, match=words) as error:
        load(tmp_path, name, data)
    assert name in str(error.value)
    assert "\n" not in str(error.value)


def test_missing_files_and_folders_are_named(tmp_path):
    with pytest.raises(SceneError, match="no such file"):
        load_mesh(tmp_path / "nowhere.obj")
    (tmp_path / "folder.obj").mkdir()
    with pytest.raises(SceneError, match=r"folder.obj: cannot be read"):
        load_mesh(tmp_path / "folder.obj")
    if os.geteuid():
        (tmp_path / "locked.obj").write_text(obj([(0, 1, 2)]))
        (tmp_path / "locked.obj").chmod(0)
        with pytest.raises(SceneError, match="Permission denied"):
            load_mesh(tmp_path / "locked.obj")


@given(data=st.binary(max_size=300), name=st.sampled_from(sorted(READERS)), start=st.integers(0, 5))
@settings(max_examples=1000)
def test_no_bytes_break_the_loader(tmp_path_factory, data, name, start):
    """Random bytes, alone or spliced into a good file, load as finite triangles or are refused in one sentence."""
    good = [
        b"",
        obj([(0, 1, 2)]).encode(),
        ply([(0, 1, 2)]).encode(),
        off([(0, 1, 2)]).encode(),
        stl(BALL[:2]),
        glb(BALL[:2], [{"mesh": 0}]),
    ]
    base = good[start]
    cut = len(data) % (len(base) + 1)
    path = tmp_path_factory.getbasetemp() / f"fuzz{name}"
    path.write_bytes(base[:cut] + data + base[cut + len(data) % 7 :])
    try:
        scene = load_mesh(path)
    except SceneError:
        return
    assert np.isfinite(scene.triangles).all()
    assert len(scene.triangles)


def test_a_scene_may_be_seen_otherwise():
    scene = scene_from_triangles(BALL, "ball")
    camera = Camera((0, 0, 9), (0, 0, 0))
    seen = seen_from(scene, camera, None)
    assert seen.camera == camera
    assert seen.light == fit_light(camera, scene.bounds)  # a fitted light goes with the camera
    assert seen_from(scene, camera, (1, 2, 3)).light == (1, 2, 3)
    lit = scene._replace(light=(4.0, 5.0, 6.0))
    assert seen_from(lit, camera, None).light == (4.0, 5.0, 6.0)  # a scene's own stays
    assert seen_from(lit, None, None) == lit


def test_the_largest_coordinates_are_far_away():
    triangles = np.full((1, 3, 3), np.finfo(np.float32).max, np.float32)
    triangles[0, 1:, 0] -= np.float32(2e31)
    far, short = scene_from_triangles(triangles, "edge").notes
    assert "where float32 has steps of 2.02824e+31" in far
    assert "(the shortest: 1)" in short


@pytest.mark.parametrize("triangles", [np.zeros((3, 3)), np.zeros((0, 3, 3)), np.full((2, 3, 3), np.nan)])
def test_triangles_that_make_no_scene_are_refused(triangles):
    with pytest.raises(SceneError, match="triangle"):
        scene_from_triangles(triangles, "none")
