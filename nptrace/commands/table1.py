"""npcache table1: Table I of the paper beside ours."""

import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import click

from nptrace.estimates import Sampling, estimate_scenes
from nptrace.following import following, named
from nptrace.groups import BadInput, Command
from nptrace.options import Choice, gathered, seed_option, threads_option, workers_options
from nptrace.output import Output, results_options
from nptrace.progress import Progress, done, say
from nptrace.scene_options import PictureOptions, Scenes, Trees
from nptrace.sources import LAYOUT_HELP, PlaceOf, chosen_sources, traces_option
from nptrace.table1_study.presets import PRESETS, note
from nptrace.typed import given, listing
from nptrace_base.places import Place

if TYPE_CHECKING:
    from cachesim.report.table1 import Equation


@dataclass(frozen=True)
class Acpr:
    """The values of the options of the paper's equation 1."""

    n: str = "paper"
    hit: int = 1
    miss: int = 100

    def equation(self) -> "Equation":
        """Return the equation."""
        from cachesim.report.table1 import Equation, parse_n

        return Equation(self.hit, self.miss, parse_n(self.n))


@click.command(cls=Command)
@click.argument("sources", metavar="[RUN]...", nargs=-1, type=PlaceOf())
@traces_option()
@click.option(
    "--preset", type=Choice(list(PRESETS)),
    help="Table I under a model that the study found, without runs: a fit of B/A, not of A.",
)  # fmt: skip
@click.option(
    "--target-error", "error", metavar="ERROR",
    help="Estimate the table for large pictures, without runs: 2%, 0.05pp or 2%,0.05pp, as in npcache estimate.",
)  # fmt: skip
@click.option(
    "--pixels",
    default="2048x2048",
    show_default=True,
    metavar="WxH",
    help="With --target-error: size of the picture in pixels.",
)
@seed_option("With --target-error: seed of the sample.")
@click.option(
    "--policy", type=Choice(["lru", "fifo", "random"]), default="lru", show_default=True,
    help="Replacement; with --target-error lru alone. The clock's caches know no opt.",
)  # fmt: skip
@click.option("--layout", default="stored", show_default=True, metavar="LAYOUT", help=LAYOUT_HELP)
@click.option(
    "--n", default="paper", show_default=True, metavar="N",
    help="Accesses per ray in the ACPR: paper, 15.77 and 27; measured; or the kd-tree's and the BVH's, as 15.77,27.",
)  # fmt: skip
@click.option("--hit", type=click.IntRange(1), default=1, show_default=True, help="Cycles of a hit, in the ACPR and in time.")
@click.option(
    "--miss", type=click.IntRange(1), default=100, show_default=True, help="Cycles of a miss, in the ACPR and in time."
)
@threads_option()
@workers_options
@results_options()
@gathered("equation", Acpr)
# Many parameters: one per option, as click passes them.
def table1(
    sources: tuple[Place, ...], folder: Place, preset: str | None, error: str | None, pixels: str, seed: int, policy: str,
    layout: str, equation: Acpr, workers: int, scheduler: str | None, threads: int, output: Output,
) -> None:  # fmt: skip
    """Print Table I of the paper beside ours, from existing runs or estimated for large pictures.

    \b
    npcache table1
    npcache table1 a/bunny-bvh b/sponza-bvh
    npcache table1 --format csv -o table1.csv
    npcache table1 --target-error 2%,0.05pp --pixels 2048x2048
    npcache table1 --preset paper2013
    """
    from cachesim.layout import parse_layout
    from cachesim.report import table1 as table
    from cachesim.report import table1_tables
    from nptrace.studies import table1_notes, table1_rows, table1_runs
    from nptrace_base.engines import engine_of
    from traces.reader import open_run

    parse_layout(layout)
    numbers = equation.equation()
    if preset is not None:
        others = given(
            "sources", "folder", "error", "pixels", "seed", "policy", "layout", "workers", "scheduler"
        )  # fmt: skip
        if others:
            raise BadInput(f"--preset {preset} has its own pictures, caches and layouts; leave out {listing(others)}")
        table1_of_preset(preset, numbers, threads, output)
        return
    if error is not None:
        if runs := given("sources", "folder"):
            raise BadInput(f"--target-error traces the four scenes itself; leave out {listing(runs)}, or --target-error")
        if others := given("n", "hit", "miss"):
            raise BadInput(f"--target-error has the paper's equation; leave out {listing(others)}, or give runs")
        if others := given("workers", "scheduler"):
            raise BadInput(f"--target-error has threads alone; leave out {listing(others)}, or give runs")
        estimated_table1(Sampling(error, threads=threads), PictureOptions(pixels=pixels, seed=seed), policy, layout, output)
        return
    if others := given("pixels", "seed"):
        raise BadInput(f"runs have their own pictures; leave out {listing(others)}, or estimate the table with --target-error")
    chosen = table1_runs([open_run(path) for path in chosen_sources(sources, folder)], None if sources else folder)
    began = time.perf_counter()
    with engine_of(workers, scheduler) as engine, Progress() as bar:
        rows = table1_rows(chosen, bar, policy=policy, layout=layout, equation=numbers, threads=threads, engine=engine)
    for tree, scene in table.missing(chosen):
        say(f"no run of {scene} as a {table.TREES[tree]}: nptrace render {scene} --accel {tree}")
    output.write(table.to_dicts(rows), lambda: (table1_tables.tables(rows), table1_notes(rows)))
    is_timed = all(run.footer.packet == 1 for run in chosen.values())
    subject = named([run.path for run in chosen.values()]) if is_timed else None
    what = f"{len(chosen)} run{'s' * (len(chosen) != 1)}, {len(rows)} rows"
    done(what, began, following("npcache compare", subject, drops=["n"]))


def table1_of_preset(name: str, equation: "Equation", threads: int, output: Output) -> None:
    """Write Table I under a preset."""
    from cachesim.report import table1_tables
    from cachesim.report.table1 import to_dicts
    from nptrace.studies import preset_rows

    began = time.perf_counter()
    with Progress() as bar:
        rows = preset_rows(name, bar, equation=equation, threads=threads)
    output.write(to_dicts(rows), lambda: (table1_tables.tables(rows), [*table1_tables.notes(rows), note(name)]))
    done(f"{len(rows)} rows", began)


def estimated_table1(sampling: Sampling, picture: PictureOptions, policy: str, layout: str, output: Output) -> None:
    """Write Table I estimated for the four scenes and both trees."""
    from cachesim.report import estimate_tables
    from cachesim.report.table1 import SCENES, TREES, caches
    from cachesim.sampling.cold_start import check_lru

    began = time.perf_counter()
    configs = [replace(each, policy=policy) for each in caches()]
    check_lru(configs)
    found = estimate_scenes(Scenes(SCENES).load(), Trees(tuple(TREES)), configs, picture, sampling, [layout])
    ordered = [(tree, scene.name, result) for tree in TREES for kind, scene, result in found if kind == tree]
    records = estimate_tables.records([result for _, _, result in ordered], output.form)
    output.write(records, lambda: estimate_tables.table1_tables(ordered))
    done(f"{len(ordered)} runs, {len(configs)} caches", began, f"nptrace render {' '.join(SCENES)} --pixels {picture.pixels}")
