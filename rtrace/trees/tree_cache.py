"""Trees kept in the user's cache: a scene and builder parameters -> the tree, built once.

The name of a file is a hash of everything that determines the tree: the triangles, the kind, the parameters and the builders'
sources. Files are written atomically, so concurrent processes are safe; a damaged file is replaced. The folder must be
writable by this user alone, because kernels trust the numbers of a tree. The trees take ``SHARE`` of what the disk has for
them, free space and their own; beyond it, the oldest files are deleted.
"""

import hashlib
import json
import os
import shutil
import zipfile
from contextlib import suppress
from functools import cache
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from platformdirs import user_cache_path

from nptrace_base import compiling
from nptrace_base.atomic import replacing
from nptrace_base.errors import NptraceError
from nptrace_base.folders import private_folder
from nptrace_base.jit import versions
from nptrace_base.source_files import digest_of
from rtrace.scenes.scene import Scene
from rtrace.trees.bvh import build_bvh
from rtrace.trees.kdtree import build_kdtree
from rtrace.trees.tree import BVH_NODE, KD_NODE, Tree, in_format
from traces.node_formats import NODE_FORMATS

#: The kinds of trees: every node format there is.
TREES = tuple(NODE_FORMATS)
SHARE = 1 / 4


def build_tree(triangles: np.ndarray, kind: str, *, threads: int = 1, **params: Any) -> Tree:
    """Build a tree of a kind of ``TREES``; parameters as ``build_kdtree`` and ``build_bvh``."""
    build = build_kdtree if _tree_of(kind) == "kdtree" else build_bvh
    return in_format(build(triangles, threads=threads, **params), kind)


def _tree_of(kind: str) -> str:
    """Return which tree is built for a kind: formats of one tree share what is built, and the file it is kept in."""
    if kind not in TREES:
        raise NptraceError(f"tree must be one of {', '.join(TREES)}, got {kind!r}")
    return NODE_FORMATS[kind].tree


def cached_tree(scene: Scene, kind: str, folder: Path | None = None, *, threads: int = 1, **params: Any) -> Tree:
    """Return the scene's tree from the cache (``folder``, or the user's); build and store it if it is not there.

    Parameters as ``build_tree``; the tree does not depend on ``threads``. If the cache is not usable, the tree is not stored.
    """
    folder = folder or user_cache_path("nptrace") / "trees"
    key = json.dumps([scene.sha256, _tree_of(kind), sorted(params.items()), _builder_digest(), versions()])
    path = folder / f"{hashlib.sha256(key.encode()).hexdigest()[:32]}.npz"
    try:
        private_folder(folder)
    except OSError as e:
        compiling.not_kept("trees", {folder: e})
        return build_tree(scene.triangles, kind, threads=threads, **params)
    try:
        return _load(path, scene, kind)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        tree = build_tree(scene.triangles, kind, threads=threads, **params)
    try:
        _store(path, tree)
        _forget_oldest(folder)
    except OSError as e:
        compiling.not_kept("trees", {folder: e})
    return tree


@cache
def _builder_digest() -> str:
    """Return a digest of the sources that determine a tree and its file."""
    here = Path(__file__)
    return digest_of([here.with_name("kdtree.py"), here.with_name("bvh.py")]) + hashlib.sha256(here.read_bytes()).hexdigest()


#: Two trees are loaded at a time, and NumPy has Python parse the headers of arrays: in two threads at once, Python 3.11
#: may raise a SystemError (CPython issue 106905).
_reading = Lock()


def _load(path: Path, scene: Scene, kind: str) -> Tree:
    with _reading, open(path, "rb") as file, np.load(file, allow_pickle=False) as arrays:  # the zip checks each array's sum
        params = json.loads(bytes(arrays["params"]))
        nodes = arrays["nodes"].view(KD_NODE if _tree_of(kind) == "kdtree" else BVH_NODE)
        prims, max_level = arrays["prims"], int(arrays["max_level"])
        bounds, core = arrays["extent"]
    with suppress(OSError):
        os.utime(path)  # recently used, so not among the oldest
    corners = np.take(scene.triangles, prims, axis=0)
    return in_format(Tree(kind, nodes, prims, corners, scene.triangles, bounds, core, max_level, params), kind)


def _store(path: Path, tree: Tree) -> None:
    with replacing(path) as temporary, open(temporary, "wb") as file:
        params = np.frombuffer(json.dumps(tree.params).encode(), np.uint8)
        extent, nodes = np.stack((tree.bounds, tree.core)), tree.nodes.view(np.uint32)
        np.savez(file, nodes=nodes, prims=tree.prims, extent=extent, max_level=tree.max_level, params=params)


def _forget_oldest(folder: Path) -> None:
    files = []
    for path in folder.glob("[!.]*.npz"):  # the others are being written
        with suppress(FileNotFoundError):  # another process has just deleted this one
            facts = path.stat()
            files.append((facts.st_mtime, facts.st_size, path))
    files.sort()
    total = sum(size for _, size, _ in files)
    most = SHARE * (shutil.disk_usage(folder).free + total)
    for _, size, path in files[:-1]:
        if total <= most:
            break
        path.unlink(missing_ok=True)
        total -= size
