"""All policies side by side on one cache and machine, and the baselines that need no unit: lines, alignment, node order.

A prefetcher that is not compared with a longer line and an aligned layout of the same capacity is compared with a strawman.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from cachesim.clock.parameters import Clock
from cachesim.clock.timing import Timing, time_run
from cachesim.config import CacheConfig
from cachesim.layout import Layout, parse_layout
from cachesim.policies import policies
from cachesim.prefetch import parse_prefetch
from cachesim.result import ratio
from cachesim.source import RunSource
from traces.reader import Run

#: The bound, and what every row is measured against.
BOUND, REFERENCE = "perfect", "none"

#: Variants of a policy that the comparison shows besides its plain form.
VARIANTS = ("stack:once", "stack:budget=1", "stack:tris*1", "stack:level=12", "stack:live")

#: Policies of the baselines: none, the paper's unit, and at the push.
ON_BASELINES = ("none", "stack", "push")


@dataclass(frozen=True, slots=True)
class Compared:
    """One row: a policy, a layout and a line size, against no prefetching on the cache asked for.

    Attributes
    ----------
    timing : Timing
    group : str
        ``"policy"``, or ``"baseline"`` where the layout or the line differs from the reference.
    reference : Timing
        No prefetches, the cache and layout asked for.
    bound : Timing
        Every read hits.
    """

    timing: Timing
    group: str
    reference: Timing
    bound: Timing

    @property
    def speed_up(self) -> float | None:
        """Cycles of the reference / cycles."""
        return ratio(self.reference.cycles, self.timing.cycles)

    @property
    def share_of_bound(self) -> float | None:
        """Cycles saved / cycles that the bound saves."""
        return ratio(self.reference.cycles - self.timing.cycles, self.reference.cycles - self.bound.cycles)

    @property
    def coverage(self) -> float | None:
        """1 - demand misses / those of the reference; a read that joins a demand miss in flight is one."""
        remaining = ratio(_misses(self.timing), _misses(self.reference))
        return None if remaining is None else 1 - remaining

    @property
    def traffic_ratio(self) -> float | None:
        """Bytes from memory / those of the reference."""
        return ratio(_bytes(self.timing), _bytes(self.reference))

    def to_dict(self) -> dict[str, Any]:
        """Return the figures as JSON values."""
        return self.timing.to_dict() | {
            "group": self.group, "speed_up": self.speed_up, "share_of_bound": self.share_of_bound, "coverage": self.coverage,
            "traffic_ratio": self.traffic_ratio, "cycles_without": self.reference.cycles,
            "cycles_per_ray_without": ratio(self.reference.cycles, self.reference.n_rays), "cycles_bound": self.bound.cycles,
        }  # fmt: skip


def _misses(timing: Timing) -> int:
    return timing.lines["misses"] + timing.lines["joined_by_demand"]


def _bytes(timing: Timing) -> int:
    return (timing.lines["misses"] + timing.lines["filled"]) * timing.config.line_bytes


def usual_policies() -> list[str]:
    """Return what is compared: every policy in its plain form, some variants, and the bound."""
    plain = [name for name in policies() if name not in ("traced", REFERENCE, BOUND, "next-line")]
    sequential = [f"next-line:{when}" for when in ("always", "miss", "tagged")]
    return [*sorted([*plain, *sequential, *VARIANTS]), BOUND]


def baselines(run: Run, config: CacheConfig, layout: Layout) -> list[tuple[CacheConfig, Layout]]:
    """Return caches of equal capacity and layouts that need no unit.

    Lines of the size asked for, twice and four times it; nodes as they lie, with sibling pairs moved to where no line cuts
    them, and in the other orders.
    """
    node_bytes = run.footer.tree.node_bytes
    found = []
    for line_bytes in (config.line_bytes, 2 * config.line_bytes, 4 * config.line_bytes):
        lines = config.size_bytes // line_bytes
        ways = config.ways if config.n_sets > 1 else lines
        if not 0 < ways <= lines or config.size_bytes % (ways * line_bytes):
            continue
        cache = replace(config, line_bytes=line_bytes, ways=ways)
        aligned = (-node_bytes) % max(line_bytes, node_bytes)  # the pair of nodes 1 and 2 begins at a line
        orders = ["stored", "bfs", "dfs", "veb", f"stored+{aligned}", f"bfs+{aligned}", f"veb+{aligned}"]
        block = max(line_bytes, 4 * node_bytes)
        orders += [f"treelet:{block * 4}"]
        layouts = dict.fromkeys(parse_layout(text.removesuffix("+0")) for text in orders)
        found += [(cache, each) for each in layouts if (cache, each) != (config, layout)]
    return found


def compare(
    run: Run,
    config: CacheConfig,
    clock: Clock,
    *,
    layout: Layout | str = "stored",
    prefetches: Sequence[str] = (),
    has_baselines: bool = True,
    threads: int | None = None,
    progress: Callable[[int], object] | None = None,
) -> list[Compared]:
    """Time every policy, and the baselines, on one cache and machine.

    Parameters
    ----------
    prefetches : sequence of str
        Policies; ``usual_policies`` when empty. The reference and the bound are always timed.
    progress : callable, optional
        Called with the number of rows done after each batch.
    """
    layout = parse_layout(layout) if isinstance(layout, str) else layout
    asked = [parse_prefetch(name) for name in prefetches or usual_policies()]
    found = {str(prefetch): prefetch for prefetch in asked if prefetch.kind not in (REFERENCE, BOUND)}
    source = RunSource(run, layout)
    timings = time_run(source, [config], [clock], [REFERENCE, *found.values(), BOUND], threads=threads, progress=progress)
    reference, bound = timings[0], timings[-1]
    rows = [Compared(each, "policy", reference, bound) for each in timings]
    by_layout: dict[Layout, list[CacheConfig]] = {}
    for cache, other in baselines(run, config, layout) if has_baselines else ():
        by_layout.setdefault(other, []).append(cache)
    for other, caches in by_layout.items():
        others = time_run(RunSource(run, other), caches, [clock], ON_BASELINES, threads=threads, progress=progress)
        rows += [Compared(each, "baseline", reference, bound) for each in others]
    return rows
