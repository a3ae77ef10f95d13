"""The functions of ``import nptrace`` that draw: ``view``, ``plot``, ``report``; and ``map``, whose rows ``plot`` draws too.

A notebook shows the pictures that they return; with ``output`` they are files, as those of the commands.
"""

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Unpack

from nptrace.plans import Given, MachineOptions, listed, machines_plan
from nptrace.results import Results
from nptrace.studies import Where
from nptrace.typed import listing
from nptrace.values import PATH, checked, pixels_text, sources_or, text
from nptrace_base.errors import NptraceError
from nptrace_base.places import place
from traces.reader import Run, open_run

if TYPE_CHECKING:
    from nptrace.tracing import Pixels
    from rtrace.scenes.scene import Scene

_RESULTS = sources_or(
    "results, a run, a path or a list of one or more",
    "sweep.parquet",
    lambda value: isinstance(value, Results) and len(value) > 0,
)


class Picture:
    """A picture that a function drew: PNG, SVG or PDF. A notebook shows it; ``bytes(picture)`` is its file."""

    def __init__(self, data: bytes, ending: str, path: Path | None) -> None:
        self._data, self._ending, self.path = data, ending, path

    def __bytes__(self) -> bytes:
        return self._data

    def _repr_png_(self) -> bytes | None:
        return self._data if self._ending == ".png" else None

    def _repr_svg_(self) -> str | None:
        return self._data.decode() if self._ending == ".svg" else None

    def __repr__(self) -> str:
        return f"<Picture {self.path or self._ending[1:].upper()}: {len(self._data):,} bytes>"


class _Canvas:
    """The file that a picture is drawn into: the one asked for, or a temporary PNG."""

    def __init__(self, output: Path | str | None) -> None:
        self._output = None if output is None else Path(output)

    def __enter__(self) -> "_Canvas":
        self._folder = TemporaryDirectory() if self._output is None else None
        self.path = self._output or Path(self._folder.name if self._folder else "") / "picture.png"
        return self

    def __exit__(self, *exception: object) -> None:
        if self._folder:
            self._folder.cleanup()

    def picture(self) -> Picture:
        return Picture(self.path.read_bytes(), self.path.suffix, self._output)


@checked(prefetch=text("stack"), layout=text("veb"))
# Many parameters: one per option of the command, as callers write them and help() lists them.
def view(
    sources: Where | Iterable[Where], /, *, heat: str | Sequence[str] = (), difference: bool = False,
    enlarge: int | None = None, machine: str = "paper", size: Given = (), ways: Given = (), line: Given = (),
    policy: Given = "lru", seed: int = 0, prefetch: str = "traced", layout: str = "stored",
    output: Path | str | None = None, threads: int | None = None, **numbers: Unpack[MachineOptions],
) -> Picture:  # fmt: skip
    """Show the pictures of runs, enlarged, or what their pixels cost, as heat maps on one scale, as ``nptrace view`` does.

    Parameters
    ----------
    sources : Run, path or several
        Runs.
    heat : str or list
        Numbers per pixel to show as colours, such as ``"accesses"`` or ``"misses"``, as the command's help lists them.
    difference : bool
        Show the first run, and each other one minus the first.
    enlarge : int, optional
        Dots per pixel of the run, on either side, from 1 to 64.
    prefetch, layout : str
        A single prefetch policy, and a single layout.
    output : Path, optional
        File for the picture: .png; heat maps also .svg and .pdf. By default none is written.
    machine, size, ways, line, policy, seed, threads, numbers
        As those of ``time``, for one cache and one machine.

    Returns
    -------
    Picture

    Raises
    ------
    NptraceError
        A value is wrong, a run cannot be read, or matplotlib is missing.
    """
    from nptrace.commands.view import ViewOptions, parse_kind
    from nptrace.sources import each_once

    machines = machines_plan(machine, size, ways, line, policy, seed, numbers)
    shown = ViewOptions(listed("heat", heat, parse_kind), difference, enlarge, machines, prefetch, layout, threads)
    shown.check_machines()
    runs = each_once(run for each in _several(sources) for run in _runs(each))
    shown.check(runs)
    with _Canvas(output) as canvas:
        shown.draw(runs, canvas.path)
        return canvas.picture()


