"""The node stack rebuilt from demand rows: equal to the traced requests, and to an obvious model for every policy."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cachesim import source
from cachesim.config import CacheConfig
from cachesim.policies.stack import UNLIMITED
from cachesim.prefetch import UnitReplay, parse_prefetch
from cachesim.replay import replay
from cachesim.source import RunSource
from tests.reference.cache import Cache, derive
from tests.reference.traces import make_trace, write
from traces.format import ROW_GROUP
from traces.node_formats import NODE_FORMATS

KINDS = ("kdtree", "bvh", "bvh64")


def unit(trace, policy):
    columns = (np.array(column) for column in (trace.n_prims, trace.level, trace.parent))
    return UnitReplay(parse_prefetch(policy), NODE_FORMATS[trace.kind], *columns)


def columns(rows):
    return np.array([node for node, _ in rows], np.uint32), np.array([kind for _, kind in rows], np.uint8)


def run_through(trace, policy, cuts=()):
    """Return (node, is_request) of every event, replayed in batches that end at ``cuts``."""
    nodes, kinds = columns(trace.node_kinds)
    replayed, edges = unit(trace, policy), [0, *sorted(cuts), len(nodes)]
    made = [replayed.events(nodes[a:b], kinds[a:b]) for a, b in pairwise(edges)]
    return [(int(node), bool(label)) for batch in made for node, label in zip(*batch, strict=True)]


def test_the_worked_ray():
    """Seven kd nodes; the ray crosses 3, then 4, then 5, and hits a triangle there (the run format's worked example)."""
    rows = [(0, 1), (1, 1), (3, 2), (4, 2), (2, 0), (5, 2)]
    level, n_prims, parent = np.array([0, 1, 1, 2, 2, 2, 2]), np.array([0, 0, 0, 2, 1, 1, 1]), np.array([-1, 0, 0, 1, 1, 2, 2])
    replayed = UnitReplay(parse_prefetch("stack"), NODE_FORMATS["kdtree"], n_prims, level, parent)
    nodes, labels = replayed.events(*columns(rows))
    assert list(zip(nodes.tolist(), labels.tolist(), strict=True)) == [
        (0, 0), (1, 0), (3, 0), (4, 11), (2, 11), (4, 0), (2, 0), (5, 0)
    ]  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
@given(seed=st.integers(0, 1 << 20), cuts=st.lists(st.integers(0, 100), max_size=4))
def test_unlimited_is_what_was_traced_event_by_event(kind, seed, cuts):
    trace = make_trace(kind, seed, n_rays=8)
    assert run_through(trace, "stack", cuts) == trace.accesses


policies = st.builds(
    lambda budget, once, empty: (budget, once, empty),
    st.sampled_from(["", ":budget=0", ":budget=1", ":budget=3", ":tris*1", ":tris*2", ":unlimited", ":2"]),
    st.booleans(),
    st.booleans(),
)


@pytest.mark.parametrize("kind", KINDS)
@given(seed=st.integers(0, 1 << 20), policy=policies, cuts=st.lists(st.integers(0, 100), max_size=4))
def test_any_policy_is_that_of_the_model(kind, seed, policy, cuts):
    trace = make_trace(kind, seed, n_rays=8)
    text = f"stack{policy[0]}{':once' * policy[1]}{':empty' * policy[2]}"
    parsed = parse_prefetch(text)
    budget = parsed.options.get("budget", UNLIMITED)
    budget = None if budget == UNLIMITED else budget
    per_triangle = parsed.options.get("per_triangle", False)
    wanted = derive(trace.node_kinds, kind, trace.n_prims, budget, per_triangle, policy[1], policy[2])
    assert run_through(trace, text, cuts) == wanted


@pytest.mark.parametrize("kind", KINDS)
def test_policies_differ(kind):
    """The generator does make traces on which every option matters."""
    trace = make_trace(kind, 3, n_rays=60)
    requests = {
        policy: sum(is_request for _, is_request in run_through(trace, policy))
        for policy in ("stack", "stack:budget=1", "stack:tris*1", "stack:empty", "stack:once", "stack:budget=0")
    }
    assert len(set(requests.values())) == (5 if kind == "bvh64" else 6), requests  # the leaves of that have triangles
    assert requests["stack:budget=0"] == 0


@pytest.mark.parametrize("kind", KINDS)
def test_a_run_replays_as_its_model(kind, tmp_path):
    """From Parquet, with stack and traced, and every count by the model on the addresses as stored."""
    trace = make_trace(kind, 7, n_rays=200, max_level=9)
    run = write(trace, tmp_path / f"bunny-{kind}")
    grid = [CacheConfig(512, 2, 32), CacheConfig(256, 1, 16)]
    traced, derived = replay(run, grid, three_c=True), replay(run, grid, prefetch="stack:unlimited", three_c=True)
    for a, b, config in zip(traced, derived, grid, strict=True):
        assert a.to_dict() | {"prefetch": ""} == b.to_dict() | {"prefetch": ""}
        accesses = [
            (line, 11 if is_request else 0)
            for node, is_request in trace.accesses
            for line in range(trace.addresses[node] // config.line_bytes,
                              (trace.addresses[node] + trace.node_bytes - 1) // config.line_bytes + 1)
        ]  # fmt: skip
        model = Cache(config).replay(accesses)
        assert {name: getattr(a, name).tolist() for name in model.counts} == model.counts
        assert (a.useful, a.useless, a.resident, a.pollution) == (
            model.useful, model.useless, len(model.unused), model.pollution
        )  # fmt: skip
        assert a.useful > 0
        assert a.pollution > 0
        assert a.n_splits == len(accesses) - len(trace.accesses)


@pytest.mark.parametrize("prefetch", ["traced", "stack:tris*1", "next-line:tagged"])
def test_small_batches_of_a_run_and_several_row_groups(prefetch, tmp_path, monkeypatch):
    """Every row is replayed once, wherever batches and row groups end."""
    trace = make_trace("kdtree", 9, n_rays=200)
    run, config = write(trace, tmp_path / "x-kdtree"), CacheConfig(128, 2, 16)
    [whole] = replay(run, [config], prefetch=prefetch)
    monkeypatch.setattr(source, "BATCH", 37)
    assert replay(run, [config], prefetch=prefetch)[0].to_dict() == whole.to_dict()
    monkeypatch.undo()
    repeat = ROW_GROUP // len(trace.rows) + 2
    many = write(trace, tmp_path / "many-kdtree", repeat=repeat)
    assert many.n_accesses > ROW_GROUP
    [result] = replay(many, [config], prefetch=prefetch)
    assert result.demand_accesses == whole.demand_accesses * repeat
    if prefetch != "next-line:tagged":
        assert result.prefetch_accesses == whole.prefetch_accesses * repeat


@pytest.mark.parametrize("kind", KINDS)
def test_none_and_next_line_leave_the_traced_requests_out(kind, tmp_path):
    trace = make_trace(kind, 7, n_rays=50)
    replayed = RunSource(write(trace, tmp_path / f"x-{kind}"))
    wanted = [node for node, is_request in trace.accesses if not is_request]
    for text in ("none", "next-line:miss"):
        [(nodes, labels)] = replayed.events(parse_prefetch(text))
        assert nodes.tolist() == wanted
        assert not labels.any()


@pytest.mark.parametrize(
    ("text", "canonical"),
    [
        ("none", "none"), ("traced", "traced"), ("stack", "stack:unlimited"), ("STACK:once", "stack:unlimited:once"),
        ("stack:2", "stack:budget=2"), ("stack:empty:tris*3", "stack:tris*3:empty"),
        ("stack:budget=tris*1", "stack:tris*1"), ("next-line:tagged", "next-line:tagged"),
        ("next-line:miss:4", "next-line:miss:4"), ("next-line:always:1", "next-line:always"),
    ],
)  # fmt: skip
def test_names(text, canonical):
    assert str(parse_prefetch(text)) == canonical
    assert parse_prefetch(canonical) == parse_prefetch(text)


@pytest.mark.parametrize(
    "text",
    ["", "next", "stack:", "stack:budget=x", "stack:1:2", "stack:once:once", "next-line", "next-line:miss:0",
     "next-line:miss:1:2", "none:1", "traced:once", "stack:budget=-1"],
)  # fmt: skip
def test_what_is_not_a_policy(text):
    with pytest.raises(ValueError, match=r"^'"):
        parse_prefetch(text)


@pytest.mark.parametrize(
    ("kind", "rows"),
    [
        ("kdtree", [(1, 0)]),  # does not begin with a root
        ("kdtree", [(0, 2), (1, 2)]),  # pops an empty stack
        ("kdtree", [(0, 1), (1, 2), (3, 2)]),  # pops what was not pushed
        ("bvh", [(0, 0), (1, 2)]),  # missed the root's box, goes on
        ("bvh", [(0, 1), (1, 1), (3, 2), (2, 2)]),  # leaves out a pushed node, whose box it has to read
        ("bvh", [(0, 1), (1, 1), (3, 1), (5, 2), (9, 2)]),  # a node that is not in the tree
        ("kdtree", [(0, 1), (1, 1), (3, 1), (5, 1), (7, 2)]),  # deeper than the tree
        ("bvh64", [(0, 0), (3, 2)]),  # neither a child of the node read nor popped
        ("bvh64", [(0, 1), (1, 0), (5, 2)]),  # popped what was not pushed
        ("bvh64", [(0, 0), (1, 2), (2, 2)]),  # popped an empty stack
    ],
)
def test_a_trace_that_is_not_of_its_tree(kind, rows):
    level, n_prims = np.array([0, 1, 1, 2, 2, 3, 3, 3, 3]), np.ones(9, np.uint32)
    parent = np.array([-1, 0, 0, 1, 1, 3, 3, 4, 4])
    with pytest.raises(ValueError, match="a traversal cannot read node .* after the rows before it"):
        UnitReplay(parse_prefetch("stack"), NODE_FORMATS[kind], n_prims, level, parent).events(*columns(rows))


def test_a_bad_row_is_numbered_from_the_first_batch():
    level, n_prims, parent = np.array([0, 1, 1]), np.array([0, 1, 1]), np.array([-1, 0, 0])
    replayed = UnitReplay(parse_prefetch("stack"), NODE_FORMATS["kdtree"], n_prims, level, parent)
    replayed.events(*columns([(0, 1), (1, 2), (2, 2), (0, 1)]))
    with pytest.raises(ValueError, match="row 6: a traversal cannot read node 1 "):
        replayed.events(*columns([(1, 2), (2, 2), (1, 2)]))
