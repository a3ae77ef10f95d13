"""Layouts: permutations of the nodes, with the order each one promises."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cachesim.config import CacheConfig
from cachesim.layout import LAYOUTS, Layout, addresses, parse_layout
from cachesim.replay import replay
from tests.reference.cache import Cache
from tests.reference.traces import make_trace, write

NAMES = ("stored", "bfs", "dfs", "veb", "treelet:64", "treelet:256")


def columns(trace):
    return {"parent": np.array(trace.parent, np.int32), "level": np.array(trace.level, np.uint16)}


def slots(trace, layout, node_bytes=8):
    placed = addresses(columns(trace), node_bytes, layout)
    assert placed.dtype == np.int64
    assert (placed % node_bytes == 0).all()
    return placed // node_bytes


trees = st.builds(
    lambda seed, level: make_trace("kdtree", seed, n_rays=1, max_level=level), st.integers(0, 999), st.integers(0, 8)
)


@pytest.mark.parametrize("name", NAMES)
@given(tree=trees)
def test_every_layout_is_a_permutation(name, tree):
    """Of the slots 0 ... n - 1; the treelets leave slot 1 free, beside the root."""
    n = len(tree.parent)
    taken = sorted(slots(tree, name).tolist())
    assert taken == (list(range(n)) if "treelet" not in name else [0, *range(2, n + 1)])


@pytest.mark.parametrize("name", [name for name in NAMES if name != "dfs"])
@given(tree=trees)
def test_sibling_pairs_stay_together(name, tree):
    placed = slots(tree, name)
    assert (placed[2::2] == placed[1::2] + 1).all()
    if "treelet" in name:
        assert (placed[1::2] % 2 == 0).all()


@given(tree=trees)
def test_orders(tree):
    assert (slots(tree, "stored") == np.arange(len(tree.parent))).all()
    level = np.array(tree.level)
    assert (np.diff(level[np.argsort(slots(tree, "bfs"))]) >= 0).all()
    dfs = slots(tree, "dfs")
    for node, child in enumerate(tree.child):
        if child:
            assert dfs[child] == dfs[node] + 1
            assert dfs[child + 1] == dfs[child] + len(subtree(tree, child))


def subtree(tree, node):
    found = [node]
    for each in found:
        if tree.child[each]:
            found += [tree.child[each], tree.child[each] + 1]
    return found


def veb(tree, top, levels):
    """Return the pairs of a subtree's first ``levels`` levels in van Emde Boas order, by recursion; a pair is a tuple."""

    def below(pair):
        return [(tree.child[node], tree.child[node] + 1) for node in pair if tree.child[node]]

    def height(pair):
        return 1 + max((height(child) for child in below(pair)), default=0)

    levels = min(levels, height(top))
    if levels == 1:
        return [top]
    cut, upper = [top], levels // 2
    for _ in range(upper):
        cut = [child for pair in cut for child in below(pair)]
    return veb(tree, top, upper) + [pair for root in cut for pair in veb(tree, root, levels - upper)]


@given(tree=trees)
def test_van_emde_boas_is_the_recursion(tree):
    wanted = [node for pair in veb(tree, (0,), 99) for node in pair]
    assert np.argsort(slots(tree, "veb")).tolist() == wanted


@given(tree=trees, pairs=st.integers(1, 9))
def test_a_treelet_is_a_subtree_from_its_root_down(tree, pairs):
    """In a block, a pair's parent is in the same block, or the pair is the root of a subtree begun there."""
    placed = slots(tree, f"treelet:{pairs * 16}")
    order = np.argsort(placed)
    for start in range(0, int(placed.max()) + 1, 2 * pairs):
        block = [node for node in order.tolist() if start <= placed[node] < start + 2 * pairs]
        begun = [node for node in block if node % 2 == 1 and tree.parent[node] not in block]
        for root in begun[1:]:  # a second subtree in a block: all of the first has been placed before it
            first = [begun[0], begun[0] + 1] if 0 not in block else [0]
            inside = {node for each in first for node in subtree(tree, each)}
            assert placed[root] > max(placed[node] for node in inside)
    if pairs >= len(tree.parent):
        assert (np.diff(np.array(tree.level)[order]) >= 0).all()


