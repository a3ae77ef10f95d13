"""What the commands share: options, their types and their errors, progress on stderr, files that appear whole."""

import errno
import io
import os
import re
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import compiling
from traces.errors import NptraceError

if TYPE_CHECKING:
    from rtrace.scene import Scene


#: What a full disk says, whose error may not name a file: standard output has none.
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


#: Exit status of a program that Ctrl-C ended.
INTERRUPTED = 130


class Interrupt:
    """What Ctrl-C does to a program: it leaves at once, deleting on its way what is half written.

    Further ones do not disturb that; after a second of it they end everything.
    """

    def __init__(self) -> None:
        self.is_seen = False
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not where it is ignored, as behind nohup
            signal.signal(signal.SIGINT, self._leave)

    def _leave(self, number: int, frame: object) -> None:
        if not self.is_seen:
            self.is_seen, self._time = True, time.monotonic()
            sys.unraisablehook = lambda error: None  # it may be seen in a place that cannot be left
            raise SystemExit(INTERRUPTED)
        if time.monotonic() > self._time + 1:
            os._exit(INTERRUPTED)


class BadInput(click.ClickException):
    """One sentence on stderr, exit status 2."""

    exit_code = 2


class Commands(click.Group):
    """A group whose commands turn errors about inputs into one sentence; anything else is a bug and shows its traceback."""

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Run as a program: a message announces compiling, Ctrl-C ends it quietly."""
        if args:
            return super().__call__(*args, **kwargs)
        compiling.announce = lambda text: click.echo(text, err=True)
        interrupt = Interrupt()
        try:
            return super().__call__(**kwargs)
        finally:
            if interrupt.is_seen:
                os._exit(INTERRUPTED)  # threads may be busy for seconds; what they wrote is deleted by now

    def main(self, *args: Any, **kwargs: Any) -> Any:
        """Parse and run; a name that stdout cannot write, because it is no text or not ASCII, appears with escapes."""
        if isinstance(sys.stdout, io.TextIOWrapper):
            sys.stdout.reconfigure(errors="backslashreplace")
        return super().main(*args, **kwargs)

    def invoke(self, ctx: click.Context) -> Any:
        """Invoke the command."""
        try:
            return super().invoke(ctx)
        except BrokenPipeError:
            raise  # the reader has enough; click ends quietly
        except NptraceError as e:
            raise BadInput(str(e)) from e
        except MemoryError as e:
            reason = f" ({e})" if str(e) else ""
            raise BadInput(f"there is not enough memory{reason}; take a smaller picture, mesh or cache, or fewer rays") from e
        except OSError as e:
            if e.filename is None and e.errno not in _FULL:
                raise
            raise BadInput(f"{e.filename or 'standard output'}: {e.strerror}; name another file or folder") from e


class ListOf(click.ParamType):
    """A comma-separated list; every item goes through a function that raises NptraceError on a bad one."""

    def __init__(self, name: str, item: Any) -> None:
        self.name, self._item = name, item

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the list that a text names."""
        if not isinstance(value, str):
            return value
        try:
            return [self._item(text) for text in value.split(",")]
        except NptraceError as e:
            raise BadInput(f"{param.opts[0]}: {e}" if param else str(e)) from e


def merged(ctx: click.Context, param: click.Parameter, values: tuple[list[Any], ...]) -> list[Any]:
    """Join the lists of a repeated option, without repetitions."""
    return list(dict.fromkeys(item for value in values for item in value))


def list_option(*names: str, item: Any, metavar: str, default: str, help: str) -> Any:
    """Return an option that may be repeated and takes comma-separated lists."""
    return click.option(
        *names, type=ListOf(metavar, item), metavar=metavar, multiple=True, default=[default], show_default=True,
        callback=merged, help=help,
    )  # fmt: skip


def traces_option() -> Any:
    """Return the option for the folder with the runs."""
    return click.option(
        "--traces", "folder", type=click.Path(path_type=Path), default="traces", show_default=True,
        help="Folder with the runs."
    )  # fmt: skip


@contextmanager
def progress_bar(what: str, total: int | None) -> Iterator[Callable[[int], None]]:
    """Yield a function to call with the amount done: a bar on a terminal, nothing in a pipe."""
    if not sys.stderr.isatty():
        yield lambda n: None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=total)
        yield lambda n: bar.advance(task, n)


