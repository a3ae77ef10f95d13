"""The functions of ``import nptrace`` that read runs: options as a command takes them, texts, numbers or lists -> results.

Each has the options and defaults of the command of its name (``three_c`` is ``--3c``), and does the same work
(``nptrace.studies``). A wrong value raises NptraceError with the sentence that the command prints. Notes go to stderr.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from nptrace.plans import Given, MachineOptions, listed, machines_plan, replay_plan, sweep_plan, time_plan
from nptrace.progress import Progress
from nptrace.results import Results
from nptrace.studies import Where
from nptrace.values import checked, text, whole
from nptrace_base.engines import engine_of
from nptrace_base.errors import NptraceError
from nptrace_base.places import Place, Remote, place
from traces.reader import Run, open_run

if TYPE_CHECKING:
    from concurrent.futures import Executor

#: Runs, and places of runs, folders of runs or traces.
Sources = Where | Iterable[Where]


@checked()
def open(path: Place | str) -> Run:
    """Open a run.

    Parameters
    ----------
    path : Path or str
        Its folder, or its address such as s3://bucket/run.

    Returns
    -------
    Run

    Raises
    ------
    NptraceError
        There is no run, or it is damaged.
    """
    return open_run(path)


@checked()
# Many parameters: one per option of the command, as callers write them and help() lists them.
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
    traces : Path
        That folder, or its address in an object store.
    size, line : str, int or list
        In bytes: ``8192``, ``"8K,16K"``, ``"4K..64K"`` (the powers of two from one to the other).
    ways : str, int or list
        ``2``, ``"1,2,full"``, ``"1..16"``.
    policy : str or list
        Replacement: ``"lru"``, ``"fifo"``, ``"random"``, ``"opt"``.
    seed : int
        Seed of random replacement, from 0 to 2^63 - 1.
    prefetch, layout : str or list
        Prefetch policies, and layouts of the nodes in memory, as the command's help lists them.
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

    Returns
    -------
    Results
        A row per run, layout, policy and cache: counts, rates as fractions, sizes in bytes.

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


@checked()
# Many parameters: one per option of the command, as callers write them and help() lists them.
def sweep(
    sources: Sources = (), /, *, traces: Place | str = "traces", size: Given = "4K..64K", ways: Given = "1",
    line: Given = "32", prefetch: Given = "traced", layout: Given = "stored", threads: int | None = None,
    workers: "int | Executor" = 0, scheduler: str | None = None,
) -> Results:  # fmt: skip
    """Count the misses of every LRU cache in ranges, in one pass over each trace, as ``npcache sweep`` does.

    A cache is in the sweep if its size lies in a range and its number of sets is a power of two.

    Parameters
    ----------
    size : str, int or list
        Ranges of sizes in bytes, ``"4K..64K"``, or single ones.
    sources, traces, ways, line, prefetch, layout, threads, workers, scheduler
        As those of ``replay``.

    Returns
    -------
    Results
        A row per run, layout, policy and cache: counts, rates as fractions, sizes in bytes.

    Raises
    ------
    NptraceError
        A value is wrong, no cache is in the ranges, or a source cannot be read.
    """
    from cachesim.report import sweep_output
    from nptrace.studies import swept

    configs, policies, layouts = sweep_plan(size, ways, line, prefetch, layout)
    chosen = _chosen(sources, traces)
    with engine_of(workers, scheduler) as engine, Progress(len(chosen) * len(layouts) * len(policies)) as bar:
        rows = swept(chosen, configs, policies, layouts, bar, threads=threads, engine=engine)
    return Results("sweep", [row.to_dict() for row in rows], lambda: sweep_output.tables(rows))


@checked()
# Many parameters: one per option of the command, as callers write them and help() lists them.
def time(
    sources: Sources = (), /, *, traces: Place | str = "traces", machine: str = "paper", size: Given = (), ways: Given = (),
    line: Given = (), policy: Given = "lru", seed: int = 0, prefetch: Given = "stack", layout: Given = "stored",
    by: str | None = None, threads: int | None = None, **numbers: Unpack[MachineOptions],
) -> Results:  # fmt: skip
    """Count the cycles of runs, with and without prefetching, as ``npcache time`` does.

    Parameters
    ----------
    machine : str
        Where the cache and the ``numbers`` come from that are not given, as the command's help lists them.
    size, ways, line : str, int or list
        As those of ``replay``; by default the machine's.
    sources, traces, policy, seed, prefetch, layout, threads
        As those of ``replay``; opt needs the future, which a clock does not know.
    by : str, optional
        ``"level"``, ``"ray-type"``, ``"slot"`` or ``"leaf"``: return reads and requests by tree level, ray type, place on the
        stack or leaf size instead.
    numbers : int or list
        Of the machine: ``hit``, ``miss`` and ``every`` in cycles, ``box`` and ``triangle`` in cycles of a test, ``bandwidth``
        in bytes per cycle, and how many ``rays``, ``ports``, ``mshrs`` and ``units`` there are (``npcache time --help``).

    Returns
    -------
    Results
        A row per run, layout, cache, machine and policy: cycles, where they went, and what became of the requests.

    Raises
    ------
    NptraceError
        A value is wrong, a machine has no such number, or a run cannot be read or timed.
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