def test_a_treelet_fills_its_block_breadth_first():
    """A complete tree of five levels in blocks of seven pairs: the root and six pairs; then whole subtrees of seven pairs."""
    n_levels = 6
    level = np.array([0] + [0] * 62)
    parent = np.full(63, -1)
    count = 1

    def grow(node):
        nonlocal count
        if level[node] < n_levels - 1:
            first, count = count, count + 2
            parent[first : first + 2], level[first : first + 2] = node, level[node] + 1
            grow(first)
            grow(first + 1)

    grow(0)
    placed = addresses({"parent": parent, "level": level}, 8, "treelet:112") // 8
    blocks = placed // 14
    assert (blocks[level <= 2] == 0).all()  # the root and the pairs of levels 1 and 2 are four units, three of level 3
    assert sorted(np.bincount(blocks[level == 3]).tolist())[-1] == 6


def test_a_treelet_larger_than_the_tree_is_one_block():
    nodes = {"parent": np.array([-1, 0, 0, 1, 1]), "level": np.array([0, 1, 1, 2, 2])}
    np.testing.assert_array_equal(addresses(nodes, 32, "treelet:64G"), addresses(nodes, 32, "treelet:256"))


def test_base_and_names():
    tree = make_trace("kdtree", 1, n_rays=1)
    moved = addresses(columns(tree), 8, "bfs+1K")
    assert (moved - 1024 == addresses(columns(tree), 8, "bfs")).all()
    assert str(parse_layout("treelet:1k+16")) == "treelet:1K+16"
    assert parse_layout(str(parse_layout("veb+8"))) == Layout("veb", base=8)
    assert {name.partition(":")[0] for name in NAMES} == {name.partition(":")[0] for name in LAYOUTS}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("zigzag", "'zigzag' is not a layout; choose one of stored, bfs, dfs, veb, treelet:BYTES"),
        ("treelet", "only treelet has a block size, and needs it; write e.g. treelet:256"),
        ("bfs:64", "only treelet has a block size"),
        ("treelet:0", "a treelet of 0 B holds no node"),
        ("treelet:x", "'x' is not a size"),
        ("stored+", "'' is not a size"),
        ("stored+9999999999G", "beyond the largest address"),
    ],
)
def test_what_is_not_a_layout(text, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        parse_layout(text)


def test_a_block_must_be_whole_pairs():
    tree = columns(make_trace("bvh", 1, n_rays=1))
    with pytest.raises(ValueError, match=r"not a whole number of pairs of 32-byte nodes; write e\.g\. treelet:64"):
        addresses(tree, 32, "treelet:32")
    with pytest.raises(ValueError, match=r"write e\.g\. treelet:64"):
        addresses(tree, 32, "treelet:96")


@pytest.mark.parametrize("parent", [[-1, 0], [-1, 0, 1], [-1, 0, 0, 3, 3], [-1, 0, 0, -1, -1]])
def test_what_is_not_a_tree(parent):
    level = np.zeros(len(parent), np.uint16)
    with pytest.raises(ValueError, match="are not sibling pairs"):
        addresses({"parent": np.array(parent), "level": level}, 8, "veb")


@pytest.mark.parametrize("layout", [*NAMES, "stored+8", "veb+4", "bfs+4G"])
def test_a_replay_uses_the_layout(layout, tmp_path):
    trace = make_trace("kdtree", 5, n_rays=60)
    run = write(trace, tmp_path / "x-kdtree")
    config = CacheConfig(224, 1, 32)  # seven sets: the lines of a moved layout fall into other sets
    [result] = replay(run, [config], layout=layout)
    placed = addresses(columns(trace), 8, layout)
    accesses = [
        (line, 11 if row == 3 else 0)
        for node, row in trace.node_kinds
        for line in range(int(placed[node]) // 32, (int(placed[node]) + 7) // 32 + 1)
    ]
    model = Cache(config).replay(accesses)
    assert result.misses.tolist() == model.counts["misses"]
    assert result.accesses.tolist() == model.counts["accesses"]
    assert result.layout == str(parse_layout(layout))
