"""How far a total from some sample units may be off: what those of every stratum add -> a variance no luck makes zero.

Two units to a stratum say little about it where a run has steps: both may lie on one side. So a variance has three parts, each
of which is seen by more than the two:

- *Neighbours.* A stratum is as uneven as its own units and those of the two strata beside it, and no less than the steps from
  its mean to theirs allow: a step of height d, somewhere in one of two strata, leaves d^2 / 12 in each (a trend does as well).
  The sum over all strata is not below that of the strata's own variances, which is right in the mean.
- *What is like nothing that was sampled.* Of n units drawn, each was like some other; by Laplace's rule one in n + 1 of the
  others is not. How far it is off its surroundings is taken from the farthest that was seen, and from the value itself.
- *The second sample.* By the same rule, of m units warmed up again one more is expected to have settled otherwise.
"""

import numpy as np

#: A step anywhere in one of two strata, (step)^2 f (1 - f) in the mean over its place f, half of it for each.
_STEP = 1 / 12


def between_strata(means: np.ndarray, squares: np.ndarray, freedom: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """Return the variance of totals due to the units that were not drawn, (k,) float64.

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
    """Return the variance of totals due to units that are like none of those drawn, (k,) float64.

    Parameters
    ----------
    distance : (n, k) float64
        Of the drawn units from the means of their strata, positive.
    least : (k,) float64
        What such a unit may be off although no unit that was drawn is.
    """
    n = len(distance)
    n_unlike = (n_units - n) / (n + 1)
    return (n_unlike * np.maximum(distance.max(axis=0), least)) ** 2


def settled_otherwise(opened: np.ndarray, m: int, n_units: float) -> np.ndarray:
    """Return the least variance of totals due to a second sample of ``m`` units; ``opened`` is what all open misses add."""
    return (opened / (m + 2)) ** 2 * (1 - m / n_units)


def _with_neighbours(values: np.ndarray) -> np.ndarray:
    padded = np.pad(values, ((1, 1), (0, 0)))
    return padded[:-2] + padded[1:-1] + padded[2:]
