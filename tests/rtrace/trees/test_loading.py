"""Trees that are kept are loaded by several threads at a time."""

from concurrent.futures import ThreadPoolExecutor
from threading import Lock
from time import sleep

from rtrace.scenes.scene import scene_from_triangles
from rtrace.scenes.shapes import soup
from rtrace.trees import tree_cache


def test_headers_of_arrays_are_parsed_by_one_thread_at_a_time(tmp_path, monkeypatch):
    """Two threads of Python 3.11 at once may end in a SystemError."""
    scene = scene_from_triangles(soup(50, seed=1), "soup")
    for kind in ("bvh", "kdtree"):
        tree_cache.cached_tree(scene, kind, tmp_path / "trees")
    load, at_a_time, lock, most = tree_cache.np.load, [0], Lock(), [0]

    class Watched:
        def __init__(self, file, **options):
            self.arrays = load(file, **options)

        def __enter__(self):
            with lock:
                at_a_time[0] += 1
                most[0] = max(most[0], at_a_time[0])
            sleep(0.01)  # time enough for another thread to come, if none is kept waiting
            return self.arrays.__enter__()

        def __exit__(self, *error):
            with lock:
                at_a_time[0] -= 1
            return self.arrays.__exit__(*error)

    monkeypatch.setattr(tree_cache.np, "load", Watched)
    monkeypatch.setattr(tree_cache, "build_tree", None)
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda i: tree_cache.cached_tree(scene, ("bvh", "kdtree")[i % 2], tmp_path / "trees"), range(16)))
    assert most == [1]
