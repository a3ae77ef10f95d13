"""Options that choose what is replayed, shared by the commands of npcache."""

import os
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from nptrace_base.errors import NptraceError

LAYOUT_HELP = "Node layout in memory: stored, bfs, dfs, veb, treelet:BYTES; +BYTES moves them."


def prefetch_help(*, is_timed: bool = True) -> str:
    """Return what ``--prefetch`` says of the policies; without a clock, of those that need none."""
    from cachesim.policies import described

    return "Prefetch policies: " + "; ".join(f"{form}: {text}" for form, text in described().values()) + "."


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
