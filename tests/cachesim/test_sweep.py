"""The sweep and the stack distances against the one-cache replay and plain lists; the filter against no filter."""

import csv
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cachesim.access import PREFETCH
from cachesim.config import CacheConfig
from cachesim.filter import DirectFilter, check_exact, filter_sets, filtered
from cachesim.grid import grid, parse_range, parse_ways_range
from cachesim.lines import AddressLines
from cachesim.prefetch import parse_prefetch
from cachesim.replay import replay
from cachesim.report.curves import draw_curves
from cachesim.report.pictures import check_plot
from cachesim.source import open_source
from cachesim.stack_distance import StackDistances, stack_distances
from cachesim.sweep import SweepRow, sweep
from nptrace.output import Output
from tests.reference.cache import Cache
from tests.reference.traces import make_trace
from tests.reference.traces import write as write_run
from traces.identity import COLUMNS, RunIdentity

LABELS = st.sampled_from([0, 0, 0, 2, 3, 11, 11, 8])
WAYS = (1, 2, 3, 4, 16, 17, 18, 19, 33, 34, 35, 51)  # on both sides of every border between one vector and the next
GRID = [CacheConfig(sets * ways * line, ways, line) for line in (16, 32) for sets in (1, 2, 4, 16) for ways in WAYS]


class Listed:
    """A source from (line of 16 bytes, label) pairs, in batches that end at ``cuts``."""

    identity, n_rays, n_events, layout = RunIdentity("listed"), None, None, "stored"

    def __init__(self, accesses, cuts=()):
        edges = [0, *sorted(cuts), len(accesses)]
        self.batches = [accesses[a:b] for a, b in pairwise(edges)]

    def events(self, prefetch):
        for batch in self.batches:
            lines, labels = np.array(batch, np.int64).reshape(-1, 2).T
            kept = labels < (16 if prefetch.kind == "traced" else PREFETCH)
            yield ((16 * lines[kept]).astype(np.uint32), 16), labels[kept].astype(np.uint8)

    def lines(self, line_bytes, ahead):
        return AddressLines(line_bytes, ahead)


def near_and_far(n, lines, near, seed):
    """Return (line, label) pairs: some anywhere, most near where the last was, some again and again."""
    rng = np.random.default_rng(seed)
    out = np.cumsum(rng.integers(-near, near + 1, n)) % lines
    far = rng.random(n) < 0.2
    out[far] = rng.integers(0, lines, far.sum())
    labels = np.where(rng.random(n) < 0.25, 11, 0)
    return list(zip(out.tolist(), labels.tolist(), strict=True))


def loops(n):
    """Return (line, label) pairs that use 1, 2, 3 ... lines round and round: every stack distance up to n occurs."""
    steps = ((turn, line) for size in range(1, n + 1) for turn in range(3) for line in range(size))
    return [(line, 11 if (line + turn) % 5 == 0 else 0) for turn, line in steps]


accesses = st.one_of(
    st.lists(st.tuples(st.integers(0, 90), LABELS), max_size=150),
    st.builds(near_and_far, st.integers(0, 600), st.integers(1, 150), st.integers(0, 9), st.integers(0, 99)),
)


def assert_equal_to_replay(source, configs, prefetch, rows):
    results = replay(source, configs, prefetch=prefetch, threads=1)
    for row, result in zip(rows, results, strict=True):
        mine, theirs = row.to_dict(), result.to_dict()
        shared = [name for name in mine if name in theirs]
        assert len(shared) == 16 + len(COLUMNS)
        assert {name: mine[name] for name in shared} == {name: theirs[name] for name in shared}
        assert mine["total_misses"] == theirs["demand_misses"] + theirs["prefetch_misses"]
        assert mine["sets"] == result.config.n_sets


@settings(max_examples=40)
@given(accesses, st.sampled_from(["none", "traced"]))
def test_every_cell_is_that_of_the_replay(trace, prefetch):
    assert_equal_to_replay(Listed(trace), GRID, prefetch, sweep(Listed(trace), GRID, prefetch=prefetch, threads=1))


def test_every_depth_is_that_of_the_replay():
    trace = loops(60)
    assert_equal_to_replay(Listed(trace), GRID, "traced", sweep(Listed(trace), GRID))


