"""The sample units of an estimate: a source that traces any stretch of a run -> counts of units, and of the whole run exactly.

Each unit is replayed after a short warm-up of a few positions; unknown misses are counted separately. Some units are replayed
again after a long warm-up, which includes the rays beside those of the unit. Counts are kept, so a larger sample, or the same
sample after an interruption, only costs its new units.
"""

import hashlib
import os
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from cachesim.config import CacheConfig
from cachesim.layout import Layout, addresses, parse_layout
from cachesim.lines import NodeLines
from cachesim.prefetch import KIND_PREFETCH, REQUEST
from cachesim.sampling import resume_file
from cachesim.sampling.cold_start import N_MISSES, Counts, KnownReplay, check_lru
from cachesim.sampling.work import Rate, Work
from nptrace_base.errors import NptraceError
from nptrace_base.pools import thread_pool
from traces.identity import RunIdentity

#: The short warm-up: SHORT positions, doubled until there are ACCESSES_PER_LINE accesses for each line of the largest cache,
#: but no more than a row.
SHORT, ACCESSES_PER_LINE = 64, 12
_CHUNK = 4096  # positions of an exact run traced at a time

#: Columns of the exact counts of a unit.
N_COUNTS = 3
ACCESSES, PREFETCHES, RAYS = range(N_COUNTS)


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
    identity : RunIdentity
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
    reads_leaves : bool
        Whether leaves are nodes in memory; the accesses are those of nodes in memory.
    nodes : mapping
        Columns ``parent`` and ``level`` of ``nodes.parquet``.
    """

    identity: RunIdentity
    key: str
    n_positions: int
    unit: int
    row: int
    grain: int
    node_bytes: int
    reads_leaves: bool
    nodes: Mapping[str, np.ndarray]

    def trace(self, cuts: Sequence[int]) -> Sequence[Stretch]:
        """Return the accesses of the positions from each of ``cuts`` up to the next; they ascend."""

    def probe(self, n: int, seed: int) -> float:
        """Return the mean number of accesses, prefetches included, of a position, from ``n`` random ones."""

    def scout(self, seed: int) -> tuple[np.ndarray, Sequence[Stretch], np.ndarray]:
        """Return a thin sample spread evenly over the run, in groups: places (g,) ascending, accesses; and positions (k,)."""


class _Piece(NamedTuple):
    """The accesses of a stretch."""

    lines: np.ndarray
    access_types: np.ndarray
    n_rays: int


class _Long(NamedTuple):
    settled: np.ndarray
    bracket: np.ndarray


class _Counted(NamedTuple):
    counts: np.ndarray
    short: Counts
    settled: _Long
    before: int  # positions of the short warm-up
    span: tuple[int, int]  # positions traced
    work: Work


class UnitCounts:
    """Counts of units, made on demand and kept.

    Attributes
    ----------
    n_units : int
    row, n_positions : int
        The source's.
    layout : Layout
        Where the nodes lie.
    work : Work
        What counting units took, in all.
    """

    def __init__(
        self, source: UnitSource, configs: Sequence[CacheConfig], threads: int | None = None, layout: Layout | str = "stored"
    ) -> None:
        if not configs:
            raise NptraceError("no cache to estimate; name at least one, e.g. --size 8K --assoc 2")
        check_lru(configs)
        self._source, self._configs, self._threads = source, list(configs), threads or os.cpu_count() or 1
        self._enough = ACCESSES_PER_LINE * max(config.n_lines for config in configs)
        self.layout = parse_layout(layout) if isinstance(layout, str) else layout
        self._lines = NodeLines(
            addresses(source.nodes, source.node_bytes, self.layout, source.reads_leaves), source.node_bytes,
            configs[0].line_bytes, 0,
        )  # fmt: skip
        unit = -(-source.unit // source.grain) * source.grain
        self._starts = np.append(np.arange(0, source.n_positions, unit), source.n_positions)
        self.n_units = self._starts.size - 1
        self.row, self.n_positions = source.row, source.n_positions
        self.work = Work()
        self._spans: list[tuple[int, int]] = []  # stretches of positions traced
        self._looked = np.empty(0, np.int64)  # positions traced singly
        self._counts: dict[int, np.ndarray] = {}
        self._short: dict[int, Counts] = {}
        self._long: dict[tuple[int, int], _Long] = {}
        self._before: dict[int, int] = {}  # positions of the short warm-up

    @property
    def middles(self) -> np.ndarray:
        """Position of the middle of every unit, (n_units,) float64."""
        return (self._starts[:-1] + self._starts[1:]) / 2

    @property
    def n_traced(self) -> int:
        """Positions traced so far, warm-up and scout included; one that was traced several times counts once."""
        spans = np.array(sorted(self._spans), np.int64).reshape(-1, 2)
        reached = np.maximum.accumulate(np.append(0, spans[:, 1]))
        in_spans = int(np.maximum(spans[:, 1] - np.maximum(spans[:, 0], reached[:-1]), 0).sum())
        looked = np.unique(self._looked)
        last = np.searchsorted(spans[:, 0], looked, side="right")  # spans that start up to there
        return in_spans + int(np.count_nonzero(reached[last] <= looked))

    def scout(self, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the scout's places, (g,) int64, and per ray the accesses and different lines there, (g, 2) float64."""
        places, stretches, looked = self._source.scout(seed)
        features = np.zeros((len(stretches), 2))
        for feature, stretch in zip(features, stretches, strict=True):
            access_types = np.zeros(stretch.nodes.size, np.uint8)
            lines, _ = self._lines.accesses(stretch.nodes, access_types)
            feature[:] = lines.size, np.unique(lines).size
            feature /= max(stretch.n_rays, 1)
        self._looked = np.concatenate([self._looked, looked])
        return places, features

    def count(self, units: Iterable[int], second: Iterable[int], warm: int) -> None:
        """Count the units after the short warm-up, and those of ``second`` also after ``warm`` positions."""
        again = {int(u) for u in second if (int(u), warm) not in self._long}
        jobs = [(u, warm if u in again else 0) for u in dict.fromkeys(map(int, units)) if u not in self._short or u in again]
        # The longest jobs first, so that none is left for a single thread at the end.
        jobs.sort(key=lambda job: -job[1])
        start = time.perf_counter()
        with thread_pool(self._threads) as pool:
            for (unit, long_), one in zip(jobs, pool.map(self._one, jobs), strict=True):
                self._counts[unit], self._short[unit], self._before[unit] = one.counts, one.short, one.before
                if long_:
                    self._long[unit, warm] = one.settled
                self._spans.append(one.span)
                self.work = self.work.plus(one.work)
        self.work = self.work.plus(Work(wall_s=time.perf_counter() - start))

    def cost(self, units: Iterable[int], second: Iterable[int], warm: int) -> int:
        """Return how many positions the counts of these units took to trace."""
        length = np.diff(self._starts)
        n = sum(int(length[u]) + self._before[u] for u in units)
        return n + sum(max(min(warm, int(self._starts[u])) - self._before[u], 0) for u in second)

    def least_cost(self, units: Sequence[int], n_second: int, warm: int) -> int:
        """Return the least number of positions to trace for these units, ``n_second`` of them after ``warm`` others."""
        return int(np.diff(self._starts)[units].sum()) + n_second * min(warm, self.n_positions)

    def table(self, units: Sequence[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the exact counts (n, 3), known and unknown misses (n, 3 x caches) of counted units, as float64."""
        short = [self._short[int(u)] for u in units]
        return (
            np.array([self._counts[int(u)] for u in units], float),
            np.array([s.misses.ravel() for s in short], float),
            np.array([s.unknown.ravel() for s in short], float),
        )

    def long_table(self, units: Sequence[int], warm: int) -> tuple[np.ndarray, np.ndarray]:
        """Return known and unknown misses (m, 3 x caches) of units counted after ``warm`` positions."""
        found = [self._long[int(u), warm] for u in units]
        return np.array([f.settled for f in found], float), np.array([f.bracket for f in found], float)

    def _accesses(self, *cuts: int) -> list[_Piece]:
        """Return the accesses of the positions between the cuts."""
        pieces = []
        for stretch in self._source.trace(cuts):
            access_types = (stretch.kinds == KIND_PREFETCH).view(np.uint8) * np.uint8(REQUEST)
            pieces.append(_Piece(*self._lines.accesses(stretch.nodes, access_types), stretch.n_rays))
        return pieces

    def _one(self, job: tuple[int, int]) -> _Counted:
        unit, warm = job
        work = Work()

        def trace(*cuts: int) -> list[_Piece]:
            nonlocal work
            began = time.thread_time()
            pieces = self._accesses(*cuts)
            work = work.plus(Work(tracing=Rate.of(_n_accesses(pieces), time.thread_time() - began)))
            return pieces

        def replay(from_start: bool, before: list[_Piece]) -> Counts:
            nonlocal work
            began = time.thread_time()
            known = KnownReplay(self._configs, from_start=from_start)
            known.step(*_joined(before))
            found = known.step(own.lines, own.access_types)
            n = _n_accesses([*before, own])
            work = work.plus(Work(replaying=Rate.of(n, time.thread_time() - began)))
            return found

        start, stop = int(self._starts[unit]), int(self._starts[unit + 1])
        far = self._back(start, warm)
        # Go back until there are enough accesses: rays that miss the scene warm nothing, and cost little.
        least, low = self._back(start, self._source.row), self._back(start, SHORT)
        *before, own = trace(*dict.fromkeys((low, start)), stop)
        n_before, step = _n_accesses(before), 4 * SHORT
        while low > least and n_before < self._enough:
            low, high = max(self._back(low, step), least), low
            before[:0] = trace(low, high)
            n_before += before[0].lines.size
            step *= 4
        counted = settled = replay(low == 0, before)
        if warm and far < low:
            settled = replay(far == 0, [*trace(far, low), *before])
        return _Counted(
            np.array([counted.accesses, counted.prefetches, own.n_rays], float), counted,
            _Long(settled.misses.ravel(), settled.unknown.ravel()), start - low, (min(far, low), stop), work,
        )  # fmt: skip

    def _back(self, position: int, n: int) -> int:
        """Return a position, ``n`` or a little more before this one, at which a stretch may start."""
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
        counts, misses = np.zeros((self.n_units, 3)), np.zeros((self.n_units, N_MISSES * len(self._configs)))
        replay = KnownReplay(self._configs, from_start=True)
        waiting: deque[Future[Any]] = deque()
        with thread_pool(self._threads) as pool:
            following = iter(pieces)
            for unit, low, stop in pieces:
                for _, a, b in following:
                    waiting.append(pool.submit(self._accesses, a, b))
                    if len(waiting) > 2 * self._threads:
                        break
                (piece,) = waiting.popleft().result()
                found = replay.step(piece.lines, piece.access_types, pool)
                counts[unit] += found.accesses, found.prefetches, piece.n_rays
                misses[unit] += found.misses.ravel()
                progress(stop - low)
        self._spans.append((0, self._source.n_positions))
        return counts, misses

    def exact_seconds(self, n_accesses: float) -> float:
        """Return about how long ``everything`` takes for so many accesses, judged by the units counted."""
        return self.work.seconds_of(n_accesses, self.n_positions / _CHUNK)

    def _key(self) -> str:
        moved = [] if self.layout == Layout("stored") else [str(self.layout)]
        facts = "\n".join(
            [self._source.key, *moved, *map(repr, self._configs), str((SHORT, ACCESSES_PER_LINE)), str(self._starts[:2])]
        )
        return hashlib.sha256(facts.encode()).hexdigest()

    def save(self, path: Path) -> None:
        """Write the counts to a file, atomically."""
        units, long_ = sorted(self._short), sorted(self._long)
        columns = N_MISSES * len(self._configs)

        def rows(values: Sequence[np.ndarray], n: int, dtype: type) -> np.ndarray:
            return np.array([value.ravel() for value in values], dtype).reshape(-1, n)

        resume_file.write(path, self._key(), resume_file.Kept(
            np.array(units, np.int64), np.array([self._before[u] for u in units], np.int64),
            rows([self._counts[u] for u in units], 3, np.float64),
            rows([self._short[u].misses for u in units], columns, np.int64),
            rows([self._short[u].unknown for u in units], columns, np.int64),
            np.array(long_, np.int64).reshape(-1, 2),
            rows([self._long[k].settled for k in long_], columns, np.int64),
            rows([self._long[k].bracket for k in long_], columns, np.int64),
            np.array(self._spans, np.int64).reshape(-1, 2), np.unique(self._looked),
            np.array(self.work.numbers()),
        ))  # fmt: skip

    def load(self, path: Path) -> None:
        """Take the counts of a file, if there is one.

        Raises
        ------
        NptraceError
            The file is of another scene, tree, picture or set of caches, it cannot be read, or could not be written.
        """
        resume_file.check_place(path)
        if not path.exists():
            return
        found = resume_file.read(path, self._key(), self.n_units, len(self._configs), self.n_positions)
        shape = len(self._configs), N_MISSES
        for unit, before, counts, known, unknown in zip(*found[:5], strict=True):
            self._counts[int(unit)], self._before[int(unit)] = counts, int(before)
            self._short[int(unit)] = Counts(int(counts[0]), int(counts[1]), known.reshape(shape), unknown.reshape(shape))
        for (unit, warm), settled, bracket in zip(found.long_, found.settled, found.bracket, strict=True):
            self._long[int(unit), int(warm)] = _Long(settled, bracket)
        self._spans += [(int(low), int(high)) for low, high in found.spans]
        self._looked = np.concatenate([self._looked, found.looked])
        self.work = self.work.plus(Work.of_numbers(found.work.tolist()))


def _n_accesses(pieces: Sequence[_Piece]) -> int:
    return sum(piece.lines.size for piece in pieces)


def _joined(pieces: Sequence[_Piece]) -> tuple[np.ndarray, np.ndarray]:
    """Return (lines, access types) of all pieces in one: a step of a replay costs as much as some thousand accesses."""
    if not pieces:
        return np.empty(0, np.uint32), np.empty(0, np.uint8)
    if len(pieces) == 1:
        return pieces[0].lines, pieces[0].access_types
    return np.concatenate([piece.lines for piece in pieces]), np.concatenate([piece.access_types for piece in pieces])
