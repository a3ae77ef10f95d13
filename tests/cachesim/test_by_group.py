"""Counts by pixel, level, node and ray type: those of a slow model, and their sums are the counts of the whole trace."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cachesim import source
from cachesim.by_group import BY, GroupedRecords, events_by, replay_by
from cachesim.config import CacheConfig
from cachesim.prefetch import parse_prefetch
from cachesim.replay import replay
from nptrace_base.errors import NptraceError
from tests.reference.cache import Cache, derive
from tests.reference.traces import make_trace, write

PREFETCHES = ("none", "traced", "stack:tris*2", "stack:1:once", "next-line:always", "next-line:miss:3", "next-line:tagged")
POLICIES = ("lru", "fifo", "random", "opt")
UNITS = {"stack:tris*2": {"budget": 2, "per_triangle": True}, "stack:1:once": {"budget": 1, "once": True}}
KINDS = ("kdtree", "bvh", "bvh64")


class Runs(dict):
    """Traces and runs by kind and seed, which a failure does not print."""

    def __repr__(self):
        return "runs"


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    traces = {(kind, seed): make_trace(kind, seed, n_rays=12) for kind in KINDS for seed in range(4)}
    return Runs({key: (trace, write(trace, folder / f"{key[0]}-{key[1]}")) for key, trace in traces.items()})


def group_of(trace, by, ray, node):
    return {"pixel": ray, "ray-type": ray % 2, "level": trace.level[node], "node": node}[by]


def accesses_of(trace, prefetch, config, by):
    """Return [(line, label, group)], from the rows of each ray apart."""
    absent = {node for node, n in enumerate(trace.n_prims) if n and trace.kind == "bvh64"}
    found = []
    for ray in range(trace.n_rays):
        rows = [row[1:] for row in trace.rows if row[0] == ray]
        if prefetch == "traced":
            events = [(node, kind == 3) for node, kind in rows if kind == 3 or node not in absent]
        else:
            events = derive(rows, trace.kind, trace.n_prims, **UNITS.get(prefetch, {"budget": 0}))
        for node, is_request in events:
            first, group = trace.addresses[node], group_of(trace, by, ray, node)
            for line in range(first // config.line_bytes, (first + trace.node_bytes - 1) // config.line_bytes + 1):
                found.append((line, 11 if is_request else 0, group))
    return found


def by_the_model(trace, config, prefetch, by):
    """Return the counts of each group as a dict, from the obvious cache: what changes in it is of the access's group."""
    accesses = accesses_of(trace, prefetch, config, by)
    policy = parse_prefetch(prefetch)
    trigger = prefetch.split(":")[1] if policy.kind == "next-line" else None
    cache = Cache(config, [line for line, _, _ in accesses]) if config.policy == "opt" else Cache(config)
    counts, filled_by = {}, {}

    def count(name, group, n=1):
        counts[group, name] = counts.get((group, name), 0) + n

    def access(line, label, group):
        is_request = label >= 8
        before = cache.pollution, {name: sum(cache.counts[name][:8]) for name in ("compulsory", "capacity", "conflict")}
        unused = set(cache.unused)
        missed, first_use = cache.access(line, label)
        count("prefetch_accesses" if is_request else "demand_accesses", group)
        if missed:
            count("filled" if is_request else "demand_misses", group)
        elif is_request:
            count("redundant", group)
        if first_use:
            count("useful", filled_by[line])
        for lost in unused - cache.unused - {line}:
            count("useless", filled_by[lost])
        count("pollution", group, cache.pollution - before[0])
        for name, n in before[1].items():
            count(name, group, sum(cache.counts[name][:8]) - n)
        if missed and is_request:
            filled_by[line] = group
        return missed, first_use

    for line, label, group in accesses:
        missed, first_use = access(line, label, group)
        if {None: False, "always": True, "miss": missed, "tagged": missed or first_use}[trigger] and label == 0:
            access(line + policy.distance, 8, group)
    for line in cache.unused:
        count("resident", filled_by[line])
    return counts


configs = st.builds(
    lambda sets, ways, line, policy: CacheConfig(sets * ways * line, ways, line, policy, 5),
    st.integers(1, 4), st.sampled_from([1, 2, 3, 9]), st.sampled_from([8, 16, 64]), st.sampled_from(POLICIES),
)  # fmt: skip


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(KINDS), st.integers(0, 3), configs, st.sampled_from(PREFETCHES), st.sampled_from(BY))
def test_every_count_of_every_group_is_that_of_the_model(runs, kind, seed, config, prefetch, by):
    if config.policy == "opt" and prefetch.startswith("next-line"):
        prefetch = "traced"
    trace, run = runs[kind, seed]
    [result] = replay_by(run, [config], by, prefetch=prefetch, three_c=True, threads=1)
    model = by_the_model(trace, config, prefetch, by)
    alone = by_the_model(trace, config, "none", by)
    for name, found in result.counts.items():
        own, key = (alone, "demand_misses") if name == "demand_misses_without" else (model, name)
        assert found.tolist() == [own.get((group, key), 0) for group in range(len(found))], name


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(KINDS), st.integers(0, 3), st.lists(configs, min_size=1, max_size=3), st.sampled_from(PREFETCHES),
       st.sampled_from(BY), st.booleans())  # fmt: skip
