"""A seeded thousand inputs of ``tests.fuzz``; each target accepts some and refuses some."""

import pytest

from tests.fuzz import TARGETS, run, was_accepted

N = -(-1000 // len(TARGETS))


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.what)
def test_any_input_is_accepted_or_refused_in_one_sentence(target, record_property):
    tried = run(target, N, seed_of=1)
    record_property("cases", tried.total())
    assert tried.total() >= N
    assert tried[False] > 0
    assert tried[True] > 0


def test_what_is_no_sentence_is_a_failure():
    def fail(error):
        raise error

    target = TARGETS[0]._replace(try_input=fail)
    assert not was_accepted(target, ValueError("one sentence"))
    for error in (ValueError(""), ValueError("two\nlines"), KeyError("x"), AssertionError("kept nothing")):
        with pytest.raises((AssertionError, KeyError)):
            was_accepted(target, error)
