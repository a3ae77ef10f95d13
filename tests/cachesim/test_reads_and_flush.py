"""What a visit reads, and a cache emptied after every ray, against obvious models that need neither renaming nor state."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cachesim import source
from cachesim.config import CacheConfig
from cachesim.flush import FlushedSource, emptied
from cachesim.prefetch import parse_prefetch
from cachesim.reads import reads_of
from cachesim.replay import replay
from cachesim.source import DinSource, RunSource
from nptrace_base.errors import NptraceError
from tests.reference.cache import Cache
from tests.reference.traces import make_trace, write
from traces.din import DinTrace

KINDS = ("kdtree", "bvh")
GRID = [CacheConfig(256, 1, 32), CacheConfig(256, 2, 32), CacheConfig(192, 2, 32), CacheConfig(128, 4, 32, "fifo")]


def events_of(source, prefetch):
    batches = source.events(parse_prefetch(prefetch))
    return [(int(node), bool(type_)) for batch in batches for node, type_ in zip(*batch, strict=True)]


def lines_of(trace, node, layout_base=0):
    first = trace.addresses[node] + layout_base
    return list(range(first // 32, (first + trace.node_bytes - 1) // 32 + 1))


def slow_children(trace):
    made = []
    for node, kind in trace.node_kinds:
        below = [trace.child[node], trace.child[node] + 1] if trace.child[node] else []
        if kind == 3:
            made += [(child, True) for child in below]
            continue
        if node == 0:
            made.append((0, False))
        if kind == 1 or (kind == 0 and trace.kind == "kdtree"):
            made += [(child, False) for child in below]
    return made


def slow_merged(trace):
    made, held = [], []
    for node, kind in trace.node_kinds:
        lines = lines_of(trace, node, 24)
        if kind == 3 or not set(lines) <= set(held):
            made.append((node, kind == 3))
        if kind != 3 and not set(lines) <= set(held):
            held = lines
    return made


@pytest.mark.parametrize("kind", KINDS)
@given(seed=st.integers(0, 1 << 20), batch=st.integers(1, 60))
def test_what_a_visit_reads_is_that_of_the_model(kind, seed, batch, tmp_path_factory):
    trace = make_trace(kind, seed, n_rays=8)
    run = write(trace, tmp_path_factory.mktemp("run") / f"x-{kind}")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(source, "BATCH", batch)
        assert events_of(reads_of(RunSource(run), "children", 32), "stack") == slow_children(trace)
        assert events_of(reads_of(RunSource(run, "stored+24"), "merged", 32), "stack") == slow_merged(trace)
        assert events_of(reads_of(RunSource(run), "own", 32), "stack") == trace.accesses


def slow_flushed(trace, config, reads):
    """Return every count of a cache that is empty when a ray starts, as is what holds the line read last."""
    counts, rows, held = Counter(), {}, []
    for (ray, *_), (node, is_request) in zip(trace.rows, trace.accesses, strict=True):
        if ray not in rows:
            rows[ray], held = [], []
        lines = lines_of(trace, node)
        if is_request or reads == "own" or not set(lines) <= set(held):
            rows[ray].extend((line, 11 if is_request else 0) for line in lines)
            held = held if is_request else lines
    for accesses in rows.values():
        cache = Cache(config).replay(accesses)
        counts["demand_misses"] += sum(cache.counts["misses"][:8])
        counts["prefetch_misses"] += sum(cache.counts["misses"][8:])
        counts["useful"] += cache.useful
        counts["useless"] += cache.useless + len(cache.unused)
        counts["pollution"] += cache.pollution
        alone = Cache(config).replay([access for access in accesses if access[1] < 8])
        counts["demand_misses_without"] += sum(alone.counts["misses"])
    return counts


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=20)
@given(seed=st.integers(0, 1 << 20), batch=st.sampled_from([7, 1 << 18]), reads=st.sampled_from(["own", "merged"]))
def test_a_flush_after_every_ray_is_that_of_the_model(kind, seed, batch, reads, tmp_path_factory):
    trace = make_trace(kind, seed, n_rays=30, max_level=7)
    run = write(trace, tmp_path_factory.mktemp("run") / f"x-{kind}")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(source, "BATCH", batch)
        for is_filtered in (True, False):
            made = FlushedSource(reads_of(RunSource(run), reads, 32, "ray"), GRID)
            found = emptied(replay(made, GRID, prefetch="stack", is_filtered=is_filtered))
            for result, config in zip(found, GRID, strict=True):
                wanted = slow_flushed(trace, config, reads)
                assert {name: getattr(result, name) for name in wanted} == wanted, config
                assert result.resident == 0


def test_a_flush_and_reads_matter(tmp_path):
    """The random traces are such that each option changes counts."""
    run = write(make_trace("kdtree", 5, n_rays=80, max_level=8), tmp_path / "x-kdtree")
    config = [CacheConfig(256, 2, 32)]
    usual, flushed = replay(run, config, prefetch="stack"), emptied(replay(FlushedSource(RunSource(run), config), config))
    assert flushed[0].demand_accesses == usual[0].demand_accesses
    assert flushed[0].demand_misses_without > usual[0].demand_misses_without
    assert flushed[0].pollution > 0 and flushed[0].useful > 0 and flushed[0].useless > 0
    accesses = {
        reads: replay(reads_of(RunSource(run), reads, 32), config)[0].demand_accesses for reads in ("children", "merged")
    }
    assert accesses["merged"] < usual[0].demand_accesses < accesses["children"]


def test_what_cannot_be_flushed_or_read_otherwise_is_refused(tmp_path):
    run = write(make_trace("kdtree", 5, n_rays=8), tmp_path / "x-kdtree")
    for config, prefetch, sentence in (
        (CacheConfig(256, 2, 32, "random"), "stack", "exact for lru and fifo, not for random"),
        (CacheConfig(256, 2, 32, "opt"), "stack", "not for opt"),
        (CacheConfig(256, 2, 32), "next-line:miss", "requests neighbours"),
    ):
        with pytest.raises(NptraceError, match=sentence):
            replay(FlushedSource(RunSource(run), [config]), [config], prefetch=prefetch)
    (tmp_path / "x.din").write_text("0 20\n", encoding="ascii")
    din = DinSource(DinTrace(tmp_path / "x.din"))
    with pytest.raises(NptraceError, match="addresses, not rays"):
        FlushedSource(din, GRID)
    with pytest.raises(NptraceError, match="addresses, not visits"):
        reads_of(din, "children", 32)
    with pytest.raises(NptraceError, match="one size of lines at a time"):
        replay(reads_of(RunSource(run), "merged", 64), GRID[:1])
    with pytest.raises(NptraceError, match="hold both children's boxes"):
        reads_of(RunSource(write(make_trace("bvh64", 5, n_rays=8), tmp_path / "x-bvh64")), "children", 32)


def test_renamed_lines_keep_their_sets_and_are_never_shared(tmp_path):
    trace = make_trace("bvh", 3, n_rays=40)
    flushed = FlushedSource(RunSource(write(trace, tmp_path / "x-bvh")), GRID)
    lines, seen, ray = flushed.lines(32, 0), {}, -1
    for events, types in flushed.events(parse_prefetch("none")):
        numbers, _ = lines.accesses(events, types)
        for node, number in zip(events.tolist(), numbers.tolist(), strict=True):
            ray += node == 0
            assert (number - lines_of(trace, node)[0]) % np.lcm.reduce([each.n_sets for each in GRID]) == 0
            assert seen.setdefault(number, (ray, node)) == (ray, node)
