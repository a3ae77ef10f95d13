"""The two groups of commands: an error of an input becomes one sentence, Ctrl-C ends a program at once."""

import gc
import importlib
import io
import os
import re
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import click

from nptrace import __version__, progress
from nptrace.trouble import trouble
from nptrace.typed import ARGS
from nptrace_base import compiling
from nptrace_base.errors import NptraceError

#: Where a command keeps, in its context, the runs that it found in folders: path -> folder.
FOUND = "nptrace.found"

#: Where a command keeps the texts of the options that its user typed: name of the function's parameter -> text, or a list.
TYPED = "nptrace.typed"

#: Exit status of a program that Ctrl-C ended.
INTERRUPTED = 130


class Interrupt:
    """What Ctrl-C does to a program: it leaves at once, deleting on its way what is half written.

    Further ones do not disturb that; after a second of it they end everything. Where code that ran swallowed the
    exception, as a destructor or a bare ``except`` does, the program is asked to leave again.
    """

    #: Seconds after which a program that did not begin to leave is asked again.
    AGAIN = 0.1

    def __init__(self) -> None:
        self.is_seen = self.is_over = False
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not where it is ignored, as behind nohup
            signal.signal(signal.SIGINT, self._leave)
            signal.signal(signal.SIGALRM, self._leave_again)

    def _leave(self, number: int, frame: object) -> None:
        if self.is_over:  # nothing is left to clean up, and Python, which ends, would drop an exception
            os._exit(INTERRUPTED)
        if not self.is_seen:
            self.is_seen, self._time = True, time.monotonic()
            sys.unraisablehook = lambda error: None  # it may be seen in a place that cannot be left
            signal.setitimer(signal.ITIMER_REAL, self.AGAIN, self.AGAIN)
            raise SystemExit(INTERRUPTED)
        if time.monotonic() > self._time + 1:
            os._exit(INTERRUPTED)

    def _leave_again(self, number: int, frame: object) -> None:
        """Leave, unless the blocks that clean up are at work: they handle the exception, or close a generator."""
        error = sys.exc_info()[1]
        while error is not None and not isinstance(error, SystemExit | GeneratorExit):
            error = error.__context__
        if error is None:
            raise SystemExit(INTERRUPTED)


class BadInput(click.ClickException):
    """One sentence on stderr, exit status 2."""

    exit_code = 2


def command_of(name: str) -> click.Command:
    """Return the command of a name, of either program."""
    found = vars(importlib.import_module(f"nptrace.commands.{name}"))
    command: click.Command = found.get(f"{name}_") or found[name]
    return command


class _Commands(dict[str, click.Command]):
    """The commands of a program by name, each imported when it is looked up."""

    def __init__(self, program: str, names: Iterable[str]) -> None:
        super().__init__(dict.fromkeys(names))  # type: ignore[arg-type]
        self._program = program

    def __getitem__(self, name: str) -> click.Command:
        if super().__getitem__(name) is None:
            command = command_of(name)
            _version_option(self._program)(command)
            _verbosity_option("-q", "--quiet", progress.QUIET, "Print results and errors only.")(command)
            _verbosity_option("-v", "--verbose", progress.VERBOSE, "Print also notes that carry no news.")(command)
            self[name] = command
        return super().__getitem__(name)

    def get(self, name: str, default: Any = None) -> Any:
        if name not in self:
            return default
        return self[name]


def _version_option(program: str) -> Any:
    return click.version_option(__version__, prog_name=program, message="%(prog)s %(version)s")


def _verbosity_option(short: str, long: str, verbosity: int, help: str) -> Any:
    """Return the option that sets how much a command prints."""

    def choose(ctx: click.Context, param: click.Parameter, is_chosen: bool) -> None:
        if is_chosen and progress.verbosity not in (progress.USUAL, verbosity):
            raise BadInput("-q asks for less and -v for more than usual; leave one out")
        if is_chosen:
            progress.verbosity = verbosity

    return click.option(short, long, is_flag=True, is_eager=True, expose_value=False, callback=choose, help=help)


def _way_around(sentence: str, found: Mapping[str, str]) -> str:
    """Return how to leave out the run that a sentence is about, if it was found in a folder with others."""
    bad = [path for path in found if re.search(rf"(?<!\S){re.escape(path)}(?![\w-]|\.\w)", sentence)]
    if len(bad) != 1 or len(found) == 1:
        return ""
    return f"; to leave it out, name the other runs, or move it out of {found[bad[0]]}"


