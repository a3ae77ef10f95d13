"""The functions of ``import nptrace``: options as the commands take them, as texts, numbers or lists -> runs and results.

Each has the options and defaults of the command of its name (``three_c`` is ``--3c``), and does the same work
(``nptrace.studies``). A wrong value raises NptraceError with the sentence that the command prints. Notes go to stderr.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypedDict, Unpack, overload

from nptrace.plans import Given, MachineOptions, estimate_plan, listed, machines_plan, replay_plan, sweep_plan, time_plan
from nptrace.progress import Progress
from nptrace.results import Results
from nptrace.studies import Where
from nptrace_base.engines import engine_of
from nptrace_base.errors import NptraceError
from nptrace_base.places import Place, Remote, place
from traces.reader import Run, open_run

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from rtrace.scenes.scene import Scene

#: Runs, and places of runs, folders of runs or traces.
Sources = Where | Iterable[Where]


class RenderOptions(TypedDict, total=False):
    """The options of ``render`` that do not decide how many runs it makes."""

    pixels: str
    light: str | None
    order: str
    batch: int
    seed: int
    packet: int
    shadow: str
    shadow_order: str
    shadow_end: str
    kd: str
    bvh: str
    rays: Path | str | None
    out: Place | str
    name: str | Sequence[str]
    overwrite: bool
    workers: "int | Executor"
    scheduler: str | None
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
    light: str | None = None, order: str = "scanline", batch: int = 1, seed: int = 0, packet: int = 1, shadow: str = "lit",
    shadow_order: str = "sign", shadow_end: str = "stop", kd: str = "", bvh: str = "sweep", bvh_nodes: Given = 32,
    rays: Path | str | None = None, out: Place | str = "traces", name: str | Sequence[str] = (), overwrite: bool = False,
    workers: "int | Executor" = 0, scheduler: str | None = None, threads: int | None = None, strict: bool = False,
    offline: bool = False,
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
    packet : int
        Rays that walk the tree as one: 1, 4, 16 or 64, of a square of pixels.
    shadow, shadow_order, shadow_end : str
        Which pixels send a shadow ray (``"lit"``, ``"hit"``, ``"all"``), which child it searches first (``"sign"``,
        ``"cheaper"``), and what is read after its hit (``"stop"``, ``"drain"``).
    rays : Path, optional
        Parquet file of rays to trace instead of a picture's (``rtrace.ray_file``).
    out : Path
        Folder for the runs, or an address such as s3://bucket/folder.
    workers : int or Executor
        Trace parts of the picture in so many processes, or on the workers of an executor of ``concurrent.futures``.
    scheduler : str, optional
        Trace them on the workers of a Dask cluster.

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
    shooting = picture = Shooting(*parse_size(pixels), order, batch, seed, packet, shadow, shadow_order, shadow_end)
    if rays is not None:
        shooting = own_rays(Path(rays), picture, [*cameras, *([light] if light else [])])
    params = tree_params(trees, kd, bvh, sizes)
    seen = load_scenes([str(each) if isinstance(each, Path) else each for each in scenes], strict, offline, cameras, light)
    folder = place(out)
    with engine_of(workers, scheduler) as engine, Progress(len(seen) * len(params)) as bar:
        made = rendered(
            seen, params, shooting, folder, bar, names=names, overwrite=overwrite, threads=threads, engine=engine
        )  # fmt: skip
    runs = [open_run(folder / each.identity.run) for each in made]  # whose path is for printing alone
    is_single = len(runs) == 1 and isinstance(accel, str) and (camera is None or isinstance(camera, str))
    return runs[0] if is_single else runs


def open(path: Place | str) -> Run:
    """Open a run, on disk or at an address such as s3://bucket/run; NptraceError if it is none, or damaged."""
    return open_run(path)


