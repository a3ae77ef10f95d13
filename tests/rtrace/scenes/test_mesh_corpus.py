"""Generated mesh files over all formats and their options: triangles, areas and volumes as written."""

import struct
from pathlib import Path
from random import Random

import numpy as np
import pytest

from rtrace.scenes.scene import Scene, load_mesh
from tests.reference.gltf_writer import MEANS, write_gltf
from tests.reference.mesh_shapes import prism, shape
from tests.reference.mesh_writers import write_obj, write_off, write_ply, write_stl

WRITERS = {"obj": write_obj, "off": write_off, "ply": write_ply, "stl": write_stl}
N = 80  # files of each format


def areas(triangles: np.ndarray) -> np.ndarray:
    a, b, c = np.asarray(triangles, np.float64).transpose(1, 0, 2)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def volume(triangles: np.ndarray) -> float:
    return float(np.linalg.det(np.asarray(triangles, np.float64)).sum() / 6)


def load(path: Path, data: bytes) -> Scene:
    path.write_bytes(data)
    return load_mesh(path)


@pytest.mark.parametrize("kind", WRITERS)
def test_what_a_file_has_is_what_was_written(tmp_path, kind, record_property):
    seen = set()
    n_concave = 0
    for seed in range(N):
        rng = Random(f"{kind} {seed}")
        made = shape(rng)
        file = WRITERS[kind](rng, made)
        seen |= set(file.options)
        scene = load(tmp_path / f"m{file.suffix}", file.data)
        what = f"seed {seed}: {made.name}, {file.options}"
        assert scene.dropped == (), what
        assert not any("planar" in note or "crosses" in note or "polygon" in note for note in scene.notes), what
        if made.is_convex:
            np.testing.assert_array_equal(scene.triangles, made.fans(), what)
        assert areas(scene.triangles).sum() == pytest.approx(made.area, rel=1e-9), what
        if made.volume is not None:
            assert volume(scene.triangles) == pytest.approx(made.volume, rel=1e-9), what
        n_concave += not made.is_convex
    record_property("cases", N)
    assert len(seen) > 15
    assert n_concave > N // 4


def test_what_a_gltf_scene_has_is_what_was_written(tmp_path, record_property):
    seen = set()
    for seed in range(N):
        rng = Random(f"gltf {seed}")
        made = shape(rng)
        path, want, options = write_gltf(rng, tmp_path, made.fans() if made.is_convex else prism_triangles(rng))
        seen |= set(options)
        scene = load_mesh(path)
        size = np.abs(want).max()
        np.testing.assert_allclose(scene.triangles, want, rtol=0, atol=1e-6 * size, err_msg=f"seed {seed}: {options}")
        np.testing.assert_allclose(areas(scene.triangles), areas(want), rtol=0, atol=1e-5 * size**2)
    record_property("cases", N)
    assert seen >= {*MEANS, "data", "percent data", "beside", "encoded", "glb", "B", "H", "I", "none"}


def prism_triangles(rng: Random) -> np.ndarray:
    made = prism(rng)
    return made.fans()[:8]


def test_trimesh_reads_the_same_where_it_is_right(tmp_path, record_property):
    """Triangles in a plain form of each format, all of which trimesh reads in the order of the file."""
    trimesh = pytest.importorskip("trimesh")
    for seed in range(40):
        rng = Random(f"plain {seed}")
        triangles = np.array([[[rng.randint(-640, 640) / 64 for _ in "xyz"] for _ in "abc"] for _ in range(rng.randint(1, 9))])
        for name, data in plain_files(triangles).items():
            scene = load(tmp_path / name, data)
            theirs = trimesh.load(tmp_path / name, process=False, force="mesh")
            np.testing.assert_array_equal(scene.triangles, np.asarray(theirs.triangles, np.float32), name)
            np.testing.assert_array_equal(scene.triangles, triangles.astype(np.float32), name)
    record_property("cases", 40 * len(plain_files(triangles)))


def plain_files(triangles: np.ndarray) -> dict[str, bytes]:
    n = len(triangles)
    rows = [" ".join(map(repr, p)) for p in triangles.reshape(-1, 3).tolist()]
    faces = [f"{3 * k} {3 * k + 1} {3 * k + 2}" for k in range(n)]
    obj = [f"v {row}" for row in rows] + [f"f {3 * k + 1} {3 * k + 2} {3 * k + 3}" for k in range(n)]
    off = ["OFF", f"{3 * n} {n} 0", *rows, *(f"3 {face}" for face in faces)]
    ply = ["ply", "format ascii 1.0", f"element vertex {3 * n}", *(f"property double {axis}" for axis in "xyz")]
    ply += [f"element face {n}", "property list uchar int vertex_indices", "end_header", *off[2:]]
    stl = ["solid s"]
    for k in range(n):
        stl += [
            "facet normal 0 0 1",
            "outer loop",
            *(f"vertex {row}" for row in rows[3 * k : 3 * k + 3]),
            "endloop",
            "endfacet",
        ]
    binary = b"".join(struct.pack("<12fH", 0, 0, 1, *t.ravel(), 0) for t in triangles)
    texts = {"m.obj": obj, "m.off": off, "m.ply": ply, "t.stl": [*stl, "endsolid s"]}
    files = {name: ("\n".join(lines) + "\n").encode() for name, lines in texts.items()}
    return files | {"b.stl": b"\0" * 80 + struct.pack("<I", n) + binary}
