"""The clock against a model that steps every cycle: every number equal, on random trees, traces and machines."""

from hypothesis import given
from hypothesis import strategies as st

from tests.reference.clock import NoPolicy
from tests.reference.clock_cases import cases, check_account, config_of, configs, fast_account, machines, slow_account


@given(cases, machines, configs, st.integers(1, 8), st.lists(st.integers(1, 12), max_size=2), st.booleans())
def test_without_prefetches_every_number_is_that_of_the_model(case, numbers, config, n_slots, steps, watches):
    fast = fast_account(case, numbers, config_of(config), n_slots, "none", steps=sorted(steps), watches_leaves=watches)
    assert fast == slow_account(case, numbers, config_of(config), n_slots, NoPolicy())
    check_account(fast, n_slots)
