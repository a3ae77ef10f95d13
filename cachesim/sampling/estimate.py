"""Miss rates of a large picture from part of its rays: a source of sample units, caches and a target error in, intervals out.

A sample unit, or *unit* in this package, is a stretch of rays that is drawn as a whole; it has nothing to do with the paper's
prefetch unit.

1. The number of accesses is predicted from a few random rays. A run that takes a moment is counted exactly.
2. A scout of single rays all over the picture says where it changes. Units are sampled in stages, more where it changes more
   (``sampling.strata``), counted (``sampling.unit_counts``) and extrapolated (``sampling.two_phase``), until every interval is
   within the target.
3. Where misses that the long warm-up leaves open take up more than a quarter of the target, the warm-up is doubled; where that
   does not help, they are first touches of lines, which no sample can tell from re-use at a distance: the cell is flagged.
4. A flagged cell, a target that would take most of the run, or too few misses to judge: the whole run is counted exactly, and
   the result gives the reason.

The accuracy target holds for the miss rates of all caches: demand accesses without prefetching (A) and with (B), and the
paper's metric of B. All intervals, those of ratios and totals too, hold at once with 95 %; none of a sampled run is 0 or
infinite: what has no bound is counted exactly.
"""

import math
import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from cachesim.config import CacheConfig
from cachesim.sampling.cold_start import ALONE, DEMAND, N_MISSES, REQUESTS
from cachesim.sampling.strata import Design, Stage, expected, weights
from cachesim.sampling.two_phase import LIKELY, Interval, Ratio, Sample, value_of
from cachesim.sampling.two_phase import Estimate as Extrapolated
from cachesim.sampling.two_phase import estimate as extrapolate
from cachesim.sampling.unit_counts import ACCESSES, PREFETCHES, RAYS, UnitCounts, UnitSource
from nptrace_base.errors import NptraceError
from traces.identity import RunIdentity

CONFIDENCE = 0.95
#: Of each look at a sample. More than what is stated, because the first sample that looks good enough ends the search; how
#: much more was measured (docs/speed-error.md).
_OF_A_LOOK = 0.965
#: Random rays for the prediction of the number of accesses.
PROBES = 200
#: Predicted accesses up to which the run is counted exactly: about a second and a half on two cores.
EXACT_BELOW = 1e8
#: Share of the positions that a sample may cost, warm-up included, before the exact run is the better choice.
MOST_SHARE = 0.6
#: Misses, certain or open, that a cache must have had in the sample for an interval to be stated.
LEAST_MISSES = 100
_LEAST_SECOND = 24  # units counted with a long warm-up, at least
_LEAST_PART = 1 / 8  # and of the sampled units
_MOST_WARM, _MOST_WARM_SHARE = 8, 0.15  # rows of warm-up, at most, and positions of them, as a share of the run
_SETTLED = 0.25  # part of the target that open misses may take up before the warm-up is doubled
#: Part of the mean variance to expect in a stratum whose neighbours are all alike: what is rare may hide there.
_ANYWHERE = 0.5
_DECLINE = 1.2  # an error falls with about this power of the number of units: strata grow shorter, neighbours are alike
#: Prefetches per access that a unit may have more than the mean, where none was seen: they come in bursts, where rays run
#: along a plane of the tree.
_BURSTS = 4.0
_N_COUNTS = 3

#: Quantities of a cache that the target is for.
TARGETED = ("demand_miss_rate_without", "demand_miss_rate", "paper_miss_rate")
#: All quantities of a cache; the last two are bytes.
QUANTITIES = (
    *TARGETED, "demand_ratio", "paper_ratio", "traffic_ratio", "bytes_from_memory_without", "bytes_from_memory"
)  # fmt: skip
#: Quantities of the run. They come before those of the caches.
OF_THE_RUN = ("accesses_per_ray", "prefetches_per_access")


@dataclass(frozen=True, slots=True)
class Target:
    """Half-width allowed: the larger of ``relative`` times the value and ``absolute``, both as fractions."""

    relative: float
    absolute: float

    def __post_init__(self) -> None:
        for name in ("relative", "absolute"):
            if not 0.0 <= getattr(self, name) < 1.0:
                raise NptraceError(f"a target error of {getattr(self, name)} is not below 100 %; write e.g. 2% or 0.05pp")
        if self.relative == self.absolute == 0.0:
            raise NptraceError("a target error of 0 is that of the exact run: leave --target-error out and use npcache replay")

    def __str__(self) -> str:
        parts = [f"{100 * self.relative:g}%"] if self.relative else []
        return ",".join(parts + ([f"{100 * self.absolute:g}pp"] if self.absolute else []))

    def part(self, half: float, value: float) -> float:
        """Return a half-width in units of the one allowed for a miss rate of this value."""
        allowed = max(self.relative * value, self.absolute)
        if half == 0.0:
            return 0.0
        return half / allowed if allowed > 0.0 else math.inf


