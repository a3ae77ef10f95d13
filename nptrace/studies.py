"""The work of npcache's commands: runs and parsed options in, results out. Commands, functions of ``import nptrace`` and the
studies of ``nptrace run`` share it, so that all three count the same.

``bar`` is the line of progress; one that was not entered prints nothing.
"""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nptrace.progress import Progress, detail, say
from nptrace_base.errors import NptraceError
from nptrace_base.places import Place
from traces.reader import Run

if TYPE_CHECKING:
    from cachesim.by_group import GroupedResult
    from cachesim.clock.compare import Compared
    from cachesim.clock.parameters import Clock
    from cachesim.clock.timing import Timing
    from cachesim.config import CacheConfig
    from cachesim.layout import Layout
    from cachesim.report.table1 import Equation, Table1Row
    from cachesim.result import Result
    from cachesim.source import Source
    from cachesim.sweep import SweepRow
    from nptrace_base.engines import Engine
    from rtrace.ray_file import RayFile
    from rtrace.render import RunFacts, Shooting
    from rtrace.scenes.scene import Scene

#: What is replayed: a run, or the place of a run or a trace.
Where = Run | Place | str


def rendered(
    scenes: "Sequence[Scene]", params: Mapping[str, Mapping[str, Any]], shooting: "Shooting | RayFile", out: Place,
    bar: Progress, *, names: Sequence[str] = (), overwrite: bool = False, threads: int | None = None,
    engine: "Engine | None" = None,
) -> "list[RunFacts]":  # fmt: skip
    """Trace every scene with every tree and write the runs: by the engine's workers, or in this process."""
    from functools import partial

    from nptrace import __version__
    from rtrace.part_render import render_parts
    from rtrace.ray_file import RayFile
    from rtrace.render import render, render_all
    from rtrace.scenes import float32_check
    from rtrace.trees.strays import margin_note

    if isinstance(shooting, RayFile):
        say(f"{shooting.source}: {shooting.n_rays:,} rays and no picture, so image.png is one grey pixel")
    for scene in scenes:
        if scene.precision is not None:
            detail(f"{scene.label}: {float32_check.choice(scene.precision)}")
        if note := margin_note(scene.triangles, scene.bounds, scene.camera.eye):
            say(f"{scene.label}: {note}")

    def on_phase(run: str, phase: str, total: int | None) -> Callable[[int], object]:
        if phase == "build":
            bar.job(run)
        return bar.phase(phase, total)

    return list(render_all(
        scenes, params, shooting, out, names=names, overwrite=overwrite, threads=threads or os.cpu_count() or 1,
        tool_version=__version__, on_phase=on_phase,
        render_one=render if engine is None and isinstance(out, Path) else partial(render_parts, engine=engine),
    ))  # fmt: skip


# Many parameters: what is counted (to bar) and how (by name), which commands, functions and studies choose one by one.
def replayed(
    sources: Sequence[Where], configs: "Sequence[CacheConfig]", prefetches: Sequence[str], layouts: Sequence[str],
    bar: Progress, *, reads: str = "own", flush: str = "never", three_c: bool = False, threads: int | None = None,
    engine: "Engine | None" = None,
) -> "list[Result]":  # fmt: skip
    """Replay every source under every layout and prefetch policy through every cache, the caches fastest."""
    from cachesim.flush import FlushedSource, emptied
    from cachesim.prefetch import parse_prefetch
    from cachesim.reads import reads_of
    from cachesim.replay import replay

    policies = [parse_prefetch(text) for text in prefetches]
    results: list[Result] = []
    for opened in _opened(sources, layouts):
        opened.check_passes(len(policies))
        source: Source = reads_of(opened, reads, configs[0].line_bytes, flush)
        if flush == "ray":
            source = FlushedSource(source, configs)
        for policy in policies:
            bar.job(source.identity.run)
            advance = bar.phase(f"replay, prefetch {policy}", source.n_events)
            found = replay(
                source, configs, prefetch=policy, three_c=three_c, threads=threads, engine=engine, progress=advance
            )  # fmt: skip
            for result in found:
                result.reads, result.flush = reads, flush
            results += emptied(found) if flush == "ray" else found
    return results


def check_whole(by: str | None, reads: str, flush: str, *, has_workers: bool = False) -> None:
    """Raise NptraceError for options that only the replay of a whole trace knows, or one by one counter."""

    if by is not None and (reads, flush) != ("own", "never"):
        raise NptraceError(f"reads {reads} and flush {flush} are for the counts of whole caches, not by {by}; leave by out")
    if has_workers and by is not None:
        raise NptraceError(f"by: counts by {by} are not made by workers; leave by or workers out")
    if has_workers and (reads, flush) != ("own", "never"):
        raise NptraceError(f"reads {reads} and flush {flush} are for one process; leave them or workers out")


