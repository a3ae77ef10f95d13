"""The clock against a model that steps every cycle: every number equal, on random trees, traces, machines and policies."""

from typing import NamedTuple

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from cachesim.clock.kernel import run
from cachesim.clock.state import CYCLES, Parameters, Rows, make_state
from cachesim.config import CacheConfig
from cachesim.fast_lru import set_mask
from cachesim.policies import machine as shared
from cachesim.policies import stack
from cachesim.policies.machine import Tree, make_machine
from tests.reference.clock import NoPolicy, SlowClock, SlowStack, visits_of
from tests.reference.traces import make_trace

LINES = {
    "hits": "hits", "misses": "misses", "joined_by_demand": "joined by demand", "redundant": "redundant", "joined": "joined",
    "filled": "filled", "timely": "timely", "late": "late", "saved": "saved", "waited": "waited", "evicted": "evicted",
    "wanted_again": "wanted again", "pollution": "pollution",
}  # fmt: skip
CANDIDATES = {
    "offered": "offered", "no_time": "no time", "port_busy": "port busy", "mshr_full": "MSHR full",
    "demanded_first": "demanded first", "issued": "issued",
}  # fmt: skip


class Nothing(NamedTuple):
    nothing: int = 0


machines = st.fixed_dictionaries({
    "hit": st.integers(1, 4), "extra": st.integers(0, 30), "mshrs": st.integers(1, 5), "ports": st.integers(1, 3),
    "transfer": st.integers(0, 12), "box": st.integers(0, 3), "triangle": st.integers(0, 9), "every": st.integers(0, 9),
    "n_units": st.integers(0, 3),
})  # fmt: skip


class Case:
    """A random trace, cut into rays, with the lines of its nodes."""

    def __init__(self, kind, seed, line_bytes, base, n_rays=12):
        self.trace = trace = make_trace(kind, seed, n_rays=n_rays)
        rng = np.random.default_rng(seed)
        rows = [row for row in trace.rows if row[2] != 3]
        starts = [i for i, row in enumerate(rows) if i == 0 or row[0] != rows[i - 1][0]]
        self.first = [*starts, len(rows)]
        self.waits_for = [-1] * len(starts)
        self.types = rng.integers(0, 2, len(starts)).astype(np.uint8)
        for ray in range(1, len(starts)):
            choice = rng.integers(4)
            if choice == 0 and self.waits_for[ray - 1] != -2:
                self.waits_for[ray] = -2
            elif choice == 1 and (primary := int(rng.integers(ray))) not in self.waits_for:
                self.waits_for[ray] = primary  # a primary ray has one shadow ray at most
        address = base + trace.node_bytes * np.arange(len(trace.parent))
        first, last = address // line_bytes, (address + trace.node_bytes - 1) // line_bytes
        self.lines = [list(range(a, b + 1)) for a, b in zip(first.tolist(), last.tolist(), strict=True)]
        self.n_lines = int(last.max()) + 1
        self.tree = Tree(
            np.array(trace.n_prims, np.uint32), np.array(trace.level, np.uint16), np.array(trace.parent, np.int32),
            first.astype(np.uint32), (last - first + 1).astype(np.uint8),
        )  # fmt: skip
        self.nodes, self.kinds = (np.array([row[i] for row in rows], dtype) for i, dtype in ((1, np.uint32), (2, np.uint8)))
        self.rays = [
            visits_of([row[1:] for row in rows[a:b]], trace.parent, trace.n_prims, self.lines, a)
            for a, b in zip(self.first, self.first[1:], strict=False)
        ]

    def rows(self, start=0, n=None):
        n = len(self.rays) if n is None else n
        return Rows(self.nodes, self.kinds, np.array(self.first), self.types[:n], np.array(self.waits_for[:n]), 0, 0, n == len(self.rays))


