"""Numbers that are larger than a narrow type: they work, or are one sentence. No table here is large; limits are lowered."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cachesim import line_ids, replacement
from cachesim.cache import make_cache
from cachesim.clock.parameters import PRESETS
from cachesim.clock.state import BY_LEAF, TALLY
from cachesim.clock.timing import time_run
from cachesim.config import CacheConfig
from cachesim.flush import FlushedSource
from cachesim.line_ids import DenseIds
from cachesim.lines import AddressLines
from cachesim.prefetch import parse_prefetch
from cachesim.reads import reads_of
from cachesim.replay import replay
from cachesim.source import RunSource
from nptrace_base.errors import NptraceError
from tests.reference.clock_cases import Case, fast_account
from tests.reference.traces import Trace, make_trace, write


@dataclass
class Wide(Trace):
    """A trace whose nodes have 1024 bytes: 256 lines of 4 bytes."""

    node_bytes = 1024


@pytest.fixture(scope="module")
def wide(tmp_path_factory):
    trace = make_trace("bvh", 3)
    trace = Wide(**vars(trace))
    return trace, write(trace, tmp_path_factory.mktemp("wide") / "wide-bvh")


def visits_of(trace):
    return [node for node, kind in trace.node_kinds if kind != 3]


def test_a_node_may_have_more_lines_than_a_byte_counts(wide):
    trace, run = wide
    roomy = CacheConfig("1M", 1, 4)
    (timing,) = time_run(run, [roomy], [PRESETS["paper"].clock], ["none"])
    assert timing.reads == 256 * len(visits_of(trace))
    assert timing.lines["misses"] + timing.lines["joined_by_demand"] == 256 * len(set(visits_of(trace)))


def test_a_flush_and_merged_reads_know_all_lines_of_a_node(wide):
    trace, run = wide
    flushed = FlushedSource(RunSource(run), [CacheConfig("1M", 1, 4)])
    (result,) = replay(flushed, [CacheConfig("1M", 1, 4)], prefetch="none")
    of_rays = {(ray, node) for ray, node, kind in trace.rows if kind != 3}
    assert result.misses.sum() == 256 * len(of_rays)
    batches = reads_of(RunSource(run), "merged", 4).events(parse_prefetch("none"))
    read = [int(node) for nodes, _ in batches for node in nodes]
    again = [node for i, node in enumerate(visits_of(trace)) if i == 0 or node != visits_of(trace)[i - 1]]
    assert read == again


addresses = st.lists(st.one_of(st.integers(0, (1 << 32) - 1), st.integers((1 << 32) - 9, (1 << 32) - 1)), min_size=1)


@given(addresses, st.integers(0, 62), st.integers(1, 9))
def test_lines_of_addresses_are_quotients(where, exponent, size):
    line_bytes = 1 << exponent
    where = [each for each in where if each + size <= 1 << 32] or [0]
    lines, _ = AddressLines(line_bytes, 0).accesses((np.array(where, np.uint32), size), np.zeros(len(where), np.uint8))
    quotients = [range(each // line_bytes, (each + size - 1) // line_bytes + 1) for each in where]
    assert lines.tolist() == [line for pieces in quotients for line in pieces]


def test_a_line_as_large_as_memory_is_one_line(tmp_path):
    path = tmp_path / "x.din"
    path.write_text("0 0\n0 ffffffff\n2 80000000\n0 7ffffffc\n")
    for size in ("4G", "8G", "1T"):
        (result,) = replay(path, [CacheConfig(size, 1, size)])
        assert (result.accesses.sum(), result.misses.sum()) == (4, 1)


@pytest.mark.parametrize(("line_bytes", "ahead", "is_kept"), [(1, 0, True), (1, 1, False), (2, 999_999, True)])
def test_a_prefetcher_never_leaves_32_bits(line_bytes, ahead, is_kept):
    if is_kept:
        AddressLines(line_bytes, ahead)
        return
    with pytest.raises(NptraceError, match="2\\^32 lines of 1 B, and a prefetcher that goes 1 further .* use longer lines"):
        AddressLines(line_bytes, ahead)


def test_more_lines_than_ids(monkeypatch):
    monkeypatch.setattr(line_ids, "MOST_SLOTS", 1 << 12)
    dense = DenseIds()
    dense.ids(np.arange(1 << 11, dtype=np.uint32))
    with pytest.raises(NptraceError, match="more than 2,048 lines, which is the most; use longer lines"):
        dense.ids(np.arange(1 << 12, dtype=np.uint32))


def test_more_sets_and_lines_than_links(monkeypatch):
    monkeypatch.setattr(replacement, "MOST_NODES", 100)
    make_cache(CacheConfig(50 * 32), 50, three_c=False)
    with pytest.raises(NptraceError, match="of 50 sets and a trace of 51 lines are more than 2\\^31 - 1 together"):
        make_cache(CacheConfig(50 * 32), 51, three_c=False)


def test_sets_without_a_common_multiple_cannot_be_flushed_together(wide):
    sizes = [32 * n for n in (3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47, 53, 59)]
    with pytest.raises(NptraceError, match="needs more than 2\\^31 line numbers .* replay fewer caches at a time"):
        FlushedSource(RunSource(wide[1]), [CacheConfig(size) for size in sizes])


@pytest.mark.parametrize(("size", "line"), [(1 << 63, 1 << 63), (1 << 63, 32), (32, 1 << 80), (10**30, 32)])
def test_sizes_that_no_table_of_results_holds(size, line):
    with pytest.raises(NptraceError, match="beyond the largest address, 2\\^62; take a smaller cache, or shorter lines"):
        CacheConfig(size, 1, line)


@settings(suppress_health_check=[HealthCheck.too_slow], max_examples=10)
@given(st.integers(0, 1 << 20), st.integers(1, 4))
def test_a_leaf_of_any_size_is_a_class(seed, n_slots):
    case, scale = Case("bvh", seed, 32, 0), 70_000
    case.tree = case.tree._replace(n_prims=case.tree.n_prims * np.uint32(scale))
    numbers = {
        "hit": 1, "extra": 9, "mshrs": 4, "ports": 1, "transfer": 0, "box": 1, "triangle": 9, "every": 0, "n_units": 0
    }  # fmt: skip
    account = fast_account(case, numbers, CacheConfig(128, 1, 32), n_slots, "stack", by=BY_LEAF)
    tally = np.array(account["tally"])
    assert not np.delete(tally, np.arange(0, len(tally), scale), axis=0)[:, TALLY.index("late") :].any()
