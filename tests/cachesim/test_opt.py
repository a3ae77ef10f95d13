"""Belady's replacement: the fewest possible misses, never more than another policy, equal to a model that looks ahead."""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cachesim import next_use
from cachesim.cache import grow_cache, make_cache, replay_optimal
from cachesim.config import CacheConfig
from cachesim.replay import replay
from tests.cachesim.test_dinero_golden import din  # noqa: F401 (a fixture)
from tests.cachesim.test_replay import Listed, demand, events
from tests.reference.cache import Cache, pieces
from tests.reference.traces import make_trace, write

shapes = st.builds(
    lambda sets, ways, line: (sets * ways * line, ways, line),
    st.integers(1, 5), st.integers(1, 5) | st.integers(17, 19), st.sampled_from([4, 16, 16, 32]),
)  # fmt: skip
known = st.sampled_from(["none", "traced"])


@settings(max_examples=400)
@given(events, shapes, known, st.lists(st.integers(0, 120), max_size=3))
def test_every_count_is_that_of_the_model(trace, shape, prefetch, cuts):
    config = CacheConfig(*shape, "opt")
    [result] = replay(Listed(trace, cuts), [config], prefetch=prefetch, three_c=True, threads=1)
    accesses = pieces(trace if prefetch == "traced" else demand(trace), config.line_bytes)
    model = Cache(config, future=[line for line, _ in accesses]).replay(accesses)
    for name, counts in model.counts.items():
        assert getattr(result, name).tolist() == counts, name
    for name in ("useful", "useless", "pollution"):
        assert getattr(result, name) == getattr(model, name), name
    assert result.resident == len(model.unused)
    alone = pieces(demand(trace), config.line_bytes)
    without = Cache(config, future=[line for line, _ in alone]).replay(alone)
    assert result.demand_misses_without == sum(without.counts["misses"])


def fewest_misses(lines, n_sets, ways):
    """Return the least misses of any replacement that fills at every miss: all choices of victims are tried."""

    @cache
    def least(at, held):
        if at == len(lines):
            return 0
        line = lines[at]
        if line in held:
            return least(at + 1, held)
        rivals = sorted(other for other in held if other % n_sets == line % n_sets)
        if len(rivals) < ways:
            return 1 + least(at + 1, held | {line})
        return 1 + min(least(at + 1, held - {victim} | {line}) for victim in rivals)

    return least(0, frozenset())


@settings(max_examples=150)
@given(st.lists(st.integers(0, 7), max_size=24), st.sampled_from([(1, 1), (1, 2), (1, 3), (2, 2), (3, 2), (1, 4)]))
def test_no_choice_of_victims_has_fewer_misses(lines, shape):
    n_sets, ways = shape
    trace = [(4 * line, 4, 11 if at % 5 == 4 else 0) for at, line in enumerate(lines)]
    [result] = replay(Listed(trace), [CacheConfig(4 * n_sets * ways, ways, 4, "opt")])
    assert sum(result.misses) == fewest_misses(lines, n_sets, ways)


def rivals_of(size, ways, line):
    others = [("lru", 0), ("fifo", 0), *(("random", seed) for seed in range(3))]
    return [CacheConfig(size, ways, line, policy, seed) for policy, seed in others]


@settings(max_examples=200)
@given(events, shapes, known)
def test_no_other_policy_misses_less(trace, shape, prefetch):
    best, *others = replay(Listed(trace), [CacheConfig(*shape, "opt"), *rivals_of(*shape)], prefetch=prefetch)
    assert all(sum(best.misses) <= sum(other.misses) for other in others)
    assert all(best.demand_misses_without <= other.demand_misses_without for other in others)


@given(events, st.integers(1, 4), st.sampled_from([4, 16]))
def test_more_ways_never_miss_more(trace, n_sets, line):
    grid = [CacheConfig(n_sets * ways * line, ways, line, "opt") for ways in (1, 2, 3, 4, 6, 16, 20)]
    for fewer, more in pairwise(replay(Listed(trace), grid, three_c=True)):
        assert sum(more.misses) <= sum(fewer.misses)
        if n_sets == 1:
            assert not more.conflict.any()


@given(events, shapes, known)
def test_accounts_close(trace, shape, prefetch):
    values = replay(Listed(trace), [CacheConfig(*shape, "opt")], prefetch=prefetch, three_c=True)[0].to_dict()
    assert values["prefetch_accesses"] == values["redundant"] + values["filled"]
    assert values["filled"] == values["useful"] + values["useless"] + values["resident"]
    assert sum(values[kind] for kind in ("compulsory", "capacity", "conflict")) == values["demand_misses"]


