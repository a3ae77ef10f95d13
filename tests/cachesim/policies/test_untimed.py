"""Policies without a clock: the events of the replay are those of the slow policies, which are asked after every read."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cachesim.prefetch import UnitReplay, parse_prefetch
from tests.cachesim.policies.test_stack import options, text_of
from tests.reference.clock import SlowStack
from tests.reference.policies import SlowPush, SlowTtp, rows_read
from tests.reference.traces import make_trace
from tests.reference.untimed import Untimed, nodes_as_lines, rays_of
from traces.node_formats import NODE_FORMATS

KINDS = ("kdtree", "bvh", "bvh64")
seeds, cuts = st.integers(0, 1 << 20), st.lists(st.integers(0, 100), max_size=4)


def replayed(trace, text, cuts):
    """Return (node, whether it is a request) of a replay in batches that end at ``cuts``."""
    rows = [row for row in trace.node_kinds if row[1] != 3]
    nodes, kinds = np.array([node for node, _ in rows], np.uint32), np.array([kind for _, kind in rows], np.uint8)
    columns = (np.array(column) for column in (trace.n_prims, trace.level, trace.parent))
    unit = UnitReplay(parse_prefetch(text), NODE_FORMATS[trace.kind], *columns, n_rows=len(rows))
    batches = [(nodes[a:b], kinds[a:b]) for a, b in pairwise([0, *sorted(cuts), len(rows)])]
    unit.scout(lambda: iter(batches))
    made = [unit.events(*batch) for batch in batches]
    return [(int(node), bool(access_type)) for batch in made for node, access_type in zip(*batch, strict=True)]


def check(trace, text, cuts, policy, lines, rays):
    absent = {node for node, held in enumerate(lines) if not held}
    wanted = Untimed(policy, absent).events(rays)
    assert replayed(trace, text, cuts) == wanted
    return wanted


@pytest.mark.parametrize("kind", KINDS)
@given(seed=seeds, cuts=cuts)
def test_push(kind, seed, cuts):
    trace = make_trace(kind, seed, n_rays=8)
    lines = nodes_as_lines(trace)
    rays = rays_of(trace, lines)
    wanted = check(trace, "push", cuts, SlowPush(lines), lines, rays)
    pushed = [visit.pushes for visits in rays for visit in visits if visit.pushes is not None]
    assert [node for node, is_request in wanted if is_request] == [node for node in pushed if lines[node]]


@pytest.mark.parametrize("kind", KINDS)
@given(seed=seeds, cuts=cuts)
def test_ttp(kind, seed, cuts):
    trace = make_trace(kind, seed, n_rays=8)
    lines = nodes_as_lines(trace)
    check(trace, "ttp", cuts, SlowTtp(lines, max(trace.level)), lines, rays_of(trace, lines))


@pytest.mark.parametrize("kind", KINDS)
@given(seed=seeds, cuts=cuts, options=options, is_live=st.booleans())
def test_stack_by_level_and_live(kind, seed, cuts, options, is_live):
    trace = make_trace(kind, seed, n_rays=8)
    lines = nodes_as_lines(trace)
    rays = rays_of(trace, lines)
    text, options = text_of(options)
    policy = SlowStack(lines, trace.level, trace.n_prims, **options, wanted=rows_read(rays) if is_live else None)
    check(trace, text + ":live" * is_live, cuts, policy, lines, rays)


@pytest.mark.parametrize("kind", KINDS)
def test_the_options_matter(kind):
    trace = make_trace(kind, 3, n_rays=60, max_level=8)
    n_requests = {
        text: sum(is_request for _, is_request in replayed(trace, text, ()))
        for text in (
            "stack", "stack:live", "stack:level=2", "stack:persist", "stack:restart", "stack:pop", "stack:pop:restart",
            "stack:pop:persist", "push", "ttp",
        )
    }  # fmt: skip
    assert len(set(n_requests.values())) == 10 and min(n_requests.values()) > 0, n_requests
    assert n_requests["stack:live"] < n_requests["stack"] > n_requests["stack:level=2"]
