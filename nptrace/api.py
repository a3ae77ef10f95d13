"""The functions of ``import nptrace``: options as the commands take them, as texts, numbers or lists -> runs and results.

Each has the options and defaults of the command of its name (``three_c`` is ``--3c``), and does the same work
(``nptrace.studies``). A wrong value raises NptraceError with the sentence that the command prints. Notes go to stderr.
"""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypedDict, TypeVar, Unpack, overload

from nptrace.progress import Progress
from nptrace.results import Results
from nptrace.studies import Where, Workers
from nptrace_base.errors import NptraceError
from traces.reader import Run, open_run

if TYPE_CHECKING:
    from cachesim.config import CacheConfig
    from nptrace.clock_options import Machines
    from rtrace.scenes.scene import Scene

#: An option with a value, or several: 8192, "8K", "8K,16K", "4K..64K", ["8K", 16384].
Given = str | int | Sequence[str | int]
#: Runs, and places of runs, folders of runs or traces.
Sources = Where | Iterable[Where]

_T = TypeVar("_T")


class RenderOptions(TypedDict, total=False):
    """The options of ``render`` that do not decide how many runs it makes."""

    pixels: str
    light: str | None
    order: str
    batch: int
    seed: int
    kd: str
    bvh: str
    rays: Path | str | None
    out: Path | str
    name: str | Sequence[str]
    overwrite: bool
    threads: int | None
    strict: bool
    offline: bool


@overload
def render(  # type: ignore[overload-overlap]
    scene: "str | Path | Scene", /, *, accel: Literal["kdtree", "bvh"], camera: str | None = None,
    bvh_nodes: Literal[32, 64] = 32, **options: Unpack[RenderOptions],
) -> Run: ...  # fmt: skip


@overload
def render(
    *scenes: "str | Path | Scene", accel: Given = (), camera: str | Sequence[str] | None = None, bvh_nodes: Given = 32,
    **options: Unpack[RenderOptions],
) -> list[Run]: ...  # fmt: skip


def render(
    *scenes: "str | Path | Scene", accel: Given = (), pixels: str = "128x128", camera: str | Sequence[str] | None = None,
    light: str | None = None, order: str = "scanline", batch: int = 1, seed: int = 0, kd: str = "", bvh: str = "sweep",
    bvh_nodes: Given = 32, rays: Path | str | None = None, out: Path | str = "traces", name: str | Sequence[str] = (),
    overwrite: bool = False, threads: int | None = None, strict: bool = False, offline: bool = False,
) -> Run | list[Run]:  # fmt: skip
    """Trace pictures of scenes, as ``nptrace render`` does, and return the runs, which are on disk.

    Parameters
    ----------
    scenes : str, Path or Scene
        Mesh files, names that ``nptrace scenes`` lists, or scenes (``rtrace.scene_from_triangles``).
    accel : str or list
        Trees, ``"kdtree"`` and ``"bvh"``; both by default.
    camera : str or list
        One, or several for several runs; by default the scene's or a fitted one.
    rays : Path, optional
        Parquet file of rays to trace instead of a picture's (``rtrace.ray_file``).
    out : Path
        Folder for the runs.

    Returns
    -------
    Run or list of Run
        A Run if one scene, one tree and at most one camera are given, each as a single value; else a list.

    Raises
    ------
    NptraceError
        A value is wrong, a scene is not found or cannot be read, or a run of other content has the name.
    """
    from nptrace.scene_options import check_run_names, load_scenes, own_rays, parse_tree, tree_params
    from nptrace.studies import rendered
    from rtrace.camera import ORDERS, parse_size
    from rtrace.ray_file import RayFile
    from rtrace.render import Shooting

    trees, sizes = listed("accel", accel, parse_tree), listed("bvh_nodes", bvh_nodes, str)
    cameras = [camera] if isinstance(camera, str) else list(camera or ())
    names = [name] if isinstance(name, str) else list(name)
    if not scenes:
        raise NptraceError("no scene is given; name a mesh file or a scene, e.g. render('sponza')")
    if order not in ORDERS:
        raise NptraceError(f"order: {order!r} is not one of {', '.join(ORDERS)}")
    check_run_names(names, len(scenes) * max(len(cameras), 1))
    shooting: Shooting | RayFile
    shooting = picture = Shooting(*parse_size(pixels), order, batch, seed)
    if rays is not None:
        shooting = own_rays(Path(rays), picture, [*cameras, *([light] if light else [])])
    params = tree_params(trees, kd, bvh, sizes)
    seen = load_scenes([str(each) if isinstance(each, Path) else each for each in scenes], strict, offline, cameras, light)
    with Progress(len(seen) * len(params)) as bar:
        made = rendered(seen, params, shooting, Path(out), bar, names=names, overwrite=overwrite, threads=threads)
    runs = [open_run(str(each.identity.path)) for each in made]
    is_single = len(runs) == 1 and isinstance(accel, str) and (camera is None or isinstance(camera, str))
    return runs[0] if is_single else runs