def summarised(
    run: Run, configs: "Sequence[CacheConfig]", prefetches: Sequence[str], layouts: Sequence[str], part: tuple[int, int],
    out: Path, bar: Progress, *, three_c: bool = False, threads: int | None = None,
) -> tuple[int, int]:  # fmt: skip
    """Replay part i of n of a run as ``replayed`` does, and write its summary; return its accesses and the file's bytes."""
    from cachesim.parts import Part, pass_through
    from cachesim.replay import Replay
    from cachesim.source import RunSource
    from cachesim.summary import reason_against
    from cachesim.summary_file import Asked, write_part

    asked, summaries, source = [], [], None
    for layout in parsed(layouts):
        whole = RunSource(run, layout)
        source = Part(whole, *part, {})
        for prefetch in prefetches:
            question = Replay(tuple(configs), prefetch, three_c)
            if reason := reason_against(question.configs, question.policy):
                raise NptraceError(f"parts of a run cannot be replayed apart: {reason}; use npcache replay for the whole run")
            bar.job(f"part {part[0]} of {part[1]}")
            advance = bar.phase(f"replay, prefetch {prefetch}", source.n_events)
            asked.append(Asked(str(layout), question))
            summaries.append(pass_through(source, question, threads or os.cpu_count() or 1, advance))
    assert source is not None
    return source.run.n_accesses, write_part(out, source.run, asked, summaries)


def replayed_by(
    sources: Sequence[Where], configs: "Sequence[CacheConfig]", prefetches: Sequence[str], layouts: Sequence[str], by: str,
    bar: Progress, *, three_c: bool = False, threads: int | None = None,
) -> "list[GroupedResult]":  # fmt: skip
    """Replay as ``replayed`` does, and keep the counts by pixel, level, node or type of ray."""
    from cachesim.by_group import replay_by, run_source
    from cachesim.prefetch import parse_prefetch
    from cachesim.source import as_source

    policies = [parse_prefetch(text) for text in prefetches]
    results: list[GroupedResult] = []
    for where in sources:
        for layout in parsed(layouts):
            source = run_source(as_source(where, layout), layout, by)
            for policy in policies:
                bar.job(source.identity.run)
                advance = bar.phase(f"replay, prefetch {policy}", source.n_events)
                results += replay_by(
                    source, configs, by, prefetch=policy, three_c=three_c, threads=threads, progress=advance
                )  # fmt: skip
    return results


def swept(
    sources: Sequence[Where], configs: "Sequence[CacheConfig]", prefetches: Sequence[str], layouts: Sequence[str],
    bar: Progress, *, threads: int | None = None, engine: "Engine | None" = None,
) -> "list[SweepRow]":  # fmt: skip
    """Count the misses of every LRU cache, in the order of ``replayed``."""
    from cachesim.sweep import sweep

    rows: list[SweepRow] = []
    for source in _opened(sources, layouts):
        source.check_passes(len(prefetches))
        for policy in prefetches:
            bar.job(source.identity.run)
            advance = bar.phase(f"sweep, prefetch {policy}", source.n_events)
            rows += sweep(source, configs, prefetch=policy, threads=threads, engine=engine, progress=advance)
    return rows


def timed(
    sources: Sequence[Where], configs: "Sequence[CacheConfig]", clocks: "Sequence[Clock]", prefetches: Sequence[str],
    layouts: Sequence[str], bar: Progress, *, by: str = "nothing", threads: int | None = None,
) -> "list[Timing]":  # fmt: skip
    """Count the cycles of every run under every layout, with every cache, machine and policy."""
    from cachesim.clock.timing import time_run, timed_policy

    # By name: traced requests and those of the paper's unit are the same on the clock.
    policies = list({str(each): each for each in map(timed_policy, prefetches)}.values())
    results: list[Timing] = []
    for source in _opened(sources, layouts):
        bar.job(source.identity.run)
        advance = bar.phase("time", source.n_events)
        results += time_run(source, configs, clocks, policies, by=by, threads=threads, progress=advance)
    return results


