"""The clock on a sample of the rays: every N-th piece of a run in; speed-ups with 95 % intervals, for all of its rays, out.

A piece is counted behind the piece before it, which warms the cache up. What a piece tells are its cycles per read of a line,
since the trace has the number of reads. The pieces are taken as drawn at random; they are spread evenly, which is no worse.
docs/speed-error.md states how often the intervals hold.
"""

from collections.abc import Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from cachesim.clock.parameters import Clock
from cachesim.clock.state import Rows
from cachesim.clock.stretches import NOTHING, Stretches
from cachesim.clock.timing import Job, Workshop, check, timed_policy
from cachesim.config import CacheConfig
from cachesim.policies.machine import NodeColumns
from cachesim.prefetch import Prefetch
from cachesim.sampling.two_phase import t_quantile
from cachesim.source import RunSource
from nptrace_base.errors import NptraceError
from nptrace_base.pools import thread_pool
from traces.reader import Run

#: Pieces of a run: at 128x128 pixels, about as many rays as a row of the picture has.
PIECES = 128
#: Primary rays that a run has at least: with smaller pieces, the rays that overlap with the next piece weigh too much, and the
#: empty cache at the run's beginning, which pieces do not have.
LEAST = 64 * PIECES
#: No interval is narrower than this share on either side: where nearly all pieces are alike, as with so many rays in flight
#: that the port is always busy, those picked may miss the few that are not.
NARROWEST = 0.002
#: The smallest sample is one piece in so many: it has eight pieces.
MOST_ONE_IN = 16


class CutRows(NamedTuple):
    """All rows of a run in memory, and the rays at which its pieces begin; ``cuts`` has the end too."""

    rows: Rows
    cuts: np.ndarray


class Counted(NamedTuple):
    """Cycles that each piece took, and lines that its demand reads looked up in them: (n,) int64."""

    cycles: np.ndarray
    reads: np.ndarray


class Figures(NamedTuple):
    """Cycles per read and speed-up, and the relative half-width of their 95 % intervals."""

    cycles_per_read: float
    speed_up: float
    of_cycles: float
    of_speed_up: float


class EstimatedSpeedUp(NamedTuple):
    """A speed-up, and the cycles per ray without prefetches, of one machine, cache and policy; relative half-widths."""

    run: Run
    config: CacheConfig
    clock: Clock
    prefetch: str
    speed_up: float
    of_speed_up: float
    cycles_per_ray_without: float

    def to_dict(self) -> dict[str, Any]:
        """Return the figures as JSON values, by the names of ``Timing.to_dict``."""
        return {
            **self.run.identity.to_dict(), "size_bytes": self.config.size_bytes, "ways": self.config.ways,
            "line_bytes": self.config.line_bytes, "prefetch": self.prefetch, **self.clock.to_dict(),
            "speed_up": self.speed_up, "speed_up_half_width": self.speed_up * self.of_speed_up,
            "cycles_per_ray_without": self.cycles_per_ray_without,
        }  # fmt: skip