def open(path: Path | str) -> Run:
    """Open a run on disk; NptraceError if it is none, or damaged."""
    return open_run(path)


def replay(
    sources: Sources = (), /, *, traces: Path | str = "traces", size: Given = "8K", ways: Given = "1", line: Given = "32",
    policy: Given = "lru", seed: int = 0, prefetch: Given = "traced", layout: Given = "stored", three_c: bool = False,
    by: str | None = None, threads: int | None = None, workers: Workers = None,
) -> Results:  # fmt: skip
    """Replay runs, or traces of addresses, through every combination of caches, exactly, as ``npcache replay`` does.

    Parameters
    ----------
    sources : Run, path or several
        Without any, the runs in the folder ``traces``.
    size, line : str, int or list
        In bytes: ``8192``, ``"8K,16K"``, ``"4K..64K"`` (the powers of two from one to the other).
    ways : str, int or list
        ``2``, ``"1,2,full"``, ``"1..16"``.
    policy, prefetch, layout : str or list
        As the command's help lists them.
    three_c : bool
        Classify misses as compulsory, capacity or conflict.
    by : str, optional
        ``"pixel"``, ``"level"``, ``"node"`` or ``"ray-type"``: return where the counts fall, a row for each.
    threads : int, optional
        By default, the number of processors; the results do not depend on it.
    workers : int or concurrent.futures.Executor, optional
        Processes to use instead of threads, or what runs calls elsewhere, each for parts of a run.

    Raises
    ------
    NptraceError
        A value is wrong, or a source cannot be read.
    """
    from cachesim.by_group import BY, GroupedRecords
    from cachesim.report import group_tables, replay_tables
    from nptrace.studies import replayed, replayed_by

    if by not in (None, *BY):
        raise NptraceError(f"by: {by!r} is not one of {', '.join(BY)}")
    if by is not None and workers is not None:
        raise NptraceError(f"by: counts by {by} are not made by workers; leave by or workers out")
    configs, policies, layouts = replay_plan(size, ways, line, policy, seed, prefetch, layout)
    chosen = _chosen(sources, traces)
    with Progress(len(chosen) * len(layouts) * len(policies)) as bar:
        if by is not None:
            grouped = replayed_by(chosen, configs, policies, layouts, by, bar, three_c=three_c, threads=threads)
            return Results("replay", GroupedRecords(grouped), lambda: group_tables.tables(grouped))
        results = replayed(
            chosen, configs, policies, layouts, bar, three_c=three_c, threads=threads, workers=workers
        )  # fmt: skip
    return Results("replay", [each.to_dict() for each in results], lambda: replay_tables.tables(results))


def sweep(
    sources: Sources = (), /, *, traces: Path | str = "traces", size: Given = "4K..64K", ways: Given = "1",
    line: Given = "32", prefetch: Given = "traced", layout: Given = "stored", threads: int | None = None,
    workers: Workers = None,
) -> Results:  # fmt: skip
    """Count the misses of every LRU cache in ranges, in one pass over each trace, as ``npcache sweep`` does.

    The parameters are those of ``replay``; a cache is in the sweep if its size lies in a range and its number of sets is a
    power of two.
    """
    from cachesim.report import sweep_output
    from nptrace.studies import swept

    configs, policies, layouts = sweep_plan(size, ways, line, prefetch, layout)
    chosen = _chosen(sources, traces)
    with Progress(len(chosen) * len(layouts) * len(policies)) as bar:
        rows = swept(chosen, configs, policies, layouts, bar, threads=threads, workers=workers)
    return Results("sweep", [row.to_dict() for row in rows], lambda: sweep_output.tables(rows))


