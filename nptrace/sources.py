"""Options that choose what is replayed, shared by the commands of npcache."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from nptrace.groups import FOUND, BadInput
from nptrace_base.errors import NptraceError
from nptrace_base.places import Place, Remote, place

LAYOUT_HELP = "Node layout in memory: stored, bfs, dfs, veb, treelet:BYTES; +BYTES moves them."


#: What ``--prefetch`` says where a list of the policies ends the help.
PREFETCH_HELP = "Prefetch policies, e.g. none,stack:tris*2; the list is below."


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


def chosen_sources(sources: Sequence[Place], folder: Place) -> list[Place]:
    """Return the runs and traces to read: those named, each once, or the runs in a folder, at least one."""
    from traces.reader import find_runs

    if sources:
        named = [path for source in sources for path in (_runs_in(source) or [source])]
        return list({_key(path): path for path in reversed(named)}.values())[::-1]
    found = find_runs(folder)
    if not found:
        raise NptraceError(f"there is no run in {folder}; make one with `nptrace render SCENE`, or name runs or a trace")
    _keep(found, folder)
    return found


def _keep(found: Sequence[Place], folder: Place) -> None:
    """Remember that runs were found in a folder, and not named one by one."""
    if context := click.get_current_context(silent=True):
        context.meta.setdefault(FOUND, {}).update(dict.fromkeys(map(str, found), str(folder)))


def _key(path: Place) -> object:
    """Return what two names of one run have in common."""
    return path if isinstance(path, Remote) or str(path) == "-" else os.path.realpath(path)


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
