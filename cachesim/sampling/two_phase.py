"""Totals of a run from some of its sample units: counts of the sampled units in; ratios with joint intervals out.

Two phases. The units of a first sample, drawn in strata of neighbouring units, are counted after a very short warm-up: some
misses are known, others unknown (``cold_start``). A random part of these units is counted again after a long warm-up, which
settles nearly all unknown misses. The share of unknown misses that prove to be misses is a regression coefficient through the
origin, taken from the second sample and applied to the first (two-phase regression: Cochran 1977, Sec. 12.6; Saerndal,
Swensson and Wretman 1992, Ch. 9). Misses that stay unknown widen the interval by as much as they can change the result.

Every quantity is a ratio of products of totals, linearised about the estimate. Numerator and denominator come from the same
units, so their common error cancels.
"""

import math
from collections.abc import Sequence
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from cachesim.sampling.spread import between_strata, settled_otherwise, unlike_any

#: Share of the misses unknown after a long warm-up that counts as misses: a line unused for that long is rarely still in the
#: cache. Measured 0.84 to 0.98 where it matters, in the bunny with its empty margins. The interval covers 0 to 1.
LIKELY = 0.9

#: Draws for the joint distribution of all errors; the error of the quantile itself is 0.5 % of coverage.
_DRAWS = 2000


class Sample(NamedTuple):
    """The counts of the sampled units.

    Attributes
    ----------
    edges : (n_strata + 1,) int64
        Stratum h holds the units from edges[h] up to edges[h + 1]; together they are all units of the run.
    units : (n,) int64
        The sampled units, ascending; in each stratum drawn at random without replacement, at least two or all.
    counts : (n, n_counts) float64
        Exact counts of each unit: accesses, prefetches, rays.
    known, unknown : (n, n_misses) float64
        Misses after the short warm-up.
    second : (m,) int64
        Places in ``units`` of the units counted again, drawn at random from all of them; at least two.
    settled, bracket : (m, n_misses) float64
        Known and unknown misses of these after the long warm-up.
    """

    edges: np.ndarray
    units: np.ndarray
    counts: np.ndarray
    known: np.ndarray
    unknown: np.ndarray
    second: np.ndarray
    settled: np.ndarray
    bracket: np.ndarray


class Ratio(NamedTuple):
    """The product of the totals ``form . totals`` above / the product of those below, with forms of (n_counts + n_misses,).

    ``unlike``: how far an unsampled unit may deviate even if no sampled one does, as a multiple of a unit's mean contribution.
    """

    above: tuple[np.ndarray, ...]
    below: tuple[np.ndarray, ...] = ()
    unlike: float = 0.25


class Interval(NamedTuple):
    """value - half <= truth <= value + half; ``bracket`` is the part of ``half`` due to unsettled misses, not to chance."""

    value: float
    half: float
    bracket: float


class Estimate(NamedTuple):
    """Totals of the whole run, and the errors of ratios of them."""

    totals: np.ndarray  # (n_counts + n_misses,) with the likely part of the bracket
    intervals: list[Interval]
    means: np.ndarray  # (n_strata, n_ratios) of the units' contributions to each ratio's error
    variances: np.ndarray  # (n_strata, n_ratios) of them
    second_share: np.ndarray  # (n_ratios,) share of the variance because the second sample is smaller than the first