def test_one_way_leaves_no_choice():
    rng = np.random.default_rng(2)
    trace = [(int(4 * line), 4, 0) for line in rng.integers(0, 40, 2000)]
    lru, opt = replay(Listed(trace), [CacheConfig(64, 1, 4), CacheConfig(64, 1, 4, "opt")], prefetch="none")
    assert lru.demand_misses == opt.demand_misses > 100


def test_a_loop_one_line_too_long():
    """LRU misses always; OPT keeps all lines but one: of n + 1 lines in turn it misses one in n after the first round."""
    trace = [(4 * (at % 9), 4, 0) for at in range(9 * 80)]
    lru, opt = replay(Listed(trace), [CacheConfig(32, 8, 4), CacheConfig(32, 8, 4, "opt")])
    assert lru.demand_misses == 720
    assert opt.demand_misses == 9 + 711 // 8


@pytest.mark.parametrize("name", ["bst", "bst_pf_label_b", "stream"])
@pytest.mark.parametrize("ways", [1, 2, 8, 64])
def test_no_other_policy_misses_less_on_the_golden_traces(din, name, ways):  # noqa: F811
    shape = (2048, ways, 32)
    best, *others = replay(din / f"{name}.din", [CacheConfig(*shape, "opt"), *rivals_of(*shape)])
    assert all(sum(best.misses) <= sum(other.misses) for other in others)
    if ways > 1:
        assert sum(best.misses) < 0.95 * min(sum(other.misses) for other in others)


# Misses of libCacheSim 0.3.5's Belady, which is fully associative, measured for this project.
LIBCACHESIM = [
    ("bst", 64, 329), ("bst", 256, 292), ("bst_pf_label_b", 64, 389), ("bst_pf_label_b", 256, 332),
    ("stream", 64, 5057), ("stream", 256, 3060),
]  # fmt: skip


@pytest.mark.parametrize(("name", "ways", "misses"), LIBCACHESIM)
def test_another_simulator_counts_the_same(din, name, ways, misses):  # noqa: F811
    [result] = replay(din / f"{name}.din", [CacheConfig(32 * ways, ways, 32, "opt")])
    assert sum(result.misses) == misses


@pytest.mark.parametrize("kind", ["kdtree", "bvh"])
def test_a_run_and_its_derived_requests(tmp_path, kind):
    """From Parquet, in two passes over it; the derived stream is the traced one."""
    run = write(make_trace(kind, 7, n_rays=200, max_level=9), tmp_path / f"x-{kind}")
    configs = [CacheConfig(512, 2, 32, "opt"), CacheConfig(512, 16, 32, "opt"), CacheConfig(512, 2, 32)]
    traced, derived = (replay(run, configs, prefetch=policy, three_c=True) for policy in ("traced", "stack"))
    for a, b in zip(traced, derived, strict=True):
        assert a.to_dict() | {"prefetch": ""} == b.to_dict() | {"prefetch": ""}
    assert sum(traced[1].misses) < sum(traced[0].misses) < sum(traced[2].misses)


def test_room_for_more_lines_changes_nothing():
    rng = np.random.default_rng(6)
    ids, future = rng.integers(0, 40, 800).astype(np.uint32), next_use.NextUse()
    future.add(ids, 40)
    due, labels, counts = future.take(ids.size), np.zeros(ids.size, np.uint8), []
    for is_grown in (False, True):
        cache = make_cache(CacheConfig(32, 4, 4, "opt"), 40, three_c=True)
        for start in range(0, 800, 100):
            piece = slice(start, start + 100)
            replay_optimal(ids[piece], ids[piece], labels[piece], due[piece], start, cache)
            cache = grow_cache(cache, 41 + start) if is_grown else cache
        counts.append(cache.counts.tolist())
    assert counts[0] == counts[1]


def test_what_cannot_be_foreseen_is_refused(monkeypatch):
    with pytest.raises(ValueError, match="opt needs all accesses in advance, but next-line:miss issues requests"):
        replay(Listed([]), [CacheConfig(8, 2, 4, "opt")], prefetch="next-line:miss")
    monkeypatch.setattr(next_use, "MAX_ACCESSES", 10)
    with pytest.raises(ValueError, match="this trace has more than 10 accesses; render a smaller picture, or use lru"):
        replay(Listed([(0, 4, 0)] * 11), [CacheConfig(8, 2, 4, "opt")])
    assert replay(Listed([(0, 4, 0)] * 10), [CacheConfig(8, 2, 4, "opt")])[0].demand_misses == 1