def time_sample(
    run: Run, configs: Sequence[CacheConfig], clocks: Sequence[Clock], prefetches: Sequence[str], one_in: int, threads: int
) -> list[EstimatedSpeedUp]:  # fmt: skip
    """Estimate the speed-up of every cache on every machine under every policy, the policies fastest.

    Parameters
    ----------
    one_in : int
        One of so many pieces is timed, 2 to ``MOST_ONE_IN``.

    Raises
    ------
    NptraceError
        The run has too few rays, or its shadow rays do not follow their primary rays; a policy needs all rays.
    """
    if not 2 <= one_in <= MOST_ONE_IN:
        raise NptraceError(
            f"a sample is one piece in 2 to {MOST_ONE_IN}, not in {one_in}; choose another, or time all of the run"
        )
    source = RunSource(run)
    cut, workshop = read_cut_rows(source, LEAST), Workshop(source, threads, is_whole=False)
    check(configs, clocks, cut.rows.waits_for.size)
    policies = [timed_policy(name) for name in ("none", *prefetches)]
    for prefetch in policies:
        if workshop.job(configs[0], clocks[0], prefetch, is_scout=True) is not None:
            raise NptraceError(f"{prefetch} goes through all rays twice, and a sample lacks most of them; time all of the run")
    pieces = range(one_in // 2, PIECES, one_in)
    cells = list(product(configs, clocks))

    def counted(case: tuple[tuple[CacheConfig, Clock], Prefetch]) -> Counted:
        (config, clock), prefetch = case
        job = workshop.job(config, clock, prefetch)
        assert job is not None
        return count(job, *picked(cut, pieces, clock.rays))

    # Before the threads, which then find the trees read.
    reads = {size: _reads(workshop.tree(size)[0], cut.rows) for size in {config.line_bytes for config in configs}}
    with thread_pool(threads) as pool:
        counts = iter(pool.map(counted, product(cells, policies)))
    found = []
    for config, clock in cells:
        without, per_ray = next(counts), reads[config.line_bytes] / max(run.footer.n_rays, 1)
        slow = figures(without, without).cycles_per_read * per_ray
        for prefetch in policies[1:]:
            of = figures(without, next(counts))
            found.append(EstimatedSpeedUp(run, config, clock, str(prefetch), of.speed_up, of.of_speed_up, slow))
    return found


def _reads(tree: NodeColumns, rows: Rows) -> int:
    """Return the lines that all demand reads of a run look up."""
    return int(np.sum(tree.n_lines[rows.nodes], dtype=np.int64))


def read_cut_rows(source: RunSource, least: int = PIECES) -> CutRows:
    """Return the rows of a run; pieces begin at primary rays. NptraceError if there are fewer than ``least``."""
    stretches = Stretches(source)
    stretches.keep(0, 0)
    *_, rows = stretches
    starts = np.flatnonzero(rows.waits_for == NOTHING)
    if starts.size < least or np.any(rows.waits_for >= 0):
        raise NptraceError(
            f"{source.identity.run} cannot be timed by a sample: that takes {least} primary rays that read nodes, each with "
            f"its shadow ray behind it, and it has {starts.size} of them; time all of it, or trace a larger picture"
        )
    wanted = np.searchsorted(starts, np.linspace(0, rows.waits_for.size, PIECES + 1)[1:-1])
    return CutRows(rows, np.array([0, *starts[np.clip(wanted, 0, starts.size - 1)], rows.waits_for.size]))


def picked(
    cut: CutRows, pieces: Sequence[int], n_slots: int, *, is_warm: bool = True
) -> tuple[Rows, list[tuple[int, int]]]:  # fmt: skip
    """Return the rays of some pieces, one after the other, and from where to where each of them is to be counted.

    With ``is_warm``, the piece before one that is not there stands before it, and is not counted. At the end stand as many
    further rays as keep all slots busy until the last piece is done.
    """
    rows, cuts = cut
    n_rays = rows.waits_for.size
    stretches: list[tuple[int, int]] = []
    counted: list[tuple[int, int]] = []
    at = 0
    for i, piece in enumerate(pieces):
        if is_warm and piece and (i == 0 or pieces[i - 1] != piece - 1):
            stretches.append((int(cuts[piece - 1]), int(cuts[piece])))
            at += int(cuts[piece] - cuts[piece - 1])
        stretches.append((int(cuts[piece]), int(cuts[piece + 1])))
        counted.append((at, at + int(cuts[piece + 1] - cuts[piece])))
        at = counted[-1][1]
    more, start = 2 * n_slots + 1, int(cuts[pieces[-1] + 1]) % n_rays
    while more > 0:
        stretches.append((start, min(start + more, n_rays)))
        more -= stretches[-1][1] - start
        start = 0
    return _joined(rows, stretches), counted


def _joined(rows: Rows, stretches: Sequence[tuple[int, int]]) -> Rows:
    """Return stretches of rays as rows of their own."""
    ends = [(int(rows.first[a]), int(rows.first[b])) for a, b in stretches]
    counts = np.concatenate([np.diff(rows.first[a : b + 1]) for a, b in stretches])
    waits_for = np.concatenate([rows.waits_for[a:b] for a, b in stretches])
    return Rows(
        np.concatenate([rows.nodes[a:b] for a, b in ends]), np.concatenate([rows.kinds[a:b] for a, b in ends]),
        np.concatenate([[0], np.cumsum(counts)]), np.concatenate([rows.types[a:b] for a, b in stretches]), waits_for,
        first_row=0, first_ray=0, is_last=False,
    )  # fmt: skip


def count(job: Job, rows: Rows, counted: Sequence[tuple[int, int]]) -> Counted:
    """Time rays with a new job, and return what the counted pieces took: each until its last ray has found a slot."""
    numbers, port, margin = job.clock.numbers[0], job.machine.port[0], 2 * job.machine.sp.size
    found: dict[int, tuple[int, int]] = {}
    for ray in sorted({ray for both in counted for ray in both}):
        if ray:
            n = min(ray + margin, rows.waits_for.size)
            job.step(rows._replace(first=rows.first[: n + 1], types=rows.types[:n], waits_for=rows.waits_for[:n]))
        found[ray] = int(port.now), reads_of(numbers)
    both = np.array([np.subtract(found[b], found[a]) for a, b in counted], np.int64)
    return Counted(both[:, 0], both[:, 1])


def reads_of(numbers: Any) -> int:
    """Return the lines that demand reads have looked up."""
    return sum(int(numbers[name]) for name in ("hits", "misses", "joined_by_demand", "late"))


def figures(without: Counted, with_: Counted) -> Figures:
    """Return the figures of pieces without and with prefetches; fewer than five pieces have no interval: infinity."""
    (slow, slow_residuals), (rate, residuals) = _rate(without), _rate(with_)
    n = residuals.size
    if n < 5:
        return Figures(rate, slow / rate, np.inf, np.inf)
    scale = t_quantile(0.025, n - 1) * np.sqrt(n / (n - 1) * (1 - n / PIECES))
    half_widths = [scale * np.sqrt(np.sum(each**2)) for each in (residuals, slow_residuals - residuals)]
    return Figures(rate, slow / rate, *(max(float(each), NARROWEST) for each in half_widths))


def _rate(counts: Counted) -> tuple[float, np.ndarray]:
    """Return cycles per read, and by what share of it each piece moves it."""
    rate = counts.cycles.sum() / counts.reads.sum()
    return float(rate), (counts.cycles - rate * counts.reads) / counts.cycles.sum()
