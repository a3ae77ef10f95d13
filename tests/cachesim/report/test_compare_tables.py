"""What a comparison says: the best unit is one that can be built, and none is recommended where none pays."""

from types import SimpleNamespace

import pytest

from cachesim.report.compare_tables import is_buildable, verdict


def rows(group="policy", **cycles):
    """Return rows against a reference of 1000 cycles, by policy, whose colons are underscores."""
    return [
        SimpleNamespace(
            timing=SimpleNamespace(prefetch=name.replace("_", ":"), cycles=n, config="1K 1-way 64 B", layout=group),
            group=group, speed_up=1000 / n, traffic_ratio=1.0,
        )
        for name, n in cycles.items()
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("prefetch", "yes"),
    [
        ("stack:unlimited", True), ("stack:unlimited:once", True), ("push", True), ("ttp", True), ("stack:live", False),
        ("stack:unlimited:once:live", False), ("stack:tris*1:live:level=3", False), ("oracle", False),
        ("oracle:unlimited:once", False), ("perfect", False),
    ],
)  # fmt: skip
def test_what_can_be_built(prefetch, yes):
    assert is_buildable(prefetch) is yes


def test_a_unit_that_knows_what_is_read_is_not_the_best():
    policies = {"none": 1000, "stack_unlimited": 950, "stack_unlimited_once_live": 700, "push": 800, "perfect": 100}
    assert verdict("x", rows(**policies)) == ["x: the best unit is push with 1.250x, the paper's gives 1.053x."]


def test_none_pays():
    worse = rows(none=1000, stack_unlimited=1250, push=1030)
    assert verdict("x", worse) == ["x: no unit pays: the best, push, gives 0.971x, the paper's gives 0.800x."]
    of_layout = rows("baseline", none=1250, push=1000)
    assert verdict("x", [*worse, *of_layout])[1] == (
        "Without any unit, no line or layout pays: the best, 1K 1-way 64 B with the layout baseline, gives 0.800x at 1.00 of "
        "the bytes; on top of it: push 1.250x."
    )
    assert verdict("x", rows("baseline", none=500, push=400)) == [
        "Without any unit, 1K 1-way 64 B with the layout baseline gives 2.000x at 1.00 of the bytes; on top of it: "
        "push 1.250x."
    ]
