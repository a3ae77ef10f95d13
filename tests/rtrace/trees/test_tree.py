"""The table of nodes: every column against plain Python that walks the tree from its root."""

import math

import pytest

from rtrace.scenes.shapes import soup
from rtrace.trees.tree import LEAF_AXIS, node_table
from rtrace.trees.tree_cache import build_tree


@pytest.mark.parametrize("kind", ["kdtree", "bvh"])
def test_every_column_is_what_a_walk_from_the_root_finds(kind):
    tree = build_tree(soup(200, seed=3), kind)
    table, seen, waiting = node_table(tree), 0, [(0, -1, 0)]
    while waiting:
        i, parent, level = waiting.pop()
        node, seen = tree.nodes[i], seen + 1
        meta = int(node["meta"])
        is_leaf = meta & 3 == LEAF_AXIS
        expected = {"node": i, "parent": parent, "level": level, "axis": meta & 3, "n_prims": meta >> 2 if is_leaf else 0}
        expected["address"] = i * (8 if kind == "kdtree" else 32)
        if kind == "bvh":
            for end, corner in (("min", node["lower"]), ("max", node["upper"])):
                expected |= {f"{end}_{axis}": float(corner[k]) for k, axis in enumerate("xyz")}
        elif is_leaf:
            assert math.isnan(table["split"][i])
        else:
            expected["split"] = float(node["split"])
        assert {name: table[name][i].item() for name in expected} == expected
        if not is_leaf:
            child = meta >> 2 if kind == "kdtree" else int(node["child"])
            waiting += [(child, i, level + 1), (child + 1, i, level + 1)]
    assert seen == len(tree.nodes) == len(table["node"]) > 50