def both(case, numbers, config, n_slots, fast_policy, slow_policy, *, is_perfect=False, steps=(), watches_leaves=True, by=0):
    """Return the accounts of the clock and of the model."""
    numbers = dict(numbers)
    numbers["miss"] = numbers["hit"] + numbers.pop("extra")
    machine = make_machine(case.tree, n_slots, case.n_lines)
    is_kd = case.trace.kind == "kdtree"
    parameters = Parameters(
        **numbers,
        is_perfect=is_perfect,
        skips=is_kd,
        follows=is_kd,
        watches_leaves=watches_leaves,
        mask=set_mask(config.n_sets),
    )
    state = make_state(config, machine, parameters)
    unit = fast_policy(machine)
    for n in steps:
        run(case.rows(n=min(n, len(case.rays))), unit, machine, state, parameters)
    assert run(case.rows(), unit, machine, state, parameters)
    slow = SlowClock(
        numbers, config.n_sets, config.ways, n_slots, case.rays, case.waits_for, slow_policy,
        fifo=config.policy == "fifo", is_perfect=is_perfect,
    ).run()  # fmt: skip
    numbers_of = state.numbers[0]
    unused = int(np.count_nonzero(machine.status & shared.UNUSED))
    fast = {
        "total": int(numbers_of["last_cycle"]), "unused": unused,
        **dict(zip(CYCLES, state.cycles.tolist(), strict=True)),
        **{name: int(numbers_of[field]) for field, name in LINES.items()},
        **{f"candidates: {name}": int(machine.port[0][field]) for field, name in CANDIDATES.items()},
    }  # fmt: skip
    model = {"total": slow.last_cycle, "unused": len(slow.unused)}
    model |= {name: slow.cycles[name] for name in CYCLES}
    model |= {name: slow.lines[name] for name in LINES.values()} | {
        f"candidates: {name}": slow.candidates[name] for name in CANDIDATES.values()
    }
    return fast, model


cases = st.builds(
    Case,
    st.sampled_from(("kdtree", "bvh")),
    st.integers(0, 1 << 20),
    st.sampled_from((16, 32, 64)),
    st.sampled_from((0, 8, 16, 24)),
)
configs = st.builds(
    lambda n_sets, ways, policy: (n_sets, ways, policy), st.integers(1, 6), st.integers(1, 4), st.sampled_from(("lru", "fifo"))
)


def config_of(parts):
    n_sets, ways, policy = parts
    return CacheConfig(n_sets * ways * 32, ways, 32, policy)


@given(cases, machines, configs, st.integers(1, 8), st.lists(st.integers(1, 12), max_size=2), st.booleans(), st.booleans())
def test_without_prefetches_every_number_is_that_of_the_model(case, numbers, config, n_slots, steps, is_perfect, watches):
    fast, model = both(
        case,
        numbers,
        config_of(config),
        n_slots,
        lambda machine: Nothing(),
        NoPolicy(),
        is_perfect=is_perfect,
        steps=sorted(steps),
        watches_leaves=watches,
    )
    assert fast == model
    assert sum(fast[name] for name in CYCLES) == n_slots * fast["total"]


stacks = st.fixed_dictionaries(
    {
        "budget": st.none() | st.integers(0, 4),
        "per_triangle": st.booleans(),
        "once": st.booleans(),
        "deepest": st.integers(1, 7),
    }
)


@given(cases, machines, configs, st.integers(1, 8), stacks)
def test_the_unit_is_that_of_the_model(case, numbers, config, n_slots, options):
    per_triangle = options["per_triangle"] and options["budget"] is not None
    budget = stack.UNLIMITED if options["budget"] is None else options["budget"]

    def fast_policy(machine):
        return stack.make_unit(
            machine, budget=budget, per_triangle=per_triangle, once=options["once"], levels=options["deepest"]
        )

    trace = case.trace
    slow_policy = SlowStack(
        case.lines, trace.level, trace.n_prims, options["budget"], per_triangle, options["once"], options["deepest"]
    )
    fast, model = both(case, numbers, config_of(config), n_slots, fast_policy, slow_policy)
    assert fast == model
