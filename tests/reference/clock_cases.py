"""Random runs for the clock and its model, and the account of each, number by number."""

import numpy as np
from hypothesis import strategies as st

from cachesim.clock.kernel import run
from cachesim.clock.state import CYCLES, Parameters, Rows, make_state
from cachesim.config import CacheConfig
from cachesim.fast_lru import set_mask
from cachesim.policies import Facts
from cachesim.policies.machine import UNUSED, NodeColumns, make_machine
from cachesim.prefetch import parse_prefetch
from tests.reference.clock import SlowClock, visits_of
from tests.reference.traces import make_trace
from traces.rays import TracedRays

LINES = {
    "hits": "hits", "misses": "misses", "joined_by_demand": "joined by demand", "redundant": "redundant", "joined": "joined",
    "filled": "filled", "timely": "timely", "late": "late", "saved": "saved", "waited": "waited", "evicted": "evicted",
    "wanted_again": "wanted again", "pollution": "pollution",
}  # fmt: skip
CANDIDATES = {
    "offered": "offered", "no_time": "no time", "port_busy": "port busy", "mshr_full": "MSHR full",
    "demanded_first": "demanded first", "issued": "issued",
}  # fmt: skip

machines = st.fixed_dictionaries({
    "hit": st.integers(1, 4), "extra": st.integers(0, 30), "mshrs": st.integers(1, 5), "ports": st.integers(1, 3),
    "transfer": st.integers(0, 12), "box": st.integers(0, 3), "triangle": st.integers(0, 9), "every": st.integers(0, 9),
    "n_units": st.integers(0, 3),
})  # fmt: skip


