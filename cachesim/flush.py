"""A cache that is emptied after every ray, without a change of any cache: a source in, its lines renamed ray by ray out.

Every ray gets line numbers of its own, in the sets in which its lines lie. What earlier rays left behind is then never hit,
and LRU and FIFO evict it first, because it is older than all that the ray brings. So every access hits or misses as in a
cache that is empty when its ray starts. Random replacement may evict something else, and a next-line prefetcher would find
no neighbours: both are refused.
"""

import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from cachesim.access import READ
from cachesim.config import CacheConfig
from cachesim.filter import DirectFilter
from cachesim.lines import count_and_keep
from cachesim.prefetch import Prefetch
from cachesim.result import Result
from cachesim.source import DinSource
from nptrace_base.errors import NptraceError
from nptrace_base.jit import kernel

FLUSHES = ("never", "ray")

_MOST_IDS = 1 << 31


def _too_many(n_sets: int) -> str:
    return (
        f"a flush after every ray needs more than 2^31 line numbers for caches of {n_sets} sets together; "
        "replay fewer caches at a time, or a smaller run"
    )


class FlushedSource:
    """A source of a run, whose lines are renamed for every ray, for caches whose numbers of sets divide ``n_sets``."""

    def __init__(self, source: Any, configs: Iterable[CacheConfig]) -> None:
        configs = list(configs)
        if isinstance(source, DinSource):
            raise NptraceError(f"{source.identity.run} has addresses, not rays, after which a cache is emptied; flush never")
        bad = next((each for each in configs if each.policy not in ("lru", "fifo")), None)
        if bad is not None:
            raise NptraceError(f"a flush after every ray is exact for lru and fifo, not for {bad.policy}; use one of those")
        self._source, self.layout, self.identity = source, source.layout, source.identity
        self.n_rays, self.n_events = source.n_rays, source.n_events
        self._n_sets = math.lcm(*(each.n_sets for each in configs)) if configs else 1
        if self._n_sets >= _MOST_IDS:
            raise NptraceError(_too_many(self._n_sets))

    def events(self, prefetch: Prefetch) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield (node, access type) batches."""
        if prefetch.trigger:
            raise NptraceError(f"{prefetch} requests neighbours, and a flush after every ray renames lines; use stack or push")
        return iter(self._source.events(prefetch))

    def check_passes(self, n_passes: int) -> None:
        """Do nothing: a run can be read repeatedly."""

    def lines(self, line_bytes: int, ahead: int) -> "RenamedLines":
        """Return the lines of the nodes, renamed."""
        first, n_lines = self._source.lines(line_bytes, ahead).of_nodes()
        return RenamedLines(first, n_lines, self._n_sets)


class RenamedLines:
    """The lines of nodes, each with a new number for every ray that touches it; a number keeps the line's set.

    Parameters
    ----------
    first, n_lines : (n_nodes,) uint32
        Lowest line and number of lines of every node.
    n_sets : int
        A line and its new number are equal modulo it.
    """

    def __init__(self, first: np.ndarray, n_lines: np.ndarray, n_sets: int) -> None:
        self._first, self._n_lines = first, n_lines
        n = int((first.astype(np.int64) + n_lines).max()) if first.size else 0
        self._ray_of = np.full(n, -1, np.int64)  # the last ray that touched each line, and its number there
        self._number = np.zeros(n, np.uint32)
        self._taken = np.zeros(n_sets, np.int64)  # numbers taken in each residue class
        self._ray = np.zeros(1, np.int64)

    @property
    def n_ids(self) -> int:
        """Number of ids that may occur so far."""
        return int(self._taken.max()) * self._taken.size

    def accesses(self, events: np.ndarray, access_types: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the accesses of node reads."""
        n = int(self._n_lines[events].sum(dtype=np.int64))
        lines, types = np.empty(n, np.uint32), np.empty(n, np.uint8)
        state = self._ray_of, self._number, self._taken, self._ray
        rename(events, access_types, self._first, self._n_lines, state, lines, types)
        if self.n_ids >= _MOST_IDS:
            raise NptraceError(_too_many(self._taken.size))
        return lines, types

    def counted(
        self, events: np.ndarray, access_types: np.ndarray, direct: DirectFilter | None, totals: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the accesses of node reads that are kept."""
        return count_and_keep(*self.accesses(events, access_types), direct, totals)

    def ids(self, lines: np.ndarray) -> np.ndarray:
        """Return the lines themselves."""
        return lines


@kernel
def rename(nodes, access_types, first, n_lines, state, lines, types):
    """Write the renamed line and the access type of every access; a ray starts where the root is read."""
    ray_of, number, taken, ray = state
    n, n_sets = np.uint64(0), np.int64(taken.size)
    for i in range(nodes.size):
        node = nodes[i]
        if node == 0 and access_types[i] == READ:
            ray[0] += 1
        for line in range(np.int64(first[node]), np.int64(first[node]) + np.int64(n_lines[node])):
            if ray_of[line] != ray[0]:
                ray_of[line] = ray[0]
                residue = line % n_sets
                number[line] = taken[residue] * n_sets + residue
                taken[residue] += 1
            lines[n], types[n] = number[line], access_types[i]
            n += np.uint64(1)


def emptied(results: Iterable[Result]) -> list[Result]:
    """Return results whose last ray's cache is emptied too: what prefetches brought and no ray used by its end is useless."""
    found = list(results)
    for result in found:
        result.useless += result.resident
        result.resident = 0
    return found
