"""npcache estimate: miss rates of a large picture from part of its rays."""

import time
from collections import Counter
from dataclasses import replace

import click

from cachesim.config import parse_bytes
from nptrace.estimates import Sampling, estimate_scenes
from nptrace.following import following
from nptrace.groups import BadInput, Command
from nptrace.options import (
    Caches,
    gathered,
    list_option,
    policy_option,
    size_option,
    threads_option,
    ways_option,
)
from nptrace.output import Output, output_option, results_options
from nptrace.progress import done
from nptrace.scene_options import PictureOptions, Scenes, Trees, ray_options, scene_options, tree_options
from nptrace.sources import layouts_option
from nptrace.typed import given, listing
from nptrace_base.shell import word


@click.command(cls=Command)
@click.argument("names", metavar="SCENE...", nargs=-1, required=True)
@tree_options
@size_option()
@ways_option()
@list_option("--line", item=parse_bytes, metavar="SIZES", default="32", help="Line sizes in bytes; one at a time.")
@policy_option("lru", help="Replacement: lru alone can be estimated.")
@layouts_option()
@click.option(
    "--table1", "is_table1", is_flag=True, help="Use the four caches of Table I instead of --size, --ways and --line."
)
@click.option(
    "--target-error", "error", default="2%,0.05pp", show_default=True, metavar="ERROR",
    help="Half-width allowed for every miss rate: relative (2%), in percentage points (0.05pp), or the wider of both.",
)  # fmt: skip
@ray_options("2048x2048", "Seed of the sample, and of the random order.")
@click.option(
    "--exact-below", type=click.IntRange(0), default=100_000_000, show_default=True, metavar="N",
    help="Count runs of up to N predicted accesses exactly, without sampling.",
)  # fmt: skip
@threads_option()
@scene_options
@output_option(
    "--resume", binary="what an estimate keeps", help="Keep the counts in this file, and continue from it if it exists."
)
@results_options()
@gathered("scenes", Scenes)
@gathered("trees", Trees)
@gathered("picture", PictureOptions)
@gathered("caches", Caches)
@gathered("sampling", Sampling)
def estimate(
    scenes: Scenes, trees: Trees, picture: PictureOptions, caches: Caches, layout: list[str], is_table1: bool,
    sampling: Sampling, output: Output,
) -> None:  # fmt: skip
    """Estimate the miss rates of a picture, tracing only as many of its rays as the target error needs.

    A SCENE is a mesh file or a name that `nptrace scenes` lists. The picture is the one that `nptrace render` traces with
    the same options, but only the sampled part is traced, and no run is written.

    \b
    npcache estimate sponza --table1
    npcache estimate model.obj --size 16K,64K --assoc 2,8 --target-error 5% --pixels 4096x4096 --accel bvh
    """
    from cachesim.report import estimate_tables, table1
    from cachesim.sampling.cold_start import check_lru
    from cachesim.sampling.target import parse_target

    began = time.perf_counter()
    parse_target(sampling.error)  # refused now, not after scenes are loaded
    if is_table1:
        if others := given("size", "ways", "line"):
            raise BadInput(f"--table1 has the caches of Table I; leave out {listing(others)}, or --table1")
        configs = [replace(each, policy=one) for one in caches.policy for each in table1.caches()]
    else:
        configs = caches.configs()
    check_lru(configs)
    found = estimate_scenes(scenes.load(), trees, configs, picture, sampling, layout)
    results = [result for _, _, result in found]
    output.write(estimate_tables.records(results, output.form), lambda: estimate_tables.tables(results))
    methods = ", ".join(f"{n} {method}" for method, n in Counter(result.method for result in results).items())
    what = f"{len(results)} run{'s' * (len(results) != 1)} ({methods}), {len(configs)} cache{'s' * (len(configs) != 1)}"
    of_caches = "size", "ways", "line", "policy", "layout", "is_table1", "error", "exact_below", "resume", "pixels"
    subject = " ".join(map(word, scenes.names))
    done(what, began, following("nptrace render", subject, f"--pixels {picture.pixels}", drops=of_caches))