def replay(
    sources: Sources = (), /, *, traces: Place | str = "traces", size: Given = "8K", ways: Given = "1", line: Given = "32",
    policy: Given = "lru", seed: int = 0, prefetch: Given = "traced", layout: Given = "stored", reads: str = "own",
    flush: str = "never", three_c: bool = False, by: str | None = None, workers: "int | Executor" = 0,
    scheduler: str | None = None, threads: int | None = None,
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
    reads : str
        What a visit reads: ``"own"``, its node; ``"children"``, both children of a node that is entered, at once;
        ``"merged"``, its node unless that lies in the line read last.
    flush : str
        ``"never"``, or ``"ray"``: the caches are empty when a ray starts (lru and fifo).
    three_c : bool
        Classify misses as compulsory, capacity or conflict.
    by : str, optional
        ``"pixel"``, ``"level"``, ``"node"`` or ``"ray-type"``: return where the counts fall, a row for each.
    threads : int, optional
        By default, the number of processors; the results do not depend on it.
    workers : int or concurrent.futures.Executor
        Processes to use instead of threads, or what runs calls elsewhere, each for parts of a run; 0 for none.
    scheduler : str, optional
        Address of a Dask scheduler whose workers are used.

    Raises
    ------
    NptraceError
        A value is wrong, or a source cannot be read.
    """
    from cachesim.by_group import BY, GroupedRecords
    from cachesim.flush import FLUSHES
    from cachesim.reads import READS
    from cachesim.report import group_tables, replay_tables
    from nptrace.studies import check_whole, replayed, replayed_by

    for name, value, known in (("by", by, (None, *BY)), ("reads", reads, READS), ("flush", flush, FLUSHES)):
        if value not in known:
            raise NptraceError(f"{name}: {value!r} is not one of {', '.join(filter(None, known))}")
    check_whole(by, reads, flush, has_workers=bool(workers or scheduler))
    configs, policies, layouts = replay_plan(size, ways, line, policy, seed, prefetch, layout)
    chosen = _chosen(sources, traces)
    with engine_of(workers, scheduler) as engine, Progress(len(chosen) * len(layouts) * len(policies)) as bar:
        if by is not None:
            grouped = replayed_by(chosen, configs, policies, layouts, by, bar, three_c=three_c, threads=threads)
            return Results("replay", GroupedRecords(grouped), lambda: group_tables.tables(grouped))
        results = replayed(
            chosen, configs, policies, layouts, bar, reads=reads, flush=flush, three_c=three_c, threads=threads, engine=engine
        )  # fmt: skip
    return Results("replay", [each.to_dict() for each in results], lambda: replay_tables.tables(results))


def sweep(
    sources: Sources = (), /, *, traces: Place | str = "traces", size: Given = "4K..64K", ways: Given = "1",
    line: Given = "32", prefetch: Given = "traced", layout: Given = "stored", threads: int | None = None,
    workers: "int | Executor" = 0, scheduler: str | None = None,
) -> Results:  # fmt: skip
    """Count the misses of every LRU cache in ranges, in one pass over each trace, as ``npcache sweep`` does.

    The parameters are those of ``replay``; a cache is in the sweep if its size lies in a range and its number of sets is a
    power of two.
    """
    from cachesim.report import sweep_output
    from nptrace.studies import swept

    configs, policies, layouts = sweep_plan(size, ways, line, prefetch, layout)
    chosen = _chosen(sources, traces)
    with engine_of(workers, scheduler) as engine, Progress(len(chosen) * len(layouts) * len(policies)) as bar:
        rows = swept(chosen, configs, policies, layouts, bar, threads=threads, engine=engine)
    return Results("sweep", [row.to_dict() for row in rows], lambda: sweep_output.tables(rows))


def time(
    sources: Sources = (), /, *, traces: Place | str = "traces", machine: str = "paper", size: Given = (), ways: Given = (),
    line: Given = (), policy: Given = "lru", seed: int = 0, prefetch: Given = "stack", layout: Given = "stored",
    by: str | None = None, threads: int | None = None, **numbers: Unpack[MachineOptions],
) -> Results:  # fmt: skip
    """Count the cycles of runs, with and without prefetching, as ``npcache time`` does.

    Parameters
    ----------
    machine : str
        Where the cache and the ``numbers`` come from that are not given.
    by : str, optional
        ``"level"``, ``"ray-type"``, ``"slot"`` or ``"leaf"``: return reads and requests by tree level, ray type, place on the
        stack or leaf size instead.

    The other parameters are those of ``replay``.
    """
    from cachesim.report import tally_tables, timing_tables
    from nptrace.commands.time import BY, NAMES
    from nptrace.studies import timed

    by = {name: tally for tally, name in NAMES.items()}.get(str(by), by)
    if by not in (None, *BY):
        raise NptraceError(f"by: {by!r} is not one of {', '.join(NAMES.get(each, each) for each in BY)}")
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
    sources: Sources = (), /, *, traces: Place | str = "traces", machine: str = "paper", size: Given = (), ways: Given = (),
    line: Given = (), policy: Given = "lru", seed: int = 0, prefetch: Given = "all", layout: str = "stored",
    baselines: bool = True, workers: "int | Executor" = 0, scheduler: str | None = None, threads: int | None = None,
    **numbers: Unpack[MachineOptions],
) -> Results:  # fmt: skip
    """Compare prefetch policies on one cache and machine, with what needs no unit, as ``npcache compare`` does.

    The parameters are those of ``time``, for one cache and one machine; without ``baselines``, line sizes, alignments and node
    orders are not compared. Workers are those of ``replay``, and take whole runs.
    """
    from cachesim.report import compare_tables
    from nptrace.clock_options import one_machine
    from nptrace.studies import compared

    config, clock = one_machine(machines_plan(machine, size, ways, line, policy, seed, numbers))
    policies, chosen = listed("prefetch", prefetch, str), _chosen(sources, traces)
    with engine_of(workers, scheduler) as engine, Progress(1 if engine else len(chosen)) as bar:
        rows = compared(
            chosen, config, clock, policies, layout, bar, baselines=baselines, threads=threads, engine=engine
        )  # fmt: skip
    return Results("compare", [row.to_dict() for row in rows], lambda: compare_tables.tables(rows))


def estimate(
    *scenes: "str | Path | Scene", accel: Given = (), size: Given = "8K", ways: Given = "1", line: Given = "32",
    policy: Given = "lru", layout: Given = "stored", is_table1: bool = False, target_error: str = "2%,0.05pp",
    exact_below: int = 100_000_000, resume: Path | str | None = None, pixels: str = "2048x2048",
    camera: str | Sequence[str] | None = None, light: str | None = None, order: str = "scanline", batch: int = 1,
    seed: int = 0, kd: str = "", bvh: str = "sweep", bvh_nodes: Given = 32, threads: int | None = None,
    strict: bool = False, offline: bool = False,
) -> Results:  # fmt: skip
    """Estimate the miss rates of large pictures from part of their rays, as ``npcache estimate`` does; no run is written.

    Parameters
    ----------
    scenes, accel, pixels, camera, light, order, batch, kd, bvh, bvh_nodes
        As those of ``render``.
    size, ways, line, policy, layout
        As those of ``replay``; lru alone can be estimated.
    is_table1 : bool
        Take the four caches of Table I.
    target_error : str
        Half-width allowed for every miss rate: relative (``"2%"``), in percentage points (``"0.05pp"``), or the wider of both.
    exact_below : int
        Runs of up to so many predicted accesses are counted exactly.
    resume : Path, optional
        Keep the counts of one run in this file, and continue from it if it exists.
    seed : int
        Of the sample, and of the random order.

    Returns
    -------
    Results
        One row per run, with its caches in ``cells``.
    """
    from cachesim.report import estimate_tables
    from nptrace.estimates import Sampling, estimate_scenes
    from nptrace.scene_options import Picture, Trees, load_scenes, parse_tree

    configs, _, layouts = estimate_plan(size, ways, line, policy, layout, is_table1=is_table1)
    cameras = [camera] if isinstance(camera, str) else list(camera or ())
    trees = Trees(listed("accel", accel, parse_tree), kd, bvh, tuple(listed("bvh_nodes", bvh_nodes, str)))
    sampling = Sampling(target_error, exact_below, threads, None if resume is None else Path(resume))
    if not scenes:
        raise NptraceError("no scene is given; name a mesh file or a scene, e.g. estimate('sponza')")
    named = [str(each) if isinstance(each, Path) else each for each in scenes]
    seen = load_scenes(named, strict, offline, cameras, light)
    found = [result for *_, result in estimate_scenes(
        seen, trees, configs, Picture(pixels, order, batch, seed), sampling, layouts
    )]  # fmt: skip
    return Results("estimate", estimate_tables.records(found, "json"), lambda: estimate_tables.tables(found))


def table1(
    sources: Sources = (), /, *, traces: Place | str = "traces", preset: str | None = None, policy: str = "lru",
    layout: str = "stored", n: str = "paper", hit: int = 1, miss: int = 100, workers: "int | Executor" = 0,
    scheduler: str | None = None, threads: int | None = None,
) -> Results:  # fmt: skip
    """Return Table I of the paper beside ours from existing runs, as ``npcache table1`` does.

    Parameters
    ----------
    preset : str, optional
        ``"paper2013"``: a model that the study found, in place of runs; ``n``, ``hit``, ``miss`` and ``threads`` go with it.
    n : str
        Accesses per ray in the ACPR: ``"paper"``, ``"measured"``, or the kd-tree's and the BVH's, ``"15.77,27"``.
    hit, miss : int
        Cycles of a hit and of a miss, in the ACPR and in time; from 1.
    workers, scheduler
        Those of ``replay``; each worker takes whole runs.
    """
    from cachesim.report import table1 as table
    from cachesim.report import table1_tables
    from nptrace.studies import preset_rows, table1_notes, table1_rows, table1_runs
    from nptrace.table1_study.presets import PRESETS, note

    for name, cycles in (("hit", hit), ("miss", miss)):
        if not (type(cycles) is int and cycles >= 1):
            raise NptraceError(f"{name}: {cycles!r} is no number of cycles; write a whole number from 1")
    equation = table.Equation(hit, miss, table.parse_n(n))
    if preset is not None:
        if preset not in PRESETS:
            raise NptraceError(f"preset: {preset!r} is none of {', '.join(PRESETS)}")
        if _given(sources) or traces != "traces" or workers or scheduler or (policy, layout) != ("lru", "stored"):
            raise NptraceError("preset: it has its own pictures, caches and layouts; give n, hit, miss and threads alone")
        with Progress() as bar:
            rows = preset_rows(preset, bar, equation=equation, threads=threads)
        return Results(
            "table1", table.to_dicts(rows), lambda: (table1_tables.tables(rows), [*table1_tables.notes(rows), note(preset)])
        )
    runs = [each if isinstance(each, Run) else open_run(each) for each in _chosen(sources, traces)]
    with engine_of(workers, scheduler) as engine, Progress() as bar:
        rows = table1_rows(
            table1_runs(runs, traces), bar, policy=policy, layout=layout, equation=equation, threads=threads, engine=engine
        )  # fmt: skip
    return Results("table1", table.to_dicts(rows), lambda: (table1_tables.tables(rows), table1_notes(rows)))


def _given(sources: Any) -> list[Any]:
    """Return sources as a list, also a single one."""
    return [sources] if isinstance(sources, (str, Path, Remote, Run)) else list(sources)


def _chosen(sources: Any, folder: Place | str) -> list[Where]:
    """Return what to read: runs as they are, and the runs and traces at the places named, or those in the folder."""
    from nptrace.sources import chosen_sources

    given = _given(sources)
    if not given:
        return [*chosen_sources([], place(folder))]
    chosen: list[Where] = []
    for each in given:
        chosen += [each] if isinstance(each, Run) else chosen_sources([place(each)], place(folder))
    return chosen
