"""The units an estimate samples: a source that traces any stretch of a run -> counts of units, and of the whole run exactly.

A unit is counted shortly, after a few positions that warm the caches, what this leaves open counted apart; and some are
counted again after so many positions that the neighbours of its rays were among them. Counts are kept, so a larger sample, or
the same sample after an interruption, costs only what is new.
"""

import hashlib
import os
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from cachesim.config import CacheConfig
from cachesim.known import Counts, KnownReplay, check_lru
from cachesim.layout import addresses
from cachesim.prefetch import KIND_PREFETCH, REQUEST
from cachesim.source import NodeLines
from traces.errors import NptraceError
from traces.pools import thread_pool
from traces.whole import whole_file

#: The short warm-up: so many positions, or twice, four times ... as many, until there were so many accesses for each line of
#: the largest cache, but no more than a row.
SHORT, ACCESSES_PER_LINE = 64, 12
_CHUNK = 4096  # positions of an exact run traced at a time

#: Columns of what is counted without doubt in a unit.
ACCESSES, PREFETCHES, RAYS = range(3)


class Stretch(Protocol):
    """Accesses in the order of the run, and how many rays made them."""

    @property
    def nodes(self) -> np.ndarray:
        """(n,) uint32."""

    @property
    def kinds(self) -> np.ndarray:
        """(n,) uint8, as in a trace."""

    @property
    def n_rays(self) -> int:
        """Rays, of both types."""


class UnitSource(Protocol):
    """A run that can be traced from anywhere.

    Attributes
    ----------
    name : str
    key : str
        Everything that decides its accesses.
    n_positions : int
        The run is a sequence of so many positions, each with a ray or a few.
    unit : int
        Positions to sample together: what lies together in the picture.
    row : int
        Positions after which the neighbours come again.
    grain : int
        Stretches start and end at multiples of it, or at the end.
    node_bytes : int
    nodes : mapping
        Columns ``parent`` and ``level`` of ``nodes.parquet``.
    """

    name: str
    key: str
    n_positions: int
    unit: int
    row: int
    grain: int
    node_bytes: int
    nodes: Mapping[str, np.ndarray]

    def trace(self, cuts: Sequence[int]) -> Sequence[Stretch]:
        """Return the accesses of the positions from each of ``cuts`` up to the next; they ascend."""

    def probe(self, n: int, seed: int) -> float:
        """Return the mean number of accesses, pre-fetches included, of a position, from ``n`` random ones."""

    def scout(self, seed: int) -> tuple[np.ndarray, Sequence[Stretch], int]:
        """Return a thin sample spread evenly over the run, in groups: places (g,) ascending, accesses, positions traced."""


class _Long(NamedTuple):
    settled: np.ndarray
    bracket: np.ndarray


