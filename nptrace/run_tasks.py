"""Tasks that take a whole run: what workers do where a trace cannot be cut, as under a clock. A worker takes run after run."""

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nptrace_base.errors import NptraceError
from nptrace_base.places import Place, place
from nptrace_base.source_files import digest_of
from traces.reader import Run, open_run

if TYPE_CHECKING:
    from cachesim.clock.compare import Compared
    from cachesim.clock.parameters import Clock
    from cachesim.config import CacheConfig
    from cachesim.report.table1 import Equation, Table1Row
    from nptrace_base.engines import Engine


def run_by_run(
    engine: "Engine", function: Callable[..., list[Any]], runs: Sequence[Run | Place | str], arguments: Sequence[tuple],
    advance: Callable[[int], object],
) -> list[Any]:  # fmt: skip
    """Return what ``function`` returns for each run and its arguments, one run after the other."""
    tasks = [(_code(), function, *_there(run), *given) for run, given in zip(runs, arguments, strict=True)]
    found: dict[int, list[Any]] = {}
    for number, rows in engine.results(_by_same_code, tasks):
        found[number] = rows
        advance(1)
    return [row for number in range(len(tasks)) for row in found[number]]


def _by_same_code(code: str, function: Callable[..., list[Any]], there: Place, *arguments: Any) -> list[Any]:
    """Return what ``function`` returns in a worker; NptraceError if its rows might not be those of the other workers."""
    if code != _code():
        raise NptraceError(
            f"cannot replay {there}: a worker has other sources of nptrace than the command; "
            "install the same version for all workers"
        )
    return function(there, *arguments)


@cache
def _code() -> str:
    return digest_of([Path(__file__)])


def _there(run: Run | Place | str) -> tuple[Place, Place]:
    """Return where a run is, for a worker that may be in another folder, and what rows call that place."""
    where = run.path if isinstance(run, Run) else place(run)
    return (where.absolute() if isinstance(where, Path) else where), where


def _opened(there: Place, where: Place) -> Run:
    run = open_run(there)
    run.path = where
    return run


def compare_run(
    there: Place, where: Place, config: "CacheConfig", clock: "Clock", prefetches: list[str], layout: str, baselines: bool
) -> "list[Compared]":  # fmt: skip
    """Compare the policies on one run."""
    from cachesim.clock.compare import compare

    run = _opened(there, where)
    return compare(run, config, clock, layout=layout, prefetches=prefetches, has_baselines=baselines, threads=1)


def table1_of_run(
    there: Place, where: Place, key: tuple[str, str], policy: str, layout: str, equation: "Equation | None"
) -> "list[Table1Row]":  # fmt: skip
    """Return the rows of Table I of one run."""
    from cachesim.report.table1 import table1

    return table1({key: _opened(there, where)}, policy=policy, layout=layout, equation=equation, threads=1)
