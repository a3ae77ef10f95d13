"""Timing: a run, caches, machines and prefetch policies in; for each combination its cycles, and where they went, out."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import Any

import numpy as np

from cachesim.clock import kernel as clock_kernel
from cachesim.clock.parameters import Clock
from cachesim.clock.state import BY, CYCLES, TALLY, ClockState, Parameters, Rows, make_state
from cachesim.clock.stretches import Stretches
from cachesim.config import CacheConfig
from cachesim.fast_lru import set_mask
from cachesim.layout import Layout
from cachesim.policies import Facts, Policy
from cachesim.policies.machine import UNUSED, Machine, NodeColumns, make_machine
from cachesim.prefetch import Prefetch, parse_prefetch
from cachesim.result import ratio
from cachesim.source import RunSource, Source, as_source
from nptrace_base.errors import NptraceError
from nptrace_base.pools import thread_pool
from traces.identity import RunIdentity
from traces.node_formats import CHILD_BOXES, NO_BOX
from traces.rays import traced_rays
from traces.reader import Run


@dataclass(frozen=True, slots=True)
class Timing:
    """The cycles of one run on one machine.

    Attributes
    ----------
    identity : RunIdentity
    config : CacheConfig
    clock : Clock
    prefetch, layout : str
    n_rays, n_pixels : int
        All rays of the run, and its pixels.
    cycles, cycles_without : int
        From the first read to the end of the last ray; without: the same without prefetches.
    spent : dict
        Cycles of all rays in flight by ``clock.state.CYCLES``; they add up to cycles x rays in flight.
    lines : dict
        What reads and prefetches found, and what became of the lines that prefetches filled (``clock.state.NUMBERS``).
    candidates : dict
        What became of the nodes that the policy wanted (``policies.machine.PORT``).
    unused : int
        Lines that a prefetch filled and that are in the cache, or on their way, unused at the end.
    lines_without : int
        Lines from memory without prefetches.
    tally : list of dict
        Reads and requests by class (``clock.state.TALLY``); empty unless it was asked for.
    """

    identity: RunIdentity
    config: CacheConfig
    clock: Clock
    prefetch: str
    layout: str
    n_rays: int
    n_pixels: int
    cycles: int
    cycles_without: int
    spent: dict[str, int]
    lines: dict[str, int]
    candidates: dict[str, int]
    unused: int
    lines_without: int
    tally: list[dict[str, int]]

    @property
    def speed_up(self) -> float | None:
        """Cycles without prefetches / cycles with."""
        return ratio(self.cycles_without, self.cycles)

    @property
    def reads(self) -> int:
        """Lines looked up by demand reads."""
        return sum(self.lines[name] for name in ("hits", "misses", "joined_by_demand", "late"))

    @property
    def never_used(self) -> int:
        """Lines that a prefetch filled, that were evicted unused, and that nothing requested again."""
        return self.lines["evicted"] - self.lines["wanted_again"]

    def to_dict(self) -> dict[str, Any]:
        """Return the figures as JSON values; a rate with a denominator of 0 is None."""
        config, lines = self.config, self.lines
        requests = lines["redundant"] + lines["joined"] + lines["filled"]
        return {
            **self.identity.to_dict(),
            "size_bytes": config.size_bytes, "ways": config.ways, "line_bytes": config.line_bytes, "policy": config.policy,
            "policy_seed": config.seed if config.policy == "random" else None,
            "prefetch": self.prefetch, "layout": self.layout, **self.clock.to_dict(),
            "cycles": self.cycles, "cycles_without": self.cycles_without, "speed_up": self.speed_up,
            "cycles_per_ray": ratio(self.cycles, self.n_rays),
            "cycles_per_ray_without": ratio(self.cycles_without, self.n_rays),
            "cycles_per_pixel": ratio(self.cycles, self.n_pixels),
            **{f"spent_{name.lower().replace(' ', '_')}": n for name, n in self.spent.items()},
            "demand_reads": self.reads, "demand_hits": lines["hits"], "demand_misses": lines["misses"],
            "demand_joined": lines["joined_by_demand"], "demand_late": lines["late"],
            **{f"candidates_{name}": n for name, n in self.candidates.items()},
            "requests": requests, "redundant": lines["redundant"], "joined": lines["joined"], "filled": lines["filled"],
            "timely": lines["timely"], "late": lines["late"], "cycles_saved": lines["saved"], "cycles_waited": lines["waited"],
            "evicted_before_use": lines["wanted_again"], "never_used": self.never_used, "resident": self.unused,
            "pollution": lines["pollution"],
            "bytes_from_memory": (lines["misses"] + lines["filled"]) * config.line_bytes,
            "demand_miss_rate": ratio(lines["misses"] + lines["joined_by_demand"], self.reads),
            "requests_per_read": ratio(requests, self.reads),
            "accuracy": ratio(lines["timely"] + lines["late"], lines["filled"]),
            "traffic_ratio": ratio(lines["misses"] + lines["filled"], self.lines_without),
        }  # fmt: skip


#: Bytes that a job keeps for each line of the nodes, about, and that all jobs of a pass may keep.
_LINE_BYTES, _MOST_BYTES = 16, 1 << 31


class Job:
    """One cache on one machine under one policy, stepping through the stretches."""

    def __init__(self, prefetch: Prefetch, parameters: Parameters, machine: Machine, clock: ClockState, unit: Any) -> None:
        self.prefetch, self.machine, self.clock, self.unit = prefetch, machine, clock, unit
        self._parameters = parameters
        self.run = clock_kernel.run

    def step(self, rows: Rows) -> None:
        """Go on as far as these rows allow."""
        self.run(rows, self.unit, self.machine, self.clock, self._parameters)

    @property
    def first_needed(self) -> int:
        """The lowest ray whose rows may still be read."""
        slots = self.clock.slots
        number, event = slots["number"], slots["event"]
        begun = number[number >= 0] + (event[number >= 0] == clock_kernel.RAY_DUE)
        return int(min(begun.min(initial=1 << 62), self.clock.numbers[0].next_ray))


def tree_of(source: RunSource, line_bytes: int) -> tuple[NodeColumns, int]:
    """Return the nodes of a source with the lines of each, and the number of lines."""
    columns = source.run.columns("nodes", ["n_prims", "level", "parent", "axis"])
    lines = source.lines(line_bytes, 0)
    first, n_lines = lines.of_nodes()
    if not source.run.footer.tree.node_format.reads_leaves:
        n_lines[columns["axis"] == 3] = 0
    tree = NodeColumns(
        np.ascontiguousarray(columns["n_prims"], np.uint32), np.ascontiguousarray(columns["level"], np.uint16),
        np.ascontiguousarray(columns["parent"], np.int32), first, n_lines,
    )  # fmt: skip
    return tree, lines.n_ids


def time_run(
    run: Source | Run | str,
    configs: Sequence[CacheConfig],
    clocks: Sequence[Clock],
    prefetches: Sequence[Prefetch | str] = ("stack",),
    *,
    layout: Layout | str = "stored",
    by: str = BY[0],
    threads: int | None = None,
    progress: Callable[[int], object] | None = None,
) -> list[Timing]:
    """Replay a run in cycles: every cache on every machine under every policy, in this order, the policies fastest.

    Each is also timed without prefetches, for the speed-up.

    Parameters
    ----------
    run : Source, Run or path
        ``layout`` is that of a Run or path.
    by : str
        What the tally is kept by (``clock.state.BY``): tree level, ray type, place on the stack from the top, or leaf size.
    threads : int, optional
        Combinations at a time; as many as there are cores when None. The results do not depend on it.
    progress : callable, optional
        Called with the number of rows done after each batch.

    Raises
    ------
    NptraceError
        It is no run; a cache replaces by ``opt``; more rays are to be in flight than the run has.
    """
    source = as_source(run, layout)
    if not isinstance(source, RunSource):
        raise NptraceError(
            f"{source.identity.run} has addresses alone, and the clock needs leaves and rays; time the run itself"
        )
    policies = [timed_policy(each) for each in prefetches]
    stretches = Stretches(source)
    check(configs, clocks, stretches.n_rays)
    workshop = Workshop(source, threads or os.cpu_count() or 1, progress, by)
    machines, results = list(product(configs, clocks)), []
    n_lines = max((workshop.tree(config.line_bytes)[1] for config in configs), default=0)
    at_a_time = max(1, _MOST_BYTES // (_LINE_BYTES * max(n_lines, 1) * (1 + len(policies))))
    for start in range(0, len(machines), at_a_time):
        results += _time_together(workshop, stretches, machines[start : start + at_a_time], policies)
    return results


def _time_together(
    workshop: "Workshop", stretches: Stretches, machines: Sequence[tuple[CacheConfig, Clock]], policies: Sequence[Prefetch]
) -> list[Timing]:  # fmt: skip
    """Time some caches on their machines under every policy, all in one pass through the run, or two with a scout."""
    none = parse_prefetch("none")
    wanted = [(*machine, prefetch) for machine in machines for prefetch in (none, *policies)]
    scouting = [workshop.job(*each, is_scout=True) for each in wanted]
    scouts = [job for job in scouting if job is not None]
    if scouts:
        workshop.run_all(scouts, stretches)
    jobs = [workshop.job(*each, scout=scout) for each, scout in zip(wanted, scouting, strict=True)]
    workshop.run_all([job for job in jobs if job is not None], stretches)
    results, without = [], jobs[0]
    for (config, clock, prefetch), job in zip(wanted, jobs, strict=True):
        assert job is not None and without is not None
        if prefetch is none:
            without = job
        else:
            results.append(_timing(workshop.source, config, clock, job, without))
    return results


def timed_policy(prefetch: Prefetch | str) -> Prefetch:
    """Return the policy that is timed: for traced requests the unit that makes them, since the clock decides when.

    NptraceError for the option ``empty``: a leaf without triangles has no test during which the unit could request.
    """
    parsed = parse_prefetch(prefetch) if isinstance(prefetch, str) else prefetch
    if parsed.options.get("empty"):
        raise NptraceError(
            f"{parsed}: on the clock a leaf without triangles takes no time in which the unit could request; leave empty out, "
            "or use npcache replay"
        )
    return parse_prefetch("stack") if parsed.kind == "traced" else parsed


def check(configs: Sequence[CacheConfig], clocks: Sequence[Clock], n_rays: int) -> None:
    """Raise NptraceError for a cache or a clock that a run of so many rays cannot be timed with."""
    for config in configs:
        if config.policy == "opt":
            raise NptraceError("opt has to know the order of all accesses, which the clock decides; use lru, fifo or random")
    for clock in clocks:
        if clock.rays > max(n_rays, 1):
            raise NptraceError(
                f"rays={clock.rays} cannot be in flight: the run has {n_rays} rays that read nodes; use fewer, or trace a "
                "larger picture"
            )


class Workshop:
    """Makes jobs for one source, and runs them together."""

    def __init__(
        self, source: RunSource, threads: int, progress: Callable[[int], object] | None = None, by: str = BY[0], *,
        is_whole: bool = True,
    ) -> None:  # fmt: skip
        self.source, self._threads, self._progress, self._by = source, threads, progress, BY.index(by)
        self._trees: dict[int, tuple[NodeColumns, int]] = {}
        self._boxes = source.run.footer.tree.node_format.boxes
        self._rays = cache(lambda: traced_rays(source.run)) if is_whole else None

    def job(
        self, config: CacheConfig, clock: Clock, prefetch: Prefetch, *, is_scout: bool = False, scout: Job | None = None,
        log: tuple[int, int] = (0, 0),
    ) -> Job | None:  # fmt: skip
        """Return a job, or with ``is_scout`` that of the pass before, None if the policy needs none."""
        policy = prefetch.policy
        if is_scout and policy.scout is None:
            return None
        tree, n_lines = self.tree(config.line_bytes)
        machine = make_machine(tree, clock.rays, n_lines)
        run = self.source.run
        facts = Facts(run.footer.tree.node_bytes, config.line_bytes, run.n_accesses, self._rays)
        unit = self._unit(policy, machine, facts, prefetch.options, is_scout, scout)
        if unit is None:
            return None
        transfer = -(-config.line_bytes // clock.bandwidth) if clock.bandwidth else 0
        reads_less = self._boxes in (NO_BOX, CHILD_BOXES)
        parameters = Parameters(
            clock.hit, clock.miss, clock.mshrs, clock.ports, transfer, clock.box, clock.triangle, clock.every, clock.units,
            policy.is_perfect, skips=reads_less, follows=reads_less, watches_leaves=policy.watches_leaves, by=self._by,
            mask=set_mask(config.n_sets),
        )  # fmt: skip
        return Job(prefetch, parameters, machine, make_state(config, machine, parameters, *log), unit)

    def log(self, config: CacheConfig, clock: Clock, prefetch: Prefetch, n_events: int) -> list[list[int]]:
        """Return events of one job from the middle of the run on, as ``kernel._note`` keeps them."""
        stretches = Stretches(self.source)
        scout = self.job(config, clock, prefetch, is_scout=True)
        if scout is not None:
            self.run_all([scout], stretches)
        job = self.job(config, clock, prefetch, scout=scout, log=(n_events, stretches.n_rays // 2))
        assert job is not None
        self.run_all([job], stretches)
        return job.clock.log[: int(job.clock.numbers[0].n_logged)].tolist()

    def _unit(
        self, policy: Policy, machine: Machine, facts: Facts, options: Any, is_scout: bool, scout: Job | None
    ) -> Any:  # fmt: skip
        if is_scout:
            assert policy.scout is not None
            return policy.scout(machine, facts, **options)
        assert policy.make_unit is not None
        return policy.make_unit(machine, facts, **options, **({"scouted": scout.unit} if scout else {}))

    def tree(self, line_bytes: int) -> tuple[NodeColumns, int]:
        """Return ``tree_of`` the source, which is read once; not by several threads at a time."""
        if line_bytes not in self._trees:
            self._trees[line_bytes] = tree_of(self.source, line_bytes)
        return self._trees[line_bytes]

    def run_all(self, jobs: Sequence[Job], stretches: Stretches) -> None:
        """Step all jobs through the run."""
        stretches.keep(0, 0)
        with thread_pool(self._threads) as pool:
            for rows in stretches:
                list(pool.map(lambda job: job.step(rows), jobs))  # noqa: B023
                ray = min(job.first_needed for job in jobs)
                ray = min(ray, rows.first_ray + rows.waits_for.size)
                stretches.keep(int(rows.first[ray - rows.first_ray]), ray)
                if self._progress is not None:
                    self._progress(rows.nodes.size)


def _timing(source: RunSource, config: CacheConfig, clock: Clock, job: Job, without: Job) -> Timing:
    numbers, other, port, footer = job.clock.numbers[0], without.clock.numbers[0], job.machine.port[0], source.run.footer
    account = list(numbers.dtype.names)
    lines = {name: int(numbers[name]) for name in account[account.index("hits") :]}
    return Timing(
        source.identity, config, clock, str(job.prefetch), str(source.layout), footer.n_rays, footer.width * footer.height,
        cycles=int(numbers.last_cycle), cycles_without=int(other.last_cycle),
        spent=dict(zip(CYCLES, job.clock.cycles.tolist(), strict=True)),
        lines=lines,
        candidates={name: int(port[name]) for name in port.dtype.names[2:]},
        unused=int(np.count_nonzero(job.machine.status & UNUSED)),
        lines_without=int(other.misses),
        tally=[dict(zip(TALLY, row, strict=True)) for row in job.clock.tally.tolist()],
    )  # fmt: skip
