"""A trace and a question -> the summary of the whole trace: one pass, or the parts of a run by threads, processes or more.

Every way is the same fold (``cachesim.summary``): a part begins with the summary of no access, steps through its batches, and
the summaries are joined in order. A part of a run begins with a ray, because a prefetch unit begins anew there.
"""

import inspect
import os
import re
from collections.abc import Callable
from concurrent.futures import Future
from functools import cache, lru_cache, reduce
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from cachesim.lines import NodeLines
from cachesim.source import RunSource, Source
from cachesim.summary import Question, Summary, check_parts, reason_against
from nptrace_base.engines import Engine
from nptrace_base.errors import NptraceError
from nptrace_base.places import Place
from nptrace_base.pools import thread_pool
from nptrace_base.source_files import digest_of

#: Accesses in the smallest part that a thread gets: less takes longer to open and to join than it saves.
LEAST_PART = 1 << 20

#: Parts for each process, so that the last does not wait for one that is slow. An executor whose workers are not counted gets
#: parts of so many accesses, or so many parts: each costs its scheduler two messages, and this process a joining. A thread
#: has one: more cost more work than their balance saves.
PARTS_PER_WORKER, PART, MOST_PARTS = 4, 1 << 22, 10_000

OnProgress = Callable[[int], None] | None


def count(
    source: Source, question: Question, *, threads: int | None = None, engine: Engine | None = None,
    progress: OnProgress = None,
) -> Any:  # fmt: skip
    """Return the summary of a whole trace; it does not depend on threads and the engine's workers.

    Raises
    ------
    NptraceError
        Workers are asked for, and the parts of the trace cannot be counted apart; or too many workers were lost.
    """
    threads = threads or os.cpu_count() or 1
    if engine is not None:
        return _by_workers(source, question, engine, progress)
    n = min(threads, (source.n_events or 0) // LEAST_PART)
    if n < 2 or type(source) is not RunSource or reason_against(question.configs, question.policy):
        return pass_through(source, question, threads, progress)
    source.run.columns("nodes", ["axis"])  # read and checked here, for all parts
    advance = _one_at_a_time(progress)
    with thread_pool(n) as pool:
        running = [pool.submit(pass_through, part, question, 1, advance) for part in cut(source, n)]
        return reduce(lambda one, other: one.then(other), [each.result() for each in running])


def pass_through(source: Source, question: Question, threads: int = 1, progress: OnProgress = None) -> Any:
    """Return the summary of a source, read from its first event to its last, twice if something has to be foreseen."""
    summary = question.begin(source)
    if any(config.policy == "opt" for config in question.configs):
        source.check_passes(2)
        for events, access_types in source.events(question.policy):
            summary.look_ahead(events, access_types)
    running: list[Future[None]] = []
    with thread_pool(threads) as pool:
        for events, access_types in source.events(question.policy):
            # The next batch is decoded and looked up while the caches step over the last one.
            steps = summary.steps(events, access_types)
            for step in running:
                step.result()
            running = [pool.submit(*step) for step in steps]
            if progress is not None:
                progress(access_types.size)
        for step in running:
            step.result()
    return summary


class Part(RunSource):
    """A part of a run; parts share the lines of the nodes."""

    def __init__(self, whole: RunSource, number: int, n: int, lines: dict[tuple[int, int], NodeLines]) -> None:
        vars(self).update(vars(whole))
        self.run = whole.run.part(number, n)
        self.n_events = self.run.n_accesses
        self._lines = lines

    def lines(self, line_bytes: int, ahead: int) -> NodeLines:
        """Return the lines of the nodes."""
        with _making_lines:
            if (line_bytes, ahead) not in self._lines:
                self._lines[line_bytes, ahead] = super().lines(line_bytes, ahead)
        return self._lines[line_bytes, ahead]


_making_lines = Lock()


def parse_part(text: str) -> tuple[int, int]:
    """Return the number of a part, from 1, and the number of parts, from ``i/n``."""
    found = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", text)
    if found is None or not 1 <= int(found[1]) <= int(found[2]):
        raise NptraceError(f"{text!r} is not a part of a run; write 1/8 for the first of eight, 8/8 for the last")
    return int(found[1]), int(found[2])


def cut(source: RunSource, n: int) -> list[Part]:
    """Return the parts of a run, in order."""
    lines: dict[tuple[int, int], NodeLines] = {}
    return [Part(source, number, n, lines) for number in range(1, n + 1)]


def _one_at_a_time(progress: OnProgress) -> OnProgress:
    """Return a function for several threads to call."""
    if progress is None:
        return None
    lock = Lock()

    def advance(n: int) -> None:
        with lock:
            progress(n)

    return advance


def _by_workers(source: Source, question: Question, engine: Engine, progress: OnProgress) -> Any:
    check_parts(question.configs, question.policy)
    if type(source) is not RunSource:
        raise NptraceError(f"{source.identity.run} has no rays, between which a trace is cut for workers; leave workers out")
    n_events, place = source.run.n_accesses, source.run.path
    n = min(PARTS_PER_WORKER * engine.n_workers, n_events // LEAST_PART) if engine.n_workers else n_events // PART
    n = max(min(n, MOST_PARTS), 1)
    # Workers may be in other folders.
    there = place.absolute() if isinstance(place, Path) else place
    task = there, str(source.layout), source.run.digest, code_of(question), question
    whole, n_joined = question.begin(None), 0
    waiting: dict[int, dict[str, np.ndarray]] = {}  # came before one that precedes them
    for number, (n_counted, arrays) in engine.results(count_part, [(*task, i, n) for i in range(1, n + 1)]):
        waiting[number] = arrays
        while n_joined in waiting:
            whole = whole.then(_loaded(question, waiting.pop(n_joined)))
            n_joined += 1
        if progress is not None:
            progress(n_counted)
    return whole


def _loaded(question: Question, arrays: dict[str, np.ndarray]) -> Summary:
    summary: Summary = question.begin(None)
    summary.load(arrays)
    return summary


def code_of(question: Question) -> str:
    """Return a digest of all that counts for a question: only summaries of the same code are joined."""
    return _digest(Path(inspect.getfile(type(question))))


@cache
def _digest(source: Path) -> str:
    return digest_of([Path(__file__), source])


def count_part(
    path: Place, layout: str, digest: str, code: str, question: Question, number: int, n: int
) -> tuple[int, dict[str, np.ndarray]]:  # fmt: skip
    """Return the number of events in part ``number`` of ``n`` of a run, and the arrays of its summary; runs in a worker."""
    if code != code_of(question):
        raise NptraceError(
            f"cannot count a part of {path}: a worker has other sources of nptrace than the command; "
            "install the same version for all workers"
        )
    source, lines = _opened(path, layout, digest)
    n_events: list[int] = []
    summary = pass_through(Part(source, number, n, lines), question, progress=n_events.append)
    return sum(n_events), summary.arrays()


@lru_cache(1)
def _opened(path: Place, layout: str, digest: str) -> tuple[RunSource, dict[tuple[int, int], NodeLines]]:
    """Return a run and its lines, which a worker keeps from one part to the next."""
    from cachesim.source import open_source

    source = open_source(path, layout)
    assert isinstance(source, RunSource)
    if source.run.digest != digest:
        raise NptraceError(f"{path} is another run where a worker reads it; give the workers the same files")
    source.run.columns("nodes", ["axis"])  # once in a worker, and not for each of its parts
    return source, {}
