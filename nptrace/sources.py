"""Options that choose what is replayed, shared by the commands of npcache."""

import os
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from nptrace_base.errors import NptraceError

LAYOUT_HELP = "Node layout in memory: stored, bfs, dfs, veb, treelet:BYTES; +BYTES moves them."


#: What ``--prefetch`` says where a list of the policies ends the help.
PREFETCH_HELP = "Prefetch policies, e.g. none,stack:tris*2; the list is below."


def policies() -> list[tuple[str, str]]:
    """Return the names of the prefetch policies with their options, and what they do."""
    from cachesim.policies import described

    return [(form, f"{text[0].upper()}{text[1:]}.") for form, text, _ in described().values()]


def untimed_policies() -> list[tuple[str, str]]:
    """Return those policies that need no clock."""
    from cachesim.policies import described

    needs_clock = {form for form, _, needs_clock in described().values() if needs_clock}
    return [row for row in policies() if row[0] not in needs_clock]


def chosen_sources(sources: Sequence[Path], folder: Path) -> list[Path]:
    """Return the runs and traces to read: those named, each once, or the runs in a folder, at least one."""
    from traces.reader import find_runs

    if sources:
        named = [path for source in sources for path in (_runs_in(source) or [source])]
        return list({os.path.realpath(path) if str(path) != "-" else path: path for path in reversed(named)}.values())[::-1]
    found = find_runs(folder)
    if not found:
        raise NptraceError(f"there is no run in {folder}; make one with `nptrace render SCENE`, or name runs or a trace")
    return found


def _runs_in(folder: Path) -> list[Path]:
    """Return the runs in a folder that holds runs and is none."""
    from traces.format import FILES
    from traces.reader import find_runs

    return [] if any((folder / name).exists() for name in FILES) else find_runs(folder)


def again(sources: Sequence[Path], folder: Path, *, needs_run: bool = False) -> str:
    """Return the words, and a blank, with which another command reads the same runs: for the last line of a command."""
    from traces.format import printable

    named = [source for source in sources if str(source) != "-" and (source.is_dir() or not needs_run)]
    if sources:
        return "".join(f"{shlex.quote(printable(str(source)))} " for source in named[:3])
    return "" if str(folder) == "traces" else f"--traces {shlex.quote(printable(str(folder)))} "


def traces_option() -> Any:
    """Return the option for the folder with the runs."""
    return click.option(
        "--traces", "folder", type=click.Path(path_type=Path), default="traces", show_default=True,
        help="Folder that holds the runs."
    )  # fmt: skip
