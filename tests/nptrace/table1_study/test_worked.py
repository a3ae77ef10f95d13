"""Seven nodes and a dozen rays: every count of the knobs of a replay, derived on paper.

The tree is a kd-tree of 8-byte nodes. Node 0 has the children 1 and 2, node 1 the leaves 3 (two triangles) and 4 (one), node 2
the leaves 5 (empty) and 6 (one). Nodes 0 to 3 lie in line 0, nodes 4 to 6 in line 1.

    P  reads 0 (pushes 2), 1 (pushes 4), leaf 3, pops leaf 4, pops 2, follows it to the empty leaf 5
    Q  reads 0, follows it to 2 (pushes 5), leaf 6, where it ends with 5 on the stack
    R  reads 0 (pushes 1), 2 (pushes 6), the empty leaf 5, pops leaf 6, pops 1, follows it to leaf 4

The dozen is P, Q, R four times: 6 + 3 + 6 = 15 reads each time, 60 in all.
"""

from itertools import pairwise

import pytest

from cachesim.config import CacheConfig
from cachesim.flush import FlushedSource, emptied
from cachesim.prefetch import parse_prefetch
from cachesim.reads import reads_of
from cachesim.replay import replay
from cachesim.source import RunSource
from tests.reference.traces import Trace, write

P = [(0, 1), (1, 1), (3, 2), (4, 2), (2, 0), (5, 2)]
Q = [(0, 0), (2, 1), (6, 2)]
R = [(0, 1), (2, 1), (5, 2), (6, 2), (1, 0), (4, 2)]
N = 4

#: The requests of P, Q and R, in order.
REQUESTS = {
    "stack": ([4, 2], [5], [1]),  # R: the empty leaf triggers nothing; at leaf 6 entry 1 is left
    "stack:empty": ([4, 2], [5], [6, 1]),  # R: the empty leaf 5 takes both, and nothing is left for leaf 6
    "stack:once": ([4, 2], [5], [1]),  # no entry is met twice anyway
    "stack:restart": ([4, 2, 2], [5], [1]),  # P: leaf 4 begins at the top again, where 2 lies
    "stack:restart:empty": ([4, 2, 2], [5], [6, 1, 1]),
    "stack:restart:empty:once": ([4, 2], [5], [6, 1]),
    "stack:pop": ([2], [], [1]),  # P: after 4 is popped 2 is left; R: after 6 is popped 1 is left
    "stack:tris*1": ([4, 2], [5], [1]),  # P: two triangles, two requests
    "stack:budget=1": ([4, 2], [5], [1]),  # P: 4 at leaf 3, and 2 at leaf 4
    "stack:budget=1:restart": ([4, 2], [5], [1]),
    "stack:budget=0": ([], [], []),
    "push": ([2, 4], [5], [1, 6]),
    "none": ([], [], []),
}


@pytest.fixture
def run(tmp_path):
    rows = [(ray, *row) for ray, path in enumerate([P, Q, R] * N) for row in path]
    trace = Trace(
        "kdtree", [-1, 0, 0, 1, 1, 2, 2], [0, 1, 1, 2, 2, 2, 2], [0, 0, 0, 2, 1, 0, 1], [1, 3, 5, 0, 0, 0, 0], rows, 3 * N
    )
    return write(trace, tmp_path / "worked-kdtree")


@pytest.mark.parametrize("policy", REQUESTS)
def test_requests(run, policy):
    [(nodes, types)] = RunSource(run).events(parse_prefetch(policy))
    made = [(int(node), bool(type_)) for node, type_ in zip(nodes, types, strict=True)]
    starts = [i for i, event in enumerate(made) if event == (0, False)] + [len(made)]
    for ray, (first, last) in enumerate(pairwise(starts)):
        assert [node for node, is_request in made[first:last] if is_request] == REQUESTS[policy][ray % 3]


def test_one_line(run):
    """A cache of one line. The reads are of lines 0 0 0 1 0 1, 0 0 1, 0 0 1 1 0 1: 4 + 2 + 4 misses without prefetching.

    With it, P: leaf 3 has line 1 fetched, which evicts line 0, and then line 0, which evicts line 1: both in vain, because 4
    misses on line 1 (pollution), then 2 and 5 miss as before: 4 misses and 2 fills. Q: 0 and 6 miss, 5 is there: redundant.
    R: 0 and 5 miss; at leaf 6 line 0 is fetched, where 1 hits: useful; then 4 misses on line 1, which that fetch evicted.
    """
    [result] = replay(run, [CacheConfig(32, 1, 32)], prefetch="stack")
    assert (result.demand_accesses, result.prefetch_accesses) == (15 * N, 4 * N)
    assert result.demand_misses_without == 10 * N
    assert (result.demand_misses, result.prefetch_misses) == (9 * N, 3 * N)
    assert (result.useful, result.useless, result.resident, result.pollution) == (N, 2 * N, 0, 2 * N)
    assert result.paper_miss_rate == 12 / 19
    assert result.demand_miss_rate == 9 / 15
    assert result.traffic_ratio == 12 / 10


def test_two_lines_and_a_flush(run):
    """Two lines hold the tree: two misses in all. Emptied after each of the dozen rays, two misses a ray.

    With prefetching P's first request brings line 1, which its reads use: 1 demand miss and 1 useful fill. Q's leaf 6 reads
    line 1 before its request, and so do R's leaves.
    """
    config = [CacheConfig(64, 2, 32)]
    [usual] = replay(run, config, prefetch="none")
    assert usual.demand_misses == 2
    [flushed] = emptied(replay(FlushedSource(RunSource(run), config), config, prefetch="stack"))
    assert flushed.demand_misses_without == 2 * 3 * N
    assert (flushed.demand_misses, flushed.prefetch_misses) == ((1 + 2 + 2) * N, N)
    assert (flushed.useful, flushed.useless, flushed.resident) == (N, 0, 0)


def test_children(run):
    """P enters 0, 1, 2: 1 + 2 + 2 + 2 reads; Q enters 0 and 2: 5; R enters 0, 2, 1: 7. Requests of leaves read nothing.

    P's request of 2 reads 5 and 6; R's of 1 reads 3 and 4; those of 4 and 5 nothing.
    """
    source = reads_of(RunSource(run), "children", 32)
    [(nodes, types)] = source.events(parse_prefetch("stack"))
    events = [-node if type_ else node for node, type_ in zip(nodes.astype(int).tolist(), types.tolist(), strict=True)]
    assert events == [0, 1, 2, 3, 4, -5, -6, 5, 6, 0, 1, 2, 5, 6, 0, 1, 2, 5, 6, -3, -4, 3, 4] * N


def test_merged(run):
    """A visit of the line read last is no access: of lines 0 0 0 1 0 1, 0 0 1, 0 0 1 1 0 1 ten reads are left."""
    source = reads_of(RunSource(run), "merged", 32)
    [(nodes, types)] = source.events(parse_prefetch("none"))
    assert nodes.tolist() == [0, 4, 2, 5, 0, 6, 0, 5, 1, 4] * N
    assert not types.any()