class Case:
    """A random trace, cut into rays, with the lines of its nodes; a share ``beside`` of the rays reads nothing."""

    def __init__(self, kind, seed, line_bytes, base, n_rays=12, beside=0.2):
        self.line_bytes = line_bytes
        self.trace = trace = make_trace(kind, seed, n_rays=n_rays)
        rng = np.random.default_rng(seed)
        rows = [row for row in trace.rows if row[2] != 3]
        starts = [i for i, row in enumerate(rows) if i == 0 or row[0] != rows[i - 1][0]]
        starts = [i for i in [*starts, len(rows)] for _ in range((i < len(rows)) + (rng.random() < beside))]
        self.first = [*starts, len(rows)]
        self.waits_for = [-1] * len(starts)
        self.types = rng.integers(0, 2, len(starts)).astype(np.uint8)
        for ray in range(1, len(starts)):
            choice = rng.integers(4)
            if choice == 0 and self.waits_for[ray - 1] != -2:
                self.waits_for[ray] = -2
            elif choice == 1 and (primary := int(rng.integers(ray))) not in self.waits_for:
                self.waits_for[ray] = primary  # a primary ray has one shadow ray at most
        places, ways = rng.random((3, 3), np.float32), rng.normal(size=(3, 3)).astype(np.float32)
        of_ray = rng.integers(0, 3, (2, len(starts)))
        is_shadow = self.types == 1
        self.traced = TracedRays(places[of_ray[0]], ways[of_ray[1]], is_shadow, rng.random(len(starts)) < 0.8)
        ends = [
            (base + address, base + address + trace.node_bytes - 1) if address >= 0 else None for address in trace.addresses
        ]
        self.lines = [list(range(a // line_bytes, b // line_bytes + 1)) for a, b in (each or (line_bytes, 0) for each in ends)]
        self.n_lines = max(line for lines in self.lines for line in lines) + 1
        self.tree = NodeColumns(
            np.array(trace.n_prims, np.uint32), np.array(trace.level, np.uint16), np.array(trace.parent, np.int32),
            np.array([min(lines, default=0) for lines in self.lines], np.uint32),
            np.array([len(lines) for lines in self.lines], np.uint32),
        )  # fmt: skip
        self.nodes, self.kinds = (np.array([row[i] for row in rows], dtype) for i, dtype in ((1, np.uint32), (2, np.uint8)))
        self.rays = [
            visits_of([row[1:] for row in rows[a:b]], trace.parent, trace.n_prims, self.lines, a)
            for a, b in zip(self.first, self.first[1:], strict=False)
        ]

    def rows(self, start=0, n=None):
        n = len(self.rays) if n is None else n
        waits_for, is_last = np.array(self.waits_for[:n]), n == len(self.rays)
        return Rows(self.nodes, self.kinds, np.array(self.first), self.types[:n], waits_for, 0, 0, is_last)


def clocked(case, parameters, config, n_slots, make_unit, steps=()):
    """Run the clock with a unit; return (state, machine, unit)."""
    machine = make_machine(case.tree, n_slots, case.n_lines)
    unit = make_unit(machine)
    if unit is None:
        return None
    state = make_state(config, machine, parameters)
    for n in steps:
        run(case.rows(n=min(n, len(case.rays))), unit, machine, state, parameters)
    assert run(case.rows(), unit, machine, state, parameters)
    return state, machine, unit


def fast_account(case, numbers, config, n_slots, text, *, steps=(), watches_leaves=None, by=0):
    """Return the account of the clock under the policy that a text names, every number by its name."""
    prefetch = parse_prefetch(text)
    policy, options = prefetch.policy, prefetch.options
    reads_less = case.trace.kind != "bvh"
    numbers = numbers | {"miss": numbers["hit"] + numbers["extra"]}
    del numbers["extra"]
    parameters = Parameters(
        **numbers, is_perfect=policy.is_perfect, skips=reads_less, follows=reads_less,
        watches_leaves=policy.watches_leaves if watches_leaves is None else watches_leaves, by=by,
        mask=set_mask(config.n_sets),
    )  # fmt: skip
    facts = Facts(case.trace.node_bytes, case.line_bytes, case.nodes.size, lambda: case.traced)
    scouted = {}
    if policy.scout is not None:
        first = clocked(case, parameters, config, n_slots, lambda machine: policy.scout(machine, facts, **options))
        scouted = {} if first is None else {"scouted": first[2]}
    state, machine, _ = clocked(
        case, parameters, config, n_slots, lambda machine: policy.make_unit(machine, facts, **options, **scouted), steps
    )
    numbers_of = state.numbers[0]
    return {
        "total": int(numbers_of["last_cycle"]), "unused": int(np.count_nonzero(machine.status & UNUSED)),
        **dict(zip(CYCLES, state.cycles.tolist(), strict=True)),
        **{name: int(numbers_of[field]) for field, name in LINES.items()},
        **{f"candidates: {name}": int(machine.port[0][field]) for field, name in CANDIDATES.items()},
        **({"tally": state.tally.tolist()} if by else {}),
    }  # fmt: skip


def slow_clock(case, numbers, config, n_slots, policy, *, is_perfect=False):
    """Return the model after its run."""
    numbers = numbers | {"miss": numbers["hit"] + numbers["extra"]}
    return SlowClock(
        numbers, config.n_sets, config.ways, n_slots, case.rays, case.waits_for, policy,
        fifo=config.policy == "fifo", is_perfect=is_perfect,
    ).run()  # fmt: skip


def slow_account(case, numbers, config, n_slots, policy, *, is_perfect=False):
    """Return the account of the model."""
    slow = slow_clock(case, numbers, config, n_slots, policy, is_perfect=is_perfect)
    return (
        {"total": slow.last_cycle, "unused": len(slow.unused)}
        | {name: slow.cycles[name] for name in CYCLES}
        | {name: slow.lines[name] for name in LINES.values()}
        | {f"candidates: {name}": slow.candidates[name] for name in CANDIDATES.values()}
    )


def check_account(account, n_slots):
    """What must add up in any account."""
    assert sum(account[name] for name in CYCLES) == n_slots * account["total"]
    dropped = sum(account[f"candidates: {name}"] for name in ("no time", "port busy", "MSHR full", "demanded first"))
    assert account["candidates: offered"] == dropped + account["candidates: issued"]
    assert account["filled"] == account["timely"] + account["late"] + account["evicted"] + account["unused"]


cases = st.builds(
    Case,
    st.sampled_from(("kdtree", "bvh", "bvh64")),
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
