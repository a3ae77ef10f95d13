"""The treelet vote in the clock against its model."""

from hypothesis import given
from hypothesis import strategies as st

from tests.reference.clock_cases import cases, check_account, config_of, configs, fast_account, machines, slow_account
from tests.reference.policies import SlowTreelet


@given(
    cases,
    machines,
    configs,
    st.integers(1, 8),
    st.sampled_from((8, 32, 100, 256, 4096)),
    st.integers(1, 60),
    st.sampled_from((0, 34, 60, 100)),
)
def test_every_number_is_that_of_the_model(case, numbers, config, n_slots, block, every, share):
    fast = fast_account(case, numbers, config_of(config), n_slots, f"treelet:bytes={block}:every={every}:share={share}")
    assert fast == slow_account(
        case,
        numbers,
        config_of(config),
        n_slots,
        SlowTreelet(case.lines, case.trace.parent, case.trace.node_bytes, block, every, share),
    )
    check_account(fast, n_slots)
