"""Miss rates of a large picture from some of its rays: a source of sample units, caches and a target error in, intervals out.

A sample unit, or *unit* in this package, is a stretch of positions that is sampled as a whole; it has nothing to do with the
paper's prefetch unit.

1. A few random rays predict the number of accesses. A run that takes only a moment is counted exactly.
2. A scout of single rays all over the picture finds where it changes. Units are sampled in stages, more where it changes more
   (``sampling.strata``), counted (``sampling.unit_counts``) and extrapolated (``sampling.two_phase``), until every interval
   meets the target (``sampling.sampler``).
3. If misses that are unknown after the long warm-up take up more than a quarter of the target, the warm-up is doubled. If that
   does not help, they are first touches of lines, which no sample can tell from reuse at a distance: the cache is flagged.
4. If a cache is flagged, the target would take most of the run, or there are too few misses to judge, the whole run is counted
   exactly, and the result gives the reason.

The target holds for the miss rates of all caches: demand accesses without prefetching (A) and with (B), and the paper's metric
of B. All intervals, also those of ratios and totals, hold at once with 95 % confidence. No interval of a sampled run is 0 or
infinite: a quantity without a bound makes the run exact.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cachesim.config import CacheConfig
from cachesim.layout import Layout
from cachesim.sampling.quantities import OF_THE_RUN, QUANTITIES, place_of, ratios_of
from cachesim.sampling.sampler import Sampler
from cachesim.sampling.strata import Design, weights
from cachesim.sampling.target import Target
from cachesim.sampling.two_phase import Interval, value_of
from cachesim.sampling.unit_counts import UnitCounts, UnitSource
from traces.identity import RunIdentity

#: Of the intervals that an estimate states, all at once.
CONFIDENCE = 0.95
#: Random rays that predict the number of accesses.
PROBES = 200
#: Predicted accesses up to which the run is counted exactly: about a second and a half on two cores.
EXACT_BELOW = 1e8


@dataclass
class CacheEstimate:
    """One cache: ``values`` by the names of ``QUANTITIES``; None where the denominator is 0."""

    config: CacheConfig
    values: dict[str, Interval | None]


@dataclass
class Estimated:
    """The result for one run.

    Attributes
    ----------
    method : str
        ``sampled`` or ``exact``.
    reason : str
        Why the run was counted exactly.
    share : float
        Positions traced / positions of the run, with warm-up and scout. A position that is traced again, or was traced before
        an interruption, counts once. An exact run traces all.
    seconds : float
        Time of this call, with abandoned samples.
    exact_seconds : float
        Time of the exact run: measured, or for a sampled run predicted from the speed of the sample.
    flags : list
        What a sample cannot settle.
    """

    identity: RunIdentity
    method: str
    reason: str
    cells: list[CacheEstimate]
    accesses_per_ray: Interval | None
    prefetches_per_access: Interval | None
    n_units: int
    n_sampled: int
    share: float
    seconds: float
    exact_seconds: float
    seed: int
    target: str
    layout: str = "stored"
    flags: list[str] = field(default_factory=list)

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""

        def interval(value: Interval | None) -> dict[str, float] | None:
            return None if value is None else {"value": value.value, "half_width": value.half, "unsettled": value.bracket}

        return {
            **self.identity.to_dict(), "layout": self.layout, "method": self.method, "reason": self.reason,
            "target": self.target, "confidence": CONFIDENCE, "seed": self.seed,
            "units": self.n_units, "units_sampled": self.n_sampled, "share_of_rays": self.share,
            "seconds": self.seconds, "exact_seconds": self.exact_seconds, "flags": self.flags,
            "accesses_per_ray": interval(self.accesses_per_ray),
            "prefetches_per_access": interval(self.prefetches_per_access),
            "cells": [
                {
                    "size_bytes": cell.config.size_bytes, "ways": cell.config.ways, "line_bytes": cell.config.line_bytes,
                    "method": self.method, **{name: interval(value) for name, value in cell.values.items()},
                }
                for cell in self.cells
            ],
        }  # fmt: skip


def estimate(
    source: UnitSource,
    configs: Sequence[CacheConfig],
    target: Target,
    *,
    layout: Layout | str = "stored",
    seed: int = 0,
    threads: int | None = None,
    exact_below: float = EXACT_BELOW,
    resume: Path | None = None,
    progress: Callable[[int], object] = lambda positions: None,
) -> Estimated:
    """Return the miss rates of a run within a target error, from no more of its rays than that takes.

    Parameters
    ----------
    source : UnitSource
        A run that can be traced from anywhere; its prefetches are those of B.
    configs : sequence of CacheConfig
        LRU, of one line size.
    layout : Layout or str
        Where the nodes lie.
    seed : int
        Determines which units are sampled.
    threads : int, optional
        By default, the number of cores. The figures do not depend on it.
    exact_below : float
        Predicted accesses up to which the run is counted exactly at once.
    resume : Path, optional
        File in which the counts are stored after every stage; an existing file is continued.
    progress : callable
        Called with the number of positions done.
    """
    counts = UnitCounts(source, configs, threads, layout)
    if resume is not None:
        counts.load(resume)
    call = _Call(source, configs, target, seed, counts, time.perf_counter())
    predicted = source.probe(min(PROBES, source.n_positions), seed) * source.n_positions
    if predicted <= exact_below:
        reason = f"about {predicted / 1e6:.0f} million accesses take only a moment to count exactly"
        return _exactly(call, reason, [], progress)
    sampler = Sampler(counts, configs, source.row, seed)
    design = Design(weights(*counts.scout(seed), counts.middles), seed)
    while True:
        before = counts.n_traced
        found = sampler.look(design.stage(), target)
        progress(counts.n_traced - before)
        if resume is not None and found.intervals:
            counts.save(resume)
        if found.is_within or found.hopeless:
            break
        design.split(found.split)
    if found.hopeless:
        return _exactly(call, found.hopeless, found.flags, progress)
    seconds = time.perf_counter() - call.start
    exact_seconds = counts.exact_seconds(found.n_accesses)
    return _result(call, "sampled", found.intervals, n_sampled=found.n_sampled, seconds=seconds, exact_seconds=exact_seconds)


class _Call(NamedTuple):
    """One call of ``estimate``: what was asked for, what is counted, and when it began."""

    source: UnitSource
    configs: Sequence[CacheConfig]
    target: Target
    seed: int
    counts: UnitCounts
    start: float


def _exactly(call: _Call, reason: str, flags: list[str], progress: Callable[[int], object]) -> Estimated:
    """Count the whole run; ``reason`` is why."""
    before = time.perf_counter()
    exact, misses = call.counts.everything(progress)
    end = time.perf_counter()
    totals = np.concatenate([exact.sum(axis=0), misses.sum(axis=0)])
    intervals = [Interval(value_of(ratio_, totals), 0.0, 0.0) for ratio_ in ratios_of(call.configs)]
    return _result(
        call, "exact", intervals, n_sampled=call.counts.n_units, seconds=end - call.start, exact_seconds=end - before,
        reason=reason, flags=flags,
    )  # fmt: skip


def _result(
    call: _Call, method: str, intervals: Sequence[Interval], *, n_sampled: int, seconds: float, exact_seconds: float,
    reason: str = "", flags: Sequence[str] = (),
) -> Estimated:  # fmt: skip
    defined = [None if math.isnan(interval.value) else interval for interval in intervals]
    cells = [
        CacheEstimate(config, {name: defined[place_of(k, name)] for name in QUANTITIES})
        for k, config in enumerate(call.configs)
    ]
    per_ray, per_access = defined[: len(OF_THE_RUN)]
    return Estimated(
        call.source.identity, method, reason, cells, per_ray, per_access,
        n_units=call.counts.n_units, n_sampled=n_sampled, share=call.counts.n_traced / call.source.n_positions,
        seconds=seconds, exact_seconds=exact_seconds, seed=call.seed, target=str(call.target),
        layout=str(call.counts.layout), flags=list(flags),
    )  # fmt: skip
