"""Mutations of what the builders count, list and leave in memory."""

# ruff: noqa: E501
# fmt: off

from tests.mutations.mutation import Mutation

KT, KE, CL = "rtrace/trees/kdtree.py", "rtrace/trees/kd_events.py", "rtrace/trees/clip.py"
BV, BN = "rtrace/trees/bvh.py", "rtrace/trees/binned_sah.py"
STEPS = "tests/rtrace/trees/test_builders.py::test_every_split_counts_what_it_parts"
MEMORY = "tests/rtrace/trees/test_builders.py::test_memory_that_was_never_set_is_never_read"
DEEP = "tests/rtrace/trees/test_builders.py::test_trees_deeper_than_64_find_what_brute_force_finds"

MUTATIONS = [
    Mutation("builders: what ends at the plane counts above it too", KE, "n_above -= kind != START", "n_above -= kind == PLANAR", STEPS),
    Mutation("builders: what lies in the plane below counts above it too", KE, "n_above -= kind != START", "n_above -= kind == END", STEPS),
    Mutation("builders: what straddles the plane does not count below it", KE, "n_below += kind != END", "n_below += kind != START", STEPS),
    Mutation("builders: one triangle too many is taken above now and then", KE, "    return n_below, n_above\n", "    return n_below, n_above + (n_above > 9)\n", STEPS),
    Mutation("builders: the part above a plane begins below it", CL, "max(lo, split) if k == axis else lo", "lo", STEPS),
    Mutation("builders: where rounding leaves nothing, nothing stays", CL, "        if inner_lo <= inner_hi:\n            lo, hi = inner_lo, inner_hi\n", "        lo, hi = inner_lo, max(inner_lo, inner_hi)\n",
             "tests/rtrace/trees/test_kdtree.py::test_a_part_that_rounding_left_empty_stays_near_its_triangle"),
    Mutation("builders: a right side's area that was never set", BV, "for i in range(end - 1, start, -1):", "for i in range(end - 1, start + 1, -1):", MEMORY),
    Mutation("builders: bins keep the counts of the node before", BN, "        counts[b] = 0\n", "", MEMORY),
    Mutation("builders: a kd-tree says it has 64 levels at most", KT, "state[_DEEPEST] = max(state[_DEEPEST], level + 1)", "state[_DEEPEST] = max(state[_DEEPEST], min(level + 1, 64))", DEEP),
    Mutation("builders: a BVH says it has 64 levels at most", BV, "max_level = max(max_level, level)", "max_level = max(max_level, min(level, 64))", DEEP),
    Mutation("builders: a BVH takes NaN", BV, "    check_finite(triangles)\n", "", "tests/rtrace/trees/test_bvh.py::test_bad_arguments_are_named"),
]
