"""The claims of an estimate, recomputed without its code: quantities, shares, seconds, half-widths, batches, parts."""

import json
import time
from itertools import pairwise

import numpy as np
import pytest

from cachesim.config import CacheConfig
from cachesim.sampling.estimate import estimate
from cachesim.sampling.quantities import QUANTITIES, ratios_of
from cachesim.sampling.strata import Design
from cachesim.sampling.target import Target
from cachesim.sampling.two_phase import Ratio, Sample
from cachesim.sampling.two_phase import estimate as extrapolate
from cachesim.sampling.unit_counts import UnitCounts
from cachesim.sampling.work import Rate, Work
from rtrace.ray_source import RayUnits
from rtrace.render import Shooting
from rtrace.scenes.stand_ins import stand_in
from rtrace.trees.tree_cache import build_tree
from tests.reference.cache import Contents
from tests.reference.unit_sources import PREFETCH, READ, ArraySource

WIDE = Target(0.2, 0.01)
TOTAL = Ratio((np.array([0.0, 1.0]),))


def drawn(n=200_000, share=0.15, seed=8):
    """Nodes and kinds of a trace with a hot part and some prefetches."""
    rng = np.random.default_rng(seed)
    hot = np.where(np.arange(n) // 256 % 7 == 3, 0.5, 0.3)
    nodes = np.where(rng.random(n) < hot, rng.integers(64, 2048, n), rng.integers(64, size=n))
    return nodes, np.where(rng.random(n) < share, PREFETCH, READ)


class Watched(ArraySource):
    """Notes which positions are traced, and takes its time where asked to."""

    def __init__(self, *args, scouting=0.0, **options):
        super().__init__(*args, **options)
        self.seen = np.zeros(self.n_positions, bool)
        self._scouting = scouting

    def trace(self, cuts):
        self.seen[cuts[0] : cuts[-1]] = True
        return super().trace(cuts)

    def scout(self, seed):
        time.sleep(self._scouting)
        return super().scout(seed)


def sampled(source, **options):
    result = estimate(source, [CacheConfig(2048, 1)], WIDE, exact_below=0, **options)
    assert result.method == "sampled", result.reason
    return result


def by_hand(nodes, kinds, config):
    """Return the quantities of a cache, from a replay of one access after the other."""
    alone, both = Contents(config.n_sets, config.ways, "lru"), Contents(config.n_sets, config.ways, "lru")
    misses = {"A": 0, READ: 0, PREFETCH: 0}
    for node, kind in zip(nodes.tolist(), kinds.tolist(), strict=True):
        misses[kind] += not both.access(node)[0]
        misses["A"] += kind == READ and not alone.access(node)[0]
    n, n_prefetches = int((kinds == READ).sum()), int((kinds == PREFETCH).sum())
    a, demand, all_of_b = misses["A"], misses[READ], misses[READ] + misses[PREFETCH]
    return {
        "demand_miss_rate_without": a / n,
        "demand_miss_rate": demand / n,
        "paper_miss_rate": all_of_b / (n + n_prefetches),
        "demand_ratio": demand / a,
        "paper_ratio": all_of_b / (n + n_prefetches) / (a / n),
        "traffic_ratio": all_of_b / a,
        "bytes_from_memory_without": config.line_bytes * a,
        "bytes_from_memory": config.line_bytes * all_of_b,
    }


def test_every_quantity_is_what_its_name_says():
    nodes, kinds = drawn(20_000)
    configs = [CacheConfig(1024, 1), CacheConfig(4096, 2)]
    result = estimate(ArraySource(nodes, kinds, per=2, unit=100), configs, WIDE)
    for cell, config in zip(result.cells, configs, strict=True):
        truth = by_hand(nodes, kinds, config)
        assert {name: value.value for name, value in cell.values.items()} == pytest.approx(truth, rel=1e-12)
        assert len({round(value, 9) for value in truth.values()}) == len(QUANTITIES)  # no two could be mistaken
    assert result.accesses_per_ray.value == (kinds == READ).sum() / 10_000
    assert result.prefetches_per_access.value == (kinds == PREFETCH).sum() / (kinds == READ).sum()


def test_json_has_what_the_result_has_and_no_infinity():
    for seed in range(3):
        result = sampled(ArraySource(*drawn()), seed=seed)
        said = json.loads(json.dumps(result.to_dict(), allow_nan=False))
        for name, interval in result.cells[0].values.items():
            assert said["cells"][0][name] == {
                "value": interval.value, "half_width": interval.half, "unsettled": interval.bracket
            }  # fmt: skip
            assert 0 <= interval.bracket < interval.half < np.inf
        assert (said["seconds"], said["exact_seconds"]) == (result.seconds, result.exact_seconds)
        assert (said["share_of_rays"], said["seed"], said["units_sampled"]) == (result.share, seed, result.n_sampled)


def test_a_run_without_accesses_has_no_rates():
    result = estimate(ArraySource(np.zeros(1, np.int64), np.full(1, PREFETCH)), [CacheConfig(1024, 1)], WIDE)
    assert json.dumps(result.to_dict(), allow_nan=False)
    assert result.cells[0].values["demand_miss_rate"] is None and result.prefetches_per_access is None


def test_the_share_counts_every_traced_position_once():
    source = Watched(*drawn(600_000), unit=256, row=4096)
    result = sampled(source)
    assert result.share == source.seen.mean() < 1
    assert source.n_traced > 1.05 * source.seen.sum()  # some were traced twice


def test_shares_do_not_add_up_over_resumes(tmp_path):
    kept = tmp_path / "kept.npz"
    shares = [sampled(ArraySource(*drawn()), resume=kept).share for _ in range(3)]
    assert shares[0] == shares[1] == shares[2]
    other = Watched(*drawn())
    assert shares[0] <= sampled(other, resume=kept, seed=5).share <= shares[0] + other.seen.mean()


def test_an_exact_run_traces_everything_once():
    source = Watched(*drawn())
    result = estimate(source, [CacheConfig(2048, 1)], Target(0.001, 0.0), exact_below=0)
    assert result.method == "exact" and result.share == 1.0 and source.seen.all()
    assert result.seconds > result.exact_seconds > 0


def test_seconds_include_the_scout_and_are_not_the_exact_ones(monkeypatch):
    monkeypatch.setattr("cachesim.sampling.unit_counts.UnitCounts.exact_seconds", lambda self, n: 1000.0 + n)
    source, start = Watched(*drawn(), scouting=1.5), time.perf_counter()
    result = sampled(source)
    took = time.perf_counter() - start
    assert took - 1 < result.seconds <= took
    assert result.exact_seconds == pytest.approx(201_000, rel=0.02)  # of all accesses, prefetches too


def test_the_exact_run_is_predicted_by_a_line_through_the_calls():
    rate = Rate()
    for x in (1000.0, 4000.0, 50_000.0):
        rate = rate.plus(Rate.of(x, 2e-4 + 1e-8 * x))
    assert rate.seconds(1e8, 30.0) == pytest.approx(1.0 + 30 * 2e-4)
    same = Rate.of(500.0, 1e-3).plus(Rate.of(500.0, 3e-3))
    assert same.seconds(2000.0, 7.0) == pytest.approx(8e-3)
    work = Work(rate, same, wall_s=2 * (rate.y + same.y))
    assert work.seconds_of(1e6, 5.0) == pytest.approx(2 * (0.01 + 5 * 2e-4 + 4.0))


def test_what_was_counted_is_what_the_work_was():
    counts = UnitCounts(ArraySource(*drawn(), unit=256, row=4096), [CacheConfig(2048, 1)], 1)
    counts.count([10, 300], [300], 4096)
    assert counts.work.tracing.x == pytest.approx(counts.n_traced, abs=1)
    long_ = counts.work.replaying.x - counts.work.tracing.x  # unit 300 was replayed twice, the first time with less before it
    assert 256 + 64 <= long_ < 256 + 4096
    assert counts.n_traced > 256 + 256 + 4096
    assert counts.work.wall_s >= counts.work.tracing.y + counts.work.replaying.y > 0


# What cannot be said.


@pytest.mark.parametrize("half", [0.0, np.inf, np.nan])
def test_a_figure_without_a_bound_is_counted_exactly(half, monkeypatch):
    """Although every quantity with a target is within it."""

    def without_bound(*args, **options):
        found = extrapolate(*args, **options)
        found.intervals[1] = found.intervals[1]._replace(half=half)
        return found

    monkeypatch.setattr("cachesim.sampling.sampler.extrapolate", without_bound)
    result = estimate(ArraySource(*drawn()), [CacheConfig(2048, 1)], WIDE, exact_below=0)
    assert result.method == "exact" and "not every quantity has a bound" in result.reason


def test_misses_that_turn_out_to_be_hits_are_none_to_judge_by():
    """Of a cache that holds everything, hundreds of misses are open after the short warm-up, and none is one."""
    nodes = np.random.default_rng(4).integers(2000, size=300_000)
    result = estimate(ArraySource(nodes), [CacheConfig(32 * 4096, 8)], WIDE, exact_below=0)
    assert result.method == "exact" and any("too few to judge by" in flag for flag in result.flags)


def test_a_sample_that_costs_more_than_it_saves_is_not_drawn():
    """Units an eighth of a row: a row before each of them is eight times the unit, as in flat pictures."""
    source = ArraySource(*drawn(65_536), unit=512, row=4096)
    result = estimate(source, [CacheConfig(2048, 1)], WIDE, exact_below=0)
    assert result.method == "exact" and "64 of its 128 units would take 200 % of the run to sample" in result.reason
    assert source.n_traced == source.n_positions + 1024  # the run and the scout


def test_bursts_of_prefetches_that_were_not_sampled():
    """One unit in 160 has 17 times the prefetches of the others; most first samples have none of them."""
    counts = np.tile([2500.0, 10.0, 300.0], (640, 1))
    counts[50::160, 1] = 170.0
    ratio, truth = ratios_of([])[1], counts[:, 1].sum() / counts[:, 0].sum()
    n_right = 0
    for seed in range(60):
        stage = Design(np.ones(640), seed).stage()
        own, nothing = counts[stage.units], np.zeros((64, 0))
        sample = Sample(stage.edges, stage.units, own, nothing, nothing, np.arange(64), nothing, nothing)
        found = extrapolate(sample, [ratio], confidence=0.99).intervals[0]
        n_right += abs(found.value - truth) <= found.half
    assert n_right >= 57


# Half-widths by hand. 32 strata of 10 units, two drawn from each.

UNITS = np.sort(np.concatenate([np.arange(3, 320, 10), np.arange(8, 320, 10)]))
EDGES = np.arange(0, 321, 10)


def test_the_half_width_of_unlike_units_by_hand():
    misses = np.tile([40.0, 60.0], 32)[:, None]
    nothing = np.zeros_like(misses)
    sample = Sample(EDGES, UNITS, np.full_like(misses, 1e3), misses, nothing, np.arange(64), misses, nothing)
    found = extrapolate(sample, [TOTAL]).intervals[0]
    strata = 32 * 10**2 * (1 - 2 / 10) / 2 * 200
    unlike = ((320 - 64) / 65 * 0.25 * 50) ** 2
    df = (strata + unlike) ** 2 / (32 * (strata / 32) ** 2 / 3)
    assert df == pytest.approx(98, abs=1) and found.value == 16_000
    assert found.half == pytest.approx(1.9845 * np.sqrt(strata + unlike), rel=1e-3)


def test_the_half_width_of_a_second_sample_by_hand():
    certain, opened = np.full((64, 1), 50.0), np.full((64, 1), 10.0)
    second = np.arange(0, 64, 4)
    settled = np.tile([52.0, 60.0], 8)[:, None]
    sample = Sample(EDGES, UNITS, np.full((64, 1), 1e3), certain, opened, second, settled, np.zeros((16, 1)))
    found = extrapolate(sample, [TOTAL]).intervals[0]
    phase = 320**2 * (1 / 16 - 1 / 320) * (16 * 4**2 / 15)
    unlike = ((320 - 64) / 65 * 0.25 * 56) ** 2
    df = (phase + unlike) ** 2 / (phase**2 / 17)
    assert df == pytest.approx(18, abs=0.1) and found.value == 320 * 56
    assert found.half == pytest.approx(2.1009 * np.sqrt(phase + unlike), rel=1e-3)


def test_all_but_one_unit_of_each_stratum_leave_a_tenth_of_the_variance():
    """The finite-population factor: 9 of 10 units drawn, the total of the tenth is all that is missing."""
    units = np.flatnonzero(np.arange(320) % 10 != 4)
    misses = np.where(np.arange(units.size) % 9 % 2, 40.0, 60.0)[:, None]
    nothing = np.zeros_like(misses)
    sample = Sample(EDGES, units, np.full_like(misses, 1e3), misses, nothing, np.arange(units.size), misses, nothing)
    found = extrapolate(sample, [TOTAL]).intervals[0]
    of_units = misses[:9].var(ddof=1)
    assert found.half == pytest.approx(1.96 * np.sqrt(32 * 100 * (1 - 9 / 10) / 9 * of_units), rel=0.03)


# Batches, seeds, and parts that do not divide.


@pytest.fixture(scope="module")
def court():
    scene = stand_in("court", 0.15)
    return scene, build_tree(scene.triangles, "kdtree")


@pytest.mark.parametrize("shooting", [Shooting(61, 47), Shooting(61, 47, "scanline", 7), Shooting(61, 47, "tile", 5),
                                      Shooting(61, 47, "scanline", 0), Shooting(61, 47, "hilbert", 3)])  # fmt: skip
def test_units_warmed_up_from_the_start_are_those_of_the_run(court, shooting):
    """Whatever the batch and however the units divide the picture: every one exactly, and together all of it."""
    source = RayUnits(*court, shooting)
    counts = UnitCounts(source, [CacheConfig(1024, 1), CacheConfig(2048, 2)], 2)
    every = list(range(counts.n_units))
    counts.count(every, every, source.n_positions)
    sure, misses = counts.everything()
    assert np.array_equal(counts.table(every)[0], sure)
    settled, bracket = counts.long_table(every, source.n_positions)
    assert np.array_equal(settled, misses) and not bracket.any()
    assert counts.middles[-1] > counts.middles[-2] and counts.least_cost(every, 0, 0) == source.n_positions


@pytest.mark.parametrize("batch", [0, 7])
def test_a_sampled_run_of_batches(court, batch):
    source = RayUnits(*court, Shooting(260, 256, "scanline", batch))
    configs = [CacheConfig(1024, 1)]
    truth = estimate(source, configs, WIDE).cells[0].values
    n_right = 0
    for seed in range(4):
        result = estimate(source, configs, WIDE, exact_below=0, seed=seed)
        assert result.method == "sampled" and result.share < 1, result.reason
        found = result.cells[0].values
        n_right += all(abs(found[name].value - truth[name].value) <= found[name].half for name in QUANTITIES)
    assert n_right >= 3


def test_every_seed_looks_elsewhere(court):
    source = RayUnits(*court, Shooting(100, 90))
    looked = [source.scout(seed)[2] for seed in range(8)]
    assert len({tuple(positions) for positions in looked}) >= 7
    assert len({source.probe(20, seed) for seed in range(5)}) == 5
    places, groups, positions = source.scout(3)
    assert len(groups) == places.size and (np.diff(positions) > 0).all()
    lattice = {(int(p) % 100, int(p) // 100) for p in positions}
    assert len({x % 8 for x, _ in lattice}) == len({y % 8 for _, y in lattice}) == 1 and len(lattice) == len(positions)


def test_the_last_unit_is_what_is_left():
    source = ArraySource(*drawn(100_003), unit=256)
    counts = UnitCounts(source, [CacheConfig(2048, 1)], 1)
    assert counts.n_units == 391 and counts.middles[-1] == pytest.approx((390 * 256 + 100_003) / 2)
    counts.count(range(391), [], 256)
    table = counts.table(range(391))[0]
    assert table[:, :2].sum() == 100_003 and table[:, 2].tolist() == [256] * 390 + [163]
    assert all(b - a == 256 for a, b in pairwise(counts.middles[:-1]))


def test_no_stretch_cuts_a_batch():
    cuts_seen: set[int] = set()

    class Batches(ArraySource):
        def trace(self, cuts):
            cuts_seen.update(cuts)
            return super().trace(cuts)

    source = Batches(*drawn(20_000), unit=256, row=1000)
    source.grain = 7
    counts = UnitCounts(source, [CacheConfig(2048, 1)], 1)
    counts.count(range(counts.n_units), range(0, counts.n_units, 3), 1000)
    assert all(cut % 7 == 0 for cut in cuts_seen - {20_000})
