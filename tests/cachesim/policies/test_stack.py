"""The paper's unit in the clock against its model: every option, and every number of the account."""

from hypothesis import given
from hypothesis import strategies as st

from tests.reference.clock import SlowStack
from tests.reference.clock_cases import cases, check_account, config_of, configs, fast_account, machines, slow_account
from tests.reference.policies import rows_read

options = st.fixed_dictionaries({
    "budget": st.none() | st.integers(0, 4), "per_triangle": st.booleans(), "once": st.booleans(),
    "deepest": st.integers(1, 7), "reset": st.sampled_from(["", "", "persist", "restart"]), "pop": st.booleans(),
})  # fmt: skip


def text_of(options, name="stack"):
    """Return the policy as a user writes it, and the options as the model takes them."""
    budget, is_timed_by_leaves = options["budget"], not options["pop"]
    per_triangle = options["per_triangle"] and budget is not None and is_timed_by_leaves
    words = [name, "unlimited" if budget is None else f"tris*{budget}" if per_triangle else f"budget={budget}"]
    words += ["once"] * options["once"] + [options["reset"]] * bool(options["reset"]) + ["pop"] * options["pop"]
    return ":".join([*words, f"level={options['deepest']}"]), options | {"per_triangle": per_triangle}


@given(cases, machines, configs, st.integers(1, 8), options, st.booleans())
def test_the_unit_is_that_of_the_model(case, numbers, config, n_slots, options, is_live):
    text, options = text_of(options)
    wanted = rows_read(case.rays) if is_live else None
    model = SlowStack(case.lines, case.trace.level, case.trace.n_prims, **options, wanted=wanted)
    fast = fast_account(case, numbers, config_of(config), n_slots, text + ":live" * is_live)
    assert fast == slow_account(case, numbers, config_of(config), n_slots, model)
    check_account(fast, n_slots)
