"""Which child an any-hit ray searches first, against the definition, and a tree whose answer is plain."""

import numpy as np
import pytest

from rtrace.scenes.shapes import boxes, height_field, icosphere, soup
from rtrace.trees.rtsah import COSTS, cheaper_children
from rtrace.trees.tree import BVH_NODE, Tree
from rtrace.trees.tree_cache import build_tree

SCENES = {"icosphere": icosphere(2), "height field": height_field(8), "boxes": boxes(), "soup": soup(200, seed=1)}


def area(box):
    x, y, z = (float(high) - float(low) for low, high in zip(*box, strict=True))
    return x * y + y * z + z * x


def search(tree, number, box, found):
    """Return the expected cost of a search below a node that a ray enters, and how likely it passes; note the choice."""
    per_triangle, per_node = COSTS[tree.kind]
    meta = int(tree.nodes[number]["meta"])
    if meta & 3 == 3:
        return per_node + per_triangle * (meta >> 2), float(meta >> 2 == 0)
    if tree.kind == "kdtree":
        low, split = meta >> 2, float(tree.nodes[number]["split"])
        inner = [[list(corner) for corner in box] for _ in range(2)]
        inner[0][1][meta & 3] = inner[1][0][meta & 3] = split
    else:
        low = int(tree.nodes[number]["child"])
        inner = [(tree.nodes[each]["lower"].tolist(), tree.nodes[each]["upper"].tolist()) for each in (low, low + 1)]
    share = [area(each) / area(box) if area(box) else 1.0 for each in inner]
    both = max(sum(share) - 1, 0) if tree.kind == "kdtree" else share[0] * share[1]
    (a, passes_a), (b, passes_b) = (search(tree, low + k, inner[k], found) for k in range(2))
    first = [a + passes_a * b, b + passes_b * a]
    found[number] = int(first[0] >= first[1])
    only = [share[k] - both for k in range(2)]
    neither = 1 - only[0] - only[1] - both
    cost = per_node + only[0] * a + only[1] * b + both * min(first)
    return cost, only[0] * passes_a + only[1] * passes_b + both * passes_a * passes_b + neither


@pytest.mark.parametrize("kind", ["kdtree", "bvh"])
@pytest.mark.parametrize("scene", SCENES)
def test_the_cheaper_child_is_that_of_the_definition(scene, kind):
    tree, found = build_tree(SCENES[scene], kind), {}
    search(tree, 0, tree.bounds.tolist() if kind == "kdtree" else tree.nodes[0][["lower", "upper"]].tolist(), found)
    cheaper = cheaper_children(tree)
    assert cheaper.size == tree.nodes.size and not cheaper[[i for i in range(cheaper.size) if i not in found]].any()
    assert [int(cheaper[number]) for number in found] == list(found.values())
    assert 0.05 < np.mean(list(found.values())) < 0.95


def test_one_triangle_is_cheaper_than_nine():
    nodes = np.zeros(3, BVH_NODE)
    nodes["upper"] = 1.0
    nodes["child"], nodes["meta"] = (1, 0, 9), (0, 9 << 2 | 3, 1 << 2 | 3)
    triangles, bounds = np.zeros((10, 3, 3), np.float32), np.float32([[0, 0, 0], [1, 1, 1]])
    tree = Tree("bvh", nodes, np.arange(10, dtype=np.int32), triangles, triangles, bounds, bounds, 1, {})
    assert cheaper_children(tree).tolist() == [1, 0, 0]
    nodes["meta"][1:] = 1 << 2 | 3, 9 << 2 | 3
    assert cheaper_children(tree).tolist() == [0, 0, 0]
