"""TTP's depth-first policy in the clock against its model."""

from hypothesis import given
from hypothesis import strategies as st

from tests.reference.clock_cases import cases, check_account, config_of, configs, fast_account, machines, slow_account
from tests.reference.policies import SlowTtp


@given(cases, machines, configs, st.integers(1, 8))
def test_every_number_is_that_of_the_model(case, numbers, config, n_slots):
    fast = fast_account(case, numbers, config_of(config), n_slots, "ttp")
    assert fast == slow_account(case, numbers, config_of(config), n_slots, SlowTtp(case.lines, max(case.trace.level)))
    check_account(fast, n_slots)
