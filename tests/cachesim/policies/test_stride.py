"""The stride prefetcher in the clock against its model."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from cachesim.policies import stride
from cachesim.policies.machine import NodeColumns, make_machine
from tests.reference.clock_cases import cases, check_account, config_of, configs, fast_account, machines, slow_account
from tests.reference.policies import SlowStride


@given(cases, machines, configs, st.integers(1, 8))
def test_every_number_is_that_of_the_model(case, numbers, config, n_slots):
    fast = fast_account(case, numbers, config_of(config), n_slots, "stride")
    assert fast == slow_account(case, numbers, config_of(config), n_slots, SlowStride(case.n_lines))
    check_account(fast, n_slots)


def test_a_ray_begins_without_the_last_line_and_stride_of_the_ray_before(monkeypatch):
    """The rays of one slot, one after the other: only the confirmed stride, 3, goes from one to the next."""
    root = NodeColumns(*np.ones((5, 1), np.int64))
    machine = make_machine(root, 1, 100)
    unit, asked = stride.make_unit(machine, None), []
    monkeypatch.setattr(stride, "replace", lambda unit, machine, slot, line: asked.append(line))
    for lines, requests in (([10, 13, 16], [19]), ([19, 40], []), ([50, 71], []), ([80, 83], [86])):
        unit.on_start(machine, 0)
        for line in lines:
            unit.on_visit(machine, 0, line, None)
        unit.on_end(machine, 0)
        assert asked == requests
        asked.clear()