@settings(max_examples=20)
@given(st.lists(st.tuples(st.integers(0, 40), LABELS), max_size=100))
def test_cells_are_those_of_the_model(trace):
    configs = [CacheConfig(sets * ways * 16, ways, 16) for sets in (1, 2, 8) for ways in (1, 2, 3, 20)]
    for row in sweep(Listed(trace), configs, threads=1):
        both, alone = Cache(row.config).replay(trace), Cache(row.config).replay([pair for pair in trace if pair[1] < PREFETCH])
        assert row.demand_misses == sum(both.counts["misses"][:PREFETCH])
        assert row.prefetch_misses == sum(both.counts["misses"][PREFETCH:])
        assert row.demand_misses_without == sum(alone.counts["misses"])
        assert row.demand_accesses + row.prefetch_accesses == len(trace)


@pytest.mark.parametrize("kind", ["kdtree", "bvh"])
@pytest.mark.parametrize("prefetch", ["none", "traced", "stack:tris*2:once"])
def test_a_run_under_a_layout(tmp_path, kind, prefetch):
    source = open_source(write_run(make_trace(kind, 5, n_rays=200, max_level=9), tmp_path / "run").path, "bfs+8")
    configs = grid([(512, 4096)], ["1", "2", "3", "4", "full"], [16, 32, 64])
    rows = sweep(source, configs, prefetch=prefetch)
    assert any(row.demand_misses for row in rows)
    assert_equal_to_replay(source, configs, prefetch, rows)


@given(accesses, st.lists(st.integers(0, 150), max_size=5), st.integers(1, 3))
def test_batches_and_threads_make_no_difference(trace, cuts, threads):
    configs = [CacheConfig(sets * ways * 16, ways, 16) for sets in (1, 4, 8) for ways in (2, 20)]
    whole = sweep(Listed(trace), configs, threads=1)
    assert sweep(Listed(trace, [min(cut, len(trace)) for cut in cuts]), configs, threads=threads) == whole


@given(accesses)
def test_a_cache_with_more_ways_never_misses_more(trace):
    rows = sweep(Listed(trace), [CacheConfig(sets * ways * 16, ways, 16) for sets in (1, 4) for ways in WAYS], threads=1)
    for fewer, more in pairwise(rows):
        if fewer.to_dict()["sets"] == more.to_dict()["sets"]:
            assert more.demand_misses_without <= fewer.demand_misses_without
            assert more.demand_misses <= fewer.demand_misses
            assert more.prefetch_misses <= fewer.prefetch_misses


def test_cells_do_not_depend_on_their_neighbours():
    trace = near_and_far(2000, 200, 4, 1)
    together = sweep(Listed(trace), GRID)
    assert [sweep(Listed(trace), [config])[0] for config in GRID] == together


@pytest.mark.parametrize(
    ("config", "prefetch", "message"),
    [
        (CacheConfig(1024, 2, 16, "fifo"), "traced", "1K 2-way 16 B fifo cannot be swept.*use lru, or npcache replay"),
        (CacheConfig(1024, 2, 16, "random"), "none", "random cannot be swept"),
        (CacheConfig(96, 2, 16), "none", "has 3 sets; a sweep needs a power of two; choose another size"),
        (CacheConfig(8, 2, 1), "none", "lines of at least 2 B"),
        (CacheConfig(1024, 2, 16), "next-line:miss", "of next-line:miss depend on hits.*use none, traced or stack"),
    ],
)
def test_what_one_pass_cannot_count_is_refused(config, prefetch, message):
    with pytest.raises(ValueError, match=message):
        sweep(Listed([(1, 0)]), [CacheConfig(1024, 1, 16), config], prefetch=prefetch)


def test_an_error_in_the_trace_reaches_the_caller():
    class Broken(Listed):
        def events(self, prefetch):
            yield from super().events(prefetch)
            raise ValueError("damaged")

    with pytest.raises(ValueError, match="damaged"):
        sweep(Broken([(1, 0)]), GRID)