def write_out(text: str, out: Path | None) -> None:
    """Write text to a file, whole or not at all, or to stdout."""
    if out is None:
        click.echo(text, nl=False)
        return
    from traces.whole import whole_file

    with whole_file(out) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="surrogateescape")


def output_option(*names: str, help: str) -> Any:
    """Return an option for a file to write; whether it can be written is looked at before any work is done."""

    def checked(ctx: click.Context, param: click.Parameter, path: Path | None) -> Path | None:
        if path is not None:
            from traces.whole import check_writable

            try:
                check_writable(path)
            except NptraceError as e:
                raise BadInput(str(e)) from e
        return path

    return click.option(*names, type=click.Path(path_type=Path, allow_dash=True), callback=checked, help=help)


def threads_option() -> Any:
    """Return the option for the number of threads."""
    return click.option(
        "--threads", type=click.IntRange(1), default=os.cpu_count() or 1, show_default="all processors",
        help="Threads to use; the results do not depend on it.",
    )  # fmt: skip


def scene_options(command: Any) -> Any:
    """Add the options that say how scenes are found."""
    for option in (
        click.option("--offline", is_flag=True, help="Never download a scene."),
        click.option("--strict", is_flag=True, help="Refuse a mesh with bad triangles instead of leaving them out."),
    ):
        command = option(command)
    return command


def load_scenes(names: Sequence[str], strict: bool, offline: bool) -> "list[Scene]":
    """Load scenes by name or file; say on stderr what a user should know about each."""
    from rtrace.catalog import load_scene
    from rtrace.scene import dropped_sentence

    scenes = []
    for name in names:
        scene = load_scene(name, strict=strict, download=not offline, notify=lambda text: click.echo(text, err=True))
        for sentence in (dropped_sentence(scene), *scene.notes):
            if sentence:
                click.echo(sentence, err=True)
        scenes.append(scene)
    return scenes


def check_run_names(names: Sequence[str], n_scenes: int) -> None:
    """Raise BadInput unless each name, one per scene or none at all, can be that of a folder among the runs."""
    if names and len(names) != n_scenes:
        raise BadInput(f"there are {len(names)} --name for {n_scenes} SCENE; give as many, in the same order")
    for name in names:
        if not re.fullmatch(r"[\w][\w.-]*", name):
            raise BadInput(f"--name: {name!r} is no name for a run; take letters, digits, _ . and -, the first no . or -")


#: Parameters of the kd-tree builder that a user may set, and the type of each.
KD_PARAMS = {"c_trav": float, "c_isect": float, "empty_bonus": float, "max_level": int}


def parse_kd(text: str) -> dict[str, Any]:
    """Return the builder's parameters that ``text`` sets: ``coarse`` or NAME=VALUE, parted by commas."""
    params: dict[str, Any] = {}
    for part in filter(None, text.split(",")):
        name, equals, value = ("max_level", "=", "16") if part == "coarse" else part.partition("=")
        if not equals or name not in KD_PARAMS:
            raise BadInput(f"--kd: {part!r} is not coarse or NAME=VALUE with a name of {', '.join(KD_PARAMS)}")
        try:
            params[name] = KD_PARAMS[name](value)
        except ValueError:
            raise BadInput(f"--kd: {name} must be a number, got {value!r}; write e.g. {name}=2") from None
    return params


def picture_options(command: Any) -> Any:
    """Add the options of `nptrace render` that decide the rays and the trees, for commands that trace what they need."""
    orders = ["scanline", "tile", "morton", "hilbert", "random"]
    for option in reversed((
        click.option("--pixels", default="2048x2048", show_default=True, metavar="WxH", help="Size of the picture."),
        click.option("--camera", metavar="TEXT", help="As in nptrace render."),
        click.option("--light", metavar="X,Y,Z", help="As in nptrace render."),
        click.option("--order", type=click.Choice(orders), default="scanline", show_default=True, help="As in render."),
        click.option("--batch", type=click.IntRange(0), default=1, show_default=True, help="As in nptrace render."),
        click.option("--kd", "kd_text", metavar="NAME=VALUE,...", default="", help="As in nptrace render."),
        click.option("--bvh", "bvh_builder", type=click.Choice(["sweep", "binned"]), default="sweep", show_default=True),
        click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the sample and a random order."),
        click.option(
            "--exact-below", type=click.IntRange(0), default=100_000_000, show_default=True, metavar="N",
            help="Runs of up to N predicted accesses are counted exactly at once.",
        ),
        threads_option(),
        scene_options,
    )):  # fmt: skip
        command = option(command)
    return command
