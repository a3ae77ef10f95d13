"""The cache of trees: the same tree as a build gives, whatever happened to the file."""

import os
import threading
from types import SimpleNamespace

import numpy as np
import pytest

import rtrace.trees.tree_cache as treecache
from rtrace.scenes.scene import scene_from_triangles
from rtrace.scenes.shapes import soup
from rtrace.trees.tree_cache import build_tree, cached_tree


@pytest.fixture
def scene():
    far = np.float32([[[1e13, 0, 0], [1e13, 1, 0], [1e13, 0, 1]]])  # a stray, so that the core is not the box of all
    return scene_from_triangles(np.concatenate([soup(500, seed=1), far]), "soup")


def same(a, b):
    arrays = all(
        np.array_equal(getattr(a, name).view(np.uint8), getattr(b, name).view(np.uint8)) for name in ("nodes", "prims")
    )
    extents = [(tree.bounds, tree.core) for tree in (a, b)]
    return (
        arrays
        and (a.kind, a.max_level, a.params) == (b.kind, b.max_level, b.params)
        and np.array_equal(extents[0], extents[1])
    )


@pytest.mark.parametrize("kind", treecache.TREES)
def test_a_tree_is_built_once_and_comes_back_the_same(tmp_path, scene, kind, monkeypatch):
    want = build_tree(scene.triangles, kind)
    assert same(cached_tree(scene, kind, tmp_path), want)
    assert len(list(tmp_path.iterdir())) == 1
    monkeypatch.setattr(treecache, "build_tree", None)
    got = cached_tree(scene, kind, tmp_path)
    assert same(got, want)
    assert got.nodes.dtype == want.nodes.dtype and got.nodes.flags.c_contiguous


def test_other_triangles_parameters_and_kernels_are_other_trees(tmp_path, scene, monkeypatch):
    cached_tree(scene, "kdtree", tmp_path)
    assert cached_tree(scene, "kdtree", tmp_path, max_level=3).max_level == 3
    cached_tree(scene_from_triangles(soup(500, seed=2), "soup"), "kdtree", tmp_path)
    monkeypatch.setattr(treecache, "_builder_digest", lambda: "others")
    cached_tree(scene, "kdtree", tmp_path)
    assert len(list(tmp_path.iterdir())) == 4


def test_a_damaged_file_is_built_again(tmp_path, scene):
    want = cached_tree(scene, "bvh", tmp_path)
    (file,) = tmp_path.iterdir()
    whole = file.read_bytes()
    for at in range(0, len(whole), 997):
        broken = bytearray(whole)
        broken[at] ^= 0x10
        file.write_bytes(broken)
        assert same(cached_tree(scene, "bvh", tmp_path), want)
        file.write_bytes(whole[:at])
        assert same(cached_tree(scene, "bvh", tmp_path), want)
    assert file.read_bytes() == whole


def test_threads_at_once_and_folders_that_cannot_be_written_do_no_harm(tmp_path, scene):
    trees = []
    threads = [threading.Thread(target=lambda: trees.append(cached_tree(scene, "bvh", tmp_path / "c"))) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(trees) == 8 and all(same(tree, trees[0]) for tree in trees)
    assert len(os.listdir(tmp_path / "c")) == 1
    (tmp_path / "file").write_text("")
    assert same(cached_tree(scene, "bvh", tmp_path / "file"), trees[0])


def test_the_oldest_trees_go_when_the_folder_is_full(tmp_path, scene, monkeypatch):
    for level in (1, 2, 3):
        cached_tree(scene, "kdtree", tmp_path, max_level=level)
    sizes = [p.stat().st_size for p in tmp_path.iterdir()]
    monkeypatch.setattr(treecache.shutil, "disk_usage", lambda folder: SimpleNamespace(free=4 * max(sizes)))
    cached_tree(scene, "kdtree", tmp_path, max_level=4)
    assert 1 <= len(list(tmp_path.iterdir())) <= 2


def test_a_file_is_replaced_and_never_written_in_place(tmp_path, scene):
    """Another process may be reading it: what it has open stays as it is."""
    cached_tree(scene, "bvh", tmp_path)
    (file,) = tmp_path.iterdir()
    file.write_bytes(file.read_bytes()[:-50])
    damaged = file.read_bytes()
    with open(file, "rb") as reader:
        cached_tree(scene, "bvh", tmp_path)
        assert file.read_bytes() != damaged
        assert reader.read() == damaged
    assert list(tmp_path.iterdir()) == [file]


def test_what_others_write_or_delete_keeps_no_tree_from_being_kept(tmp_path, monkeypatch):
    being_written, gone = tmp_path / ".a.1-ab.tmp.npz", tmp_path / "gone.npz"
    for path in (being_written, tmp_path / "a.npz", tmp_path / "b.npz"):
        path.write_bytes(b"tree")
    os.utime(being_written, (1000, 1000))
    os.utime(tmp_path / "a.npz", (2000, 2000))
    found = type(tmp_path).glob
    monkeypatch.setattr(type(tmp_path), "glob", lambda path, pattern: [*found(path, pattern), gone])
    monkeypatch.setattr(treecache, "SHARE", 0)
    treecache._forget_oldest(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == [being_written.name, "b.npz"]
