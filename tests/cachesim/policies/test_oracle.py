"""The oracle in the clock against a model that goes through the run twice."""

from hypothesis import given
from hypothesis import strategies as st

from tests.cachesim.policies.test_stack import options, text_of
from tests.reference.clock import SlowStack
from tests.reference.clock_cases import (
    cases,
    check_account,
    config_of,
    configs,
    fast_account,
    machines,
    slow_account,
    slow_clock,
)
from tests.reference.policies import SlowScout


@given(cases, machines, configs, st.integers(1, 8), options)
def test_both_passes_are_those_of_the_model(case, numbers, config, n_slots, options):
    text, options = text_of(options, "oracle")
    trace = case.trace
    scout = SlowScout(case.lines, trace.level, trace.n_prims, **options)
    slow_clock(case, numbers, config_of(config), n_slots, scout)
    model = SlowStack(case.lines, trace.level, trace.n_prims, **options, wanted=scout.used)
    fast = fast_account(case, numbers, config_of(config), n_slots, text)
    assert fast == slow_account(case, numbers, config_of(config), n_slots, model)
    check_account(fast, n_slots)
