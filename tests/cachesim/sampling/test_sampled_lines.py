"""Set sampling and hashed lines against the exact counts, and against closed forms."""

import numpy as np
import pytest

from cachesim.config import CacheConfig
from cachesim.replay import replay
from cachesim.sampling.set_sampling import sample_sets
from cachesim.sampling.shards import HashedDistances, hashed_distances
from cachesim.source import RunSource
from cachesim.stack_distance import StackDistances
from tests.reference.traces import make_trace, write
from tests.reference.unit_sources import cyclic, of_stack_distances
from traces.reader import open_run


@pytest.fixture(scope="module", params=["bvh", "kdtree"])
def run(request, tmp_path_factory):
    return write(make_trace(request.param, 9, n_rays=300), tmp_path_factory.mktemp("run") / f"x-{request.param}")


COUNTS = ("demand_misses", "prefetch_misses", "demand_misses_without")


@pytest.mark.parametrize("every", [1, 2, 4, 8])
def test_all_parts_together_are_the_exact_replay(run, every):
    configs = [CacheConfig(256, 1), CacheConfig(1024, 2), CacheConfig(3 * 512, 3)]  # 8, 16 and 16 sets
    exact = replay(run, configs)
    for seed in (0, 1):
        parts = [sample_sets(RunSource(run), configs, every, which=which, seed=seed) for which in range(every)]
        for k, result in enumerate(exact):
            for name in COUNTS:
                assert sum(getattr(part[k], name) for part in parts) == every * getattr(result, name)
            assert all(part[k].demand_accesses == result.demand_accesses for part in parts)
            assert all(part[k].prefetch_accesses == result.prefetch_accesses for part in parts)
    if every > 1:
        assert len({part[0].demand_misses for part in parts}) > 1  # they do differ: something was sampled


def test_sets_that_are_no_power_of_two(run):
    configs = [CacheConfig(12 * 32, 1), CacheConfig(24 * 32, 1)]
    parts = [sample_sets(RunSource(run), configs, 3, which=which) for which in range(3)]
    assert sum(part[1].demand_misses for part in parts) == 3 * replay(run, configs)[1].demand_misses


@pytest.mark.parametrize(
    ("every", "which", "message"),
    [(3, 0, "divisor of 8"), (0, 0, "divisor of 8"), (4, 4, "choose 0 to 3"), (4, -1, "choose 0 to 3")],
)  # fmt: skip
def test_parts_that_do_not_exist(run, every, which, message):
    with pytest.raises(ValueError, match=message):
        sample_sets(RunSource(run), [CacheConfig(256, 1)], every, which=which)


def test_every_line_followed_is_exact(run):
    found, alone = hashed_distances(RunSource(run), 32, 1.0)
    exact = {n: r for n, r in zip((4, 16, 64), replay(run, [CacheConfig(32 * n, n) for n in (4, 16, 64)]), strict=True)}
    for n, result in exact.items():
        assert found.misses(n) == result.demand_misses + result.prefetch_misses
        assert alone.misses(n) == result.demand_misses_without


@pytest.mark.parametrize("rate", [0.5, 0.1])
def test_a_stack_distance_law_is_found_from_part_of_the_lines(rate):
    """The mean over seeds lies about the exact rate as means of independent errors do; the exact rate is the law's."""
    law = 1 / np.arange(1.0, 1025.0)
    ids = of_stack_distances(law, 80_000, seed=1).astype(np.uint32)
    labels, exact = np.zeros(ids.size, np.uint8), StackDistances()
    exact.step(ids, labels, 1024)
    for n in (100, 300, 700):
        truth = exact.misses(n)[0] / ids.size
        assert truth == pytest.approx(1 - law[:n].sum() / law.sum(), abs=0.006 + 1024 / ids.size / 2)
        rates = []
        for seed in range(20):
            distances = HashedDistances(rate, seed)
            distances.step(ids, labels, 1024)
            rates.append(distances.miss_rate(n))
        assert abs(np.mean(rates) - truth) < 3.5 * np.std(rates) / np.sqrt(20) and np.std(rates) < 0.05


def test_the_adjustment_takes_out_what_one_hot_line_does():
    """Half of all accesses go to one line: followed or not, the curve must not change by half."""
    ids = np.where(np.arange(40_000) % 2, 0, 1 + cyclic(512, 40_000)).astype(np.uint32)
    exact = StackDistances()
    exact.step(ids, np.zeros(ids.size, np.uint8), 513)
    truth = exact.misses(400)[0] / ids.size
    followed = []
    for seed in range(16):
        distances = HashedDistances(0.25, seed)
        distances.step(ids, np.zeros(ids.size, np.uint8), 513)
        followed.append(distances.n_followed / ids.size > 0.5)
        assert distances.miss_rate(400) == pytest.approx(truth, abs=0.1)
    assert any(followed) and not all(followed)


@pytest.mark.parametrize("rate", [0.0, -0.1, 1.5, float("nan")])
def test_rates_that_cannot_be_followed(rate):
    with pytest.raises(ValueError, match="above 0 and at most 1"):
        HashedDistances(rate)


def test_a_run_read_again_is_the_same(run):
    again = open_run(run.path)
    assert sample_sets(RunSource(run), [CacheConfig(256, 1)], 4) == sample_sets(RunSource(again), [CacheConfig(256, 1)], 4)
