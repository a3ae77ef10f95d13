"""Options that choose what is replayed, shared by the commands of npcache."""

import os
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import click

from nptrace.groups import FOUND, BadInput
from nptrace.options import list_option
from nptrace_base.errors import NptraceError
from nptrace_base.places import Place, Remote, place

_Source = TypeVar("_Source")

LAYOUT_HELP = "Node layout in memory: stored, bfs, dfs, veb, treelet:BYTES; +BYTES moves them."


#: What ``--prefetch`` says where a list of the policies ends the help.
PREFETCH_HELP = "Prefetch policies, e.g. none,stack:tris*2; the list is below."
#: The same where a command takes one.
ONE_PREFETCH_HELP = "Prefetch policy, e.g. stack:tris*2; the list is below."


class PlaceOf(click.Path):
    """The type of an option or argument that names runs: a local path, or an address such as s3://bucket/folder."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the place that a text names."""
        if not isinstance(value, str):
            return value
        try:
            found = place(value)
        except NptraceError as e:
            raise BadInput(str(e)) from e
        return found if isinstance(found, Remote) else super().convert(found, param, ctx)


def policies() -> list[tuple[str, str]]:
    """Return the names of the prefetch policies with their options, and what they do."""
    from cachesim.policies import described

    return [(form, f"{text[0].upper()}{text[1:]}.") for form, text, _ in described().values()]


def untimed_policies() -> list[tuple[str, str]]:
    """Return those policies that need no clock."""
    from cachesim.policies import described

    needs_clock = {form for form, _, needs_clock in described().values() if needs_clock}
    return [row for row in policies() if row[0] not in needs_clock]


def prefetch_option(default: str, *, is_clocked: bool = False, also: Sequence[str] = (), help: str = PREFETCH_HELP) -> Any:
    """Return the option for a list of prefetch policies; ``also`` are words beside them."""
    return list_option("--prefetch", item=policy_of(is_clocked, also), metavar="POLICIES", default=default, help=help)


def one_prefetch_option(*, is_clocked: bool = False) -> Any:
    """Return the option for one prefetch policy."""

    def checked(ctx: click.Context, param: click.Parameter, value: str) -> str:
        try:
            return policy_of(is_clocked)(value)
        except NptraceError as e:
            raise BadInput(f"--prefetch: {e}") from e

    return click.option(
        "--prefetch", default="traced", show_default=True, metavar="POLICY", callback=checked, help=ONE_PREFETCH_HELP
    )  # fmt: skip


def policy_of(is_clocked: bool = False, also: Sequence[str] = ()) -> Callable[[str], str]:
    """Return a function from the text of a policy to its name, one for all its spellings.

    Of an unknown policy the NptraceError names those that the command takes.
    """

    def checked(text: str) -> str:
        from cachesim.policies import own_policy
        from cachesim.policies import policies as known
        from cachesim.prefetch import parse_prefetch

        name = text.strip().lower().partition(":")[0]
        if own_policy(name) is None and name not in known() and text not in also:
            forms = [*also, *(form for form, _ in (policies() if is_clocked else untimed_policies()))]
            raise NptraceError(f"there is no prefetch policy {name!r}; write one of {', '.join(forms)}")
        return text if text in also else str(parse_prefetch(text))

    return checked


def layouts_option() -> Any:
    """Return the option for a list of layouts."""
    return list_option("--layout", item=layout_of, metavar="LAYOUTS", default="stored", help=LAYOUT_HELP)


def layout_of(text: str) -> str:
    """Return the name of a layout, one for all its spellings."""
    from cachesim.layout import parse_layout

    return str(parse_layout(text))


def chosen_sources(sources: Sequence[Place], folder: Place) -> list[Place]:
    """Return the runs and traces to read: those named, each once, or the runs in a folder, at least one."""
    from traces.reader import find_runs

    if sources:
        named = [path for source in sources for path in (_runs_in(source) or [_checked(source)])]
        return each_once(named)
    found = find_runs(folder)
    if not found:
        what = f"there is no run in {folder}" if folder.is_dir() else f"there is no folder {folder}"
        raise NptraceError(f"{what}; make a run with nptrace render SCENE, or name runs or a trace")
    _keep(found, folder)
    return found


