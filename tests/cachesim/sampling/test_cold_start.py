"""Replay from an unknown start: known and unknown references, compared with a cache that saw the whole trace."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cachesim.access import PREFETCH
from cachesim.config import CacheConfig
from cachesim.sampling.cold_start import ALONE, DEMAND, REQUESTS, KnownReplay, check_lru
from tests.reference.cache import Contents

LABELS = np.array([0, 11], np.uint8)  # a read, a prefetch


def truth(lines, labels, config, start):
    """Return the misses after ``start`` of a cache that saw everything: A, B's demand accesses, B's requests."""
    found = [0, 0, 0]
    alone, both = Contents(config.n_sets, config.ways, "lru"), Contents(config.n_sets, config.ways, "lru")
    for i, (line, label) in enumerate(zip(lines.tolist(), labels.tolist(), strict=True)):
        misses = not both.access(line)[0]
        found[REQUESTS if label & PREFETCH else DEMAND] += misses and i >= start
        if not label & PREFETCH:
            found[ALONE] += (not alone.access(line)[0]) and i >= start
    return found


streams = st.tuples(
    st.lists(st.tuples(st.integers(0, 11), st.booleans()), min_size=1, max_size=60),
    st.integers(0, 30), st.integers(0, 20), st.sampled_from([(1, 1), (2, 1), (1, 2), (2, 2), (4, 1), (2, 3), (1, 4)]),
)  # fmt: skip


@given(streams)
def test_certain_and_open_misses_bracket_the_truth(drawn):
    events, start, warm, (n_sets, ways) = drawn
    lines = np.array([line for line, _ in events], np.uint32)
    labels = LABELS[[int(is_prefetch) for _, is_prefetch in events]]
    config = CacheConfig(32 * n_sets * ways, ways, 32)
    start = min(start, lines.size)
    begin = max(start - warm, 0)
    replay = KnownReplay([config])
    replay.step(lines[begin:start], labels[begin:start])
    found = replay.step(lines[start:], labels[start:])
    true = truth(lines, labels, config, start)
    assert (found.misses[0] <= true).all() and (true <= found.misses[0] + found.unknown[0]).all()
    assert found.accesses + found.prefetches == lines.size - start


@given(streams)
def test_from_the_start_of_the_trace_nothing_is_open(drawn):
    events, cut, _, (n_sets, ways) = drawn
    lines = np.array([line for line, _ in events], np.uint32)
    labels = LABELS[[int(is_prefetch) for _, is_prefetch in events]]
    config = CacheConfig(32 * n_sets * ways, ways, 32)
    cut = min(cut, lines.size)
    replay = KnownReplay([config], from_start=True)
    replay.step(lines[:cut], labels[:cut])
    found = replay.step(lines[cut:], labels[cut:])
    assert found.misses[0].tolist() == truth(lines, labels, config, cut)
    assert not found.unknown.any()


def test_open_misses_occur_and_end():
    config = CacheConfig(64, 2, 32)
    replay = KnownReplay([config])
    first = replay.step(np.array([1, 2], np.uint32), np.zeros(2, np.uint8))
    assert first.unknown[0].tolist() == [2, 2, 0] and not first.misses.any()
    second = replay.step(np.array([3, 2, 1], np.uint32), np.zeros(3, np.uint8))
    assert second.misses[0].tolist() == [2, 2, 0] and not second.unknown.any()


def test_what_cannot_be_replayed_from_an_unknown_start():
    with pytest.raises(ValueError, match="fifo"):
        check_lru([CacheConfig(1024, 2, 32, "fifo")])
    with pytest.raises(ValueError, match="one line size"):
        check_lru([CacheConfig(1024, 2, 32), CacheConfig(1024, 2, 64)])