class UnitCounts:
    """Counts of units, made when asked for and kept.

    Attributes
    ----------
    n_units : int
    row, n_positions : int
        The source's.
    n_traced : int
        Positions traced so far, those before the units included.
    """

    def __init__(self, source: UnitSource, configs: Sequence[CacheConfig], threads: int | None = None) -> None:
        if not configs:
            raise NptraceError("no cache to estimate; name at least one, e.g. --size 8K --assoc 2")
        check_lru(configs)
        self._source, self._configs, self._threads = source, list(configs), threads or os.cpu_count() or 1
        self._enough = ACCESSES_PER_LINE * max(config.n_lines for config in configs)
        self._lines = NodeLines(
            addresses(source.nodes, source.node_bytes, "stored"), source.node_bytes, configs[0].line_bytes, 0
        )
        unit = -(-source.unit // source.grain) * source.grain
        self._starts = np.append(np.arange(0, source.n_positions, unit), source.n_positions)
        self.n_units = self._starts.size - 1
        self.row, self.n_positions = source.row, source.n_positions
        self.n_traced = 0
        self._counts: dict[int, np.ndarray] = {}
        self._short: dict[int, Counts] = {}
        self._long: dict[tuple[int, int], _Long] = {}
        self._before: dict[int, int] = {}  # positions of the short warm-up

    @property
    def middles(self) -> np.ndarray:
        """Position of the middle of every unit, (n_units,) float64."""
        return (self._starts[:-1] + self._starts[1:]) / 2

    def scout(self, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Return where the scout looked (g,), and what it saw there, per ray: accesses and different lines (g, 2)."""
        places, stretches, n = self._source.scout(seed)
        features = np.zeros((len(stretches), 2))
        for feature, stretch in zip(features, stretches, strict=True):
            labels = np.zeros(stretch.nodes.size, np.uint8)
            lines, _ = self._lines.accesses(stretch.nodes, labels)
            feature[:] = lines.size, np.unique(lines).size
            feature /= max(stretch.n_rays, 1)
        self.n_traced += n
        return places, features

    def count(self, units: Iterable[int], second: Iterable[int], warm: int) -> None:
        """Count the units shortly, and those of ``second`` also with ``warm`` positions before them."""
        again = {int(u) for u in second if (int(u), warm) not in self._long}
        jobs = [(u, warm if u in again else 0) for u in dict.fromkeys(map(int, units)) if u not in self._short or u in again]
        # The longest jobs first: none is left over at the end for one thread.
        jobs.sort(key=lambda job: -job[1])
        with thread_pool(self._threads) as pool:
            for (unit, long_), (counts, short, settled, before) in zip(jobs, pool.map(self._one, jobs), strict=True):
                self._counts[unit], self._short[unit], self._before[unit] = counts, short, before
                if long_:
                    self._long[unit, warm] = settled
                self.n_traced += self.cost([unit], [unit] if long_ else [], warm)

    def cost(self, units: Iterable[int], second: Iterable[int], warm: int) -> int:
        """Return how many positions are traced to count these units, which were counted before."""
        length = np.diff(self._starts)
        n = sum(int(length[u]) + self._before[u] for u in units)
        return n + sum(max(min(warm, int(self._starts[u])) - self._before[u], 0) for u in second)

    def table(self, units: Sequence[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the sure counts (n, 3), certain misses and open misses (n, 3 x caches) of counted units, as float64."""
        short = [self._short[int(u)] for u in units]
        return (
            np.array([self._counts[int(u)] for u in units], float),
            np.array([s.misses.ravel() for s in short], float),
            np.array([s.open_.ravel() for s in short], float),
        )

    def long_table(self, units: Sequence[int], warm: int) -> tuple[np.ndarray, np.ndarray]:
        """Return certain and open misses (m, 3 x caches) of units counted with ``warm`` positions before them."""
        found = [self._long[int(u), warm] for u in units]
        return np.array([f.settled for f in found], float), np.array([f.bracket for f in found], float)

    def _accesses(self, *cuts: int) -> list[tuple[np.ndarray, np.ndarray, int]]:
        """Return (lines, labels, rays) of the positions between the cuts."""
        pieces = []
        for stretch in self._source.trace(cuts):
            labels = (stretch.kinds == KIND_PREFETCH).view(np.uint8) * np.uint8(REQUEST)
            pieces.append((*self._lines.accesses(stretch.nodes, labels), stretch.n_rays))
        return pieces

    def _one(self, job: tuple[int, int]) -> tuple[np.ndarray, Counts, _Long, int]:
        unit, warm = job
        start, stop = int(self._starts[unit]), int(self._starts[unit + 1])
        far = self._back(start, warm)
        # Backwards until enough was accessed: rays that pass the scene by warm nothing, and cost little.
        least, low = self._back(start, self._source.row), self._back(start, SHORT)
        *before, own = self._accesses(*dict.fromkeys((low, start)), stop)
        n_before, step = sum(piece[0].size for piece in before), 4 * SHORT
        while low > least and n_before < self._enough:
            low, high = max(self._back(low, step), least), low
            before[:0] = self._accesses(low, high)
            n_before += before[0][0].size
            step *= 4
        short = KnownReplay(self._configs, from_start=low == 0)
        short.step(*_joined(before))
        counted = short.step(*own[:2])
        settled = counted
        if warm and far < low:
            long_ = KnownReplay(self._configs, from_start=far == 0)
            long_.step(*_joined([*self._accesses(far, low), *before]))
            settled = long_.step(*own[:2])
        counts = np.array([counted.accesses, counted.prefetches, own[2]], float)
        return counts, counted, _Long(settled.misses.ravel(), settled.open_.ravel()), start - low

    def _back(self, position: int, n: int) -> int:
        """Return the position ``n`` before, or a little more, at which a stretch may start."""
        grain = self._source.grain
        return max(position - -(-n // grain) * grain, 0)

    def everything(self, progress: Callable[[int], object] = lambda positions: None) -> tuple[np.ndarray, np.ndarray]:
        """Count the whole run exactly, in order; return the counts (n_units, 3) and misses (n_units, 3 x caches) of each unit.

        ``progress`` is called with the number of positions done after each piece.
        """
        step = -(-_CHUNK // self._source.grain) * self._source.grain
        pieces = []
        for unit, (start, end) in enumerate(zip(self._starts[:-1].tolist(), self._starts[1:].tolist(), strict=True)):
            pieces += [(unit, low, min(low + step, end)) for low in range(start, end, step)]
        counts, misses = np.zeros((self.n_units, 3)), np.zeros((self.n_units, 3 * len(self._configs)))
        replay = KnownReplay(self._configs, from_start=True)
        waiting: deque[Future[Any]] = deque()
        with thread_pool(self._threads) as pool:
            following = iter(pieces)
            for unit, low, stop in pieces:
                for _, a, b in following:
                    waiting.append(pool.submit(self._accesses, a, b))
                    if len(waiting) > 2 * self._threads:
                        break
                lines, labels, n_rays = waiting.popleft().result()[0]
                found = replay.step(lines, labels, pool)
                counts[unit] += found.accesses, found.prefetches, n_rays
                misses[unit] += found.misses.ravel()
                progress(stop - low)
        self.n_traced += self._source.n_positions
        return counts, misses

    def _key(self) -> str:
        said = "\n".join([self._source.key, *map(repr, self._configs), str((SHORT, ACCESSES_PER_LINE)), str(self._starts[:2])])
        return hashlib.sha256(said.encode()).hexdigest()

    def save(self, path: Path) -> None:
        """Write the counts to a file, whole or not at all."""
        units, long_ = sorted(self._short), sorted(self._long)
        counts, certain, open_ = self.table(units)
        settled = np.array([self._long[k].settled for k in long_]), np.array([self._long[k].bracket for k in long_])
        with whole_file(path) as temporary, open(temporary, "wb") as file:
            np.savez(
                file, key=np.array(self._key()), units=units, long=np.array(long_, np.int64).reshape(-1, 2),
                settled=settled[0], bracket=settled[1], n_traced=self.n_traced, counts=counts, certain=certain, open=open_,
                before=[self._before[u] for u in units],
            )  # fmt: skip

    def load(self, path: Path) -> None:
        """Take the counts of a file, if there is one.

        Raises
        ------
        ValueError
            The file is of another scene, tree, picture or set of caches, or it cannot be read.
        """
        if not path.exists():
            return
        try:
            with open(path, "rb") as file, np.load(file, allow_pickle=False) as kept:
                key = str(kept["key"])
                if key != self._key():
                    raise NptraceError("it is of another scene, tree, picture or set of caches")
                shape = (-1, len(self._configs), 3)
                rows = zip(kept["units"], kept["counts"], kept["certain"], kept["open"], kept["before"], strict=True)
                for unit, counts, certain, open_, before in rows:
                    self._counts[int(unit)], self._before[int(unit)] = counts, int(before)
                    self._short[int(unit)] = Counts(
                        int(counts[0]), int(counts[1]), certain.reshape(shape)[0], open_.reshape(shape)[0]
                    )
                for (unit, warm), settled, bracket in zip(kept["long"], kept["settled"], kept["bracket"], strict=True):
                    self._long[int(unit), int(warm)] = _Long(settled, bracket)
                self.n_traced = int(kept["n_traced"])
        except (OSError, KeyError, EOFError, ValueError) as e:
            raise NptraceError(f"{path} cannot be resumed from: {e}; name another file or remove it") from e


def _joined(pieces: Sequence[tuple[np.ndarray, np.ndarray, int]]) -> tuple[np.ndarray, np.ndarray]:
    """Return the (lines, labels) of pieces of a trace in one: a step of a replay costs as much as some thousand accesses."""
    if len(pieces) == 1:
        return pieces[0][:2]
    lines, labels, _ = zip(*pieces, strict=True) if pieces else ((np.empty(0, np.uint32),), (np.empty(0, np.uint8),), ())
    return np.concatenate(lines), np.concatenate(labels)
