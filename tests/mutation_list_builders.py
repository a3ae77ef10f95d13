"""Mutations of what the builders count, list and leave in memory."""

# ruff: noqa: E501
# fmt: off

from tests.mutation_list import Mutation

KT, CL, BV, BN = "rtrace/kdtree.py", "rtrace/clip.py", "rtrace/bvh.py", "rtrace/binned.py"
BUILDERS = "tests/test_builders.py"

MUTATIONS = [
    Mutation("builders: what ends at the plane counts above it too", KT, "n_above -= kind != _START", "n_above -= kind == _PLANAR", BUILDERS),
    Mutation("builders: what lies in the plane below counts above it too", KT, "n_above -= kind != _START", "n_above -= kind == _END", BUILDERS),
    Mutation("builders: what straddles the plane does not count below it", KT, "n_below += kind != _END", "n_below += kind != _START", BUILDERS),
    Mutation("builders: one triangle too many is taken above now and then", KT, "    return n_below, n_above\n", "    return n_below, n_above + (n_above > 9)\n", BUILDERS),
    Mutation("builders: the part above a plane begins below it", CL, "max(lo, split) if k == axis else lo", "lo", BUILDERS),
    Mutation("builders: where rounding leaves nothing, nothing stays", CL, "        if inner_lo <= inner_hi:\n            lo, hi = inner_lo, inner_hi\n", "        lo, hi = inner_lo, max(inner_lo, inner_hi)\n", BUILDERS),
    Mutation("builders: a right side's area that was never set", BV, "for i in range(end - 1, start, -1):", "for i in range(end - 1, start + 1, -1):", BUILDERS),
    Mutation("builders: bins keep the counts of the node before", BN, "        counts[b] = 0\n", "", BUILDERS),
    Mutation("builders: a kd-tree says it has 64 levels at most", KT, "state[_DEEPEST] = max(state[_DEEPEST], level + 1)", "state[_DEEPEST] = max(state[_DEEPEST], min(level + 1, 64))", BUILDERS),
    Mutation("builders: a BVH says it has 64 levels at most", BV, "max_level = max(max_level, level)", "max_level = max(max_level, min(level, 64))", BUILDERS),
    Mutation("builders: a BVH takes NaN", BV, "    check_finite(triangles)\n", "", "tests/test_bvh.py::test_bad_arguments_are_named"),
]
