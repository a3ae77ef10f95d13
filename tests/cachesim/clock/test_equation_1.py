"""Equation 1 of the paper as a run of the clock, and its misses as a replay's: on random runs and on a rendered scene."""

import pytest

from cachesim.clock.parameters import PRESETS
from cachesim.clock.timing import time_run
from cachesim.config import CacheConfig
from cachesim.replay import replay
from cachesim.report.table1 import acpr
from rtrace.render import Shooting, render
from rtrace.scenes.stand_ins import stand_in
from rtrace.trees.tree_cache import build_tree
from tests.reference.traces import make_trace, write
from traces.reader import open_run

CACHES = [
    CacheConfig(size, ways, 64, policy) for size in (512, 1024) for ways in (1, 2, size // 64) for policy in ("lru", "fifo")
]
PAPER = PRESETS["paper"].clock


@pytest.fixture(scope="module", params=["kdtree", "bvh", "bvh64", "rendered kdtree", "rendered bvh"])
def run(request, tmp_path_factory):
    path, kind = tmp_path_factory.mktemp("runs") / "run", request.param.split()[-1]
    if kind == request.param:
        return write(make_trace(kind, 11, n_rays=150, max_level=8), path)
    scene = stand_in("blob", 0.1)
    render(scene, build_tree(scene.triangles, kind), Shooting(24, 24), path)
    return open_run(path)


def test_the_paper_s_numbers_give_the_paper_s_cycles(run):
    """Hit 1, miss 100, one ray, one outstanding miss, free tests, no prefetches: N ((1 - R) 1 + R 100) is exact."""
    clock = PAPER.with_numbers(mshrs=1, box=0, triangle=0, every=0)
    assert (clock.hit, clock.miss, clock.rays, clock.ports) == (1, 100, 1, 1)
    for timing, counts in zip(time_run(run, CACHES, [clock]), replay(run, CACHES, prefetch="none"), strict=True):
        n, missed = counts.demand_accesses, counts.demand_misses
        assert timing.cycles_without == (n - missed) + 100 * missed
        assert timing.cycles_without / timing.n_rays == pytest.approx(acpr(n / timing.n_rays, missed / n), rel=1e-12)


def test_one_ray_misses_what_the_replay_misses(run):
    """On the paper's machine with its tests and 16 MSHRs, and on one with a slow memory: LRU and FIFO, 1, 2 and all ways."""
    clocks = [PAPER, PAPER.with_numbers(miss=300, bandwidth=1, mshrs=2, hit=4, units=1)]
    timings = iter(time_run(run, CACHES, clocks, ["none"]))
    for counts in replay(run, CACHES, prefetch="none"):
        for _ in clocks:
            timing = next(timings)
            assert timing.lines["misses"] == counts.demand_misses > 0
            assert timing.reads == counts.demand_accesses
            assert timing.speed_up == 1
