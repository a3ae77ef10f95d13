"""Sequential prefetchers in the clock against their model."""

from hypothesis import given
from hypothesis import strategies as st

from tests.reference.clock_cases import cases, check_account, config_of, configs, fast_account, machines, slow_account
from tests.reference.policies import SlowNextLine


@given(cases, machines, configs, st.integers(1, 8), st.sampled_from(("always", "miss", "tagged")), st.integers(1, 4))
def test_every_number_is_that_of_the_model(case, numbers, config, n_slots, trigger, distance):
    fast = fast_account(case, numbers, config_of(config), n_slots, f"next-line:{trigger}:{distance}")
    assert fast == slow_account(case, numbers, config_of(config), n_slots, SlowNextLine(case.n_lines, trigger, distance))
    check_account(fast, n_slots)
