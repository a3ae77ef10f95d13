"""Which policies are exact without a clock: a machine with time for everything counts what the replay counts."""

import pytest
from click.testing import CliRunner

import cli
from cachesim.clock.parameters import PRESETS
from cachesim.clock.timing import time_run
from cachesim.config import CacheConfig
from cachesim.policies import policies
from cachesim.replay import replay
from cachesim.sweep import sweep
from nptrace_base.errors import NptraceError
from tests.reference.traces import make_trace, write

EXACT = {"none", "traced", "stack", "push", "ttp", "next-line"}
NEED_CLOCK = {"stride", "treelet", "oracle", "perfect", "predictor"}
CACHES = [CacheConfig(size, ways, 64, policy) for size, ways in ((512, 1), (512, 2), (1024, 16)) for policy in ("lru", "fifo")]


def test_each_policy_says_whether_it_is_exact_without_a_clock():
    assert {name for name, policy in policies().items() if policy.needs_clock} == NEED_CLOCK
    assert set(policies()) == EXACT | NEED_CLOCK


@pytest.fixture(scope="module", params=["kdtree", "bvh", "bvh64"])
def run(request, tmp_path_factory):
    path = tmp_path_factory.mktemp("runs") / f"bunny-{request.param}"
    return write(make_trace(request.param, 11, n_rays=120, max_level=8), path)


def test_a_machine_with_time_for_everything_counts_what_the_replay_counts(run):
    """One ray; every request is made and has arrived before the next read: order and counts are those of the replay."""
    clock = PRESETS["paper"].clock.with_numbers(hit=1, miss=1, mshrs=1024, box=1000, triangle=1000, every=1000)
    names = ("stack", "stack:tris*1:once", "stack:level=3", "stack:live", "push", "ttp")
    timings = iter(time_run(run, CACHES, [clock], names))
    counts = {name: iter(replay(run, CACHES, prefetch=name)) for name in names}
    for _ in CACHES:
        for name in names:
            timing, count = next(timings), next(counts[name])
            lines = timing.lines
            assert (timing.reads, lines["misses"]) == (count.demand_accesses, count.demand_misses), name
            requests = lines["redundant"] + lines["joined"] + lines["filled"]
            assert (requests, lines["filled"]) == (count.prefetch_accesses, count.prefetch_misses), name
            assert (lines["timely"], lines["evicted"], timing.unused) == (count.useful, count.useless, count.resident), name
            assert lines["pollution"] == count.pollution
            assert lines["late"] == lines["joined"] == lines["joined_by_demand"] == 0 < requests
            assert timing.candidates["offered"] == timing.candidates["issued"] + timing.candidates["demanded_first"]


@pytest.mark.parametrize("policy", sorted(NEED_CLOCK))
def test_no_command_replays_what_needs_a_clock(policy, run):
    sentence = f"what {policy_text(policy)} requests depends on time, which a replay does not have; use npcache time"
    for call in (replay, sweep):
        with pytest.raises(NptraceError) as refused:
            call(run, [CacheConfig(512, 1, 64)], prefetch=policy)
        assert str(refused.value) == sentence
    for command in ("replay", "sweep"):
        done = CliRunner().invoke(cli.npcache, [command, str(run.path), "--prefetch", policy])
        assert (done.exit_code, done.stdout) == (2, "")
        assert sentence in done.stderr.replace("\n", " ") and "Traceback" not in done.stderr


def policy_text(policy):
    from cachesim.prefetch import parse_prefetch

    return str(parse_prefetch(policy))