def compared(
    sources: Sequence[Where], config: "CacheConfig", clock: "Clock", prefetches: Sequence[str], layout: str, bar: Progress,
    *, baselines: bool = True, threads: int | None = None, engine: "Engine | None" = None,
) -> "list[Compared]":  # fmt: skip
    """Compare the policies (``all``: the usual ones) on one cache and machine, run by run."""
    from cachesim.clock.compare import compare, usual_policies
    from cachesim.clock.timing import timed_policy
    from nptrace.run_tasks import compare_run, run_by_run
    from traces.reader import open_run

    asked = [name for text in prefetches for name in (usual_policies() if text == "all" else [text])]
    names = list(dict.fromkeys(str(timed_policy(name)) for name in asked))
    if engine is not None:
        bar.job("all runs")
        arguments = [(config, clock, names, layout, baselines)] * len(sources)
        return run_by_run(engine, compare_run, sources, arguments, bar.phase("compare", len(sources)))
    rows: list[Compared] = []
    for source in sources:
        run = source if isinstance(source, Run) else open_run(source)
        bar.job(run.name)
        rows += compare(
            run, config, clock, layout=layout, prefetches=names, has_baselines=baselines, threads=threads,
            progress=bar.phase("compare"),
        )  # fmt: skip
    return rows


def table1_rows(
    chosen: dict[tuple[str, str], Run], bar: Progress, *, policy: str = "lru", layout: str = "stored",
    equation: "Equation | None" = None, threads: int | None = None, engine: "Engine | None" = None,
) -> "list[Table1Row]":  # fmt: skip
    """Return Table I for the runs that ``table1.choose_runs`` found."""
    from cachesim.report.table1 import in_order, table1
    from nptrace.run_tasks import run_by_run, table1_of_run

    bar.job("Table I")
    if engine is not None:
        keys = in_order(chosen)
        advance = bar.phase("replay and time", len(keys))
        arguments = [(key, policy, layout, equation) for key in keys]
        return run_by_run(engine, table1_of_run, [chosen[key] for key in keys], arguments, advance)
    advance = bar.phase("replay and time", 2 * sum(run.n_accesses for run in chosen.values()))
    return table1(chosen, policy=policy, layout=layout, equation=equation, threads=threads, progress=advance)


def table1_notes(rows: "Sequence[Table1Row]") -> list[str]:
    """Return the notes below Table I of runs; one names every run that is not as usual."""
    from cachesim.report import table1_tables
    from rtrace.run_names import unusual
    from traces.identity import labels

    names = labels(row.identity for row in rows)
    views: dict[str, set[tuple[str | None, str | None]]] = {}
    for each in names:
        views.setdefault(str(each.scene).lower(), set()).add((each.camera, each.light))
    found = []
    for each, name in names.items():
        facts = unusual(each)
        if len(views[str(each.scene).lower()]) > 1 and not {"another camera", "another light"} & set(facts):
            facts.append("a view that another row of the scene does not have")
        if facts:
            found.append(f"{name}: {', '.join(facts)}")
    note = "Runs that are not as usual, each scene's own view with every default, and do not belong into one table with such: "
    return table1_tables.notes(rows, [f"{note}{'; '.join(found)}."] if found else [])


def preset_rows(name: str, bar: Progress, *, equation: "Equation", threads: int | None = None) -> "list[Table1Row]":
    """Return Table I under a model of ``table1_study.presets``: scenes are traced at their own views; no run is written."""
    from cachesim.report.table1 import SCENES, row_of
    from nptrace.table1_study.cameras import views
    from nptrace.table1_study.measure import measured
    from nptrace.table1_study.presets import PRESETS
    from nptrace.table1_study.traced import traced

    bar.job(name)
    advance = bar.phase("trace and replay", len(PRESETS[name]) * len(SCENES))
    rows = []
    for tree, setting in PRESETS[name].items():
        for scene in SCENES:
            run = traced(views(scene, only_own=True)[0].seen, tree, setting, threads or os.cpu_count() or 1)
            for _, _, results in measured(run, [setting]):
                rows += [row_of(tree, scene, result, equation) for result in results]
            advance(1)
    return rows


def table1_runs(runs: Sequence[Run], where: Any) -> dict[tuple[str, str], Run]:
    """Return the runs of Table I's scenes; NptraceError if there is none.

    ``where`` is the folder in which they were looked for, None if they were named.
    """
    from cachesim.report import table1 as table

    chosen = table.choose_runs(runs)
    if not chosen:
        of = "that is named" if where is None else f"in {where}"
        raise NptraceError(f"no run {of} is of a scene of Table I ({', '.join(table.SCENES)}); render one by its name")
    return chosen


def _opened(sources: Sequence[Where], layouts: Sequence[str]) -> "Iterator[Source]":
    """Open every source under every layout, one after another."""
    from cachesim.source import as_source

    for source in sources:
        for layout in parsed(layouts):
            yield as_source(source, layout)


def parsed(layouts: Sequence[str]) -> "list[Layout]":
    """Return the layouts of these names."""
    from cachesim.layout import parse_layout

    return [parse_layout(text) for text in layouts]
