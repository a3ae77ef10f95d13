"""npcache table1: Table I of the paper beside ours."""

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from nptrace.commands.estimate import estimate_scenes
from nptrace.groups import BadInput
from nptrace.output import FORMATS, one_form, output_option, write_out, write_tables
from nptrace.progress import progress_bar
from nptrace.scene_options import Picture, load_scenes
from nptrace.sources import default_sources, traces_option

if TYPE_CHECKING:
    from traces.reader import Run


@click.command()
@traces_option()
@click.option(
    "--target-error", "error", metavar="ERROR",
    help="Estimate the table for large pictures, without runs: 2%, 0.05pp or 2%,0.05pp, as in npcache estimate.",
)  # fmt: skip
@click.option(
    "--pixels", default="2048x2048", show_default=True, metavar="WxH", help="With --target-error: size of the picture."
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="With --target-error: seed of the sample.")
@click.option("--format", "form", type=click.Choice(FORMATS), show_default=FORMATS[0], help="Output format.")
@click.option("--json", "as_json", is_flag=True, help="The same as --format json.")
@output_option("-o", "--output", help="Write to a file instead of stdout.")
def table1(
    folder: Path, error: str | None, pixels: str, seed: int, form: str | None, as_json: bool, output: Path | None
) -> None:  # fmt: skip
    """Print Table I of the paper beside ours, from existing runs or estimated for large pictures.

    \b
    npcache table1
    npcache table1 --format csv -o table1.csv
    npcache table1 --target-error 2%,0.05pp --pixels 2048x2048
    """

    from cachesim.report import table1 as table
    from cachesim.report import table1_tables
    from traces.reader import open_run

    form = one_form("--format", form, as_json)
    if error is not None:
        estimated_table1(error, pixels, seed, form, output)
        return
    runs: list[Run] = [open_run(path) for path in default_sources(folder)]
    chosen = table.choose_runs(runs)
    if not chosen:
        raise BadInput(f"no run in {folder} is of a scene of Table I ({', '.join(table.SCENES)}); render one by its name")
    with progress_bar("replay", sum(run.n_accesses for run in chosen.values())) as progress:
        rows = table.table1(chosen, progress=progress)
    for tree, scene in table.missing(chosen):
        click.echo(f"no run of {scene} as a {table.TREES[tree]}: nptrace render {scene} --accel {tree}", err=True)
    tables, notes = table1_tables.tables(rows), table1_tables.notes(rows)
    if form == "json":
        write_out(json.dumps(table.to_dicts(rows), indent=2) + "\n", output)
    elif form == "csv":
        write_out(table.to_csv(rows), output)
    else:
        write_tables(tables, notes, form, output)


def estimated_table1(error: str, pixels: str, seed: int, form: str, output: Path | None) -> None:
    """Write Table I estimated for the four scenes and both trees."""
    from cachesim.report import estimate_tables
    from cachesim.report.table1 import SCENES, TREES, caches
    from cachesim.sampling.target import parse_target

    target = parse_target(error)
    if form == "csv":
        raise BadInput("--format csv cannot hold half-widths; with --target-error choose json, table, markdown or latex")
    scenes = load_scenes(SCENES, strict=False, offline=False)
    found = estimate_scenes(scenes, tuple(TREES), caches(), target, Picture(pixels=pixels, seed=seed))
    ordered = [(tree, scene.name, result) for tree in TREES for kind, scene, result in found if kind == tree]
    if form == "json":
        write_out(json.dumps(estimate_tables.table1_dicts(ordered), indent=2) + "\n", output)
    else:
        write_tables(*estimate_tables.table1_tables(ordered), form, output)
