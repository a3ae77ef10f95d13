"""The exact replay against an obvious model, and laws that hold for every trace."""

import os
import subprocess
import sys
from itertools import pairwise
from math import gcd
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cachesim import fast_lru
from cachesim import replay as replaying
from cachesim.config import CacheConfig
from cachesim.filter import DirectFilter
from cachesim.lines import AddressLines
from cachesim.prefetch import parse_prefetch
from cachesim.replay import replay
from tests.reference.cache import Cache, pieces
from tests.reference.traces import make_trace, write
from traces.din import export_din
from traces.identity import RunIdentity

ROOT = Path(__file__).resolve().parents[2]
KINDS = ("compulsory", "capacity", "conflict")


class Listed:
    """A source from a list of (address, size, label), in batches that end at ``cuts``."""

    identity, n_rays, n_events, layout = RunIdentity("listed"), None, None, "stored"

    def __init__(self, accesses, cuts=()):
        edges = [0, *sorted(cuts), len(accesses)]
        self.batches = [accesses[a:b] for a, b in pairwise(edges)]

    def check_passes(self, n_passes):
        pass

    def events(self, prefetch):
        for batch in self.batches:
            kept = [event for event in batch if prefetch.kind == "traced" or event[2] < 8]
            address, size, label = (np.array([event[i] for event in kept], np.int64) for i in range(3))
            yield (address.astype(np.uint32), size), label.astype(np.uint8)

    def lines(self, line_bytes, ahead):
        return AddressLines(line_bytes, ahead)


configs = st.builds(
    lambda sets, ways, line, policy, seed: CacheConfig(sets * ways * line, ways, line, policy, seed),
    st.integers(1, 5), st.integers(1, 5) | st.integers(17, 19), st.sampled_from([4, 16, 16, 32]),
    st.sampled_from(["lru", "lru", "fifo", "random"]), st.integers(0, 3),
)  # fmt: skip
events = st.lists(
    st.tuples(
        st.integers(0, 15).map(lambda part: 16 * part) | st.integers(0, 700),
        st.sampled_from([4, 8, 40]),
        st.sampled_from([0, 0, 0, 2, 3, 8, 11, 10]),
    ),
    max_size=120,
)
prefetchers = st.sampled_from(["none", "traced", "next-line:always", "next-line:miss", "next-line:tagged", "next-line:miss:3"])


def demand(trace):
    return [event for event in trace if event[2] < 8]


def by_the_model(trace, config, prefetch):
    policy = parse_prefetch(prefetch)
    trigger = prefetch.split(":")[1] if policy.kind == "next-line" else None
    seen = trace if prefetch == "traced" else demand(trace)
    return Cache(config).replay(pieces(seen, config.line_bytes), trigger, policy.distance)


@settings(max_examples=400)
@given(events, configs, prefetchers)
def test_every_count_is_that_of_the_model(trace, config, prefetch):
    [result] = replay(Listed(trace), [config], prefetch=prefetch, three_c=True, threads=1)
    model = by_the_model(trace, config, prefetch)
    for name, counts in model.counts.items():
        assert getattr(result, name).tolist() == counts, name
    for name in ("useful", "useless", "pollution"):
        assert getattr(result, name) == getattr(model, name), name
    assert result.resident == len(model.unused)
    assert result.demand_misses_without == sum(by_the_model(trace, config, "none").counts["misses"])
    seen = trace if prefetch == "traced" else demand(trace)
    assert result.n_splits == len(pieces(seen, config.line_bytes)) - len(seen)


@given(events, st.lists(configs, min_size=1, max_size=4), prefetchers, st.booleans())
def test_accounts_close(trace, grid, prefetch, three_c):
    for result in replay(Listed(trace), grid, prefetch=prefetch, three_c=three_c):
        values = result.to_dict()
        assert values["prefetch_accesses"] == values["redundant"] + values["filled"]
        assert values["filled"] == values["useful"] + values["useless"] + values["resident"]
        assert values["bytes_from_memory"] == (values["demand_misses"] + values["filled"]) * values["line_bytes"]
        assert 0 <= values["pollution"] <= values["demand_misses"]
        if three_c:
            assert sum(values[kind] for kind in KINDS) == values["demand_misses"]
        else:
            assert not set(KINDS) & set(values)


