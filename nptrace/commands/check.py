"""nptrace check: our hits against Embree's, and the catalogue of hard cases."""

import math
import time
from functools import partial
from typing import TYPE_CHECKING, Any

import click

from nptrace.groups import BadInput, Command
from nptrace.ignored import refuse
from nptrace.options import gathered, seed_option, threads_option
from nptrace.output import Output, results_options
from nptrace.progress import Progress, done
from nptrace.scene_options import Scenes, refuse_one_name, scene_options
from nptrace_base.shell import word

if TYPE_CHECKING:
    from nptrace_base.tables import Table


@click.command(cls=Command, old={"--size": "--pixels"})
@click.argument("names", metavar="[SCENE]...", nargs=-1)
@click.option("--hard", is_flag=True, help="Run the catalogue of hard cases, with exact answers, through all structures.")
@click.option("--long", "is_long", is_flag=True, help="With --hard: run the long form, which takes minutes.")
@click.option("--pixels", default="256x256", show_default=True, metavar="WxH", help="Size of the picture in pixels.")
@click.option("--random", "n_random", type=click.IntRange(0), default=200_000, show_default=True, help="How many random rays.")
@seed_option("Seed of the random rays.")
@threads_option()
@scene_options
@results_options()
@gathered("scenes", Scenes)
def check(
    scenes: Scenes, hard: bool, is_long: bool, pixels: str, n_random: int, seed: int, threads: int, output: Output,
) -> None:  # fmt: skip
    """Compare both trees with Embree on camera, shadow and random rays; exit with status 1 if a limit is exceeded.

    \b
    nptrace check bunny
    nptrace check model.ply --random 1000000
    nptrace check --hard
    """
    from nptrace_base.pools import thread_pool
    from rtrace.camera import parse_size

    if not scenes.names and not hard:
        raise BadInput("name a scene to compare with Embree, or give --hard")
    if scenes.names and hard:
        raise BadInput(f"--hard brings its own scenes, and its rows are not those of {scenes.names[0]}; run one at a time")
    if hard:
        refuse("--hard brings its own scenes and rays", "pixels", "n_random", "seed", "strict", "offline")
    else:
        refuse("--long is a form of --hard", "is_long", way=", or give --hard and no scene")
    if n_random == 0:
        refuse("there are no random rays", "seed")
    width, height = parse_size(pixels)
    began = time.perf_counter()
    rows: list[dict[str, Any]] = []
    if hard:
        from rtrace.checks.hard_cases import run_all

        with Progress(1) as bar:
            bar.job("hard cases")
            for row in run_all(is_long, threads):
                bar.phase(f"{row.case}, {row.structure}")
                rows.append({**row._asdict(), "is_good": row.is_good})
    if scenes.names:
        from rtrace.checks.embree import compare
        from rtrace.trees.tree_cache import TREES, cached_tree

        loaded = scenes.load()
        refuse_one_name([scene.label for scene in loaded], "check")
        with Progress(len(loaded)) as bar:
            for scene in loaded:
                bar.job(scene.label)
                bar.phase("build")
                with thread_pool(threads) as pool:
                    trees = list(pool.map(partial(cached_tree, scene), TREES))
                bar.phase("compare with Embree")
                compared = compare(trees, scene, width, height, n_random, seed, threads)
                of = {"scene": scene.name, "stand_in": scene.stand_in, "width": width, "height": height, "seed": seed}
                rows += [{**of, **row._asdict(), "is_good": row.is_good} for row in compared]
    n_bad = sum(not row["is_good"] for row in rows)
    output.write(rows, lambda: (tables_of(rows), [f"{len(rows)} comparisons, {n_bad} beyond their limit."]))
    following = f"nptrace render {' '.join(map(word, scenes.names))}" if scenes.names else "nptrace check sponza"
    done(f"{len(rows)} comparisons, {sum(row['n_rays'] for row in rows):,} rays", began, following)
    if n_bad:
        raise SystemExit(1)


def tables_of(rows: list[dict[str, Any]]) -> "list[Table]":
    """Return the tables of comparisons with Embree and of hard cases."""
    from nptrace_base.tables import Table, number

    verdict = {True: "ok", False: "BEYOND"}
    counts = ("n_rays", "lost", "invented", "wrong", "unlike", "ambiguous")
    embree = [
        [r["scene"] + " (stand-in)" * r["stand_in"], r["tree"], r["rays"], number(r["n_rays"]), r["what"],
         f"{r['value']:.3g}", f"{r['limit']:.3g}",
         verdict[r["is_good"]]]
        for r in rows if "scene" in r
    ]  # fmt: skip
    hard = [
        [r["case"], r["structure"], *(number(r[name]) for name in counts), _short(r["t_error"]), _short(r["bound"]),
         verdict[r["is_good"]]]
        for r in rows if "case" in r
    ]  # fmt: skip
    tables = []
    if hard:
        header = ["Hard case", "Structure", "Rays", "Lost", "Invented", "Wrong", "Differ", "Ambiguous", "t error", "Bound", ""]
        extra = ("Bound", "t error", "Ambiguous", "Differ", "Rays")
        tables.append(Table("", header, hard, n_left=2, extra=extra))
    if embree:
        header = ["Scene", "Tree", "Rays", "Number", "Compared", "Value", "Limit", ""]
        tables.append(Table("", header, embree, n_left=3))
    return tables


def _short(value: float) -> str:
    """Return a number of two digits; - for infinity, a limit that no error exceeds."""
    return f"{value:.2g}" if math.isfinite(value) else "-"
