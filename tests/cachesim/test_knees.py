"""Knees of miss-rate curves, and the picture of stack distances: its numbers are those of the caches themselves."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cachesim.config import CacheConfig
from cachesim.knees import knees_of, misses_by_size, sizes_of
from cachesim.replay import replay
from cachesim.report.distances import distances_of, draw_distances, size_text
from cachesim.source import RunSource
from tests.reference.traces import make_trace, write


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return write(make_trace("kdtree", 2, n_rays=60, max_level=9), tmp_path_factory.mktemp("run") / "bunny-kdtree")


@pytest.mark.parametrize("prefetch", ["none", "traced"])
@pytest.mark.parametrize("line", [16, 64])
def test_the_curve_is_that_of_fully_associative_caches(run, line, prefetch):
    case = distances_of(RunSource(run, "bfs"), line, prefetch)
    caches = [CacheConfig(size * line, size, line) for size in case.sizes]
    results = replay(run, caches, prefetch=prefetch, layout="bfs")
    assert case.rates == pytest.approx([result.demand_miss_rate for result in results])
    assert case.rates[-1] == pytest.approx(case.counts[0] / case.counts.sum())  # all lines fit: the first touches are left


def test_the_histogram_has_every_access_once(run):
    case = distances_of(RunSource(run), 16, "none")
    assert sum(case.shares) + case.counts[0] / case.counts.sum() == pytest.approx(1)
    slow = [0.0] * len(case.shares)
    for distance, n in enumerate(case.counts.tolist()):
        if distance:
            slow[(distance - 1).bit_length()] += n / case.counts.sum()
    assert case.shares == pytest.approx(slow)


@given(st.lists(st.integers(0, 9), min_size=1, max_size=40))
def test_misses_by_size(counts):
    counts = np.array(counts)
    for size in range(45):
        assert misses_by_size(counts, [size]) == [counts[0] + counts[size + 1 :].sum()]


def test_sizes_reach_the_whole_working_set():
    for n in (1, 2, 3, 100, 1000):
        sizes = sizes_of(n)
        assert sizes[0] == 1 and sizes[-1] >= n and sizes == sorted(set(sizes))


def test_a_step_has_its_knee_at_its_foot_and_a_line_has_none():
    sizes = [2**k for k in range(11)]
    assert knees_of(sizes, [1 - k / 10 for k in range(11)]) == []
    assert knees_of(sizes, [1.0] * 4 + [0.1] * 7) == [16]
    assert knees_of(sizes, [1.0] * 3 + [0.5] * 4 + [0.1] * 4) == [8, 128]
    assert knees_of(sizes, [1.0] * 5 + [0.99] * 6) == []  # too flat to count
    assert knees_of([1], [1.0]) == []


def test_knees_and_runs_are_in_the_picture(run, tmp_path):
    pytest.importorskip("matplotlib")
    case = distances_of(RunSource(run), 16, "none")
    knees = knees_of(case.sizes, case.rates)
    assert knees
    draw_distances([case], tmp_path / "x.svg")
    text = (tmp_path / "x.svg").read_text()
    for knee in knees:
        assert f"{size_text(16 * knee)}: {100 * case.rates[case.sizes.index(knee)]:.1f} %" in text
    assert "bunny-kdtree, 16 B lines, layout stored, prefetch none" in text
    several = [distances_of(RunSource(run, layout), 16, "none") for layout in ("stored", "veb")]
    draw_distances(several, tmp_path / "x.svg")
    assert "layout veb" in (tmp_path / "x.svg").read_text()


def test_sizes_have_three_digits():
    assert [size_text(n) for n in (16, 1024, 4864, 45 * 1024 + 200, 3 << 20)] == ["16", "1K", "4.75K", "45.2K", "3M"]
