"""The command that may follow, for the last line of a command: it runs as it is printed, on the same runs and caches."""

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from nptrace.groups import TYPED, command_of
from nptrace_base.places import Place
from nptrace_base.shell import word

#: Parameters, by the names of functions, that say how results are made and printed, and not of what.
_HOW = {
    "form", "as_json", "output_path", "path", "is_wide", "threads", "workers", "scheduler", "picture", "by", "three_c",
    "timeline", "baselines", "folder",
}  # fmt: skip


def again(sources: Sequence[Place], folder: Place, chosen: Sequence[Place], *, needs_run: bool = False) -> str | None:
    """Return the words with which another command reads the runs that were chosen; None if it cannot.

    Parameters
    ----------
    sources, folder, chosen
        What was named, the value of --traces, and what ``chosen_sources`` returned for them.
    needs_run : bool
        The command takes no traces of addresses.
    """
    if any(str(each) == "-" or (needs_run and isinstance(each, Path) and not each.is_dir()) for each in chosen):
        return None
    if not sources:
        return _traces(folder)
    return named(chosen)


def named(paths: Sequence[Place]) -> str:
    """Return the words with which a command reads these runs: by their folder where they are all that it holds."""
    from traces.reader import find_runs

    parents = {path.parent for path in paths}
    if len(paths) > 1 and len(parents) == 1 and all(isinstance(path, Path) for path in paths):
        [parent] = parents
        if {os.path.realpath(str(each)) for each in find_runs(parent)} == {os.path.realpath(str(each)) for each in paths}:
            return _traces(parent)
    return " ".join(map(word, paths))


def _traces(folder: Place) -> str:
    return "" if str(folder) == "traces" else f"--traces {word(folder)}"


def following(
    command: str, subject: str | None, fixed: str = "", *, drops: Sequence[str] = (), is_single: bool = False
) -> str:  # fmt: skip
    """Return a command line on what ``subject`` names, with the options of the running command; "" if it lacks one of them.

    Parameters
    ----------
    command : str
        Program and command.
    fixed : str
        Options that it has in any case.
    drops : sequence of str
        Parameters of the running command that do not matter to it, by the names of its function.
    is_single : bool
        It takes one cache and one machine: the first of each list.
    """
    if subject is None:
        return ""
    context = click.get_current_context()
    given = [each for each in _given(context) if each[0].name not in drops]
    target = command_of(command.split()[1])
    n_chosen = 1 if is_single else None
    chosen = {
        each for option, texts in given if option.name in ("policy", "order") for text in texts
        for each in text.split(",")[:n_chosen]
    }  # fmt: skip
    words = [command, subject]
    for option, texts in given:
        same = next((each for each in target.params if set(each.opts) & set(option.opts)), None)
        if same is None:
            return ""
        name = next(each for each in option.opts if each in same.opts)
        if option.name == "seed" and "random" not in chosen:
            continue
        if is_single and texts:
            texts = [texts[0].split(",")[0].split("..")[0]]
        words += [f"{name} {word(text)}" for text in texts] if texts else [name]
    return " ".join(filter(None, [*words, fixed]))


def _given(context: click.Context) -> Iterator[tuple[click.Option, list[str]]]:
    """Yield the options that the user gave and that change something, with their texts; flags have none."""
    typed: Mapping[str, Any] = context.meta.get(TYPED, {})
    for option in context.command.params:
        if not isinstance(option, click.Option) or option.name not in typed or option.name in (*_HOW, None):
            continue
        if option.name not in context.params:
            continue  # --help and the like
        if context.params[option.name] == option.process_value(context, option.get_default(context)):
            continue
        value = typed[option.name]
        yield option, [] if option.is_flag else [str(each) for each in (value if isinstance(value, list) else [value])]