def test_an_error_in_the_last_step_reaches_the_caller():
    class ManyLines(AddressLines):
        n_ids = 1 << 31

    class Wide(Listed):
        def lines(self, line_bytes, ahead):
            return ManyLines(line_bytes, ahead)

    with pytest.raises(ValueError, match="use longer lines"):
        sweep(Wide([(1, 0)]), [CacheConfig(64, 4, 16)], threads=2)


# Stack distances


def distances_by_a_list(trace):
    """Return {(distance, is a prefetch): accesses}; distance 0 is a first access."""
    stack, seen, counts = [], set(), {}
    for line, label in trace:
        distance = 0
        if line in seen:
            distance = stack.index(line) + 1
            stack.remove(line)
        seen.add(line)
        stack.insert(0, line)
        key = distance, int(label >= PREFETCH)
        counts[key] = counts.get(key, 0) + 1
    return counts


def count_distances(trace, batch, grow):
    """Return the counts of a StackDistances that is told of ids as they come, or of all at once."""
    ids, labels = (np.array(column) for column in zip(*trace, strict=True))
    found = StackDistances()
    for start in range(0, ids.size, batch):
        n_ids = int(ids[: start + batch].max() if grow else ids.max()) + 1
        found.step(ids[start : start + batch].astype(np.uint32), labels[start : start + batch].astype(np.uint8), n_ids)
    return {(int(d), int(kind)): int(found.counts[d, kind]) for d, kind in zip(*np.nonzero(found.counts), strict=True)}


@given(st.lists(st.tuples(st.integers(0, 40), LABELS), min_size=1, max_size=200), st.integers(1, 70), st.booleans())
def test_distances_are_those_of_a_list(trace, batch, grow):
    assert count_distances(trace, batch, grow) == distances_by_a_list(trace)


@pytest.mark.parametrize("grow", [True, False])
@pytest.mark.parametrize(("n", "lines", "near"), [(30_000, 300, 3), (30_000, 1500, 40), (25_000, 3000, 900)])
def test_distances_near_and_far(n, lines, near, grow):
    """Long enough that slots are used up and moved together several times, with live slots in several groups of words."""
    trace = near_and_far(n, lines, near, 2)
    expected = distances_by_a_list(trace)
    assert max(distance for distance, _ in expected) > lines // 2
    assert count_distances(trace, 7_001, grow) == expected


