"""Summaries of parts, joined: equal to the summary of the whole in every array, for any cuts and in any order of joining."""

from functools import reduce
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cachesim.access import PREFETCH
from cachesim.all_associativity import SetCounts
from cachesim.cache import n_resident_unused
from cachesim.cache_counts import CacheCounts
from cachesim.config import CacheConfig
from cachesim.fast_lru import LruCounts
from cachesim.prefetch import parse_prefetch
from cachesim.stack_distance import StackDistances
from tests.reference.cache import Cache

N_LINES, AHEAD = 40, 3
TYPES = [0, 0, 0, 2, 3, 8, 11, 11]


def mixed(n, n_lines, seed):
    """Return (line, access type) pairs: half of them anywhere, the others near the one before."""
    rng = np.random.default_rng(seed)
    lines = np.where(rng.random(n) < 0.5, rng.integers(0, n_lines, n), np.cumsum(rng.integers(-2, 3, n)) % n_lines)
    return list(zip(lines.tolist(), rng.choice(TYPES, n).tolist(), strict=True))


# Mostly from a generator: short lists of unlike lines, which are easy to find, leave nothing to be joined.
accesses = st.one_of(
    st.lists(st.tuples(st.integers(0, 9), st.sampled_from(TYPES)), max_size=12),
    *[st.builds(mixed, st.integers(0, 150), st.integers(1, N_LINES), st.integers(0, 1 << 20))] * 3,
)
shapes = st.tuples(st.integers(1, 6), st.integers(1, 4) | st.just(7), st.booleans(), st.booleans())


def columns(trace):
    lines, types = np.array(trace, np.int64).reshape(-1, 2).T
    return lines.astype(np.uint32), types.astype(np.uint8)


def lru_counts(n_sets, ways):
    def of(trace):
        summary = LruCounts(CacheConfig(n_sets * ways * 16, ways, 16))
        summary.step(*columns(trace))
        return summary

    return of


def exact(n_sets, ways, three_c, is_sequential):
    prefetch = parse_prefetch(f"next-line:always:{AHEAD}" if is_sequential else "traced")

    def of(trace):
        summary = CacheCounts(CacheConfig(n_sets * ways * 16, ways, 16), prefetch, three_c=three_c)
        lines, types = columns(trace)
        summary.step(lines, types, lines, lines + np.uint32(AHEAD), N_LINES + AHEAD, None, 0)
        return summary

    return of


def set_counts(exponents, ways):
    configs = [CacheConfig((16 << k) * ways, ways, 16) for k in exponents]

    def of(trace):
        summary = SetCounts(configs)
        summary.step(*columns(trace))
        return summary

    return of


def stack_distances(trace):
    summary = StackDistances()
    summary.step(*columns(trace), N_LINES)
    return summary


def then(one, other):
    return one.then(other)


def assert_same(one, other):
    arrays, others = one.arrays(), other.arrays()
    assert arrays.keys() == others.keys()
    for name, array in arrays.items():
        assert array.tolist() == others[name].tolist(), name


def assert_fold(of, trace, cuts):
    """Join the parts from the left, from the right, and the halves of halves; nothing joined may change."""
    edges = [0, *sorted(min(cut, len(trace)) for cut in cuts), len(trace)]
    parts = [of(trace[a:b]) for a, b in pairwise(edges)]
    before = [{name: array.copy() for name, array in part.arrays().items()} for part in parts]
    whole = of(trace)

    def halves(parts):
        middle = len(parts) // 2
        return parts[0] if len(parts) == 1 else then(halves(parts[:middle]), halves(parts[middle:]))

    for joined in (reduce(then, parts), reduce(lambda later, one: then(one, later), reversed(parts)), halves(parts)):
        assert_same(joined, whole)
    for part, arrays in zip(parts, before, strict=True):
        assert {name: array.tolist() for name, array in part.arrays().items()} == {
            name: array.tolist() for name, array in arrays.items()
        }


cuts = st.lists(st.integers(0, 150), max_size=5)


@settings(max_examples=300)
@given(accesses, cuts, shapes)
def test_counts_alone(trace, cuts, shape):
    assert_fold(lru_counts(*shape[:2]), trace, cuts)


@settings(max_examples=400)
@given(accesses, cuts, shapes)
def test_the_account_and_three_kinds_of_misses(trace, cuts, shape):
    assert_fold(exact(*shape), trace, cuts)


@settings(max_examples=300)
@given(accesses, cuts, st.sets(st.integers(0, 4), min_size=1, max_size=3), st.sampled_from([1, 2, 19, 35]))
def test_all_associativities(trace, cuts, exponents, ways):
    assert_fold(set_counts(exponents, ways), trace, cuts)


@settings(max_examples=200)
@given(accesses, cuts)
def test_stack_distances(trace, cuts):
    assert_fold(stack_distances, trace, cuts)


@pytest.mark.parametrize(
    "of",
    [
        lru_counts(3, 1), lru_counts(4, 2), lru_counts(3, 4), lru_counts(1, 16), exact(3, 2, False, False),
        exact(4, 3, True, False), exact(1, 8, True, True), set_counts([1, 2, 3], 4), stack_distances,
    ],
)  # fmt: skip
def test_a_cut_at_every_access(of):
    trace = mixed(150, N_LINES, 1)
    whole = of(trace)
    for cut in range(len(trace) + 1):
        assert_same(then(of(trace[:cut]), of(trace[cut:])), whole)


def test_many_lines_in_a_sweep():
    """Sets of several vectors fill up at some numbers of sets and not at others."""
    trace = [(line % 4000, kind) for line, kind in mixed(12_000, 4000, 2)]
    for cuts in ([6_000], [100, 3_000, 11_900]):
        assert_fold(set_counts([2, 5, 8], 20), trace, cuts)


@settings(max_examples=200)
@given(accesses, cuts, shapes)
def test_joined_parts_count_as_the_model(trace, cuts, shape):
    """Not only as our own replay of the whole."""
    n_sets, ways, three_c, is_sequential = shape
    edges = [0, *sorted(min(cut, len(trace)) for cut in cuts), len(trace)]
    joined = reduce(then, [exact(*shape)(trace[a:b]) for a, b in pairwise(edges)])
    model = Cache(CacheConfig(n_sets * ways * 16, ways, 16)).replay(trace, "always" if is_sequential else None, AHEAD)
    assert joined.misses.tolist() == model.counts["misses"]
    assert joined.cache.account.tolist() == [model.useful, model.useless, model.pollution]
    assert n_resident_unused(joined.cache) == len(model.unused)
    if three_c:
        for which, kind in enumerate(("compulsory", "capacity", "conflict"), 2):
            assert joined.row(which).tolist() == model.counts[kind]


def test_sizes_of_summaries():
    """Counts alone: bounded by the cache, however long the part."""
    summary = lru_counts(64, 4)([(line % 5000, 0) for line in range(20_000)])
    arrays = summary.arrays()
    assert arrays["open_lines"].size == arrays["tags"].size == 256
    assert (arrays["open_types"] < PREFETCH).all()
    assert sum(arrays[name].nbytes for name in ("tags", "open_lines", "open_types")) == 13 * 256  # as docs/scale.md states
