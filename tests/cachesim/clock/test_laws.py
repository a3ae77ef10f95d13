"""Laws of the clock: equation 1 is a case of it, bounds, what grows with what, and what adds up; under every policy."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cachesim.policies import policies
from tests.reference.cache import Contents
from tests.reference.clock_cases import Case, cases, check_account, config_of, configs, fast_account, machines

#: Every policy of the package that makes requests, some with options.
POLICIES = (
    "stack", "stack:tris*1:once", "stack:live", "push", "ttp", "next-line:always", "next-line:tagged:2", "stride",
    "treelet:bytes=64:every=5", "oracle", "predictor:entries=4:origin=1:direction=1:up=1",
)  # fmt: skip

one_line = st.builds(
    lambda kind, seed, n_rays: Case(kind, seed, 64, 0, n_rays),
    st.sampled_from(("kdtree", "bvh", "bvh64")),
    st.integers(0, 1 << 20),
    st.integers(1, 12),
)


def test_every_policy_is_tried():
    tried = {text.partition(":")[0] for text in POLICIES}
    assert tried | {"none", "traced", "perfect"} == {name for name in policies() if not name.startswith("toy")}


def lines_of(case):
    """Return the lines of all reads, in order."""
    return [line for visits in case.rays for visit in visits for line in visit.lines]


def misses(case, config):
    cache = Contents(config.n_sets, config.ways, config.policy)
    return sum(not cache.access(line)[0] for line in lines_of(case))


@given(one_line, configs, st.integers(1, 9), st.integers(0, 300), st.integers(1, 3))
def test_one_ray_and_one_outstanding_miss_are_equation_1(case, config, hit, extra, ports):
    """N ((1 - R) hit + R miss), to the cycle: no prefetches, free tests, every node in one line.

    A ray that reads nothing has its slot for a cycle; of the last ray nobody waits for the end of that cycle.
    """
    config = config_of(config)
    numbers = {"hit": hit, "extra": extra, "mshrs": 1, "ports": ports, "transfer": 0, "box": 0, "triangle": 0, "every": 0}
    fast = fast_account(case, numbers | {"n_units": 0}, config, 1, "none")
    n, n_missed = len(lines_of(case)), misses(case, config)
    read = [any(visit.lines for visit in visits) for visits in case.rays]
    assert fast["idle"] == read[:-1].count(False)
    assert fast["total"] == (n - n_missed) * hit + n_missed * (hit + extra) + fast["idle"]
    assert (fast["hits"], fast["misses"], fast["joined by demand"]) == (n - n_missed, n_missed, 0)
    assert (fast["hit"], fast["demand miss"]) == ((n - n_missed) * hit, n_missed * (hit + extra))


@given(cases, machines, configs)
def test_one_ray_misses_what_the_cache_alone_misses(case, numbers, config):
    """On any machine: with one ray the order of the lines does not depend on time, if a node's lines share no set."""
    n_sets, ways, policy = config
    config = config_of((max(n_sets, max(map(len, case.lines))), ways, policy))
    assert fast_account(case, numbers, config, 1, "none")["misses"] == misses(case, config)


@given(cases, machines, configs, st.integers(1, 30))
def test_one_ray_alone_is_never_slower_on_a_better_machine(case, numbers, config, more):
    """Without prefetches every number is monotone: later data, longer tests, fewer ports or MSHRs never end a ray earlier."""
    n_sets, ways, policy = config
    config = config_of((max(n_sets, max(map(len, case.lines))), ways, policy))
    total = fast_account(case, numbers, config, 1, "none")["total"]
    for name in ("hit", "extra", "transfer", "box", "triangle", "every"):
        assert fast_account(case, numbers | {name: numbers[name] + more}, config, 1, "none")["total"] >= total, name
    for name in ("mshrs", "ports"):
        assert fast_account(case, numbers | {name: numbers[name] + more}, config, 1, "none")["total"] <= total, name
    if policy == "lru":
        wider = config_of((config.n_sets, config.ways + more, "lru"))
        assert fast_account(case, numbers, wider, 1, "none")["total"] <= total


@settings(max_examples=20)
@pytest.mark.parametrize("policy", (*POLICIES, "none"))
@given(case=cases, numbers=machines, config=configs)
def test_no_policy_is_faster_than_perfect_for_one_ray(policy, case, numbers, config):
    config = config_of(config)
    least = fast_account(case, numbers, config, 1, "perfect")["total"]
    assert fast_account(case, numbers, config, 1, policy)["total"] >= least


@settings(max_examples=20)
@pytest.mark.parametrize("policy", (*POLICIES, "perfect"))
@given(case=cases, numbers=machines, config=configs)
def test_where_a_miss_costs_nothing_no_policy_changes_a_cycle(policy, case, numbers, config):
    """One ray, miss = hit, no limit of memory, and MSHRs for all that the ports can ask: speed-up exactly 1, not about 1.

    A read goes first, so a request takes no port from it; with fewer MSHRs it could take the one that the next read needs.
    """
    numbers = numbers | {"extra": 0, "transfer": 0, "mshrs": numbers["ports"] * numbers["hit"] + 4}
    config = config_of(config)
    with_, without = (fast_account(case, numbers, config, 1, each) for each in (policy, "none"))
    assert with_["total"] == without["total"]
    assert with_["late prefetch"] == with_["late"] == 0


@settings(max_examples=20)
@pytest.mark.parametrize("policy", POLICIES)
@given(case=one_line, numbers=machines, config=configs, n_slots=st.integers(1, 8))
def test_where_a_node_is_a_line_every_request_issued_is_found_filled_or_joined(policy, case, numbers, config, n_slots):
    fast = fast_account(case, numbers, config_of(config), n_slots, policy)
    assert fast["candidates: issued"] == fast["redundant"] + fast["joined"] + fast["filled"]
    assert fast["wanted again"] <= fast["evicted"]
    check_account(fast, n_slots)


def test_the_examples_make_requests_of_every_fate():
    """What the laws above add up is not always 0."""
    numbers = {"hit": 1, "extra": 20, "mshrs": 2, "ports": 1, "transfer": 3, "box": 1, "triangle": 8, "every": 8, "n_units": 1}
    for policy in POLICIES:
        total = {}
        for seed in range(12):
            case = Case(("kdtree", "bvh")[seed % 2], seed, 32, 16, 40)
            for n_slots in (1, 4):
                for name, value in fast_account(case, numbers, config_of((2, 2, "lru")), n_slots, policy).items():
                    total[name] = total.get(name, 0) + value
        missing = {name for name, value in total.items() if value == 0}
        without = {"candidates: demanded first"} if policy not in ("push", "ttp") else set()
        assert missing <= without | {"unused", "pollution", "candidates: no time", "timely"}, (policy, total)