@checked(sources=_RESULTS)
def plot(
    sources: Results | Where | Iterable[Results | Where], /, *, kind: str | None = None, size: Given = (), ways: Given = (),
    line: Given = (), prefetch: Given = (), layout: Given = (), output: Path | str | None = None, threads: int | None = None,
) -> Picture:  # fmt: skip
    """Draw results, or runs, as ``npcache plot`` does: all that varies has its own line, bar or panel.

    Parameters
    ----------
    sources : Results, Run, path or several
        What ``replay``, ``sweep``, ``time``, ``compare``, ``table1`` or ``map`` returned, files of it, or runs.
    kind : str, optional
        What to draw, such as ``"curves"`` or ``"levels"``, as the command's help lists them; by default what the results say.
    size, ways, line, prefetch, layout
        Of runs alone: the caches, prefetch policies and layouts that they go through, as those of ``replay``.
    output : Path, optional
        File for the picture: .png, .svg or .pdf. By default none is written.
    threads : int, optional
        By default, the number of processors.

    Returns
    -------
    Picture

    Raises
    ------
    NptraceError
        A value is wrong, the results cannot be drawn so, a source cannot be read, or matplotlib is missing.
    """
    from cachesim.config import parse_bytes
    from cachesim.grid import parse_ways_range
    from cachesim.report.pictures import check_plot
    from cachesim.report.result_files import read_rows
    from nptrace.commands.plot import KINDS, draw_results, drawn
    from nptrace.plans import sizes

    if kind not in (None, *KINDS):
        raise NptraceError(f"kind: {kind!r} is not one of {', '.join(KINDS)}")
    asked: dict[str, list] = {
        "size": sizes(size), "ways": listed("ways", ways, parse_ways_range), "line": listed("line", line, parse_bytes),
        "prefetch": listed("prefetch", prefetch, str), "layout": listed("layout", layout, str),
    }  # fmt: skip

    def refuse(reason: str, *names: str, way: str) -> None:
        if others := [name for name in names if asked[name]]:
            raise NptraceError(f"{reason}; leave out {listing(others)}{way}")

    given = _several(sources)
    with _Canvas(output) as canvas:
        check_plot(canvas.path)
        if not any(isinstance(each, Results) for each in given):
            places = [each.path if isinstance(each, Run) else place(each) for each in given]
            drawn(places, kind, asked, canvas.path, threads, refuse)
            return canvas.picture()
        refuse("results have their caches and policies", *asked, way=", or name runs")
        if len(given) == 1 and "leaf" in given[0][0]:
            from cachesim.report import map_tables

            map_tables.plot(list(given[0]), canvas.path)
            return canvas.picture()
        files = {i: list(each) if isinstance(each, Results) else read_rows(Path(str(each))) for i, each in enumerate(given)}
        draw_results(files, kind, canvas.path)
        return canvas.picture()


@checked(output=PATH, prefetch=text("stack"), layout=text("veb"))
# Many parameters: one per option of the command, as callers write them and help() lists them.
def report(
    sources: Where | Iterable[Where] = (), /, *, output: Path | str, traces: Path | str = "traces", machine: str = "paper",
    size: Given = (), ways: Given = (), line: Given = (), policy: Given = "lru", seed: int = 0, prefetch: str = "traced",
    layout: str = "stored", threads: int | None = None, **numbers: Unpack[MachineOptions],
) -> Path:  # fmt: skip
    """Write one page about runs, for any browser and without a network, as ``npcache report`` does.

    Parameters
    ----------
    output : Path
        The page: .html.
    sources, traces
        As those of ``replay``.
    prefetch, layout : str
        A single prefetch policy, and a single layout.
    machine, size, ways, line, policy, seed, threads, numbers
        As those of ``time``, for one machine; the first cache is that of the heat maps, the levels and the clock.

    Returns
    -------
    Path
        ``output``.

    Raises
    ------
    NptraceError
        A value is wrong, a run cannot be read, or a package is missing.
    """
    from cachesim.report.page import check_page
    from nptrace.api import _chosen
    from nptrace.commands.report import PageRuns, check, write_page

    path = Path(output)
    check_page(path)
    machines = machines_plan(machine, size, ways, line, policy, seed, numbers)
    check(machines, prefetch, layout)
    runs = [each if isinstance(each, Run) else open_run(each) for each in _chosen(sources, traces)]
    write_page(PageRuns(runs, machines.configs, machines.clocks[0], prefetch, layout, threads), path)
    return path


@checked()
def map(
    *scenes: "str | Path | Scene", pixels: "Pixels" = "128x128", quick: bool = False, one_in: int = 1,
    out: Path | str = "traces/map", threads: int | None = None, strict: bool = False, offline: bool = False,
) -> Results:  # fmt: skip
    """Map where prefetching pays: leaf size x triangle test x miss latency x rays in flight x cache, as ``nptrace map`` does.

    Parameters
    ----------
    scenes, pixels, strict, offline
        As those of ``render``.
    quick : bool
        Two leaf sizes and two machines.
    one_in : int
        Time one piece of the rays in so many, from 1 to 16, for speed-ups with 95 % intervals in less time.
    out : Path
        Folder of this machine for the runs and the finished parts; the same call goes on where it stopped.
    threads : int, optional
        By default, the number of processors; the results do not depend on it.

    Returns
    -------
    Results
        A row per run, cache, machine and policy; ``plot`` draws them.

    Raises
    ------
    NptraceError
        A value is wrong, or a scene is not found or cannot be read.
    """
    from cachesim.report import map_tables
    from nptrace.commands.map import mapped
    from nptrace.scene_options import load_scenes

    if not scenes:
        raise NptraceError("no scene is given; name a mesh file or a scene, e.g. map('sponza')")
    named = [str(each) if isinstance(each, Path) else each for each in scenes]
    rows = mapped(
        lambda: load_scenes(named, strict, offline), pixels_text(pixels), Path(out), quick=quick, one_in=one_in,
        threads=threads or os.cpu_count() or 1,
    )  # fmt: skip
    return Results("map", rows, lambda: map_tables.tables(rows))


def _several(sources: Any) -> list[Any]:
    return list(sources) if isinstance(sources, list) else [sources]


def _runs(where: Any) -> list[Run]:
    """Return a run, or the runs at a place."""
    from nptrace.sources import chosen_sources

    return [where] if isinstance(where, Run) else [open_run(each) for each in chosen_sources([place(where)], Path())]
