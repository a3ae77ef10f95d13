"""State from one batch to the next: the account of a cache that sees many batches, and new lines in each."""

import numpy as np
import pytest

from cachesim import source as sourcing
from cachesim.config import CacheConfig
from cachesim.replay import replay
from tests.cachesim.test_replay import Listed, demand
from tests.reference.cache import Cache, pieces
from tests.reference.recomputed import events
from tests.reference.traces import make_trace, write


def growing(n, seed):
    """Return accesses among ever more lines, prefetches among them, so that every batch brings lines that are new."""
    rng = np.random.default_rng(seed)
    address = 16 * np.minimum(rng.geometric(0.02, n), 1 + np.arange(n) // 4)
    labels = rng.choice([0, 0, 0, 2, 11], n)
    return [(int(a), 4, int(label)) for a, label in zip(address, labels, strict=True)]


@pytest.mark.parametrize("policy", ["opt", "lru", "fifo", "random"])
@pytest.mark.parametrize("ways", [1, 4, 20])
def test_an_account_over_forty_batches(policy, ways):
    trace = growing(1600, ways)
    config = CacheConfig(16 * 4 * ways, ways, 16, policy, 5)
    [result] = replay(Listed(trace, range(40, 1600, 40)), [config], three_c=True)
    accesses, alone = pieces(trace, 16), pieces(demand(trace), 16)
    model = Cache(config, future=[line for line, _ in accesses]).replay(accesses)
    for name, counts in model.counts.items():
        assert getattr(result, name).tolist() == counts, name
    found = result.useful, result.useless, result.pollution, result.resident
    assert found == (model.useful, model.useless, model.pollution, len(model.unused))
    assert min(found[:3]) > 5
    without = Cache(config, future=[line for line, _ in alone]).replay(alone)
    assert result.demand_misses_without == sum(without.counts["misses"])


@pytest.mark.parametrize("prefetch", ["traced", "stack:tris*2"])
@pytest.mark.parametrize("kind", ["kdtree", "bvh"])
def test_a_run_in_small_batches(tmp_path, monkeypatch, kind, prefetch):
    """The stack of the prefetch unit and OPT's foresight go on where the last batch ended."""
    run = write(make_trace(kind, 8, n_rays=60, max_level=8), tmp_path / f"x-{kind}")
    monkeypatch.setattr(sourcing, "BATCH", 37)
    for policy in ("opt", "lru"):
        config = CacheConfig(512, 2, 32, policy)
        [result] = replay(run, [config], prefetch=prefetch, three_c=True)
        accesses = pieces(events(run.path, kind, prefetch), 32)
        model = Cache(config, future=[line for line, _ in accesses]).replay(accesses)
        for name, counts in model.counts.items():
            assert getattr(result, name).tolist() == counts, name
        found = result.useful, result.useless, result.pollution, result.resident
        assert found == (model.useful, model.useless, model.pollution, len(model.unused))
        assert result.prefetch_accesses > 50
