"""``python -m tests.bench.mesh_readers``: how many files of the mesh corpus each installed reader reads right.

The corpus is that of tests/rtrace/scenes/test_mesh_corpus.py. A file is read right if it has as many triangles as were
written, with the same area and the same enclosed volume. Polygons of a reader that returns polygons are compared as fans.
Written to docs/data/mesh_readers.csv.
"""

import contextlib
import csv
import importlib
import importlib.metadata
import io
import logging
import sys
import tempfile
import warnings
from collections.abc import Callable
from math import isclose
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import numpy as np

from nptrace import __version__
from nptrace_base.tables import Table, print_tables
from rtrace.scenes.scene import load_mesh
from tests.reference.gltf_writer import write_gltf
from tests.reference.mesh_shapes import shape
from tests.rtrace.scenes.test_mesh_corpus import WRITERS, N, areas, prism_triangles, volume

OUT = Path(__file__).resolve().parents[2] / "docs" / "data" / "mesh_readers.csv"
FORMATS = (*WRITERS, "gltf")


class Reader(NamedTuple):
    """A reader from PyPI: ``read`` takes its module and a path and returns triangles, with ``polygons`` fans of polygons."""

    package: str
    module: str
    formats: tuple[str, ...]
    read: Callable[[Any, Path], np.ndarray]
    polygons: bool = False


def with_trimesh(trimesh: Any, path: Path) -> np.ndarray:
    return np.asarray(trimesh.load(path, process=False, force="mesh").triangles)


def with_meshio(meshio: Any, path: Path) -> np.ndarray:
    mesh = meshio.read(path)
    polygons = [polygon for block in mesh.cells for polygon in block.data.tolist()]
    return fans(mesh.points, polygons)


def with_plyfile(plyfile: Any, path: Path) -> np.ndarray:
    ply = plyfile.PlyData.read(str(path))
    points = np.stack([np.asarray(ply["vertex"][axis], np.float64) for axis in "xyz"], axis=1)
    (property_,) = (p.name for p in ply["face"].properties if p.name in ("vertex_indices", "vertex_index"))
    return fans(points, [list(polygon) for polygon in ply["face"][property_]])


def with_numpy_stl(stl: Any, path: Path) -> np.ndarray:
    return np.concatenate([part.vectors for part in stl.mesh.Mesh.from_multi_file(str(path))])


READERS = (
    Reader("trimesh", "trimesh", FORMATS, with_trimesh),
    Reader("meshio", "meshio", ("obj", "off", "ply", "stl"), with_meshio, polygons=True),
    Reader("plyfile", "plyfile", ("ply",), with_plyfile, polygons=True),
    Reader("numpy-stl", "stl", ("stl",), with_numpy_stl),
)
OURS = Reader("nptrace", "nptrace", FORMATS, lambda module, path: load_mesh(path).triangles)


def fans(points: np.ndarray, polygons: list[list[int]]) -> np.ndarray:
    return np.array([[points[p[0]], points[p[k]], points[p[k + 1]]] for p in polygons for k in range(1, len(p) - 1)])


def n_right(reader: Reader, module: Any, kind: str, folder: Path) -> int:
    """Return how many of the ``N`` files of a format a reader reads right."""
    return sum(is_right(reader, module, kind, seed, folder) for seed in range(N))


def is_right(reader: Reader, module: Any, kind: str, seed: int, folder: Path) -> bool:
    rng = Random(f"{kind} {seed}")
    made = shape(rng)
    if kind == "gltf":
        path, wanted, _ = write_gltf(rng, folder, made.fans() if made.is_convex else prism_triangles(rng))
    else:
        file = WRITERS[kind](rng, made)
        path, wanted = folder / f"m{file.suffix}", made.fans()
        path.write_bytes(file.data)
    area, enclosed = float(areas(wanted).sum()), volume(wanted)
    if kind != "gltf" and not reader.polygons:  # a fan may cover a notch of a polygon
        area = made.area
    try:
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            warnings.simplefilter("ignore")
            found = np.asarray(reader.read(module, path), np.float64)
    except Exception:  # whatever a reader raises: it does not read the file
        return False
    largest = float(np.abs(wanted).max())
    near = {"rel_tol": 1e-5, "abs_tol": 1e-5 * largest**2}
    return len(found) == len(wanted) and isclose(areas(found).sum(), area, **near) and _encloses(found, enclosed, largest)


def _encloses(triangles: np.ndarray, enclosed: float, largest: float) -> bool:
    return isclose(volume(triangles), enclosed, rel_tol=1e-5, abs_tol=1e-5 * largest**3)


def measure() -> list[dict[str, Any]]:
    """Return a row per reader and format that it promises to read; readers that are not installed are named on stderr."""
    logging.disable(logging.CRITICAL)
    rows = []
    for reader in (OURS, *READERS):
        try:
            module = importlib.import_module(reader.module)
        except ImportError:
            print(f"{reader.package} is not installed and left out", file=sys.stderr)
            continue
        version = __version__ if reader is OURS else importlib.metadata.version(reader.package)
        for kind in reader.formats:
            with tempfile.TemporaryDirectory() as folder:
                right = n_right(reader, module, kind, Path(folder))
            rows.append({"reader": reader.package, "version": version, "format": kind, "right": right, "files": N})
    return rows


def main() -> None:
    rows = measure()
    with open(OUT, "w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    cells = [[str(value) for value in row.values()] for row in rows]
    print_tables([Table("", ["reader", "version", "format", "read right", "of"], cells, n_left=3)], [], sys.stdout)


if __name__ == "__main__":
    main()