class Command(click.Command):
    """A command with ``old`` spellings of its options, which still work and say what to write instead.

    ``lists`` end its help: by title, what returns rows of a name and what it means.
    """

    def __init__(
        self, *args: Any, old: Mapping[str, str] | None = None,
        lists: Mapping[str, Callable[[], list[tuple[str, str]]]] | None = None, **kwargs: Any,
    ) -> None:  # fmt: skip
        super().__init__(*args, **kwargs)
        self._old, self._lists = old or {}, lists or {}

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the lists."""
        for title, rows in self._lists.items():
            with formatter.section(title):
                formatter.write_dl(rows(), col_max=16)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse, after replacing old spellings."""
        for i, text in enumerate(args):
            if text == "--":
                break
            name, equals, value = text.partition("=")
            if name in self._old:
                progress.say(f"{name} is now {self._old[name]}; the old spelling will go")
                args[i] = self._old[name] + equals + value
        if not ctx.resilient_parsing:
            ctx.meta[ARGS] = [*args]
            ctx.meta[TYPED] = self.make_parser(ctx).parse_args([*args])[0]
        return super().parse_args(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Refuse options that have no effect beside others; do the work."""
        from nptrace import ignored

        ignored.check(ctx.params)
        return super().invoke(ctx)


class Commands(click.Group):
    """A group whose commands turn errors about inputs into one sentence; anything else is a bug and shows its traceback.

    It and each of its commands have ``--version``, ``-h`` and ``--help``. A command is a function in the module of its name in
    ``nptrace.commands``, with a trailing underscore where the name is Python's; it is imported when it is needed, and the
    group's help, which lists ``commands``, a sentence by name, needs none.
    """

    def __init__(self, name: str, commands: Mapping[str, str], **kwargs: Any) -> None:
        super().__init__(name, context_settings={"help_option_names": ["-h", "--help"]}, **kwargs)
        self.other: Commands | None = None  # the other program
        self.commands, self._sentences = _Commands(name, commands), commands
        _version_option(name)(self)

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Run as a program: a message announces compiling, Ctrl-C ends it quietly."""
        if args:
            return super().__call__(*args, **kwargs)
        gc.set_threshold(*compiling.GC_THRESHOLD)
        # Before NumPy is imported: no command multiplies large matrices, and OpenBLAS's idle threads spin for 0.1 s.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        compiling.announce = progress.say
        interrupt = Interrupt()
        try:
            return super().__call__(**kwargs)
        finally:
            interrupt.is_over = True
            if interrupt.is_seen:
                os._exit(INTERRUPTED)  # threads may be busy for seconds; what they wrote is deleted by now

    def main(self, *args: Any, **kwargs: Any) -> Any:
        """Parse and run; a name that stdout cannot write, because it is no text or not ASCII, appears with escapes."""
        if isinstance(sys.stdout, io.TextIOWrapper):
            sys.stdout.reconfigure(errors="backslashreplace")
        return super().main(*args, **kwargs)

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        """Return the command; one of the other program is named."""
        name, other = args[0], self.other
        if other is not None and name in other.commands and name not in self.commands and not ctx.resilient_parsing:
            raise BadInput(f"{name} is a command of {other.name}, not of {self.name}; write {other.name} {name}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the names and sentences."""
        with formatter.section("Commands"):
            formatter.write_dl(list(self._sentences.items()))

    def make_context(self, *args: Any, **extra: Any) -> click.Context:
        """Parse the group's own options; --version and --help print, which may fail."""
        with _sentences({}):
            return super().make_context(*args, **extra)

    def invoke(self, ctx: click.Context) -> Any:
        """Invoke the command."""
        progress.verbosity = progress.USUAL
        with _sentences(ctx.meta):
            return super().invoke(ctx)


@contextmanager
def _sentences(meta: Mapping[str, Any]) -> Iterator[None]:
    """Turn errors about inputs, and of the machine, into one sentence; ``meta`` is that of the command's context."""
    try:
        yield
    except BrokenPipeError:
        raise  # the reader has enough; click ends quietly
    except NptraceError as e:
        raise BadInput(f"{e}{_way_around(str(e), meta.get(FOUND, {}))}") from e
    except MemoryError as e:
        reason = f" ({e})" if str(e) else ""
        raise BadInput(f"there is not enough memory{reason}; take a smaller picture, mesh or cache, or fewer rays") from e
    except OSError as e:
        if (sentence := trouble(e)) is None:
            raise
        raise BadInput(sentence) from e