def parse_target(text: str) -> Target:
    """Return the target that a text names: ``2%`` of the value, ``0.05pp`` (points of a rate in per cent), or both."""
    relative = absolute = 0.0
    for part in re.split(r"[,|]", text):
        match = re.fullmatch(r"\s*(\d+(?:\.\d*)?|\.\d+)\s*(%|pp)\s*", part)
        if match is None:
            raise NptraceError(f"{text!r} is not a target error; write e.g. 2%, 0.05pp, or 2%,0.05pp for whichever is wider")
        if match[2] == "%":
            relative = float(match[1]) / 100
        else:
            absolute = float(match[1]) / 100
    return Target(relative, absolute)


@dataclass
class Cell:
    """One cache: ``values`` by the names of ``QUANTITIES``; None for one whose denominator is 0."""

    config: CacheConfig
    values: dict[str, Interval | None]


@dataclass
class Estimated:
    """What came out for one run.

    Attributes
    ----------
    method : str
        ``sampled`` or ``exact``.
    reason : str
        Why the run was counted exactly.
    share : float
        Positions traced / positions of the run, warm-up and scout included; what is traced again, or was before an
        interruption, counts once. An exact run traces all.
    seconds : float
        What this call took, abandoned samples included.
    exact_seconds : float
        What the exact run takes: measured, or for a sampled run predicted at the rate of the sample.
    flags : list
        What was found to be out of a sample's reach.
    """

    identity: RunIdentity
    method: str
    reason: str
    cells: list[Cell]
    accesses_per_ray: Interval | None
    prefetches_per_access: Interval | None
    n_units: int
    n_sampled: int
    share: float
    seconds: float
    exact_seconds: float
    seed: int
    target: str
    flags: list[str] = field(default_factory=list)

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""

        def interval(value: Interval | None) -> dict[str, float] | None:
            return None if value is None else {"value": value.value, "half_width": value.half, "unsettled": value.bracket}

        return {
            **self.identity.to_dict(), "method": self.method, "reason": self.reason, "target": self.target,
            "confidence": CONFIDENCE, "seed": self.seed,
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


def place_of(cache: int, quantity: str) -> int:
    """Return the place in ``ratios_of`` of one of the ``QUANTITIES`` of the cache with this number."""
    return len(OF_THE_RUN) + cache * len(QUANTITIES) + QUANTITIES.index(quantity)


def ratios_of(configs: Sequence[CacheConfig]) -> list[Ratio]:
    """Return the quantities of the run (``OF_THE_RUN``) and of every cache (``QUANTITIES``) as ratios of totals."""
    size = _N_COUNTS + N_MISSES * len(configs)

    def form(*entries: int, times: float = 1.0) -> np.ndarray:
        vector = np.zeros(size)
        vector[list(entries)] = times
        return vector

    demand, everything = form(ACCESSES), form(ACCESSES, PREFETCHES)
    found = [Ratio((demand,), (form(RAYS),)), Ratio((form(PREFETCHES),), (demand,), unlike=_BURSTS)]
    for k, config in enumerate(configs):
        first = _N_COUNTS + N_MISSES * k
        alone, with_, both = form(first + ALONE), form(first + DEMAND), form(first + DEMAND, first + REQUESTS)
        found += [
            Ratio((alone,), (demand,)),
            Ratio((with_,), (demand,)),
            Ratio((both,), (everything,)),
            Ratio((with_,), (alone,)),
            Ratio((both, demand), (everything, alone)),
            Ratio((both,), (alone,)),
            Ratio((config.line_bytes * alone,)),
            Ratio((config.line_bytes * both,)),
        ]
    return found


def estimate(
    source: UnitSource,
    configs: Sequence[CacheConfig],
    target: Target,
    *,
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
    seed : int
        Decides which units are sampled.
    threads : int, optional
        As many as there are cores when None. The figures do not depend on it.
    exact_below : float
        Predicted accesses up to which the run is counted exactly at once.
    resume : Path, optional
        File that keeps the counts after every stage; one that is there is continued.
    progress : callable
        Called with the number of positions done.
    """
    counts = UnitCounts(source, configs, threads)
    if resume is not None:
        counts.load(resume)
    start = time.perf_counter()
    predicted = source.probe(min(PROBES, source.n_positions), seed) * source.n_positions
    if predicted <= exact_below:
        reason = f"about {predicted / 1e6:.0f} million accesses are counted exactly in a moment"
        return _exactly(source, configs, counts, target, seed, start, reason, [], progress)
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
        return _exactly(source, configs, counts, target, seed, start, found.hopeless, found.flags, progress)
    return _result(
        source, configs, found.intervals, method="sampled", reason="", n_units=counts.n_units, n_sampled=found.n_sampled,
        share=counts.n_traced / source.n_positions, seconds=time.perf_counter() - start,
        exact_seconds=counts.exact_seconds(found.n_accesses), seed=seed, target=str(target), flags=[],
    )  # fmt: skip


@dataclass
class Look:
    """What one sample says. ``hopeless`` is why no larger one would do, or would pay; else ``split`` are the strata to cut."""

    intervals: list[Interval]
    n_sampled: int
    share: float  # of the run that had to be traced for this sample alone
    is_within: bool
    flags: list[str]
    hopeless: str
    split: np.ndarray
    n_accesses: float = 0.0  # of the whole run, prefetches included


class Sampler:
    """Looks at one stage after the other; remembers how long the warm-up and how large the second sample had to be."""

    def __init__(self, counts: UnitCounts, configs: Sequence[CacheConfig], row: int, seed: int) -> None:
        self._counts, self._configs, self._seed = counts, configs, seed
        self._ratios = ratios_of(configs)
        self._row, self._warm, self._part = row, row, _LEAST_PART
        self._may_double = True

    def look(self, stage: Stage, target: Target) -> Look:
        """Count what the stage adds, and judge."""
        least = self._counts.least_cost(stage.units.tolist(), self._second(stage).size, self._warm)
        if least > MOST_SHARE * self._counts.n_positions:
            share = least / self._counts.n_positions
            reason = (
                f"{stage.units.size} of its {self._counts.n_units} units would take {100 * share:.0f} % of the run to sample"
            )
            return Look([], 0, 0.0, False, [], reason, np.empty(0, np.int64))
        sample, found = self._extrapolate(stage)
        while self._may_double and self._unsettled(found.intervals, target) > _SETTLED:
            warm = self._counts.least_cost([], sample.second.size, 2 * self._warm)
            if self._warm >= _MOST_WARM * self._row or warm > _MOST_WARM_SHARE * self._counts.n_positions:
                break
            self._warm *= 2
            again = self._extrapolate(stage)
            if self._unsettled(again[1].intervals, target) > 0.7 * self._unsettled(found.intervals, target):
                self._warm //= 2  # what is open is not settled by going back further
                self._may_double = False
                break
            sample, found = again
        widest, at = max(
            (target.part(found.intervals[at].half, found.intervals[at].value), at) for _, at, _ in self._targeted()
        )
        # Both samples cost a row or so per unit. The variance of the first falls with the square of its size or faster, that
        # of the second with its size: at the least cost for a given sum, their sizes are as the root of half the ratio.
        share = min(float(found.second_share[at]), 0.9)
        self._part = min(max(math.sqrt(share / (1 - share) * self._part / 2), self._part), 1.0)
        second = stage.units[sample.second].tolist()
        share = self._counts.cost(stage.units.tolist(), second, self._warm) / self._counts.n_positions
        flags = self._flags(sample, found.intervals, target)
        is_stated = all(0.0 < interval.half < math.inf for interval in found.intervals)
        is_within = widest <= 1 and is_stated and not flags
        hopeless = "" if is_within else self._hopeless(stage, widest, is_stated, share, flags)
        split = np.empty(0, np.int64) if is_within or hopeless else self._to_split(stage, found, target, widest)
        n_accesses = float(found.totals[[ACCESSES, PREFETCHES]].sum())
        return Look(found.intervals, stage.units.size, share, is_within, flags, hopeless, split, n_accesses)

    def _extrapolate(self, stage: Stage) -> tuple[Sample, Extrapolated]:
        sample = self._sample(stage)
        return sample, extrapolate(sample, self._ratios, confidence=_OF_A_LOOK, seed=self._seed)

    def _to_split(self, stage: Stage, found: Extrapolated, target: Target, widest: float) -> np.ndarray:
        """Return the strata whose cutting should bring every interval within the target, most useful first."""
        places = [at for _, at, _ in self._targeted()]
        allowed = 1 / np.array([max(target.part(1.0, found.intervals[at].value), 1e-300) for at in places])
        sizes = np.diff(stage.edges).astype(float)
        drawn = np.histogram(stage.units, stage.edges)[0]
        within = expected(found.means[:, places], found.variances[:, places]) / allowed**2
        within += _ANYWHERE * np.average(found.variances[:, places] / allowed**2, axis=0, weights=sizes)
        gain = (within * (sizes**2 * (1 - drawn / sizes) / drawn)[:, None]).max(axis=1)
        order = np.argsort(-gain, kind="stable")
        order = order[sizes[order] > 2]
        # Half the length of a stratum leaves about a fifth of its variance. Some more than seems needed, as that is a guess,
        # and as looking often would stop at the first sample that happens to look good.
        left = 1 - 0.8 * np.cumsum(gain[order]) / max(float(gain.sum()), 1e-300)
        enough = int(np.searchsorted(-left, -((0.9 / widest) ** 2))) + 1
        return order[: max(enough, len(sizes) // 8)]

    def _targeted(self) -> list[tuple[CacheConfig, int, str]]:
        """Return (cache, place among the intervals, name) of the quantities with a target."""
        return [(config, place_of(k, name), name) for k, config in enumerate(self._configs) for name in TARGETED]

    def _second(self, stage: Stage) -> np.ndarray:
        """Return the places of the second sample among the units."""
        n = stage.units.size
        m = min(max(_LEAST_SECOND, int(np.ceil(self._part * n))), n)
        return np.sort(np.argsort(stage.priority, kind="stable")[:m])

    def _sample(self, stage: Stage) -> Sample:
        second = self._second(stage)
        self._counts.count(stage.units.tolist(), stage.units[second].tolist(), self._warm)
        return Sample(
            stage.edges, stage.units, *self._counts.table(stage.units.tolist()), second,
            *self._counts.long_table(stage.units[second].tolist(), self._warm),
        )  # fmt: skip

    def _unsettled(self, intervals: Sequence[Interval], target: Target) -> float:
        """Return the largest part of the target that open misses take up."""
        return max(target.part(intervals[at].bracket, intervals[at].value) for _, at, _ in self._targeted())

    def _flags(self, sample: Sample, intervals: Sequence[Interval], target: Target) -> list[str]:
        flags = []
        second = sample.second
        # Of the open misses as many as the second sample found to be misses.
        share = (sample.settled - sample.certain[second]).sum(axis=0) / np.maximum(sample.open_[second].sum(axis=0), 1)
        seen = sample.certain.sum(axis=0) + share * sample.open_.sum(axis=0)
        for config, of_cache in zip(self._configs, seen.reshape(-1, N_MISSES), strict=True):
            n_seen = int(min(of_cache[ALONE], of_cache[DEMAND]))
            if n_seen < LEAST_MISSES:
                flags.append(f"{config}: {n_seen} misses in the sample, too few to judge by")
        for config, at, name in self._targeted():
            value = intervals[at]
            if target.part(value.bracket, value.value) > 0.5:
                share = min(value.bracket / LIKELY / value.value, 1.0)
                flags.append(
                    f"{config}: after {self._warm} positions of warm-up up to {100 * share:.2g} % of its "
                    f"{name.replace('_', ' ')} are first touches of lines, or re-use from longer ago, which no sample settles"
                )
                break
        return flags

    def _hopeless(self, stage: Stage, widest: float, is_stated: bool, share: float, flags: Sequence[str]) -> str:
        if flags:
            return flags[0]
        of_units = f"judged by {stage.units.size} units"
        if not is_stated or not math.isfinite(widest):
            # Without freedom enough to state an interval there is nothing to judge a larger sample by.
            return f"not every quantity has a bound, {of_units}" if share > MOST_SHARE / 2 else ""
        needed = share * max(widest, 1.0) ** (1 / _DECLINE)
        if needed > MOST_SHARE:
            return f"the target would take {100 * min(needed, 1.0):.0f} % of the run, {of_units}"
        return ""


def _exactly(
    source: UnitSource, configs: Sequence[CacheConfig], counts: UnitCounts, target: Target, seed: int, start: float,
    reason: str, flags: list[str], progress: Callable[[int], object],
) -> Estimated:  # fmt: skip
    before = time.perf_counter()
    sure, misses = counts.everything(progress)
    end = time.perf_counter()
    totals = np.concatenate([sure.sum(axis=0), misses.sum(axis=0)])
    intervals = [Interval(value_of(ratio_, totals), 0.0, 0.0) for ratio_ in ratios_of(configs)]
    return _result(
        source, configs, intervals, method="exact", reason=reason, n_units=counts.n_units, n_sampled=counts.n_units,
        share=counts.n_traced / source.n_positions, seconds=end - start, exact_seconds=end - before, seed=seed,
        target=str(target), flags=flags,
    )  # fmt: skip


def _result(source: UnitSource, configs: Sequence[CacheConfig], intervals: Sequence[Interval], **facts: Any) -> Estimated:
    defined = [None if math.isnan(interval.value) else interval for interval in intervals]
    cells = [
        Cell(config, {name: defined[place_of(k, name)] for name in QUANTITIES}) for k, config in enumerate(configs)
    ]  # fmt: skip
    per_ray, per_access = defined[: len(OF_THE_RUN)]
    return Estimated(source.identity, cells=cells, accesses_per_ray=per_ray, prefetches_per_access=per_access, **facts)
