"""What a command prints on stderr while it works: one line of progress on a terminal, notes, and a last line.

    with Progress(n_runs) as progress:
        progress.job("sponza bvh")                    # [1/8] sponza bvh
        advance = progress.phase("trace", n_pixels)   # [1/8] sponza bvh: trace ------ 43 %
        advance(512)
    done("8 runs, 236,000 rays", seconds, "npcache replay")

Compiling is shown below that line. A pipe gets notes and the last line only; with -q it gets neither.
"""

import sys
import textwrap
import time
from collections.abc import Callable
from typing import Any

import click

from nptrace_base import compiling
from nptrace_base.shell import command_lines

QUIET, USUAL, VERBOSE = -1, 0, 1
#: What -q and -v ask for; set for every command.
verbosity = USUAL
#: The line of progress that is on the terminal.
_shown: "Progress | None" = None


def say(text: str) -> None:
    """Print a note, above the line of progress if there is one; not with -q."""
    if verbosity < USUAL:
        return
    bar, width = _shown and _shown.bar, _width()
    if width is not None:
        text = textwrap.fill(text, width, break_long_words=False, break_on_hyphens=False)
    _print(text, bar)


def _print(text: str, bar: Any = None) -> None:
    if bar:
        bar.console.print(text, markup=False, highlight=False, soft_wrap=True)
    else:
        click.echo(text, err=True)


def _width() -> int | None:
    """Return the columns of the terminal that notes go to; None if they go elsewhere."""
    if sys.stderr is None or not sys.stderr.isatty():
        return None
    from rich.console import Console

    return Console(stderr=True).width


def detail(text: str) -> None:
    """Print a note that carries no news, with -v."""
    if verbosity >= VERBOSE:
        say(text)


def done(what: str, began: float, following: str = "") -> None:
    """Print the last line: what was done, since ``began`` on ``time.perf_counter``, and the command that may follow."""
    text = f"{what} in {time.perf_counter() - began:.1f} s"
    whole, width = f"{text}; next: {following}" if following else text, _width()
    if not following or width is None or len(whole) <= width:
        say(whole)
    elif verbosity >= USUAL:  # the command, on lines that can be pasted
        say(text)
        _print("\n".join(["next:", *command_lines(following, width)]))


def size_text(n_bytes: float) -> str:
    """Return a number of bytes as people read it: 1.2 MB."""
    for unit in ("bytes", "kB", "MB"):
        if n_bytes < 1000:
            return f"{n_bytes:.1f} {unit}" if unit != "bytes" else f"{n_bytes:.0f} {unit}"
        n_bytes /= 1000
    return f"{n_bytes:.1f} GB"


class Progress:
    """The line of progress of a command's ``n_jobs`` jobs, one after the other, as a context manager.

    ``n_done`` adds up the amounts of all phases, also where nothing is shown.
    """

    def __init__(self, n_jobs: int = 1) -> None:
        self._n_jobs, self._number, self._job, self.n_done = n_jobs, 0, "", 0
        self.bar: Any = None
        self._task: Any = None
        self._compiling: Any = None

    def __enter__(self) -> "Progress":
        global _shown
        if verbosity >= USUAL and sys.stderr is not None and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

            columns = (
                TextColumn("{task.description}", markup=False),
                BarColumn(bar_width=24),
                TaskProgressColumn(show_speed=False),
                TimeElapsedColumn(),
            )
            self.bar = Progress(*columns, console=Console(stderr=True), transient=True)
            self.bar.start()
            _shown, compiling.watch = self, self.on_compiling
        return self

    def __exit__(self, *exception: object) -> None:
        global _shown
        if self.bar:
            _shown = compiling.watch = None
            self.bar.stop()

    def job(self, name: str) -> None:
        """Begin the next job."""
        self._number, self._job = self._number + 1, name
        self.phase("")

    def phase(self, what: str, total: int | None = None) -> Callable[[int], None]:
        """Begin a phase of the job; return a function to call with the amount done, of ``total`` if that is known."""
        if not self.bar:
            return self._count
        number = f"[{self._number}/{self._n_jobs}] " if self._n_jobs > 1 else ""
        if self._task is not None:
            self.bar.remove_task(self._task)
        task = self._task = self.bar.add_task(f"{number}{self._job}" + (f": {what}" if what else ""), total=total)

        def advance(n: int) -> None:
            self._count(n)
            self.bar.advance(task, n)

        return advance

    def _count(self, n: int) -> None:
        self.n_done += n

    def on_compiling(self, n_compiled: int, is_busy: bool) -> None:
        """Show how many kernels were begun, while one is being compiled."""
        if not self.bar:
            return
        if not is_busy:
            if self._compiling is not None:
                self.bar.remove_task(self._compiling)
            self._compiling = None
            return
        text = f"compiling, kernel {n_compiled}"
        if self._compiling is None:
            self._compiling = self.bar.add_task(text, total=None)
        else:
            self.bar.update(self._compiling, description=text)