def test_distances_while_lines_are_still_being_discovered():
    """Room is made for more lines again and again, in the end with more of them than a group of words has slots."""
    trace = [(line - back, 11 * (line % 3 == 0)) for line in range(9_000) for back in (0, line // 3) if back < line % 500 * 20]
    assert len({line for line, _ in trace}) > 8_192
    assert count_distances(trace, 1_000, grow=True) == distances_by_a_list(trace)


def test_distances_give_every_fully_associative_size(tmp_path):
    path = write_run(make_trace("bvh", 3, n_rays=100, max_level=8), tmp_path / "run").path
    both, alone = stack_distances(path, 32)
    sizes = [1, 2, 3, 5, 8, 13, 40, 100, 1000]
    results = replay(path, [CacheConfig(32 * n, n, 32) for n in sizes])
    for n, result in zip(sizes, results, strict=True):
        assert both.misses(n) == (result.demand_misses, result.prefetch_misses)
        assert alone.misses(n) == (result.demand_misses_without, 0)
    with pytest.raises(ValueError, match="use none, traced or stack"):
        stack_distances(path, prefetch="next-line:always")


@given(accesses.filter(len))
def test_a_larger_fully_associative_cache_never_misses_more(trace):
    ids, labels = (np.array(column) for column in zip(*trace, strict=True))
    found = StackDistances()
    found.step(ids.astype(np.uint32), labels.astype(np.uint8), int(ids.max()) + 1)
    misses = [found.misses(n) for n in range(1, len(set(ids.tolist())) + 2)]
    assert all(a <= b for more, fewer in pairwise(misses) for a, b in zip(fewer, more, strict=True))
    assert sum(misses[-1]) == len(set(ids.tolist()))
    assert found.counts.sum() == len(trace)


def test_more_lines_than_slots_can_number_are_refused():
    with pytest.raises(ValueError, match="use longer lines"):
        StackDistances().step(np.zeros(1, np.uint32), np.zeros(1, np.uint8), (1 << 30) + 4096)


# The filter


class FilteredLines(AddressLines):
    """Lines of a source behind a filter."""

    def __init__(self, line_bytes, ahead, direct):
        super().__init__(line_bytes, ahead)
        self._direct = direct

    def accesses(self, events, labels):
        [kept] = filtered([super().accesses(events, labels)], self._direct)
        return kept


class Filtered(Listed):
    """A Listed source behind a filter."""

    def __init__(self, accesses, direct, cuts=()):
        super().__init__(accesses, cuts)
        self.direct = direct

    def lines(self, line_bytes, ahead):
        return FilteredLines(line_bytes, ahead, self.direct)


caches = st.builds(
    lambda times, ways, policy: (times, ways, policy),
    st.integers(1, 4), st.sampled_from([1, 2, 3, 4, 19]), st.sampled_from(["lru", "lru", "fifo", "random"]),
)  # fmt: skip


@settings(max_examples=150)
@given(accesses, st.integers(1, 6), st.lists(caches, min_size=1, max_size=4), st.lists(st.integers(0, 100), max_size=3))
@example([(0, 11), (0, 0), (0, 11), (0, 0)], 2, [(1, 1, "lru")], [2])
def test_the_filter_changes_no_count(trace, n_sets, shapes, cuts):
    configs = [CacheConfig(n_sets * times * ways * 16, ways, 16, policy) for times, ways, policy in shapes]
    check_exact(n_sets, 16, configs)
    assert filter_sets(configs) % n_sets == 0
    cuts = [min(cut, len(trace)) for cut in cuts]
    for keep_first_use in (True, False):
        direct = DirectFilter(n_sets, keep_first_use=keep_first_use)
        with_filter = [result.to_dict() for result in replay(Filtered(trace, direct, cuts), configs, is_filtered=False)]
        # The filter saw the trace once; what it dropped were hits, which only the accesses count.
        for mine, result in zip(with_filter, replay(Listed(trace), configs, is_filtered=False), strict=True):
            theirs = result.to_dict()
            mine["demand_accesses"] += direct.n_dropped_demand
            mine["prefetch_accesses"] += direct.n_dropped_prefetches
            mine["redundant"] += direct.n_dropped_prefetches
            names = ["demand_accesses", "demand_misses", "prefetch_accesses", "prefetch_misses", "redundant", "filled"]
            if keep_first_use:
                names += ["useful", "useless", "resident", "pollution", "demand_misses_without", "bytes_from_memory"]
            assert {name: mine[name] for name in names} == {name: theirs[name] for name in names}


def test_the_filter_drops_much_of_a_tree_walk(tmp_path):
    source = open_source(write_run(make_trace("kdtree", 1, n_rays=300, max_level=8), tmp_path / "run").path)
    lines = source.lines(32, 0)
    batches = [lines.accesses(*batch) for batch in source.events(parse_prefetch("traced"))]
    direct = DirectFilter(64)
    n_kept = sum(kept.size for kept, _ in filtered(batches, direct))
    n = sum(part.size for part, _ in batches)
    assert n_kept + direct.n_dropped_demand + direct.n_dropped_prefetches == n
    assert n_kept < n / 2


def test_which_accesses_the_filter_keeps():
    lines, labels = np.zeros(5, np.uint32), np.array([11, 11, 0, 11, 0], np.uint8)
    for keep_first_use, expected in ((False, [11]), (True, [11, 0])):
        direct = DirectFilter(4, keep_first_use=keep_first_use)
        assert direct.accesses(lines, labels)[1].tolist() == expected
        assert (direct.n_dropped_demand, direct.n_dropped_prefetches) == (3 - len(expected), 2)


def misses_of(trace, config, direct=None):
    source = Listed(trace) if direct is None else Filtered(trace, direct)
    return replay(source, [config], is_filtered=False)[0].to_dict()


def test_a_filter_with_more_sets_than_the_cache_is_refused_because_it_hides_misses():
    """32 sets: lines 0 and 32 take turns in set 0 and always miss. A filter of 64 sets sees each come back at once."""
    trace, config = [(0, 0), (32, 0), (0, 0), (32, 0)], CacheConfig(32 * 16, 1, 16)
    assert misses_of(trace, config)["demand_misses"] == 4
    assert misses_of(trace, config, DirectFilter(64))["demand_misses"] == 2
    with pytest.raises(ValueError, match=r"64 sets is not exact for 512 1-way 16 B lru: its 32 sets.*exact is 32"):
        check_exact(64, 16, [config])


def test_a_filter_of_another_number_of_sets_is_refused_because_it_hides_misses():
    trace, config = [(0, 0), (4, 0), (0, 0)], CacheConfig(4 * 16, 1, 16)
    assert misses_of(trace, config)["demand_misses"] == 3
    assert misses_of(trace, config, DirectFilter(3))["demand_misses"] == 2
    with pytest.raises(ValueError, match="its 4 sets are not a multiple"):
        check_exact(3, 16, [config])


def test_without_first_uses_the_account_is_wrong():
    trace, config = [(0, 11), (0, 0)], CacheConfig(16, 1, 16)
    assert misses_of(trace, config)["useful"] == 1
    assert misses_of(trace, config, DirectFilter(1))["useful"] == 0
    assert misses_of(trace, config, DirectFilter(1, keep_first_use=True))["useful"] == 1


def test_the_3c_classification_refuses_a_filter_because_it_hides_which_lines_are_old():
    """Two sets of one way, lines 0 and 2 in one, 1 and 3 in the other: at its last access line 0 was pushed out by line 2.

    The fully associative cache of two lines still has it, as line 0 was used between 1 and 3: a conflict. Behind the filter
    these uses are missing and it lost line 0 to line 3: capacity.
    """
    trace, config = [(line, 0) for line in (0, 1, 0, 3, 0, 2, 0)], CacheConfig(32, 1, 16)
    for source, expected in ((Listed(trace), [0, 1]), (Filtered(trace, DirectFilter(2)), [1, 0])):
        [result] = replay(source, [config], three_c=True, threads=1)
        assert [result.to_dict()[kind] for kind in ("capacity", "conflict")] == expected
    with pytest.raises(ValueError, match="3C"):
        check_exact(2, 16, [config], three_c=True)
    check_exact(1, 16, [config], three_c=True)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: check_exact(2, 32, [CacheConfig(64, 1, 16)]), "the line sizes must be equal; use one of 16 B"),
        (lambda: check_exact(2, 16, [CacheConfig(128, 1, 32)]), "the line sizes must be equal; use one of 32 B"),
        (lambda: check_exact(0, 16, [CacheConfig(64, 1, 16)]), "at least 1 set, got 0; use filter_sets"),
        (
            lambda: check_exact(2, 16, [CacheConfig(64, 1, 16)], prefetch=parse_prefetch("next-line:miss")),
            "without the filter",
        ),
    ],
)
def test_what_a_filter_would_change_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_filter_sets():
    assert filter_sets([CacheConfig(96 * 16, 2, 16), CacheConfig(64 * 16, 2, 16)]) == 16
    assert filter_sets([CacheConfig(64 * 16, 64, 16)]) == 1


