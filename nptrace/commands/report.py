"""npcache report: one page about one run or several, which needs no network."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from nptrace.clock_options import Machines, machine_options, machine_sources
from nptrace.commands.info import command_of
from nptrace.commands.view import picture_of
from nptrace.groups import BadInput, Command
from nptrace.options import threads_option
from nptrace.output import output_option, write_out
from nptrace.progress import Progress, done, say, size_text
from nptrace.sources import LAYOUT_HELP, PlaceOf, chosen_sources, one_prefetch_option, traces_option, untimed_policies
from nptrace_base.errors import NptraceError
from nptrace_base.places import Place
from nptrace_base.shell import word

if TYPE_CHECKING:
    from cachesim.clock.parameters import Clock
    from cachesim.config import CacheConfig
    from cachesim.report.page import Heat, Report
    from cachesim.report.table1 import Table1Row
    from traces.reader import Run

#: The caches of the curves, as npcache sweep takes them, and the kinds of heat maps.
SIZES, WAYS, HEAT = "4K..64K", "1,2,4,8", ("accesses", "misses")


@click.command(
    cls=Command, lists={"Prefetch policies": untimed_policies, "Machines and where their numbers come from": machine_sources}
)
@click.argument("sources", metavar="[RUN]...", nargs=-1, type=PlaceOf())
@traces_option()
@machine_options("One machine; the first cache is that of the maps, the levels and the clock.")
@one_prefetch_option()
@click.option("--layout", default="stored", show_default=True, metavar="LAYOUT", help=LAYOUT_HELP)
@threads_option()
@output_option("-o", "--output", "path", help="The page, which is required: .html; - is stdout.")
def report(
    sources: tuple[Place, ...], folder: Place, machines: Machines, prefetch: str, layout: str, threads: int, path: Path | None,
) -> None:  # fmt: skip
    """Write one page about runs, for any browser and without a network: pictures, heat maps, tables, curves, what was run.

    The replay goes through every cache of the options, the heat maps, the levels and the clock through the first.

    \b
    npcache report -o report.html
    npcache report traces/bunny-kdtree traces/bunny-bvh --size 8K,16K --assoc 1,2 -o bunny.html
    """
    from cachesim.report.page import check_page
    from traces.reader import open_run

    began = time.perf_counter()
    if path is None:
        raise BadInput("name the page with -o, for instance -o report.html")
    check_page(path)
    check(machines, prefetch, layout)
    runs = [open_run(each) for each in chosen_sources(sources, folder)]
    n_bytes = write_page(PageRuns(runs, machines.configs, machines.clocks[0], prefetch, layout, threads), path)
    done(f"{path}: {len(runs)} run{'s' * (len(runs) != 1)}, {size_text(n_bytes)}", began)


def write_page(case: "PageRuns", path: Path) -> int:
    """Write the page, and return its bytes."""
    from cachesim.report.page import page

    with Progress(5 * len(case.runs) + 1) as bar:
        made = gathered(case, bar)
        bar.job(str(path))
        bar.phase("write")
        text = page(made)
        write_out(text, path)
    return len(text.encode(errors="replace"))


def check(machines: Machines, prefetch: str, layout: str) -> None:
    """Refuse before the work what one of its parts cannot do."""
    from cachesim.clock.timing import check as check_clocks
    from cachesim.prefetch import parse_prefetch
    from cachesim.stack_distance import check_one_pass
    from nptrace.studies import parsed

    if len(machines.clocks) > 1:
        raise NptraceError(f"a report takes one machine, and the options ask for {len(machines.clocks)}; leave the others out")
    parsed([layout])
    check_one_pass(parse_prefetch(prefetch))
    check_clocks(machines.configs[:1], machines.clocks, machines.clocks[0].rays)


@dataclass(frozen=True)
class PageRuns:
    """The runs of a page, and what they go through; the first cache is that of the maps, the levels and the clock."""

    runs: Sequence["Run"]
    configs: Sequence["CacheConfig"]
    clock: "Clock"
    prefetch: str
    layout: str
    threads: int | None

    @property
    def single(self) -> "list[Run]":
        """The runs that a clock can time: those whose rays walk alone."""
        return [run for run in self.runs if run.footer.packet == 1]

    @property
    def commands(self) -> dict[str, str]:
        """The commands that print the results, by their name on the page."""
        first, lines = self.configs[0], ",".join(str(line) for line in dict.fromkeys(c.line_bytes for c in self.configs))
        runs = " ".join(word(run.path) for run in self.runs)
        single = " ".join(word(run.path) for run in self.single)
        same = f" --prefetch {self.prefetch} --layout {self.layout}"
        machine, *numbers = self.clock.name.split(", ")
        given = "".join(f" --{number.replace('=', ' ')}" for number in numbers)
        return {
            "replay": f"npcache replay {runs}{_cache_options(self.configs)}{same}",
            "sweep": f"npcache sweep {runs} --size {SIZES} --ways {WAYS} --line {lines}{same}",
            "levels": f"npcache replay {runs} --by level{_cache_options([first])}{same}",
            "compare": f"npcache compare {single} --machine {machine}{given}{_cache_options([first])} --layout {self.layout} "
            "--no-baselines",
            "table1": f"npcache table1 {runs} --layout {self.layout}",
            "distances": f"npcache plot {runs} --kind distances --line {first.line_bytes}{same} -o distances.png",
            "report": f"npcache report {runs} --machine {machine}{given}{_cache_options(self.configs)}{same} -o report.html",
        }


def _cache_options(configs: "Sequence[CacheConfig]") -> str:
    """Return the options that name caches, which are every combination of them."""
    from cachesim.config import format_bytes

    found = []
    for option, values in (
        ("size", [format_bytes(each.size_bytes) for each in configs]), ("ways", [_ways(each) for each in configs]),
        ("line", [each.line_bytes for each in configs]), ("policy", [each.policy for each in configs]),
    ):  # fmt: skip
        found.append(f" --{option} {','.join(dict.fromkeys(map(str, values)))}")
    seeds = {each.seed for each in configs} - {0}
    return "".join(found) + "".join(f" --seed {seed}" for seed in seeds)


def _ways(config: "CacheConfig") -> str:
    return "full" if config.n_sets == 1 and config.ways > 1 else str(config.ways)


def gathered(case: PageRuns, bar: Progress) -> "Report":
    """Count all that a page shows, phase by phase."""
    from cachesim.by_group import GroupedRecords
    from cachesim.grid import grid, parse_range
    from cachesim.report import compare_tables, replay_tables, table1, table1_tables
    from cachesim.report.page import Report
    from nptrace import __version__, studies

    runs, configs, threads = case.runs, case.configs, case.threads
    policies, layouts = [case.prefetch], [case.layout]
    lines = list(dict.fromkeys(each.line_bytes for each in configs))
    swept_caches = grid([parse_range(SIZES)], WAYS.split(","), lines)
    replayed = studies.replayed(runs, configs, policies, layouts, bar, threads=threads)
    swept = studies.swept(runs, swept_caches, policies, layouts, bar, threads=threads)
    levels = studies.replayed_by(runs, configs[:1], policies, layouts, "level", bar, threads=threads)
    compared = studies.compared(
        case.single, configs[0], case.clock, ["all"], case.layout, bar, baselines=False, threads=threads
    )
    paper = _table1(case, bar)
    results: dict[str, Any] = {
        "replay": [each.to_dict() for each in replayed], "sweep": [each.to_dict() for each in swept],
        "levels": list(GroupedRecords(levels)), "compare": [each.to_dict() for each in compared],
        "table1": table1.to_dicts(paper),
    }  # fmt: skip
    of_clock = compare_tables.tables(compared)[1]
    packets = [run.identity for run in runs if run not in case.single]
    untimed = [table1_tables.untimed_note(packets)] if packets else []
    verdicts = [*replay_tables.verdict(replayed), *(table1_tables.verdict(paper) if paper else []),
                *(text for text in of_clock if text not in compare_tables.NOTES)]  # fmt: skip
    notes = {
        "replay": [note for note in replay_tables.tables(replayed)[1] if note not in verdicts], "sweep": replay_tables.RATES,
        "levels": (), "compare": [*compare_tables.NOTES, *untimed],
        "table1": [note for note in studies.table1_notes(paper) if note not in verdicts] if paper else (),
    }  # fmt: skip
    heat, distances = _by_run(case, bar)
    return Report(
        [run.identity for run in runs], [_facts(run) for run in runs], [picture_of(run) for run in runs], results, notes,
        case.commands, verdicts, f"{configs[0]}, prefetch {case.prefetch}, layout {case.layout}", case.commands["report"],
        __version__, heat, distances,
    )  # fmt: skip


def _table1(case: PageRuns, bar: Progress) -> "list[Table1Row]":
    """Return the rows of Table I for the runs of its scenes; none if no run is of them, or several could be meant."""
    from cachesim.report.table1 import choose_runs
    from nptrace.studies import table1_rows

    try:
        chosen = choose_runs(case.runs)
    except NptraceError as e:
        say(f"the page has no Table I: {e}")
        return []
    return table1_rows(chosen, bar, layout=case.layout, threads=case.threads) if chosen else []


def _by_run(case: PageRuns, bar: Progress) -> "tuple[list[Heat], list[Any]]":
    """Return the heat maps of all runs, a scale for each kind, and their stack distances."""
    from cachesim.heat import KINDS, HeatMaps, HeatSetting
    from cachesim.prefetch import parse_prefetch
    from cachesim.report.distances import distances_of
    from cachesim.report.heat_figure import scale_of
    from cachesim.report.page import Heat
    from cachesim.source import RunSource

    setting = HeatSetting(case.configs[0], case.clock, parse_prefetch(case.prefetch))
    maps: dict[str, list[Any]] = {kind: [] for kind in HEAT}
    distances = []
    for run in case.runs:
        bar.job(run.name)
        source = RunSource(run, case.layout)
        of_run = HeatMaps(source, setting, threads=case.threads)
        for kind in HEAT:  # the reads of a packet are of no single pixel
            has_pixels = run.footer.packet == 1
            progress = bar.phase(f"heat map, {kind}", run.n_accesses)
            maps[kind].append(of_run.values(kind, progress) if has_pixels else None)
        bar.phase("stack distances")
        distances.append(distances_of(source, case.configs[0].line_bytes, case.prefetch))
    heat = []
    for kind, found in maps.items():
        label = ", ".join(filter(None, [f"{KINDS[kind][0]} per pixel", setting.text(kind)]))
        if shown := [each for each in found if each is not None]:
            heat.append(Heat(kind, scale_of(label, shown), found))
    return heat, distances


def _facts(run: "Run") -> dict[str, str]:
    """Return what a run holds, and how to make it again."""
    of, footer = run.identity, run.footer
    return {
        "scene": f"{of.scene}{' (stand-in)' if of.stand_in else ''}, {footer.scene.n_triangles:,} triangles",
        "tree": f"{of.tree}, {of.builder}; {footer.n_nodes:,} nodes of {footer.tree.node_bytes} bytes",
        "picture": ", ".join([f"{of.pixels} pixels, order {of.order}, batch {of.batch}", *of.knobs]), "camera": str(of.camera),
        "rays": f"{footer.n_rays:,}", "events": f"{footer.n_accesses:,} node reads and prefetch requests",
        "file": str(footer.scene.source), "SHA-256": str(footer.scene.sha256), "written by": f"nptrace {footer.tool_version}",
        "again": command_of(run),
    }  # fmt: skip