@given(events, configs, prefetchers, st.lists(st.integers(0, 120), max_size=5), st.booleans())
def test_batches_make_no_difference(trace, config, prefetch, cuts, three_c):
    whole, cut = (
        replay(Listed(trace, places), [config], prefetch=prefetch, three_c=three_c)[0].to_dict() for places in ((), cuts)
    )
    assert whole == cut


@given(events, configs, prefetchers)
def test_together_or_alone_and_with_any_number_of_threads(trace, config, prefetch):
    other = CacheConfig(256, 2, 16)
    [alone] = replay(Listed(trace), [config], prefetch=prefetch, threads=1)
    together = replay(Listed(trace), [other, config, other], prefetch=prefetch, threads=2)
    assert alone.to_dict() == together[1].to_dict()
    assert together[0].to_dict() == together[2].to_dict()


@given(events, st.integers(1, 4), st.sampled_from([4, 16]), st.sampled_from(["none", "traced"]))
def test_more_ways_never_miss_more(trace, n_sets, line, prefetch):
    """LRU keeps what fewer ways keep, so misses can only fall; a fully associative cache has no conflicts."""
    grid = [CacheConfig(n_sets * ways * line, ways, line) for ways in (1, 2, 3, 4, 6, 16, 20)]
    results = replay(Listed(trace), grid, prefetch=prefetch, three_c=True)
    for fewer, more in pairwise(results):
        assert more.demand_misses <= fewer.demand_misses
        assert sum(more.misses) <= sum(fewer.misses)
    if n_sets == 1:
        assert not any(result.conflict.sum() for result in results)


@settings(max_examples=30)
@given(st.lists(st.integers(0, 5), max_size=8))
def test_an_inserted_prefetch_never_saves_a_fill_when_direct_mapped(lines):
    """A set's fills are the changes in its sequence of lines; inserting a line removes none.

    Direct mapped only: with two LRU ways `a b c a` fills four lines and `a b a c a` three.
    """
    grid = [CacheConfig(n * 4, 1, 4) for n in (1, 2, 3)]
    trace = [(4 * line, 4, 0) for line in lines]
    alone = [sum(result.misses) for result in replay(Listed(trace), grid, threads=1)]
    for at in range(len(trace) + 1):
        for line in range(6):
            inserted = [*trace[:at], (4 * line, 4, 11), *trace[at:]]
            for result, fills in zip(replay(Listed(inserted), grid, threads=1), alone, strict=True):
                assert sum(result.misses) >= fills


def test_two_ways_can_save_a_fill():
    def fills(letters):
        trace = [(4 * (ord(letter) - ord("a")), 4, 0) for letter in letters]
        return replay(Listed(trace), [CacheConfig(8, 2, 4)])[0].demand_misses

    assert fills("abca") == 4
    assert fills("abaca") == 3


@pytest.mark.parametrize("ways", [1, 2])
@pytest.mark.parametrize("n_sets", [1, 7, 8])
def test_the_fast_paths_count_as_the_exact_one(ways, n_sets):
    rng = np.random.default_rng(ways * n_sets)
    lines, labels = rng.zipf(1.3, 3000) % 97, rng.choice([0, 2, 3], 3000)
    trace = [(int(4 * line), 4, int(label)) for line, label in zip(lines, labels, strict=True)]
    config = CacheConfig(n_sets * ways * 4, ways, 4)
    assert ways <= fast_lru.MAX_WAYS
    [fast], [exact] = (replay(Listed(trace), [config], prefetch="none", three_c=three_c) for three_c in (False, True))
    assert fast.misses.tolist() == exact.misses.tolist()
    assert 0 < fast.demand_misses < 3000