@checked(layout=text("veb"))
# Many parameters: one per option of the command, as callers write them and help() lists them.
def compare(
    sources: Sources = (), /, *, traces: Place | str = "traces", machine: str = "paper", size: Given = (), ways: Given = (),
    line: Given = (), policy: Given = "lru", seed: int = 0, prefetch: Given = "all", layout: str = "stored",
    baselines: bool = True, workers: "int | Executor" = 0, scheduler: str | None = None, threads: int | None = None,
    **numbers: Unpack[MachineOptions],
) -> Results:  # fmt: skip
    """Compare prefetch policies on one cache and machine, with what needs no unit, as ``npcache compare`` does.

    Parameters
    ----------
    prefetch : str or list
        Policies; ``"all"`` for the usual ones.
    layout : str
        A single one.
    baselines : bool
        Compare line sizes, alignments and node orders too.
    sources, traces, machine, size, ways, line, policy, seed, threads, numbers
        As those of ``time``, for one cache and one machine.
    workers, scheduler
        As those of ``replay``; each worker takes whole runs.

    Returns
    -------
    Results
        A row per run and policy, and per baseline: cycles, speed-ups, bytes from memory.

    Raises
    ------
    NptraceError
        A value is wrong, several caches or machines are asked for, or a run cannot be read or timed.
    """
    from cachesim.report import compare_tables
    from nptrace.clock_options import one_machine
    from nptrace.sources import policy_of
    from nptrace.studies import compared

    config, clock = one_machine(machines_plan(machine, size, ways, line, policy, seed, numbers))
    policies = listed("prefetch", prefetch, policy_of(is_clocked=True, also=["all"]))
    chosen = _chosen(sources, traces)
    with engine_of(workers, scheduler) as engine, Progress(1 if engine else len(chosen)) as bar:
        rows = compared(
            chosen, config, clock, policies, layout, bar, baselines=baselines, threads=threads, engine=engine
        )  # fmt: skip
    return Results("compare", [row.to_dict() for row in rows], lambda: compare_tables.tables(rows))


@checked(policy=text("fifo"), layout=text("veb"), hit=whole(1, 1), miss=whole(1, 100))
# Many parameters: one per option of the command, as callers write them and help() lists them.
def table1(
    sources: Sources = (), /, *, traces: Place | str = "traces", preset: str | None = None, policy: str = "lru",
    layout: str = "stored", n: str = "paper", hit: int = 1, miss: int = 100, workers: "int | Executor" = 0,
    scheduler: str | None = None, threads: int | None = None,
) -> Results:  # fmt: skip
    """Return Table I of the paper beside ours from existing runs, as ``npcache table1`` does.

    Parameters
    ----------
    sources, traces, threads
        As those of ``replay``.
    preset : str, optional
        ``"paper2013"``: a model that the study found, in place of runs; ``n``, ``hit``, ``miss`` and ``threads`` go with it.
    policy, layout : str
        A single replacement, ``"lru"``, ``"fifo"`` or ``"random"``, and a single layout of the nodes.
    n : str
        Accesses per ray in the ACPR: ``"paper"``, ``"measured"``, or the kd-tree's and the BVH's, ``"15.77,27"``.
    hit, miss : int
        Cycles of a hit and of a miss, in the ACPR and in time; from 1.
    workers, scheduler
        As those of ``replay``; each worker takes whole runs.

    Returns
    -------
    Results
        A row per tree, scene and cache: ours, the paper's, rates as fractions, sizes in bytes.

    Raises
    ------
    NptraceError
        A value is wrong, no run is of a scene of Table I, or a run cannot be read.
    """
    from cachesim.report import table1 as table
    from cachesim.report import table1_tables
    from nptrace.studies import preset_rows, table1_notes, table1_rows, table1_runs
    from nptrace.table1_study.presets import PRESETS, note

    equation = table.Equation(hit, miss, table.parse_n(n))
    if preset is not None:
        if preset not in PRESETS:
            raise NptraceError(f"preset: {preset!r} is not one of {', '.join(PRESETS)}")
        if _given(sources) or traces != "traces" or workers or scheduler or (policy, layout) != ("lru", "stored"):
            raise NptraceError("preset: it has its own pictures, caches and layouts; give n, hit, miss and threads alone")
        with Progress() as bar:
            rows = preset_rows(preset, bar, equation=equation, threads=threads)
        return Results(
            "table1", table.to_dicts(rows), lambda: (table1_tables.tables(rows), [*table1_tables.notes(rows), note(preset)])
        )
    runs = [each if isinstance(each, Run) else open_run(each) for each in _chosen(sources, traces)]
    chosen = table1_runs(runs, None if _given(sources) else traces)
    with engine_of(workers, scheduler) as engine, Progress() as bar:
        rows = table1_rows(
            chosen, bar, policy=policy, layout=layout, equation=equation, threads=threads, engine=engine
        )  # fmt: skip
    return Results("table1", table.to_dicts(rows), lambda: (table1_tables.tables(rows), table1_notes(rows)))


def _given(sources: Any) -> list[Any]:
    """Return sources as a list, also a single one."""
    return [sources] if isinstance(sources, (str, Path, Remote, Run)) else list(sources)


def _chosen(sources: Any, folder: Place | str) -> list[Where]:
    """Return what to read: runs as they are, and the runs and traces at the places named, or those in the folder."""
    from nptrace.sources import chosen_sources, each_once

    given = _given(sources)
    if not given:
        return [*chosen_sources([], place(folder))]
    chosen: list[Where] = []
    for each in given:
        chosen += [each] if isinstance(each, Run) else chosen_sources([place(each)], place(folder))
    return each_once(chosen)
