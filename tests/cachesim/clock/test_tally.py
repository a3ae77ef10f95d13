"""The tally of reads and requests by level, ray type, place on the stack and leaf size, from the events of the model."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cachesim.clock.state import BY, TALLY
from tests.reference.clock import SlowStack
from tests.reference.clock_cases import cases, config_of, configs, fast_account, machines, slow_clock
from tests.reference.policies import SlowNextLine, SlowStride

POLICIES = {
    "stack": lambda case: SlowStack(case.lines, case.trace.level, case.trace.n_prims),
    "next-line:always": lambda case: SlowNextLine(case.n_lines, "always", 1),
    "stride": lambda case: SlowStride(case.n_lines),
}


def tally_of(case, events, by):
    """Return the rows of the tally."""
    trace = case.trace
    depth = max(max(trace.level), 1)

    def level(line, node):
        there = [trace.level[each] for each, lines in enumerate(case.lines) if line in lines]
        return trace.level[node] if node is not None else min(there, default=max(trace.level) + 1)

    def class_of(line, facts):
        if by == "level":
            return level(line, facts["node"])
        if by == "slot":
            return depth if facts["place"] is None else facts["place"]
        return int(case.types[facts["ray"]]) if by == "ray" else facts["n_prims"]

    n_classes = {"level": max(trace.level) + 2, "ray": 2, "slot": depth + 1, "leaf": max(trace.n_prims) + 1}[by]
    rows, filled_by = [dict.fromkeys(TALLY, 0) for _ in range(n_classes)], {}
    for what, line, facts in events:
        if facts is None:  # of a line that a prefetch filled
            rows[filled_by[line]][what] += 1
        elif what in ("read", "missed"):
            rows[class_of(line, facts)]["reads"] += 1
            rows[class_of(line, facts)]["misses"] += what == "missed"
        else:
            rows[class_of(line, facts)][what] += 1
            if what == "filled":
                filled_by[line] = class_of(line, facts)
    return [list(row.values()) for row in rows]


@pytest.mark.parametrize("by", BY[1:])
@pytest.mark.parametrize("text", POLICIES)
@given(case=cases, numbers=machines, config=configs, n_slots=st.integers(1, 8))
def test_the_tally_is_that_of_the_model(text, by, case, numbers, config, n_slots):
    clock = slow_clock(case, numbers, config_of(config), n_slots, POLICIES[text](case))
    fast = fast_account(case, numbers, config_of(config), n_slots, text, by=BY.index(by))
    assert fast["tally"] == tally_of(case, clock.events, by)
