"""The choice of sample units: features seen by a scout along the run and a seed -> stratified samples, refined where it pays.

A stratum is a stretch of neighbouring units, two of which are sampled. So slow changes along the run, from the top of a
picture to its bottom, cause no error, and no period of the picture can hide between the samples. At first, strata are short
where the scout saw much change and long where it saw little. To refine a sample, some strata are cut in two, and units are
drawn until each half has two again; given their number in a half, the sampled units there are a random sample of it.

The neighbours of a stratum, never its own units, decide whether it is cut. To refine a stratum because its sample varies, and
to stop where the sample happens not to vary, would miss rare features by design.
"""

from typing import NamedTuple

import numpy as np

#: Strata of the first stage; with two units each, the smallest sample with an interval.
FIRST_STRATA = 32
#: Weight of a stretch in which the scout saw no change, where 1 is the mean: a scout may miss changes.
_FLOOR = 0.5


class Stage(NamedTuple):
    """One sample."""

    edges: np.ndarray  # (n_strata + 1,) int64: stratum h holds the units edges[h] up to edges[h + 1]
    units: np.ndarray  # (n,) int64, ascending
    priority: np.ndarray  # (n,) float64: units of lowest priority are a random subsample of any size


def weights(at: np.ndarray, features: np.ndarray, middles: np.ndarray) -> np.ndarray:
    """Return how much the run changes around every unit, (n_units,) float64, about 1 in the mean.

    Parameters
    ----------
    at : (g,) float64
        Where along the run the scout looked, ascending.
    features : (g, k) float64
        What it saw there.
    middles : (n_units,) float64
        Where the units lie.
    """
    if len(at) < 2:
        return np.ones(middles.size)
    total = np.zeros(middles.size)
    for column in features.T:
        change = np.abs(np.diff(column))
        padded = np.pad(change**2, 1, mode="edge")
        smooth = np.sqrt((padded[:-2] + padded[1:-1] + padded[2:]) / 3)
        mean = smooth.mean()
        total += np.interp(middles, (at[:-1] + at[1:]) / 2, smooth / mean) if mean > 0 else 1.0
    return total / features.shape[1] + _FLOOR


class Design:
    """A sample that grows.

    Parameters
    ----------
    weight : (n_units,) float64
        Positive; strata are cut where it has equal sums.
    seed : int
    """

    def __init__(self, weight: np.ndarray, seed: int) -> None:
        n_units = weight.size
        self._seed = seed
        self._priority = np.random.default_rng([seed, n_units]).random(n_units)
        self._cumulated = np.append(0.0, np.cumsum(weight))
        self._edges = _cut(self._cumulated, 0, n_units, min(FIRST_STRATA, max(n_units // 2, 1)))
        self._taken = np.zeros(n_units, bool)
        self._draw()

    def stage(self) -> Stage:
        """Return the present sample."""
        units = np.flatnonzero(self._taken)
        return Stage(self._edges, units, self._priority[units])

    def split(self, strata: np.ndarray) -> None:
        """Cut the strata with these numbers, (k,) int64, in two, and draw the units that the halves lack."""
        middles = [
            _cut(self._cumulated, int(self._edges[h]), int(self._edges[h + 1]), 2)[1]
            for h in strata
            if self._edges[h + 1] - self._edges[h] > 1
        ]
        self._edges = np.unique(np.concatenate([self._edges, np.array(middles, np.int64)]))
        self._draw()

    def _draw(self) -> None:
        low, high = self._edges[:-1], self._edges[1:]
        n_before = np.append(0, np.cumsum(self._taken))
        lacking = np.minimum(2, high - low) - (n_before[high] - n_before[low])
        for h in np.flatnonzero(lacking > 0):
            a, b = int(low[h]), int(high[h])
            rng = np.random.default_rng([self._seed, a, b])  # independent of earlier cuts
            self._taken[a + rng.permutation(np.flatnonzero(~self._taken[a:b]))[: lacking[h]]] = True


def expected(means: np.ndarray, variances: np.ndarray) -> np.ndarray:
    """Return the variance to expect inside every stratum, judged by its neighbours: (n_strata, k) float64.

    Parameters
    ----------
    means, variances : (n_strata, k) float64
        Of the units sampled in each stratum.
    """
    low, high = np.pad(means, ((1, 0), (0, 0)), mode="edge")[:-1], np.pad(means, ((0, 1), (0, 0)), mode="edge")[1:]
    before, after = np.roll(variances, 1, axis=0), np.roll(variances, -1, axis=0)
    before[0], after[-1] = after[0], before[-1]
    # The values between two neighbours' means, spread evenly.
    return (before + after) / 2 + (high - low) ** 2 / 12


def _cut(cumulated: np.ndarray, low: int, high: int, n: int) -> np.ndarray:
    """Return n + 1 edges from low to high between which the weights are about equal, and at least one unit lies."""
    wanted = np.linspace(cumulated[low], cumulated[high], n + 1)
    edges = np.searchsorted(cumulated, wanted)
    steps = np.arange(n + 1)
    edges = np.maximum.accumulate(edges - steps) + steps
    edges = np.minimum(edges, high - (n - steps))
    edges[0], edges[-1] = low, high
    return np.maximum(edges, low + steps)
