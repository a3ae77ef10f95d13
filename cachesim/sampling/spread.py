"""The error of a total from sample units: contributions of the units in every stratum -> a variance that chance cannot make 0.

Where a run has steps, two units say little about a stratum: both may lie on one side of a step. So the variance has three
parts, each based on more than two units:

- *Neighbours.* The variance in a stratum is that of its own units and those of the two strata beside it, and no less than the
  steps between their means imply: a step of height d somewhere in two strata leaves d^2 / 12 in each (so does a trend). The
  sum over all strata is at least that of their own variances, which is unbiased.
- *Unseen kinds of units.* Each of n sampled units resembles some other; by Laplace's rule, one in n + 1 of the remaining units
  does not. Its deviation is taken from the largest one sampled, and from the value itself.
- *The second sample.* By the same rule, one of m units counted again is expected to settle differently.
"""

import numpy as np

#: A step anywhere in one of two strata, (step)^2 f (1 - f) in the mean over its place f, half of it for each.
_STEP = 1 / 12


def between_strata(means: np.ndarray, squares: np.ndarray, freedom: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """Return the variance of totals due to the units that are not sampled, (k,) float64.

    Parameters
    ----------
    means, squares : (n_strata, k) float64
        Mean of the sampled units of a stratum, and sum of the squared distances from it.
    freedom : (n_strata,) int64
        Sampled units but one.
    factor : (n_strata,) float64
        Variance of the stratum's total for a variance of 1 of its units; 0 where all of them were drawn.
    """
    own = factor @ (squares / np.maximum(freedom, 1)[:, None])
    pooled = _with_neighbours(squares) / np.maximum(_with_neighbours(freedom[:, None]), 1)
    steps = np.pad(np.diff(means, axis=0) ** 2, ((1, 1), (0, 0)))
    expected = np.maximum(pooled, _STEP * np.maximum(steps[:-1], steps[1:]))
    return np.maximum(own, factor @ expected)


def unlike_any(distance: np.ndarray, least: np.ndarray, n_units: float) -> np.ndarray:
    """Return the variance of totals due to units unlike any sampled one, (k,) float64.

    Parameters
    ----------
    distance : (n, k) float64
        Of the drawn units from the means of their strata, positive.
    least : (k,) float64
        The least deviation of such a unit, even if no sampled unit deviates.
    """
    n = len(distance)
    n_unlike = (n_units - n) / (n + 1)
    return (n_unlike * np.maximum(distance.max(axis=0), least)) ** 2


def settled_otherwise(opened: np.ndarray, m: int, n_units: float) -> np.ndarray:
    """Return the least variance of totals, (k,) float64, due to a second sample of ``m`` units; ``opened``, (k,) float64, are
    the sums over unknown misses.
    """
    return (opened / (m + 2)) ** 2 * (1 - m / n_units)


def _with_neighbours(values: np.ndarray) -> np.ndarray:
    padded = np.pad(values, ((1, 1), (0, 0)))
    return padded[:-2] + padded[1:-1] + padded[2:]
