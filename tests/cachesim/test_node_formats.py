"""Layouts and replays of trees whose leaves are no nodes in memory, against obvious models."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cachesim.config import CacheConfig
from cachesim.layout import addresses
from cachesim.replay import replay
from cachesim.sampling.estimate import Target, estimate
from cachesim.sweep import sweep
from rtrace.ray_source import RayUnits
from rtrace.render import Shooting, render
from rtrace.scenes.scene import scene_from_triangles
from rtrace.scenes.shapes import soup
from rtrace.trees.tree_cache import build_tree
from tests.reference.cache import Cache, pieces
from tests.reference.traces import make_trace, write
from traces.din import export_din
from traces.reader import open_run

NAMES = ("stored", "bfs", "dfs", "veb", "treelet:64", "treelet:256")
trees = st.builds(
    lambda seed, level: make_trace("bvh64", seed, n_rays=1, max_level=level), st.integers(0, 999), st.integers(0, 8)
)


def placed(tree, layout):
    """Return the inner nodes by their place."""
    columns = {"parent": np.array(tree.parent, np.int32), "level": np.array(tree.level, np.uint16)}
    where = addresses(columns, 64, layout, reads_leaves=False)
    inner = [node for node, child in enumerate(tree.child) if child]
    assert where.dtype == np.int64 and {node for node in range(where.size) if where[node] >= 0} == set(inner)
    assert sorted(where[inner].tolist()) == [64 * slot for slot in range(len(inner))]
    return sorted(inner, key=lambda node: where[node])


def inner_below(tree, node):
    return [each for each in (tree.child[node], tree.child[node] + 1) if tree.child[each]]


def depth_first(tree, node):
    return [node] + [each for child in inner_below(tree, node) for each in depth_first(tree, child)]


def van_emde_boas(tree, top, levels):
    levels = min(levels, height(tree, top))
    if levels == 1:
        return [top]
    fringe = [top]
    for _ in range(levels // 2):
        fringe = [each for node in fringe for each in inner_below(tree, node)]
    rest = [van_emde_boas(tree, node, levels - levels // 2) for node in fringe]
    return sum(rest, van_emde_boas(tree, top, levels // 2))


def height(tree, node):
    return 1 + max((height(tree, each) for each in inner_below(tree, node)), default=0)


@pytest.mark.parametrize("name", NAMES)
@given(tree=trees)
def test_the_inner_nodes_fill_the_slots(name, tree):
    placed(tree, name)


@given(tree=trees)
def test_orders(tree):
    if not tree.child[0]:
        return
    assert placed(tree, "stored") == placed(tree, "dfs") == depth_first(tree, 0)
    assert placed(tree, "veb") == van_emde_boas(tree, 0, height(tree, 0))
    by_level = placed(tree, "bfs")
    assert [tree.level[node] for node in by_level] == sorted(tree.level[node] for node in by_level)
    blocks = placed(tree, "treelet:256")
    for at in range(0, len(blocks), 4):
        block = blocks[at : at + 4]
        assert len(block) == 4 or at + 4 > len(blocks)
        parents_inside = [tree.parent[node] in block[:i] for i, node in enumerate(block)]
        assert parents_inside.count(False) == 1 or len(depth_first(tree, block[0])) < 4


def test_a_treelet_is_whole_nodes():
    tree = make_trace("bvh64", 3)
    with pytest.raises(ValueError, match="a treelet of 96 B is not a whole number of 64-byte nodes; write e.g. treelet:64"):
        placed(tree, "treelet:96")


@pytest.mark.parametrize("layout", ["stored", "veb", "bfs+32"])
def test_a_replay_counts_inner_nodes_only(layout, tmp_path):
    """Of the exported trace, which names addresses, the same is counted; and by the slow cache."""
    trace = make_trace("bvh64", 5, n_rays=300, max_level=9)
    run = write(trace, tmp_path / "x-bvh64")
    where = addresses(run.columns("nodes", ["level", "parent"]), 64, layout, reads_leaves=False)
    configs = [CacheConfig(1024, 2, 64), CacheConfig(512, 1, 32), CacheConfig(1024, 2, 64, "opt")]
    results = replay(run, configs, layout=layout)
    events = [(int(where[node]), 64, 11 if is_request else 0) for node, is_request in trace.accesses]
    for config, result in zip(configs[:2], results[:2], strict=True):
        model = Cache(config).replay(pieces(events, config.line_bytes))
        assert result.accesses.tolist() == model.counts["accesses"] and result.misses.tolist() == model.counts["misses"]
    for config, row in zip(configs[:2], (sweep(run, [config], layout=layout)[0] for config in configs[:2]), strict=True):
        whole = results[configs.index(config)]
        assert (row.demand_accesses, row.demand_misses) == (whole.demand_accesses, whole.demand_misses)
    export_din(run, tmp_path / "x.din", fmt="binary", addresses=where)
    for ours, exported in zip(results, replay(tmp_path / "x.din", configs), strict=True):
        assert (ours.accesses.tolist(), ours.misses.tolist()) == (exported.accesses.tolist(), exported.misses.tolist())


def test_an_estimate_that_counts_all_is_the_replay(tmp_path):
    scene = scene_from_triangles(soup(200, seed=2), "soup")
    tree, shooting = build_tree(scene.triangles, "bvh64"), Shooting(24, 16)
    render(scene, tree, shooting, tmp_path / "soup-bvh64")
    configs = [CacheConfig(1024, 2, 64)]
    [wanted] = replay(tmp_path / "soup-bvh64", configs)
    found = estimate(RayUnits(scene, tree, shooting), configs, Target(0.02, 0.0005))
    assert found.method == "exact"
    assert found.accesses_per_ray.value == wanted.demand_accesses / wanted.n_rays
    assert found.prefetches_per_access.value == wanted.prefetch_accesses / wanted.demand_accesses
    assert found.cells[0].values["demand_miss_rate"].value == wanted.demand_miss_rate


def test_one_leaf_is_no_access(tmp_path):
    scene = scene_from_triangles(np.float32([[[-1, -1, 0], [1, -1, 0], [0, 1, 0]]]), "one")
    tree = build_tree(scene.triangles, "bvh64")
    summary = render(scene, tree, Shooting(4, 4), tmp_path / "one-bvh64")
    assert summary.n_accesses == summary.n_prefetches == 0 < summary.n_hits
    run = open_run(tmp_path / "one-bvh64")
    assert run.n_accesses == summary.n_rays
    for layout in NAMES:
        [result] = replay(run, [CacheConfig(1024, 2, 64)], layout=layout)
        assert result.demand_accesses == result.prefetch_accesses == 0
    assert export_din(run, tmp_path / "one.din") == 0