class MachineOptions(TypedDict, total=False):
    """The numbers of a machine, each one or several; those of the machine ``paper`` if left out (``npcache time --help``)."""

    hit: Given
    miss: Given
    rays: Given
    ports: Given
    mshrs: Given
    bandwidth: Given
    box: Given
    triangle: Given
    every: Given
    units: Given


def time(
    sources: Sources = (), /, *, traces: Path | str = "traces", machine: str = "paper", size: Given = (), ways: Given = (),
    line: Given = (), policy: Given = "lru", seed: int = 0, prefetch: Given = "stack", layout: Given = "stored",
    by: str | None = None, threads: int | None = None, **numbers: Unpack[MachineOptions],
) -> Results:  # fmt: skip
    """Count the cycles of runs, with and without prefetching, as ``npcache time`` does.

    Parameters
    ----------
    machine : str
        Where the cache and the ``numbers`` come from that are not given.
    by : str, optional
        ``"level"``, ``"ray"``, ``"slot"`` or ``"leaf"``: return reads and requests by tree level, ray type, place on the
        stack or leaf size instead.

    The other parameters are those of ``replay``.
    """
    from cachesim.report import tally_tables, timing_tables
    from nptrace.commands.time import BY
    from nptrace.studies import timed

    if by not in (None, *BY):
        raise NptraceError(f"by: {by!r} is not one of {', '.join(BY)}")
    machines, policies, layouts = time_plan(machine, size, ways, line, policy, seed, prefetch, layout, **numbers)
    chosen = _chosen(sources, traces)
    with Progress(len(chosen) * len(layouts)) as bar:
        found = timed(
            chosen, machines.configs, machines.clocks, policies, layouts, bar, by=by or "nothing", threads=threads
        )  # fmt: skip
    if by is not None:
        return Results("time", tally_tables.records(found, by), lambda: tally_tables.tables(found, by))
    return Results("time", [each.to_dict() for each in found], lambda: timing_tables.tables(found))


def compare(
    sources: Sources = (), /, *, traces: Path | str = "traces", machine: str = "paper", size: Given = (), ways: Given = (),
    line: Given = (), policy: Given = "lru", seed: int = 0, prefetch: Given = "all", layout: str = "stored",
    baselines: bool = True, threads: int | None = None, **numbers: Unpack[MachineOptions],
) -> Results:  # fmt: skip
    """Compare prefetch policies on one cache and machine, with what needs no unit, as ``npcache compare`` does.

    The parameters are those of ``time``, for one cache and one machine; without ``baselines``, line sizes, alignments and node
    orders are not compared.
    """
    from cachesim.report import compare_tables
    from nptrace.clock_options import one_machine
    from nptrace.studies import compared

    config, clock = one_machine(_machines(machine, size, ways, line, policy, seed, numbers))
    policies, chosen = listed("prefetch", prefetch, str), _chosen(sources, traces)
    with Progress(len(chosen)) as bar:
        rows = compared(chosen, config, clock, policies, layout, bar, baselines=baselines, threads=threads)
    return Results("compare", [row.to_dict() for row in rows], lambda: compare_tables.tables(rows))


def table1(
    sources: Sources = (), /, *, traces: Path | str = "traces", policy: str = "lru", layout: str = "stored",
    threads: int | None = None,
) -> Results:  # fmt: skip
    """Return Table I of the paper beside ours from existing runs, as ``npcache table1`` does."""
    from cachesim.report import table1 as table
    from cachesim.report import table1_tables
    from nptrace.studies import table1_rows, table1_runs

    runs = [each if isinstance(each, Run) else open_run(each) for each in _chosen(sources, traces)]
    with Progress() as bar:
        rows = table1_rows(table1_runs(runs, traces), bar, policy=policy, layout=layout, threads=threads)
    return Results("table1", table.to_dicts(rows), lambda: (table1_tables.tables(rows), table1_tables.notes(rows)))


