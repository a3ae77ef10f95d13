"""Knees of a miss-rate curve: the cache sizes after which more size gains little, from stack distances."""

from collections.abc import Sequence

import numpy as np

#: How far a knee lies below the straight line between the ends of its part of the curve, as a share of all accesses.
LEAST_DEPTH = 0.02


def misses_by_size(counts: np.ndarray, sizes: Sequence[int]) -> list[int]:
    """Return the misses of fully associative LRU caches of some numbers of lines.

    Of ``counts``, (n,) int64, ``counts[d]`` are the accesses at stack distance d, ``counts[0]`` the first ones to a line
    (``StackDistances.counts``).
    """
    beyond = np.concatenate([np.cumsum(counts[::-1])[::-1], [0]])  # at distance d or more
    return [int(counts[0] + beyond[min(size + 1, len(counts))]) for size in sizes]


def sizes_of(n_lines: int) -> list[int]:
    """Return the sizes at which a curve is drawn: four in each doubling, up to one that holds all lines."""
    top = max(int(np.ceil(np.log2(max(n_lines, 2)))), 1)
    return sorted({round(2 ** (step / 4)) for step in range(4 * top + 1)})


def knees_of(sizes: Sequence[int], rates: Sequence[float], least: float = LEAST_DEPTH) -> list[int]:
    """Return the sizes at the knees of a falling curve over the logarithm of size, smallest first.

    The point farthest below the straight line between the ends is a knee if it is ``least`` or more below, and each side of
    it may have others.
    """
    x, y = np.log2(np.asarray(sizes, float)), np.asarray(rates, float)

    def knees(first: int, last: int) -> list[int]:
        if last - first < 2:
            return []
        share = (x[first : last + 1] - x[first]) / (x[last] - x[first])
        below = y[first] + share * (y[last] - y[first]) - y[first : last + 1]
        lowest = first + int(np.argmax(below))
        if below[lowest - first] < least:
            return []
        return [*knees(first, lowest), lowest, *knees(lowest, last)]

    return [sizes[i] for i in knees(0, len(sizes) - 1)]