# Ranges, files, pictures


def test_ranges():
    assert parse_range("4K..64K") == (4096, 65536)
    assert parse_range("8K") == (8192, 8192)
    assert parse_ways_range("1..4") == ("1", "2", "3", "4")
    assert parse_ways_range("full") == ("full",)
    for call in (
        lambda: parse_range("8K..4K"),
        lambda: parse_ways_range("4..1"),
        lambda: parse_ways_range("1..x"),
        lambda: parse_ways_range("1..4097"),
        lambda: parse_ways_range("0..99999999999999999999999"),
    ):
        with pytest.raises(ValueError, match=r"write e\.g\."):
            call()


def test_a_grid_holds_every_size_of_its_ranges():
    shapes = [(c.size_bytes, c.ways, c.line_bytes) for c in grid([(256, 1024), (4096, 4096)], ["1", "3", "full"], [32])]
    assert shapes == [
        (256, 1, 32), (512, 1, 32), (1024, 1, 32), (4096, 1, 32), (384, 3, 32), (768, 3, 32),
        (256, 8, 32), (512, 16, 32), (1024, 32, 32), (4096, 128, 32),
    ]  # fmt: skip
    assert [c.size_bytes for c in grid([(12288, 12288)], ["1", "3", "6", "full"], [64])] == [12288, 12288, 12288]
    with pytest.raises(ValueError, match=r"no cache of 8K with 3 ways.*choose another size"):
        grid([(8192, 8192)], ["3"], [32])
    with pytest.raises(ValueError, match="not a power of two"):
        grid([(8192, 8192)], ["1"], [48])
    with pytest.raises(ValueError, match="at least 1"):
        grid([(8192, 8192)], ["0"], [32])


