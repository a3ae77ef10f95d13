"""Mutations of what the builders count, list and leave in memory."""

# ruff: noqa: E501
# fmt: off

from tests.mutations.mutation import Mutation

KT, KE, CL = "rtrace/trees/kdtree.py", "rtrace/trees/kd_events.py", "rtrace/trees/clip.py"
BV, BN = "rtrace/trees/bvh.py", "rtrace/trees/binned_sah.py"
STEPS = "tests/rtrace/trees/test_builders.py::test_every_split_counts_what_it_parts"
MEMORY = "tests/rtrace/trees/test_builders.py::test_memory_that_was_never_set_is_never_read"
DEEP = "tests/rtrace/trees/test_builders.py::test_trees_deeper_than_64_find_what_brute_force_finds"
PARTS = "tests/rtrace/trees/test_subtrees.py"
LEAVES = "tests/rtrace/trees/test_leaf_rules.py"

MUTATIONS = [
    Mutation("subtrees: nodes of a part keep their numbers", BV, "array[\"child\"][is_inner] += np.uint32(n - 1)", "pass", PARTS),
    Mutation("subtrees: nodes of a part of a kd-tree keep their numbers", KT, "array[\"meta\"][~is_leaf] += np.uint32(n - 1) << bits", "pass", PARTS),
    Mutation("subtrees: leaves of a part keep their places", KT, "array[\"first\"][is_leaf] += np.uint32(n_refs)", "pass", PARTS),
    Mutation("subtrees: the upper child comes first", "rtrace/trees/subtrees.py", "reversed(list(enumerate(part.children)))", "enumerate(part.children)", PARTS),
    Mutation("subtrees: parts under a ceiling are taken", KT, "if not built.is_cut and len(built.prims) <= max_refs // 2:", "if True:", PARTS),
    Mutation("subtrees: the root of a part has a box of its own zeros", BV, "nodes[\"child\"][at], nodes[\"meta\"][at] = built.nodes[\"child\"][0], built.nodes[\"meta\"][0]", "nodes[at] = built.nodes[0]", PARTS),
    Mutation("builders: what ends at the plane counts above it too", KE, "n_above -= kind != START", "n_above -= kind == PLANAR", STEPS),
    Mutation("builders: what lies in the plane below counts above it too", KE, "n_above -= kind != START", "n_above -= kind == END", STEPS),
    Mutation("builders: what straddles the plane does not count below it", KE, "n_below += kind != END", "n_below += kind != START", STEPS),
    Mutation("builders: one triangle too many is taken above now and then", KE, "    return n_below, n_above\n", "    return n_below, n_above + (n_above > 9)\n", STEPS),
    Mutation("builders: the part above a plane begins below it", CL, "max(lo, split) if k == axis else lo", "lo", STEPS),
    Mutation("builders: where rounding leaves nothing, nothing stays", CL, "        if inner_lo <= inner_hi:\n            lo, hi = inner_lo, inner_hi\n", "        lo, hi = inner_lo, max(inner_lo, inner_hi)\n",
             "tests/rtrace/trees/test_kdtree.py::test_a_part_that_rounding_left_empty_stays_near_its_triangle"),
    Mutation("builders: a right side's area that was never set", BV, "for i in range(end - 1, start, -1):", "for i in range(end - 1, start + 1, -1):", MEMORY),
    Mutation("builders: bins keep the counts of the node before", BN, "        counts[b] = 0\n", "", MEMORY),
    Mutation("builders: a kd-tree says it has 64 levels at most", "rtrace/trees/kd_cells.py", "state[_DEEPEST] = max(state[_DEEPEST], level + 1)", "state[_DEEPEST] = max(state[_DEEPEST], min(level + 1, 64))", DEEP),
    Mutation("builders: a BVH says it has 64 levels at most", BV, "max_level = max(max_level, level)", "max_level = max(max_level, min(level, 64))", DEEP),
    Mutation("builders: a BVH takes NaN", BV, "    check_finite(triangles)\n", "", "tests/rtrace/trees/test_bvh.py::test_bad_arguments_are_named"),
    Mutation("leaf rules: a node of max_leaf triangles is split", BV, "and count <= max_leaf:", "and count < max_leaf:", LEAVES),
    Mutation("leaf rules: a node of min_leaf triangles is split", BV, "if count > 1 and count > min_leaf:", "if count > 1 and count >= min_leaf:", LEAVES),
    Mutation("leaf rules: the cost of visiting is 1 whatever was asked for", BV, "if not trav * area + cost", "if not area + cost", LEAVES),
    Mutation("leaf rules: copies are cut where rounding says", BV, "is_cut = cost < area * count * NO_SMALLER", "is_cut = cost < np.inf", LEAVES),
    Mutation("leaf rules: halves overlap", BV, "position = start + (end - start) // 2", "position = start + 1", LEAVES),
    Mutation("leaf rules: binned: a node of min_leaf triangles is split", BN, "if count <= min_leaf:", "if count < min_leaf:", LEAVES),
    Mutation("leaf rules: binned: no leaf is too large", BN, "and count <= max_leaf:", "and count >= ZERO:", LEAVES),
    Mutation("leaf rules: binned: halves along x", BN, "axis, position = _longest_axis(nodes, node),", "axis, position = X,", LEAVES),
    Mutation("leaf rules: a cell of min_leaf triangles is split", "rtrace/trees/kd_cells.py", "may_pay = n > min_leaf and", "may_pay = n >= min_leaf and", LEAVES),
    Mutation("leaf rules: a cell may hold one triangle more than max_leaf", "rtrace/trees/kd_cells.py", "is_forced = n > max_leaf", "is_forced = n > max_leaf + 1", LEAVES),
    Mutation("leaf rules: a forced plane may part nothing", "rtrace/trees/kd_cells.py", "max(n_below, n_above) == n and min(n_below, n_above) > 0", "n < 0", LEAVES),
    Mutation("leaf rules: limits are not written into the footer", "rtrace/trees/leaf_rules.py", 'given | {"max_leaf": int(max_leaf)}', "given", LEAVES),
]
