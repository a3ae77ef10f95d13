"""Where a better machine is slower: with several rays in flight, timing decides who evicts whom. Examples found by search."""

import pytest

from tests.reference.clock import NoPolicy
from tests.reference.clock_cases import Case, config_of, fast_account, slow_account

#: What is changed -> tree, seed and number of rays; rays in flight; machine; sets and ways; cycles before and after.
#: Lines have 64 bytes, and the tests of two triangles of a leaf do not overlap.
EXAMPLES = {
    "a way more": (
        ("bvh64", 318900, 4), 4, dict(extra=12, mshrs=3, transfer=0, triangle=8, n_units=1), (3, 2), 191, 231,
    ),
    "an MSHR more": (
        ("kdtree", 1042079, 2), 2, dict(extra=7, mshrs=1, transfer=5, triangle=6, n_units=1), (1, 2), 117, 150,
    ),
    "a port more": (
        ("kdtree", 380919, 2), 2, dict(extra=5, mshrs=2, transfer=0, triangle=5, n_units=1), (3, 1), 40, 44,
    ),
    "misses a cycle shorter": (
        ("kdtree", 86439, 3), 2, dict(extra=17, mshrs=1, transfer=5, triangle=6, n_units=1), (1, 2), 296, 381,
    ),
    "triangles a cycle shorter": (
        ("bvh", 502379, 2), 2, dict(extra=17, mshrs=2, transfer=5, triangle=4, n_units=0), (1, 1), 95, 114,
    ),
    "a ray in flight more": (
        ("kdtree", 887652, 3), 2, dict(extra=26, mshrs=1, transfer=5, triangle=2, n_units=1), (1, 1), 277, 628,
    ),
}  # fmt: skip


@pytest.mark.parametrize("change", EXAMPLES)
def test_better_may_be_slower(change, record_property):
    (kind, seed, n_rays), n_slots, machine, (n_sets, ways), before, after = EXAMPLES[change]
    case = Case(kind, seed, 64, 0, n_rays, beside=0)
    case.waits_for = [-1] * n_rays
    plain = {"hit": 1, "ports": 1, "box": 1, **machine, "every": machine["triangle"]}
    better, better_ways, better_slots = dict(plain), ways, n_slots
    if change == "a way more":
        better_ways += 1
    elif change == "an MSHR more":
        better["mshrs"] += 1
    elif change == "a port more":
        better["ports"] += 1
    elif change == "misses a cycle shorter":
        better["extra"] -= 1
    elif change == "triangles a cycle shorter":
        better["triangle"] = better["every"] = plain["triangle"] - 1
    else:
        better_slots += 1
    totals = []
    for numbers, n_ways, slots in ((plain, ways, n_slots), (better, better_ways, better_slots)):
        config = config_of((n_sets, n_ways, "lru"))
        totals.append(fast_account(case, numbers, config, slots, "none")["total"])
        assert totals[-1] == slow_account(case, numbers, config, slots, NoPolicy())["total"]
    print(f"{change}: {len(case.nodes)} reads of {n_rays} rays take {totals[0]} cycles before, {totals[1]} after")
    record_property("cycles", totals)
    assert totals == [before, after] and after > before