def test_random_is_a_function_of_its_seed():
    rng = np.random.default_rng(5)
    trace = [(int(4 * line), 4, 0) for line in rng.integers(0, 60, 2000)]
    first, again, other, with_3c = (
        replay(Listed(trace), [CacheConfig(128, 4, 4, "random", seed)], prefetch="none", three_c=three_c)[0].demand_misses
        for seed, three_c in ((1, False), (1, False), (2, False), (1, True))
    )
    assert first == again == with_3c != other


def test_rates_by_name_with_their_denominators():
    """Four lines in two sets; the prefetch of line 2 evicts line 0, which is demanded again: pollution."""
    trace = [(0, 4, 0), (4, 4, 0), (8, 4, 11), (0, 4, 0), (12, 4, 11), (12, 4, 0), (12, 4, 11)]
    values = replay(Listed(trace), [CacheConfig(8, 1, 4)])[0].to_dict()
    assert (values["demand_accesses"], values["demand_misses"], values["demand_misses_without"]) == (4, 3, 3)
    assert (values["prefetch_accesses"], values["redundant"], values["filled"]) == (3, 1, 2)
    assert (values["useful"], values["useless"], values["resident"], values["pollution"]) == (1, 1, 0, 1)
    assert values["demand_miss_rate"] == 3 / 4
    assert values["paper_miss_rate"] == 5 / 7
    assert values["accuracy"] == 1 / 2
    assert values["coverage"] == 0
    assert values["traffic_ratio"] == 5 / 3
    assert values["bytes_from_memory"] == 20


def test_a_rate_without_a_denominator_is_null():
    values = replay(Listed([]), [CacheConfig(8, 1, 4)])[0].to_dict()
    for name in ("demand_miss_rate", "paper_miss_rate", "accuracy", "coverage", "traffic_ratio"):
        assert values[name] is None


def test_ids_grow_with_the_lines_of_a_trace():
    """Twenty thousand lines, some at the top of the address space, through the table that numbers them as they appear."""
    rng = np.random.default_rng(11)
    address = np.concatenate([rng.integers(0, 1 << 32, 20_000) & ~3, np.arange(0, 1 << 18, 16)])
    trace = [(int(a), 4, 0) for a in rng.permutation(np.repeat(address, 2))]
    config = CacheConfig(1024, 4, 16)
    [result] = replay(Listed(trace, [9_000, 30_000]), [config], prefetch="next-line:tagged", three_c=True)
    model = Cache(config).replay(pieces(trace, 16), "tagged")
    assert {name: getattr(result, name).tolist() for name in model.counts} == model.counts


MEASURE = """
import sys
from cachesim.config import CacheConfig
from cachesim.replay import replay
for path in sys.argv[1:]:
    replay(path, [CacheConfig(8192, 2), CacheConfig(8192, 1, 8)], three_c=True)
    status = open("/proc/self/status").read().split()
    print(int(status[status.index("VmHWM:") + 1]) // 1024)
"""


