"""A policy of another package: an entry point names it, and all that lists policies has it."""

import importlib.metadata

import pytest

import cachesim.policies
from cachesim.clock.compare import usual_policies
from cachesim.policies import Policy, no_options, push
from cachesim.prefetch import parse_prefetch
from nptrace_base.errors import NptraceError


@pytest.fixture
def foreign(monkeypatch):
    """Install a package with a policy, which does what push does."""
    policy = Policy("eager", "eager", no_options, push.make_unit)
    entry = type("Entry", (), {"load": staticmethod(lambda: policy)})
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda *, group: [entry] if group == "nptrace.policies" else [])
    cachesim.policies.policies.cache_clear()
    yield policy
    cachesim.policies.policies.cache_clear()


def test_an_entry_point_adds_a_policy(foreign):
    assert parse_prefetch("eager").policy is foreign
    assert "eager" in usual_policies()
    with pytest.raises(NptraceError, match="push, .*, eager"):
        parse_prefetch("nosuch")


def test_without_the_entry_point_there_is_none():
    with pytest.raises(NptraceError, match="there is no prefetch policy 'eager'"):
        parse_prefetch("eager")
