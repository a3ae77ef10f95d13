"""The bound of all prefetchers in the clock against the model: every read hits."""

from hypothesis import given
from hypothesis import strategies as st

from tests.reference.clock import NoPolicy
from tests.reference.clock_cases import cases, check_account, config_of, configs, fast_account, machines, slow_account


@given(cases, machines, configs, st.integers(1, 8))
def test_every_number_is_that_of_the_model(case, numbers, config, n_slots):
    fast = fast_account(case, numbers, config_of(config), n_slots, "perfect")
    assert fast == slow_account(case, numbers, config_of(config), n_slots, NoPolicy(), is_perfect=True)
    check_account(fast, n_slots)