def measure(paths):
    """Return the highest memory in MB that a process of its own has had after each replay."""
    args = [sys.executable, "-c", MEASURE, *map(str, paths)]
    return [int(peak) for peak in subprocess.run(args, check=True, capture_output=True, text=True, cwd=ROOT).stdout.split()]


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize(("form", "rows"), [("run", (3e6, 12e6)), ("text", (1e6, 9e6)), ("binary", (1e6, 9e6))])
@pytest.mark.slow
def test_memory_does_not_grow_with_the_trace(tmp_path, form, rows):
    trace = make_trace("bvh", 1, n_rays=400, max_level=12)
    paths = []
    for name, n in zip(("short", "long"), rows, strict=True):
        run = write(trace, tmp_path / f"{name}-bvh", repeat=int(n) // len(trace.rows) + 1)
        assert run.n_accesses > n
        paths.append(run.path)
        if form != "run":
            paths[-1] = tmp_path / f"{name}.din"
            export_din(run, paths[-1], fmt=form)
    measure([paths[0]])  # compiles, which takes memory of its own
    # Threads overlap otherwise from one replay to the next, so the first does not yet show the peak of a short trace.
    *_, short, long = measure([*paths[:1] * 3, paths[1]])
    assert long < short + 30, "MB"  # one uint32 for each access more would be 32 at least
    assert long < 300 + 30 * (os.cpu_count() or 1), "MB"  # each thread has a part of a run, and so batches of its own


# The exact filter


def spied_filters(monkeypatch, least):
    """Let replay use filters of ``least`` sets and more, and return the list of those it makes."""
    made = []

    class Spied(DirectFilter):
        def __init__(self, n_sets, **options):
            super().__init__(n_sets, **options)
            made.append((n_sets, self))

    monkeypatch.setattr(replaying, "DirectFilter", Spied)
    monkeypatch.setattr(replaying, "LEAST_FILTER", least)
    return made


caches = st.builds(
    lambda sets, ways, line, policy: CacheConfig(sets * ways * line, ways, line, policy),
    st.sampled_from([1, 2, 4, 6, 8, 12]), st.integers(1, 4), st.sampled_from([4, 16, 16]),
    st.sampled_from(["lru", "lru", "fifo", "random"]),
)  # fmt: skip


@settings(max_examples=300)
@given(events, st.lists(caches, min_size=1, max_size=4), prefetchers, st.booleans(), st.lists(st.integers(0, 120), max_size=3))
def test_the_filter_changes_no_result(trace, grid, prefetch, three_c, cuts):
    with pytest.MonkeyPatch.context() as patch:
        made = spied_filters(patch, 2)
        plain = replay(Listed(trace), grid, prefetch=prefetch, three_c=three_c, is_filtered=False, threads=1)
        assert not made
        found = replay(Listed(trace, cuts), grid, prefetch=prefetch, three_c=three_c, threads=1)
    if three_c or "next-line" in prefetch:
        assert not made
    served = {c.line_bytes: gcd(*(d.n_sets for d in grid if d.line_bytes == c.line_bytes and d.n_sets > 1)) for c in grid}
    if prefetch in ("none", "traced") and not three_c:
        assert sorted(n for n, _ in made) == sorted(n for n in served.values() if n > 1)
    for a, b in zip(plain, found, strict=True):
        assert a.to_dict() == b.to_dict()
        assert a.n_splits == b.n_splits
        for name in ("accesses", "misses"):
            assert getattr(a, name).tolist() == getattr(b, name).tolist()


@pytest.mark.parametrize("kind", ["kdtree", "bvh"])
@pytest.mark.parametrize("prefetch", ["none", "traced", "stack:tris*2:once"])
@pytest.mark.parametrize("layout", ["stored", "stored+8", "veb"])
def test_the_filter_changes_no_result_of_a_run(tmp_path, monkeypatch, kind, prefetch, layout):
    run = write(make_trace(kind, 3, n_rays=300, max_level=9), tmp_path / "run")
    grid = [CacheConfig(sets * ways * line, ways, line) for line in (32, 64) for sets in (16, 32, 48) for ways in (1, 2, 4)]
    made = spied_filters(monkeypatch, 16)
    plain = replay(run, grid, prefetch=prefetch, layout=layout, is_filtered=False)
    found = replay(run, grid, prefetch=prefetch, layout=layout)
    assert [n for n, _ in made] == [16, 16]
    for _, direct in made:
        assert direct.n_dropped_demand > run.n_accesses // 30
        assert (direct.n_dropped_prefetches > 0) == (prefetch != "none")
    assert [a.to_dict() for a in plain] == [b.to_dict() for b in found]
    n_dropped = sum(direct.n_dropped_demand + direct.n_dropped_prefetches for _, direct in made)
    assert n_dropped < 2 * sum(plain[0].accesses) + plain[0].n_splits + plain[-1].n_splits