def test_the_groups_add_up_to_the_counts_of_the_replay(runs, kind, seed, configs, prefetch, by, three_c):
    if prefetch.startswith("next-line"):
        configs = [CacheConfig(each.size_bytes, each.ways, each.line_bytes) for each in configs]
    _, run = runs[kind, seed]
    whole = replay(run, configs, prefetch=prefetch, three_c=three_c)
    for result, parts in zip(whole, replay_by(run, configs, by, prefetch=prefetch, three_c=three_c), strict=True):
        values = result.to_dict()
        assert {name: int(counts.sum()) for name, counts in parts.counts.items()} == {
            name: values[name] for name in parts.counts
        }
        for row in GroupedRecords([parts]):
            assert row["prefetch_accesses"] == row["redundant"] + row["filled"]
            assert row["filled"] == row["useful"] + row["useless"] + row["resident"]


@pytest.mark.parametrize("prefetch", ["traced", "stack:tris*2"])
@pytest.mark.parametrize("by", BY)
def test_batches_and_layouts(runs, monkeypatch, by, prefetch):
    _, run = runs["bvh", 1]
    config = CacheConfig(256, 2, 16, "opt")
    options = {"prefetch": prefetch, "layout": "bfs+8"}
    [whole] = replay_by(run, [config], by, **options)
    monkeypatch.setattr(source, "BATCH", 7)
    [cut] = replay_by(run, [config], by, **options, threads=1)
    assert list(whole.rows()) == list(cut.rows())
    assert (whole.layout, sum(whole.counts["demand_accesses"])) == (
        "bfs+8",
        replay(run, [config], **options)[0].demand_accesses,
    )


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("by", BY)
def test_events_need_no_cache(runs, kind, by):
    trace, run = runs[kind, 2]
    want = np.zeros((len(events_by(run, by)), 2), int)
    absent = {node for node, n in enumerate(trace.n_prims) if n and kind == "bvh64"}
    for ray, node, what in trace.rows:
        if what == 3 or node not in absent:
            want[group_of(trace, by, ray, node), int(what == 3)] += 1
    np.testing.assert_array_equal(events_by(run, by), want)


def test_rows_say_which_group_they_are(runs):
    trace, run = runs["kdtree", 0]
    config = CacheConfig(128, 2, 16)
    pixels, levels, nodes, types = (
        list(GroupedRecords(replay_by(run, [config], by))) for by in ("pixel", "level", "node", "ray-type")
    )
    assert [(row["x"], row["y"]) for row in pixels] == [(0, ray) for ray in range(12)]
    assert [row["level"] for row in levels] == sorted({trace.level[node] for _, node, _ in trace.rows})
    assert [(row["node"], row["level"]) for row in nodes] == [
        (node, trace.level[node]) for node in sorted({node for _, node, _ in trace.rows})
    ]
    assert [row["ray_type"] for row in types] == ["primary", "shadow"]
    assert GroupedRecords(replay_by(run, [config], "level"))[1] == levels[1]


def test_what_has_no_groups_is_refused(tmp_path):
    (tmp_path / "x.din").write_text("0 1000\n")
    with pytest.raises(NptraceError, match=r"x\.din has addresses alone, and no rays and nodes to count by pixel"):
        replay_by(tmp_path / "x.din", [CacheConfig(128)], "pixel")
    trace = make_trace("bvh", 0, n_rays=3)
    with pytest.raises(NptraceError, match="'colour' is nothing to keep counts by"):
        replay_by(write(trace, tmp_path / "run"), [CacheConfig(128)], "colour")


def test_a_request_of_the_root_begins_no_ray(tmp_path):
    """No policy of ours requests it, and a run of another program may."""
    trace = make_trace("bvh", 1, n_rays=6)
    at = next(i for i, (ray, _, kind) in enumerate(trace.rows) if ray == 2 and kind == 2)
    trace.rows.insert(at + 1, (2, 0, 3))
    [result] = replay_by(write(trace, tmp_path / "run"), [CacheConfig(128)], "pixel")
    model = by_the_model(trace, CacheConfig(128), "traced", "pixel")
    assert result.counts["prefetch_accesses"].tolist() == [model.get((ray, "prefetch_accesses"), 0) for ray in range(6)]


CHANGES = [
    lambda rows: rows[1:],
    lambda rows: [rows[0], (0, 0, 1), *rows[1:]],
    lambda rows: [row for row in rows if row[:2] != (1, 0)],
]


@pytest.mark.parametrize("change", CHANGES)
def test_rays_that_do_not_begin_at_the_root_once_are_refused(tmp_path, change):
    trace = make_trace("bvh", 0, n_rays=3)
    trace.rows = change(trace.rows)
    run = write(trace, tmp_path / "run")
    for by in ("pixel", "ray-type"):
        with pytest.raises(NptraceError, match=f"not every ray reads the root.*told apart by {by}"):
            replay_by(run, [CacheConfig(128)], by, prefetch="none")
    assert sum(replay_by(run, [CacheConfig(128)], "node", prefetch="none")[0].counts["demand_accesses"]) > 0


@pytest.mark.parametrize("by", ["level", "pixel"])
def test_memory_does_not_grow_with_the_trace(tmp_path, by):
    """Two million accesses against half a million: the same groups, the same batches."""
    trace = make_trace("bvh", 3, n_rays=300, max_level=10)
    repeats = [n * (1 << 19) // len(trace.rows) for n in (1, 4)]
    peaks = []
    for n in repeats:
        run = write(trace, tmp_path / str(n), repeat=n)
        tracemalloc.start()
        replay_by(run, [CacheConfig(512)], by, threads=1)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    n_rays = 300 * (repeats[1] - repeats[0])
    assert peaks[1] < 1.1 * peaks[0] + (64 * n_rays if by == "pixel" else 0)  # the pixel of each ray is kept, no access
