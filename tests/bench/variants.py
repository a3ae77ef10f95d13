"""Choices inside the traversal and what they would cost otherwise: the kernels' source with one piece changed, in one process.

Every variant gives the same events as the program, which is checked before it is measured.
"""

import importlib.util
import inspect
import re
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np

from rtrace import traverse
from rtrace.rays import Rays
from rtrace.traverse import Room
from rtrace.traversers import common
from rtrace.trees.tree import Tree
from tests.bench.measure import ratio, times

_SCALAR = """            bx, by, bz = X + POINT_FLOATS * (backwards & ONE), Y + POINT_FLOATS * (backwards >> Y & ONE), (
                Z + POINT_FLOATS * (backwards >> Z & ONE)
            )
            t0, t1 = near_t, best
            t = (nodes[b + bx] - ax) * ix
            t0 = t if t > t0 else t0
            t = (nodes[b + by] - ay) * iy
            t0 = t if t > t0 else t0
            t = (nodes[b + bz] - az) * iz
            t0 = t if t > t0 else t0
            t = (nodes[b + POINT_FLOATS + (X + X) - bx] - zx) * ix
            t1 = t if t < t1 else t1
            t = (nodes[b + POINT_FLOATS + (Y + Y) - by] - zy) * iy
            t1 = t if t < t1 else t1
            t = (nodes[b + POINT_FLOATS + (Z + Z) - bz] - zz) * iz
            t1 = t if t < t1 else t1
            if t0 <= t1:
"""
_FACES = """        ox, oy, oz = origin
        ix, iy, iz = inverses
        ax, ay, az = ox + np.copysign(px, ix), oy + np.copysign(py, iy), oz + np.copysign(pz, iz)
        zx, zy, zz = ox - np.copysign(px, ix), oy - np.copysign(py, iy), oz - np.copysign(pz, iz)
"""
_CHOSEN = """                    inverse_ = ix if axis == X else (iy if axis == Y else iz)
                    from_near = ax if axis == X else (ay if axis == Y else az)
                    from_far = zx if axis == X else (zy if axis == Y else zz)
                    low = (nodes[b + SPLIT] - from_near) * inverse_
                    high = (nodes[b + SPLIT] - from_far) * inverse_
"""


class Variant(NamedTuple):
    """``changes`` are (first words, last words, replacement): the piece from the first to the end of the last is replaced."""

    tree: str
    changes: list[tuple[str, str, str]]
    prepare: Callable[[Tree], Tree] = lambda tree: tree


def _aligned(tree: Tree) -> Tree:
    """Return the tree with sibling pairs in one 64-byte line of the processor's caches each."""
    size = tree.nodes.dtype.itemsize
    raw = np.empty(tree.nodes.nbytes + 128, np.uint8)
    start = (64 - size - raw.ctypes.data) % 64
    nodes = raw[start : start + tree.nodes.nbytes].view(tree.nodes.dtype)
    nodes[:] = tree.nodes
    return tree._replace(nodes=nodes)


_BY_NUMBER = [("triangle_t(corners, i * CORNER", "FLOATS,", "triangle_t(corners, np.uint64(c) * CORNER_FLOATS,")]

VARIANTS = {
    "BVH: box tests one plane after the other": Variant(
        "bvh",
        [
            ("            if meets_box(nodes, b", "near_t, best):\n", _SCALAR),
            ("        # The origin as seen from a box's", "scale = pack(inverses[0], inverses[1], inverses[2])\n", _FACES),
        ],
    ),
    "kd-tree: choosing among three variables at a node": Variant(
        "kdtree",
        [
            ("                    low = (nodes[b + SPLIT]", "seen[FROM_FAR + axis]) * seen[INVERSE + axis]\n", _CHOSEN),
            ("        # The origin as seen from a plane's", "ix, iy, iz = inverses\n", _FACES),
        ],
    ),
    "BVH: triangles by their number, not in leaf order": Variant(
        "bvh", _BY_NUMBER, lambda tree: tree._replace(corners=tree.triangles)
    ),
    "kd-tree: triangles by their number, not in leaf order": Variant(
        "kdtree", _BY_NUMBER, lambda tree: tree._replace(corners=tree.triangles)
    ),
    "BVH: pairs of nodes in one line of the processor's cache": Variant("bvh", [], _aligned),
    "kd-tree: pairs of nodes in one line of the processor's cache": Variant("kdtree", [], _aligned),
}  # fmt: skip


def kernel_of(name: str, variant: Variant, folder: Path) -> Any:
    """Return the kernel of a tree's traverser with the variant's changes, in one module with what traversers share."""
    ours = traverse.KERNELS[variant.tree]
    own = Path(inspect.getfile(inspect.unwrap(ours.py_func))).read_text(encoding="utf-8")
    shared = Path(common.__file__).read_text(encoding="utf-8")
    source = shared + re.sub(r"from rtrace\.traversers\.common import (\([^)]*\)|.*)", "", own)
    for first, last, new in variant.changes:
        start = source.index(first)
        source = source[:start] + new + source[source.index(last, start) + len(last) :]
    path = folder / f"variant_{list(VARIANTS).index(name)}.py"
    path.write_text(source, encoding="utf-8")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return getattr(module, ours.__name__)


def bench_variants(tree: Tree, pieces: list[Rays], repeat: int) -> dict[str, float]:
    """Return for each variant of a tree's traversal its time, traced, closest hit, over ours."""
    room = Room()

    def traced(trace_rays: Any, tree: Tree) -> Callable[[], None]:
        def call() -> None:
            with patch.dict(traverse.KERNELS, {tree.kind: trace_rays}):
                for piece in pieces:
                    traverse.trace_recorded(tree, piece, room=room)

        return call

    def fresh() -> None:
        for piece in pieces:
            traverse.trace_recorded(tree, piece)

    kind = {"bvh": "BVH", "kdtree": "kd-tree"}[tree.kind]
    functions = {f"{kind}: fresh memory for the events of every batch": fresh}
    want = traverse.trace_recorded(tree, pieces[0])[2]
    with tempfile.TemporaryDirectory() as folder:
        for name, variant in VARIANTS.items():
            if variant.tree == tree.kind:
                trace_rays, other = kernel_of(name, variant, Path(folder)), variant.prepare(tree)
                with patch.dict(traverse.KERNELS, {tree.kind: trace_rays}):
                    np.testing.assert_array_equal(traverse.trace_recorded(other, pieces[0])[2], want, name)
                functions[name] = traced(trace_rays, other)
        taken = times({"ours": traced(traverse.KERNELS[tree.kind], tree), **functions}, repeat)
    return {f"{name}: time": ratio(taken[name], taken["ours"]) for name in functions}
