"""The verdict below a replay: what prefetching changed, and what of the paper's miss rate is bookkeeping."""

import numpy as np
import pytest

from cachesim.access import PREFETCH
from cachesim.config import CacheConfig
from cachesim.replay import replay
from cachesim.report.replay_tables import tables, verdict
from cachesim.result import Result
from tests.reference.traces import make_trace, write
from traces.identity import RunIdentity


def result(accesses, misses, requests, fills, without, prefetch="traced", line_bytes=32):
    counts = {}
    for name, demand, extra in (("accesses", accesses, requests), ("misses", misses, fills)):
        counts[name] = np.zeros(16, np.int64)
        counts[name][0], counts[name][PREFETCH] = demand, extra
    config = CacheConfig(1024, 1, line_bytes)
    return Result(RunIdentity("x"), config, prefetch, "stored", False, demand_misses_without=without, **counts)


def test_the_sentence_has_the_numbers():
    """A: 200 of 1000. B: 190 demand misses and 20 fills among 250 requests, so 210 of 1250: 16.8 % instead of 20 %."""
    [sentence] = verdict([result(1000, 190, 250, 20, 200)])
    assert "demand misses change by -5.0 %, bytes from memory by +5.0 %" in sentence
    assert "The paper's miss rate changes by -16.0 %, because p = 0.250 prefetches per demand access" in sentence
    assert sentence.endswith("they alone lower it to 1 / (1 + p) of A, 80.0 %.")
    assert sentence.startswith("traced, with prefetching (B) against without (A): ")


def test_several_caches_give_ranges_and_several_policies_a_sentence_each():
    rows = [result(1000, 190, 250, 20, 200), result(1000, 210, 1000, 0, 200), result(1000, 200, 0, 0, 200, "none")]
    [sentence] = verdict(rows)
    assert "demand misses change by -5.0 to +5.0 %" in sentence and "p = 0.250 to 1.000" in sentence
    assert "1 / (1 + p) of A, 50.0 to 80.0 %" in sentence
    assert len(verdict([*rows, result(10, 5, 2, 1, 5, "push")])) == 2


@pytest.mark.parametrize("row", [result(1000, 200, 0, 0, 200, "none"), result(0, 0, 9, 9, 0), result(9, 0, 9, 9, 0)])
def test_nothing_is_said_of_what_has_no_rate(row):
    assert verdict([row]) == []


def test_the_metric_is_that_of_the_results(tmp_path):
    """The paper's B / A that the sentence derives is the quotient of the two printed rates."""
    run = write(make_trace("bvh", 3, n_rays=200, max_level=9), tmp_path / "run")
    [one] = replay(run, [CacheConfig(1024, 2)])
    change = 100 * (one.paper_miss_rate / (one.demand_misses_without / one.demand_accesses) - 1)
    assert f"The paper's miss rate changes by {change:+.1f} %" in verdict([one])[0]
    assert tables([one])[1][-1] == verdict([one])[0]
