"""The tally of reads and requests by level, ray type, place on the stack and leaf size, from the events of the model."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cachesim.clock.state import BY, TALLY
from tests.reference.clock import SlowStack
from tests.reference.clock_cases import cases, config_of, configs, fast_account, machines, slow_clock


def tally_of(case, events, by):
    """Return the rows of the tally."""
    trace = case.trace
    class_of = {
        "level": lambda facts: trace.level[facts["node"]], "ray": lambda facts: int(case.types[facts["ray"]]),
        "slot": lambda facts: facts["place"], "leaf": lambda facts: facts["n_prims"],
    }[by]  # fmt: skip
    depth = max(max(trace.level), 1)
    n_classes = {"level": max(trace.level) + 1, "ray": 2, "slot": depth + 1, "leaf": max(trace.n_prims) + 1}[by]
    rows, filled_by = [dict.fromkeys(TALLY, 0) for _ in range(n_classes)], {}
    for what, line, facts in events:
        if facts is None:  # of a line that a prefetch filled
            rows[filled_by[line]][what] += 1
        elif what in ("read", "missed"):
            rows[class_of(facts)]["reads"] += 1
            rows[class_of(facts)]["misses"] += what == "missed"
        else:
            rows[class_of(facts)][what] += 1
            if what == "filled":
                filled_by[line] = class_of(facts)
    return [list(row.values()) for row in rows]


@pytest.mark.parametrize("by", BY[1:])
@given(case=cases, numbers=machines, config=configs, n_slots=st.integers(1, 8))
def test_the_tally_is_that_of_the_model(by, case, numbers, config, n_slots):
    trace = case.trace
    policy = SlowStack(case.lines, trace.level, trace.n_prims)
    clock = slow_clock(case, numbers, config_of(config), n_slots, policy)
    fast = fast_account(case, numbers, config_of(config), n_slots, "stack", by=BY.index(by))
    assert fast["tally"] == tally_of(case, clock.events, by)
