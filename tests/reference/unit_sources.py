"""Sources of units made up from arrays: what the estimator samples when the truth is known in closed form."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from traces.identity import RunIdentity

READ, PREFETCH = 0, 3


class Stretch(NamedTuple):
    nodes: np.ndarray
    kinds: np.ndarray
    n_rays: int


class ArraySource:
    """A trace in memory, ``per`` accesses to a position; nodes are 32-byte lines, one ray to a position."""

    def __init__(self, nodes, kinds=None, *, per=1, unit=256, row=None, name="array"):
        self._all = np.ascontiguousarray(nodes, np.uint32)
        self._kinds = np.zeros(self._all.size, np.uint8) if kinds is None else np.ascontiguousarray(kinds, np.uint8)
        self._per = per
        n_nodes = int(self._all.max()) + 1
        self.identity, self.key = RunIdentity(name), name
        self.n_positions = self._all.size // per
        self.unit, self.row, self.grain = unit, row or unit, 1
        self.node_bytes, self.reads_leaves = 32, True
        self.nodes = {"parent": np.full(n_nodes, -1, np.int32), "level": np.zeros(n_nodes, np.uint16)}
        self.n_traced = 0

    def trace(self, cuts):
        self.n_traced += cuts[-1] - cuts[0]
        k = self._per
        return [
            Stretch(self._all[low * k : high * k], self._kinds[low * k : high * k], high - low) for low, high in pairwise(cuts)
        ]

    def probe(self, n, seed):
        return float(self._per)

    def scout(self, seed):
        step = 64
        at = np.arange(0, self.n_positions, step)
        groups = [self.trace([low, low + 1])[0] for low in at]
        return at + 0.5, groups, at


def independent(n_lines, n, seed):
    """References drawn alike and independently from ``n_lines`` lines: direct-mapped caches of S sets miss 1 - S / n_lines."""
    return np.random.default_rng(seed).integers(n_lines, size=n)


def cyclic(n_lines, n):
    """0, 1, ... n_lines - 1, 0, 1, ...: LRU misses always, or, if all lines fit, only the first time."""
    return np.arange(n) % n_lines


def of_stack_distances(weights, n, seed):
    """References with LRU stack distance d with probability ``weights[d - 1]``: n lines hit with the sum of the first n."""
    distances = np.random.default_rng(seed).choice(len(weights), size=n, p=np.asarray(weights) / np.sum(weights))
    stack, out = list(range(len(weights))), np.empty(n, np.int64)
    for i, d in enumerate(distances.tolist()):
        line = stack.pop(d)
        stack.insert(0, line)
        out[i] = line
    return out
