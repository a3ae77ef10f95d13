"""Tasks that take a whole run: what workers do where a trace cannot be cut, as under a clock. A worker takes run after run."""

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

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


class _There(NamedTuple):
    """Where a run is, for a worker that may be in another folder; what rows call that place; and the digest of the run."""

    there: Place
    where: Place
    digest: str

    def opened(self) -> Run:
        """Return the run, in a worker."""
        run = open_run(self.there)
        if run.digest != self.digest:
            raise NptraceError(f"{self.there} is another run where a worker reads it; give the workers the same files")
        run.path = self.where
        return run


def run_by_run(
    engine: "Engine", function: Callable[..., list[Any]], runs: Sequence[Run | Place | str], arguments: Sequence[tuple],
    advance: Callable[[int], object],
) -> list[Any]:  # fmt: skip
    """Return what ``function`` returns for each run and its arguments, one run after the other."""
    tasks = [(_code(), function, _there(run), *given) for run, given in zip(runs, arguments, strict=True)]
    found: dict[int, list[Any]] = {}
    for number, rows in engine.results(_by_same_code, tasks):
        found[number] = rows
        advance(1)
    return [row for number in range(len(tasks)) for row in found[number]]


def _by_same_code(code: str, function: Callable[..., list[Any]], run: _There, *arguments: Any) -> list[Any]:
    """Return what ``function`` returns in a worker; NptraceError if its rows might not be those of the other workers."""
    if code != _code():
        raise NptraceError(
            f"cannot replay {run.there}: a worker has other sources of nptrace than the command; "
            "install the same version for all workers"
        )
    return function(run.opened(), *arguments)


@cache
def _code() -> str:
    return digest_of([Path(__file__)])


def _there(run: Run | Place | str) -> _There:
    run = run if isinstance(run, Run) else open_run(place(run))
    return _There(run.path.absolute() if isinstance(run.path, Path) else run.path, run.path, run.digest)


def compare_run(
    run: Run, config: "CacheConfig", clock: "Clock", prefetches: list[str], layout: str, baselines: bool
) -> "list[Compared]":  # fmt: skip
    """Compare the policies on one run."""
    from cachesim.clock.compare import compare

    return compare(run, config, clock, layout=layout, prefetches=prefetches, has_baselines=baselines, threads=1)


def table1_of_run(
    run: Run, key: tuple[str, str], policy: str, layout: str, equation: "Equation | None"
) -> "list[Table1Row]":  # fmt: skip
    """Return the rows of Table I of one run."""
    from cachesim.report.table1 import table1

    return table1({key: run}, policy=policy, layout=layout, equation=equation, threads=1)
