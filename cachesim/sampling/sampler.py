"""Evaluation of a sample: a stage of units and a target in; intervals, and whether they suffice or what to do next, out."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cachesim.config import CacheConfig
from cachesim.sampling.cold_start import ALONE, DEMAND, N_MISSES
from cachesim.sampling.quantities import TARGETED, place_of, ratios_of
from cachesim.sampling.strata import Stage, expected
from cachesim.sampling.target import Target
from cachesim.sampling.two_phase import LIKELY, Estimate, Interval, Sample
from cachesim.sampling.two_phase import estimate as extrapolate
from cachesim.sampling.unit_counts import ACCESSES, PREFETCHES, UnitCounts

#: Confidence of each interim look at a sample. It is higher than the stated one, to offset optional stopping: the first sample
#: that looks good enough ends the search. The difference is measured (docs/speed-error.md).
_OF_A_LOOK = 0.965
#: Share of the positions that a sample may cost, warm-up included, before the exact run is the better choice.
MOST_SHARE = 0.6
#: Misses, known or unknown, that a cache must have in the sample for an interval to be stated.
LEAST_MISSES = 100
_LEAST_SECOND = 24  # units counted with a long warm-up, at least ...
_LEAST_PART = 1 / 8  # ... and as a share of the sampled units
_MOST_WARM, _MOST_WARM_SHARE = 8, 0.15  # rows of warm-up, at most, and their positions as a share of the run
_SETTLED = 0.25  # share of the target that unknown misses may take up before the warm-up is doubled
#: Share of the mean variance to expect in a stratum whose neighbours are all alike: a rare feature may hide there.
_ANYWHERE = 0.5
_DECLINE = 1.2  # the error falls with about this power of the number of units: shorter strata have units that are more alike


@dataclass
class Look:
    """The result of one sample. ``hopeless``: why no larger sample would suffice or pay; else ``split``: the strata to cut."""

    intervals: list[Interval]
    n_sampled: int
    share: float  # of the run that had to be traced for this sample alone
    is_within: bool
    flags: list[str]
    hopeless: str
    split: np.ndarray
    n_accesses: float = 0.0  # of the whole run, prefetches included


class Sampler:
    """Evaluates one stage after the other; remembers the length of the warm-up and the size of the second sample."""

    def __init__(self, counts: UnitCounts, configs: Sequence[CacheConfig], row: int, seed: int) -> None:
        self._counts, self._configs, self._seed = counts, configs, seed
        self._ratios = ratios_of(configs)
        self._row, self._warm, self._part = row, row, _LEAST_PART
        self._may_double = True

    def look(self, stage: Stage, target: Target) -> Look:
        """Count the units that the stage adds, and evaluate the sample."""
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
                self._warm //= 2  # a longer warm-up does not settle the unknown misses
                self._may_double = False
                break
            sample, found = again
        widest, at = max(
            (target.part(found.intervals[at].half, found.intervals[at].value), at) for _, at, _ in self._targeted()
        )
        # Each sample costs about a row per unit. The variance of the first falls with the square of its size or faster, that
        # of the second with its size: a given sum costs least if their sizes are as the root of half the ratio.
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

    def _extrapolate(self, stage: Stage) -> tuple[Sample, Estimate]:
        sample = self._sample(stage)
        return sample, extrapolate(sample, self._ratios, confidence=_OF_A_LOOK, seed=self._seed)

    def _to_split(self, stage: Stage, found: Estimate, target: Target, widest: float) -> np.ndarray:
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
        # Half the length of a stratum leaves about a fifth of its variance. Cut some more strata than seem necessary: that is
        # an estimate, and many interim looks would stop at the first sample that happens to look good.
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
        """Return the largest share of the target that unknown misses take up."""
        return max(target.part(intervals[at].bracket, intervals[at].value) for _, at, _ in self._targeted())

    def _flags(self, sample: Sample, intervals: Sequence[Interval], target: Target) -> list[str]:
        flags = []
        second = sample.second
        # The share of unknown misses that the second sample found to be misses.
        share = (sample.settled - sample.known[second]).sum(axis=0) / np.maximum(sample.unknown[second].sum(axis=0), 1)
        seen = sample.known.sum(axis=0) + share * sample.unknown.sum(axis=0)
        for config, of_cache in zip(self._configs, seen.reshape(-1, N_MISSES), strict=True):
            n_seen = int(min(of_cache[ALONE], of_cache[DEMAND]))
            if n_seen < LEAST_MISSES:
                flags.append(f"{config}: {n_seen} misses in the sample, too few to judge by")
        for config, at, name in self._targeted():
            value = intervals[at]
            if target.part(value.bracket, value.value) > 0.5:
                share = min(value.bracket / LIKELY / value.value, 1.0)
                flags.append(
                    f"{config}: after a warm-up of {self._warm} positions, up to {100 * share:.2g} % of its "
                    f"{name.replace('_', ' ')} may be first touches of lines or older reuse, which no sample can settle"
                )
                break
        return flags

    def _hopeless(self, stage: Stage, widest: float, is_stated: bool, share: float, flags: Sequence[str]) -> str:
        if flags:
            return flags[0]
        of_units = f"judged by {stage.units.size} units"
        if not is_stated or not math.isfinite(widest):
            # Without enough degrees of freedom for an interval, nothing tells how large a sample is needed.
            return f"not every quantity has a bound, {of_units}" if share > MOST_SHARE / 2 else ""
        needed = share * max(widest, 1.0) ** (1 / _DECLINE)
        if needed > MOST_SHARE:
            return f"the target would take {100 * min(needed, 1.0):.0f} % of the run, {of_units}"
        return ""
