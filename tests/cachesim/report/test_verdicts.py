"""The verdict below a replay: what prefetching changed, and what of the paper's miss rate is bookkeeping."""

from dataclasses import replace

import numpy as np
import pytest

from cachesim.access import PREFETCH
from cachesim.config import CacheConfig
from cachesim.replay import replay
from cachesim.report.replay_tables import tables, verdict
from cachesim.report.table1 import Equation, row_of
from cachesim.report.table1_tables import verdict as of_table1
from cachesim.result import Result
from tests.reference.traces import make_trace, write
from traces.identity import RunIdentity

CACHE = CacheConfig(8192, 1, 32)


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


def test_a_rise_is_not_for_the_accesses_that_prefetches_are():
    """B: 200 demand misses and 200 fills among 250 requests, so 400 of 1250: 32 % instead of 20 %."""
    worse = result(1000, 200, 250, 200, 200)
    [sentence] = verdict([worse])
    assert "The paper's miss rate changes by +60.0 %, although p = 0.250 prefetches per demand access count as" in sentence
    assert sentence.endswith("accesses, which alone lowers it to 1 / (1 + p) of A, 80.0 %: the lines filled rise by more.")
    [sentence] = verdict([worse, result(1000, 190, 250, 20, 200)])
    assert "changes by -16.0 to +60.0 %, since p = " in sentence
    assert sentence.endswith("of A, 80.0 %, and the lines filled rise by less or by more.")


@pytest.mark.parametrize(
    ("rows", "sentence"),
    [
        ([(250, 190, 20)], "the paper's miss rate changes by -16.0 %, because its prefetches count as accesses; demand misses "
                           "change by -5.0 %."),
        ([(250, 200, 200)], "the paper's miss rate changes by +60.0 %, although its prefetches count as accesses, since the "
                            "lines filled rise by more; demand misses change by 0.0 %."),
        ([(250, 190, 20), (250, 200, 200)], "the paper's miss rate changes by -16.0 to +60.0 %, since its prefetches count as "
                                            "accesses, and the lines filled rise by less or by more; demand misses change by "
                                            "-5.0 to 0.0 %."),
        ([(0, 200, 0)], "nothing is prefetched, so that A and B are the same."),
    ],
)  # fmt: skip
def test_the_sentence_of_table_1(rows, sentence):
    made = [
        row_of("bvh", "bunny", replace(result(1000, misses, requests, fills, 200), config=CACHE), Equation())
        for requests, misses, fills in rows
    ]
    assert of_table1(made) == [f"BVH: {sentence}"]


def test_table_1_of_rays_that_read_no_node():
    """No cell has a ratio; the least of none ended the command."""
    rows = [row_of("kdtree", "bunny", replace(result(0, 0, 0, 0, 0), config=CACHE), Equation())]
    assert of_table1(rows) == ["kd-tree: nothing is prefetched, so that A and B are the same."]
    rows = [row_of("kdtree", "bunny", replace(result(9, 0, 9, 9, 0), config=CACHE), Equation())]
    assert of_table1(rows) == ["kd-tree: nothing misses without prefetching, so that B/A has no value."]


@pytest.mark.parametrize("row", [result(1000, 200, 0, 0, 200, "none"), result(0, 0, 9, 9, 0), result(9, 0, 9, 9, 0)])
def test_what_has_no_rate_has_no_verdict(row):
    assert verdict([row]) == []


def test_the_metric_is_that_of_the_results(tmp_path):
    """The paper's B / A that the sentence derives is the quotient of the two printed rates."""
    run = write(make_trace("bvh", 3, n_rays=200, max_level=9), tmp_path / "run")
    [one] = replay(run, [CacheConfig(1024, 2)])
    change = 100 * (one.paper_miss_rate / (one.demand_misses_without / one.demand_accesses) - 1)
    assert f"The paper's miss rate changes by {change:+.1f} %" in verdict([one])[0]
    assert tables([one])[1][-1] == verdict([one])[0]
