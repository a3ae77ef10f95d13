"""The check of accesses against the rule as one would say it, for every byte that a kind can be and nodes at both ends."""

from pathlib import Path

import numpy as np
import pytest

from traces.format import RunError
from traces.node_formats import NODE_FORMATS
from traces.validation import check_accesses, first_bad_access, kinds_allowed

AXES = np.array([0, 3, 2, 3, 3], np.uint8)
KINDS_OF = {"kdtree": ({0, 1, 3}, {2, 3}), "bvh": ({0, 1, 3}, {0, 2, 3}), "bvh64": ({0, 1, 3}, {2})}


def test_the_byte_behind_the_tree_is_never_looked_at():
    """It would allow everything here."""
    allowed = np.full(AXES.size + 1, 255, np.uint8)[:-1]
    nodes, kinds = np.array([0, AXES.size], np.uint32), np.zeros(2, np.uint8)
    assert first_bad_access(nodes, kinds, allowed) == 1
    with pytest.raises(RunError, match=f"a, column 'node', row 1: {AXES.size} breaks"):
        check_accesses(nodes, kinds, allowed, Path("a"), 0)


@pytest.mark.parametrize("tree", KINDS_OF)
def test_one_access_among_good_ones_is_refused_for_a_node_or_a_kind_that_cannot_be(tree):
    allowed = kinds_allowed(AXES, NODE_FORMATS[tree])
    inner, leaf = KINDS_OF[tree]
    for node in (0, 1, 2, AXES.size - 1, AXES.size, AXES.size + 1, 2**31, 2**32 - 1):
        for kind in range(256):
            nodes, kinds = np.array([0, 1, node, 4], np.uint32), np.array([1, 2, kind, 2], np.uint8)
            for array in (nodes, kinds):
                array.flags.writeable = False  # as Arrow's
            if node < AXES.size and kind in (leaf if AXES[node] == 3 else inner):
                check_accesses(nodes, kinds, allowed, Path("a"), 10)
            else:
                column, value = ("kind", kind) if node < AXES.size else ("node", node)
                with pytest.raises(RunError, match=f"a, column '{column}', row 12: {value} breaks"):
                    check_accesses(nodes, kinds, allowed, Path("a"), 10)