@pytest.fixture
def rows():
    configs = grid([(128, 1024)], ["1", "2", "3", "4", "5", "6", "7", "full"], [16, 32])
    return sweep(Listed(near_and_far(3000, 100, 3, 4)), configs)


def test_files_hold_the_rows(rows, tmp_path):
    empty = SweepRow(RunIdentity("empty"), CacheConfig(64, 1, 16), "none", "stored", 0, 0, 0, 0, 0)
    rows.append(empty)  # its rates have no value
    for ending in ("parquet", "csv"):
        Output(ending, tmp_path / f"rows.{ending}").write([row.to_dict() for row in rows], tuple)
    expected = [row.to_dict() for row in rows]
    table = pq.read_table(tmp_path / "rows.parquet")
    assert table.to_pylist() == expected
    assert {str(field.type) for field in table.schema} == {"string", "int64", "double", "bool"}
    with (tmp_path / "rows.csv").open(newline="") as file:
        found = list(csv.DictReader(file))
    assert found == [{name: "" if value is None else str(value) for name, value in row.items()} for row in expected]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["rows.csv", "rows.parquet"]


def test_a_file_is_whole_or_not_there(rows, tmp_path, monkeypatch):
    records = [row.to_dict() for row in rows]
    with pytest.raises(ValueError, match=r"cannot write .*rows\.csv: there is no folder .*; name another file"):
        Output("csv", tmp_path / "no" / "rows.csv").write(records, tuple)
    (tmp_path / "rows.csv").write_text("before")

    def fail(self, *args, **kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", fail)
    with pytest.raises(ValueError, match="No space left on device"):
        Output("csv", tmp_path / "rows.csv").write(records, tuple)
    monkeypatch.undo()
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("rows.csv", "before")]


def plot(rows, path):
    draw_curves([row.to_dict() for row in rows], path)


def test_a_plot(rows, tmp_path):
    pytest.importorskip("matplotlib")
    for ending, start in ((".png", b"\x89PNG"), (".svg", b"<?xml"), (".pdf", b"%PDF")):
        for name in ("a", "b"):
            plot(rows, tmp_path / (name + ending))
        assert (tmp_path / ("a" + ending)).read_bytes().startswith(start)
        assert (tmp_path / ("a" + ending)).read_bytes() == (tmp_path / ("b" + ending)).read_bytes()
    text = (tmp_path / "a.svg").read_text()
    axes = ("cache size (bytes, K = 1024)", "demand misses / demand accesses (%)")
    for said in (*axes, "listed", "16 B lines", "32 B lines", "1K", "512", "ways:", "4-way", "full", "prefetch:", "none"):
        assert said in text
    assert "3-way" not in text  # seven numbers of ways would be too many
    with pytest.raises(ValueError, match=r"must end in \.pdf or \.png or \.svg"):
        plot(rows, tmp_path / "a.gif")


def test_a_plot_without_misses_or_pre_fetches(tmp_path):
    pytest.importorskip("matplotlib")
    plot(sweep(Listed([]), [CacheConfig(64, 1, 16)], prefetch="none"), tmp_path / "empty.svg")
    plot(sweep(Listed([(1, 0)]), [CacheConfig(64, 1, 16)], prefetch="none"), tmp_path / "one.svg")
    assert "prefetch" not in (tmp_path / "one.svg").read_text()


def test_a_plot_without_matplotlib_gives_a_message(rows, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ValueError, match="pip install matplotlib, or uv tool .* or pipx inject"):
        plot(rows, tmp_path / "a.png")
    with pytest.raises(ValueError, match="pip install matplotlib"):
        check_plot(tmp_path / "a.png")  # before any work
    assert not list(tmp_path.iterdir())