class OptionError(NptraceError):
    """A wrong value of the option ``name``."""

    def __init__(self, name: str, sentence: object) -> None:
        super().__init__(f"{name}: {sentence}")
        self.name = name


Plan = tuple[list["CacheConfig"], list[str], list[str]]


def replay_plan(
    size: Given, ways: Given, line: Given, policy: Given, seed: int, prefetch: Given, layout: Given
) -> Plan:  # fmt: skip
    """Return the caches, prefetch policies and layouts that the options of ``replay`` name."""
    from cachesim.grid import caches, parse_ways_range

    parsed = _sizes(size), listed("ways", ways, parse_ways_range), _lines(line), listed("policy", policy, str.lower)
    return caches(*parsed, seed), _prefetches(prefetch), _layouts(layout)


def sweep_plan(size: Given, ways: Given, line: Given, prefetch: Given, layout: Given) -> Plan:
    """Return the caches, prefetch policies and layouts that the options of ``sweep`` name."""
    from cachesim.grid import grid, parse_range, parse_ways_range

    numbers = [number for named in listed("ways", ways, parse_ways_range) for number in named]
    return grid(listed("size", size, parse_range), numbers, _lines(line)), _prefetches(prefetch), _layouts(layout)


def time_plan(
    machine: str, size: Given, ways: Given, line: Given, policy: Given, seed: int, prefetch: Given, layout: Given,
    **numbers: Unpack[MachineOptions],
) -> "tuple[Machines, list[str], list[str]]":  # fmt: skip
    """Return the machines, prefetch policies and layouts that the options of ``time`` name."""
    return _machines(machine, size, ways, line, policy, seed, numbers), _prefetches(prefetch), _layouts(layout)


def listed(name: str, value: Any, item: Callable[[str], _T]) -> list[_T]:
    """Return the values of an option, each once, as the command reads them from text."""
    values = [value] if isinstance(value, (str, int)) else list(value)
    texts = [text for each in values for text in str(each).split(",")]
    try:
        return list(dict.fromkeys(item(text) for text in texts))
    except NptraceError as e:
        raise OptionError(name, e) from e


def _prefetches(value: Given) -> list[str]:
    from cachesim.prefetch import parse_prefetch

    return listed("prefetch", value, lambda text: str(parse_prefetch(text)))


def _layouts(value: Given) -> list[str]:
    from cachesim.layout import parse_layout

    return listed("layout", value, lambda text: str(parse_layout(text)))


def _sizes(value: Given) -> list[int]:
    from cachesim.grid import parse_sizes

    found = listed("size", value, lambda text: tuple(parse_sizes(text)))
    return list(dict.fromkeys(size for sizes in found for size in sizes))


def _lines(value: Given) -> list[int]:
    from cachesim.config import parse_bytes

    return listed("line", value, parse_bytes)


def _machines(
    machine: str, size: Given, ways: Given, line: Given, policy: Given, seed: int, numbers: MachineOptions
) -> "Machines":  # fmt: skip
    from cachesim.clock.parameters import NUMBERS
    from cachesim.grid import parse_ways_range
    from nptrace.clock_options import machines_of, parse_number

    for name in numbers:
        if name not in NUMBERS:
            raise NptraceError(f"a machine has no number {name}; its numbers are {', '.join(NUMBERS)}")
    given: dict[str, Sequence[int]] = {name: listed(name, value, parse_number) for name, value in numbers.items()}
    parsed = _sizes(size), listed("ways", ways, parse_ways_range), _lines(line), listed("policy", policy, str.lower)
    return machines_of(machine, given, *parsed, seed)


def _chosen(sources: Any, folder: Path | str) -> list[Where]:
    """Return what to read: runs as they are, and the runs and traces at the places named, or those in the folder."""
    from nptrace.sources import chosen_sources

    given = [sources] if isinstance(sources, (str, Path, Run)) else list(sources)
    if not given:
        return [*chosen_sources([], Path(folder))]
    chosen: list[Where] = []
    for each in given:
        chosen += [each] if isinstance(each, Run) else chosen_sources([Path(each)], Path(folder))
    return chosen
