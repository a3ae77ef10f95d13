"""glTF files in which any value may stand in any place, for ``tests.fuzz``."""

import copy
import json
import tempfile
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from hypothesis import strategies as st

from rtrace.scenes.scene import load_mesh
from tests.reference.gltf_writer import MEANS, write_gltf


@cache
def good_trees() -> list[dict]:
    """Return the JSON of a small file for each means of moving triangles."""
    found: dict[str, dict] = {}
    folder = Path(tempfile.mkdtemp(prefix="nptrace-fuzz-"))
    triangles = np.random.default_rng(0).integers(-9, 9, (3, 3, 3)).astype(float)
    for k in range(1000):
        path, _, (means, how, _) = write_gltf(Random(k), folder, triangles)
        if how == "data":
            found[means] = json.loads(path.read_text(encoding="utf-8-sig"))
    assert len(found) == len(MEANS)
    return list(found.values())


def places(value: Any, path: tuple = ()) -> list[tuple]:
    """Return the paths to all values in a tree."""
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [path, *(found for key, each in inner for found in places(each, (*path, key)))]


KEYS = [
    "weights",
    "skin",
    "sparse",
    "extensions",
    "matrix",
    "rotation",
    "mode",
    "children",
    "normalized",
    "byteStride",
    "byteOffset",
]
junk = st.sampled_from(
    [None, True, -1, 1.5, 1e300, 10**30, 1 << 31, "x", [], {}, [0], [1, 2, 3, 4], {"a": 1}, "VEC3", "data:,"]
)
values = junk | st.integers(-2, 70) | st.sampled_from([5120, 5121, 5123, 5126, float("nan"), "MAT4", [0] * 4, [0.5] * 16])
changes = st.lists(st.tuples(st.integers(0, 1 << 16), st.sampled_from(["set", "drop", *KEYS]), values), max_size=3)
changed_gltf = st.tuples(st.integers(0, len(MEANS) - 1), changes)


def try_changed_gltf(value: tuple[int, list[tuple[int, str, Any]]]) -> None:
    """What is read are triangles of numbers; the rest is refused in a sentence."""
    number, changed = value
    tree = copy.deepcopy(good_trees()[number])
    for at, what, value_there in changed:
        new = copy.deepcopy(value_there)  # a later change may be made inside it
        paths = [path for path in places(tree) if path]
        if not paths:
            break
        *path, last = paths[at % len(paths)]
        place = tree
        for key in path:
            place = place[key]
        if what == "set" or isinstance(place, list):
            place[last] = new
        elif what == "drop":
            del place[last]
        else:
            place[what] = new
    with tempfile.TemporaryDirectory(prefix="nptrace-fuzz-") as folder:
        file = Path(folder) / "changed.gltf"
        file.write_text(json.dumps(tree))
        scene = load_mesh(file)
    assert len(scene.triangles) and np.isfinite(scene.triangles).all()