def one_run(source: Place) -> Place:
    """Return the place of the run that is named; NptraceError if there is none, BadInput if there are several."""
    found = chosen_sources([source], source)
    if len(found) > 1:
        raise BadInput(f"{source} holds {len(found)} runs; name one of them, e.g. {found[0]}")
    return found[0]


def _checked(source: Place) -> Place:
    """Return a place that is named; NptraceError if nothing to be read is there, with what is."""
    from traces.format import FILES
    from traces.reader import holds_run

    if str(source) == "-" or not isinstance(source, Path):
        return source
    if not source.exists():
        raise NptraceError(f"there is no {source}; check the spelling, or make a run with nptrace render SCENE")
    if source.is_dir():
        if not holds_run(source):
            raise NptraceError(f"there is no run in {source}; make one with nptrace render SCENE, or name another folder")
    elif source.name in FILES and holds_run(source.parent):
        raise NptraceError(f"{source} is a part of a run; name the run, {source.parent}")
    elif source.suffix.lower() in (".csv", ".json", ".parquet") and _has_results(source):
        raise NptraceError(f"{source} holds results, and no run; draw them with npcache plot, or name the runs they are of")
    return source


def _has_results(path: Path) -> bool:
    """Return whether a file holds rows of results: those have a column run."""
    names = columns_of(path)
    return "run" in names and "address" not in names


def is_trace(path: Path) -> bool:
    """Return whether a file is a trace of addresses, by its name, and a table by its columns."""
    from traces.address_files import ENDINGS

    name = path.name.lower()
    if name.endswith((".csv", ".parquet")):
        return "address" in columns_of(path)
    return name.endswith((".din", *(f".din.{each}" for each in ("gz", "zst", "xz", "bz2", "lz4")), *ENDINGS))


def columns_of(path: Path) -> list[str]:
    """Return the columns of a table in a file; none if it cannot be read, of which its reader says why."""
    import pyarrow as pa

    try:
        if path.suffix.lower() == ".parquet":
            import pyarrow.parquet as pq

            with path.open("rb") as file:
                names: list[str] = pq.read_schema(file).names
            return [name.lower() for name in names]
        if not path.is_file():
            return []
        with path.open("rb") as file:
            start = file.read(4096).decode("utf-8-sig", "replace")
    except (OSError, ValueError, pa.ArrowException):
        return []
    if path.suffix.lower() == ".json":
        return re.findall(r'"(\w+)":', start)
    return [name.strip().strip('"').lower() for name in start.partition("\n")[0].split(",")]


def _keep(found: Sequence[Place], folder: Place) -> None:
    """Remember that runs were found in a folder, and not named one by one."""
    if context := click.get_current_context(silent=True):
        context.meta.setdefault(FOUND, {}).update(dict.fromkeys(map(str, found), str(folder)))


def each_once(sources: Iterable[_Source]) -> list[_Source]:
    """Return runs, or places of runs, without those that are another one of them: a run may have several names."""
    from traces.reader import Run

    found: dict[object, _Source] = {}
    for source in sources:
        path: Any = source.path if isinstance(source, Run) else source
        found.setdefault(path if isinstance(path, Remote) or str(path) == "-" else os.path.realpath(path), source)
    return [*found.values()]


def _runs_in(folder: Place) -> list[Place]:
    """Return the runs in a folder that holds runs and is none."""
    from traces.reader import find_runs, holds_run

    found = [] if holds_run(folder) else find_runs(folder)
    _keep(found, folder)
    return found


def traces_option() -> Any:
    """Return the option for the folder with the runs."""
    return click.option(
        "--traces", "folder", type=PlaceOf(), default="traces", show_default=True,
        help="Folder that holds the runs."
    )  # fmt: skip