def t_quantile(upper: float, df: float) -> float:
    """Return the value that Student's t with ``df`` degrees of freedom exceeds with probability ``upper``.

    Abramowitz and Stegun 1964, eq. 26.7.5; for ``upper`` >= 0.001 within 1 % from 8 degrees of freedom on. Below 4 degrees
    it is too inaccurate for an interval, and the result is infinite.
    """
    if df < 4:
        return float("inf")
    z = -NormalDist().inv_cdf(upper)
    terms = (
        (z**3 + z) / 4,
        (5 * z**5 + 16 * z**3 + 3 * z) / 96,
        (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384,
        (79 * z**9 + 776 * z**7 + 1482 * z**5 - 1920 * z**3 - 945 * z) / 92160,
    )
    return z + sum(term / df ** (k + 1) for k, term in enumerate(terms))


def joint_tail(correlation: np.ndarray, confidence: float, seed: int) -> float:
    """Return the one-sided tail for each of several normal errors with which all bounds hold at once with ``confidence``.

    It lies between (1 - confidence) / 2, for identical errors, and that divided by their number (Bonferroni, without any
    assumption). Caches of similar size miss on the same lines, so their errors are nearly identical.
    """
    n = len(correlation)
    values, vectors = np.linalg.eigh(correlation)
    draws = np.random.default_rng(seed).standard_normal((_DRAWS, n)) * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    z = float(np.quantile(np.abs(draws).max(axis=1), confidence))
    low, high = (1 - confidence) / (2 * n), (1 - confidence) / 2
    return min(max(NormalDist().cdf(-z), low), high)


def estimate(sample: Sample, ratios: Sequence[Ratio], *, confidence: float = 0.95, seed: int = 0) -> Estimate:
    """Return the totals, and for every ratio an interval; all of them hold at once with ``confidence``.

    Raises
    ------
    ValueError
        A stratum has a single sampled unit of several, or the second sample has fewer than two.
    """
    edges, units = sample.edges, sample.units
    stratum = np.searchsorted(edges, units, side="right") - 1
    sizes, drawn = np.diff(edges).astype(float), np.bincount(stratum, minlength=len(edges) - 1).astype(float)
    if ((drawn < 2) & (drawn < sizes)).any() or sample.second.size < min(2, units.size):
        raise ValueError("every stratum needs at least two sampled units, and so does the second sample")
    n_units, m = float(edges[-1]), float(sample.second.size)
    weight = (sizes / drawn)[stratum]

    own = weight[sample.second, None]
    # Without unknown misses all sums are 0.
    unknown_of_second = np.maximum((own * sample.unknown[sample.second]).sum(axis=0), 1e-300)
    n_counts = sample.counts.shape[1]

    def predict(settled: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        share = (own * (settled - sample.known[sample.second])).sum(axis=0) / unknown_of_second
        predicted = np.hstack([sample.counts, sample.known + share * sample.unknown])
        missed = np.zeros((sample.second.size, predicted.shape[1]))
        missed[:, n_counts:] = settled - predicted[sample.second, n_counts:]
        return predicted, missed

    totals = weight @ predict(sample.settled + LIKELY * sample.bracket)[0]
    bracket = np.zeros_like(totals)
    bracket[n_counts:] = (weight @ sample.unknown) * (own * sample.bracket).sum(axis=0) / unknown_of_second * LIKELY
    values, gradients = zip(*(_linearise(ratio, totals) for ratio in ratios), strict=True)
    gradient = np.array(gradients)

    freedom = drawn - 1
    factor = sizes**2 * (1 - drawn / sizes) / drawn  # 0 for a stratum whose units are all sampled
    of_second = np.sqrt(max(n_units**2 * (1 / m - 1 / n_units), 0.0) / max(m - 1, 1))
    # A value of 0 does not tell how large it may be elsewhere; 1 is a miss, or a prefetch, for every access.
    least = np.array([r.unlike * (abs(v) or 1.0) / n_units for r, v in zip(ratios, values, strict=True)])
    opened = np.abs(gradient[:, n_counts:] @ (weight @ sample.unknown))

    def errors(settled: np.ndarray) -> _Errors:
        predicted, missed = predict(settled)
        z, r = predicted @ gradient.T, missed @ gradient.T * of_second
        means, squares = np.zeros((2, len(sizes), len(ratios)))
        np.add.at(means, stratum, z)
        means /= drawn[:, None]
        off = z - means[stratum]
        np.add.at(squares, stratum, off**2)
        variances = squares / np.maximum(freedom, 1)[:, None]
        second = np.maximum((r**2).sum(axis=0), settled_otherwise(opened, int(m), n_units))
        variance = between_strata(means, squares, freedom, factor) + second
        variance += unlike_any(np.abs(off), least, n_units)
        scaled = off * np.sqrt(factor / np.maximum(freedom, 1))[stratum, None]
        # Satterthwaite's degrees of freedom. The square of an estimated variance is too large by (df + 2) / df in the mean,
        # which with two units a stratum, df = 1, would leave a third of the freedom there is.
        spent = ((variances * factor[:, None]) ** 2 / (freedom + 2)[:, None]).sum(axis=0) + second**2 / (m + 1)
        df = np.divide(variance**2, spent, out=np.full(len(spent), 1e9), where=spent > 0)
        return _Errors(scaled.T @ scaled + r.T @ r, variance, second, df, means, variances)

    # The unknown references may all be hits or all be misses: take the wider of the two intervals.
    hits, misses = errors(sample.settled), errors(sample.settled + sample.bracket)
    tail = joint_tail(correlation_of(misses.covariance), confidence, seed)
    # The full distance to the case in which no unknown reference is a miss, for each total separately.
    widths = np.abs(gradient) @ bracket
    intervals = []
    for k, value in enumerate(values):
        chance = max(t_quantile(tail, float(of.df[k])) * math.sqrt(of.variance[k]) for of in (hits, misses))
        intervals.append(Interval(float(value), float(widths[k]) + chance, float(widths[k])))
    share = np.divide(misses.second, misses.variance, out=np.zeros(len(values)), where=misses.variance > 0)
    return Estimate(totals, intervals, misses.means, misses.variances, share)


class _Errors(NamedTuple):
    covariance: np.ndarray  # (n_ratios, n_ratios), of the sampled units
    variance: np.ndarray  # (n_ratios,), with an allowance for what the sample may have missed
    second: np.ndarray  # (n_ratios,), the part due to the second sample
    df: np.ndarray
    means: np.ndarray  # (n_strata, n_ratios)
    variances: np.ndarray  # (n_strata, n_ratios)


def correlation_of(covariance: np.ndarray) -> np.ndarray:
    """Return the correlations, (k, k) float64; an error without variance correlates with itself only."""
    deviation = np.sqrt(np.diag(covariance))
    is_seen = deviation > 1e-12 * deviation.max(initial=0.0)
    scale = np.where(is_seen, deviation, 1.0)
    found = np.where(np.outer(is_seen, is_seen), covariance / np.outer(scale, scale), 0.0)
    np.fill_diagonal(found, 1.0)
    return found


def value_of(ratio: Ratio, totals: np.ndarray) -> float:
    """Return the ratio's value for the totals, (n_counts + n_misses,) float64; NaN where it divides by 0."""
    return _linearise(ratio, totals)[0]


def _linearise(ratio: Ratio, totals: np.ndarray) -> tuple[float, np.ndarray]:
    above, below = [float(form @ totals) for form in ratio.above], [float(form @ totals) for form in ratio.below]
    if 0.0 in below:
        return float("nan"), np.zeros_like(totals)
    divisor = math.prod(below)
    value = math.prod(above) / divisor
    gradient = np.zeros_like(totals)
    for k, form in enumerate(ratio.above):
        gradient += math.prod(above[:k] + above[k + 1 :]) / divisor * form
    for total, form in zip(below, ratio.below, strict=True):
        gradient -= value / total * form
    return value, gradient
