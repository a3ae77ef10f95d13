"""The two commands, nptrace and npcache: parse, call one function, print. Nothing is computed here.

Data goes to stdout, progress and warnings to stderr. A bad input exits 2 with one sentence: the value, the rule, the way out.
Heavy modules are imported inside the commands, so that ``--help`` is quick.
"""

import gc
import json
import os
import sys
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import compiling
from cachesim.config import CacheConfig, parse_bytes, parse_ways
from options import (
    BadInput,
    Commands,
    check_run_names,
    list_option,
    load_scenes,
    output_option,
    parse_kd,
    picture_options,
    progress_bar,
    scene_options,
    threads_option,
    traces_option,
    write_out,
)

if TYPE_CHECKING:
    from cachesim.account import Result
    from cachesim.estimate import Estimated, Target
    from cachesim.text import Table
    from rtrace.scene import Scene
    from traces.reader import Run

PREFETCH_HELP = "none, traced, stack[:budget=K|tris*K|unlimited][:once][:empty], next-line:always|miss|tagged[:DISTANCE]."
LAYOUT_HELP = "Where nodes lie: stored, bfs, dfs, veb, treelet:BYTES; +BYTES moves them."
FORMATS = ("table", "csv", "json", "markdown", "latex")

gc.set_threshold(*compiling.GC_THRESHOLD)
# Before NumPy is imported: no command multiplies large matrices, and OpenBLAS's idle threads spin for a tenth of a second.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


@click.group(cls=Commands)
def nptrace() -> None:
    """Stage 1: a scene -> the node accesses of its rays."""


@nptrace.command()
@click.argument("names", metavar="SCENE...", nargs=-1, required=True)
@click.option("--accel", type=click.Choice(["kdtree", "bvh"]), multiple=True, help="Tree to build; both by default.")
@click.option("--size", default="128x128", show_default=True, metavar="WxH", help="Pixels of the picture.")
@click.option("--camera", metavar="TEXT", help="'eye=1,2,3 at=0,0,0 up=0,1,0 fov=45'; else the scene's own or a fitted one.")
@click.option("--light", metavar="X,Y,Z", help="Place of the point light; else the scene's own or a fitted one.")
@click.option(
    "--order",
    type=click.Choice(["scanline", "tile", "morton", "hilbert", "random"]),
    default="scanline",
    show_default=True,
    help="Order in which the pixels are shot.",
)
@click.option(
    "--batch",
    type=click.IntRange(0),
    default=1,
    show_default=True,
    help="Primary rays shot before their shadow rays; 0: all of them.",
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the random order.")
@click.option(
    "--kd",
    "kd_text",
    metavar="NAME=VALUE,...",
    default="",
    help="kd-tree builder: c_trav, c_isect, empty_bonus, max_level; `coarse` is max_level=16.",
)
@click.option(
    "--bvh",
    "bvh_builder",
    type=click.Choice(["sweep", "binned"]),
    default="sweep",
    show_default=True,
    help="BVH builder: exact SAH over all centroids, or up to 16 bins.",
)
@click.option("--out", type=click.Path(path_type=Path), default="traces", show_default=True, help="Folder for the runs.")
@click.option(
    "--name", "run_names", multiple=True, metavar="NAME",
    help="Name of the run, before -kdtree or -bvh, in place of the scene's; once per SCENE.",
)  # fmt: skip
@click.option("--overwrite", is_flag=True, help="Replace a run of another scene, picture or tree that has the same name.")
@threads_option()
@scene_options
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
def render(
    names: tuple[str, ...], accel: tuple[str, ...], size: str, camera: str | None, light: str | None, order: str, batch: int,
    seed: int, kd_text: str, bvh_builder: str, out: Path, run_names: tuple[str, ...], overwrite: bool, threads: int,
    strict: bool, offline: bool, as_json: bool,
) -> None:  # fmt: skip
    """Trace pictures of scenes and write one run per scene and tree.

    A SCENE is a mesh file or a name that `nptrace scenes` lists. A run is named <scene>-<tree>; the same run made again
    replaces itself, another one of its name is kept unless --overwrite is given.

    \b
    nptrace render bunny
    nptrace render a/scene.gltf b/scene.gltf --name chair --name table
    nptrace render model.obj --accel bvh --size 512x512 --camera "eye=0,2,5 at=0,0,0"
    """
    from rtrace import precision
    from rtrace.camera import parse_camera, parse_point, parse_size
    from rtrace.render import Shooting, render_all
    from rtrace.scene import seen_from
    from rtrace.strays import margin_note

    check_run_names(run_names, len(names))
    shooting = Shooting(*parse_size(size), order, batch, seed)
    params: dict[str, dict[str, Any]] = {"kdtree": parse_kd(kd_text), "bvh": {"builder": bvh_builder}}
    chosen = {kind: params[kind] for kind in accel or params}
    eye, lamp = parse_camera(camera) if camera else None, parse_point(light) if light else None
    scenes = [seen_from(scene, eye, lamp) for scene in load_scenes(names, strict, offline)]
    for scene in scenes:
        if scene.precision is not None:
            click.echo(f"{scene.label}: {precision.choice(scene.precision)}", err=True)
        if note := margin_note(scene.triangles, scene.bounds, scene.camera.eye):
            click.echo(f"{scene.label}: {note}", err=True)
    n_pixels = shooting.width * shooting.height * len(scenes) * len(chosen)
    with progress_bar("trace", n_pixels) as progress:
        summaries = render_all(
            scenes, chosen, shooting, out, names=run_names, overwrite=overwrite, threads=threads,
            tool_version=version("nptrace"), progress=progress,
        )  # fmt: skip
        runs = list(summaries)
    if as_json:
        click.echo(json.dumps([run._asdict() for run in runs], indent=2))
        return
    from cachesim.text import Table, number, percent, print_tables
    from traces.format import printable

    header = ["Run", "Triangles", "Nodes", "Rays", "Hit %", "Shadow", "Shadowed %", "Accesses", "Per ray", "Pre-fetches"]
    rows = [
        [
            printable(run.path), number(run.n_triangles), number(run.n_nodes), number(run.n_rays), percent(run.hit_share, 1),
            number(run.n_shadow_rays), percent(run.shadowed_share, 1), number(run.n_accesses), number(run.accesses_per_ray, 1),
            number(run.n_prefetches),
        ]
        for run in runs
    ]  # fmt: skip
    print_tables([Table("", header, rows)], [], sys.stdout)


@nptrace.command()
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def scenes(as_json: bool) -> None:
    """List the scenes known by name: their size, licence, and where they are found."""
    from rtrace.catalog import list_scenes

    rows = list_scenes()
    if as_json:
        click.echo(json.dumps([row._asdict() for row in rows], indent=2, default=str))
        return
    from cachesim.text import Table, number, print_tables

    lines = [[row.name, number(row.n_triangles), row.where or f"stand-in: {row.stand_in}", row.licence] for row in rows]
    header = ["Scene", "Triangles", "Where", "Licence"]
    print_tables([Table("", header, lines)], ["Built in: blob, room, nave, court. Any mesh file is a scene too."], sys.stdout)


@nptrace.command()
@click.argument("names", metavar="[SCENE]...", nargs=-1)
@click.option("--hard", is_flag=True, help="Run the catalogue of hard cases, whose answers are exact, through all structures.")
@click.option("--long", "is_long", is_flag=True, help="With --hard: the long form, some minutes.")
@click.option("--size", default="256x256", show_default=True, metavar="WxH", help="Pixels of the picture.")
@click.option("--random", "n_random", type=click.IntRange(0), default=200_000, show_default=True, help="Random rays.")
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Of the random rays.")
@scene_options
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def check(
    names: tuple[str, ...], hard: bool, is_long: bool, size: str, n_random: int, seed: int, strict: bool, offline: bool,
    as_json: bool,
) -> None:  # fmt: skip
    """Compare both trees with Embree on camera, shadow and random rays; exit 1 beyond a limit.

    \b
    nptrace check bunny
    nptrace check model.ply --random 1000000
    nptrace check --hard
    """
    from rtrace.camera import parse_size

    if not names and not hard:
        raise BadInput("name a scene to compare with Embree, or give --hard")
    width, height = parse_size(size)
    rows: list[dict[str, Any]] = []
    if hard:
        from rtrace.hard_cases import run_all

        rows += [{**row._asdict(), "is_good": row.is_good} for row in run_all(is_long)]
    if names:
        from rtrace.treecache import TREES, cached_tree
        from rtrace.verify import compare

        for scene in load_scenes(names, strict, offline):
            trees = [cached_tree(scene, kind) for kind in TREES]
            compared = compare(trees, scene, width, height, n_random, seed)
            rows += [{"scene": scene.label, **row._asdict(), "is_good": row.is_good} for row in compared]
    n_bad = sum(not row["is_good"] for row in rows)
    if as_json:
        click.echo(json.dumps(rows, indent=2))
    else:
        print_checks(rows, f"{len(rows)} comparisons, {n_bad} beyond their limit.")
    if n_bad:
        raise SystemExit(1)


def print_checks(rows: list[dict[str, Any]], note: str) -> None:
    """Print comparisons with Embree and hard cases, each kind as a table of its own."""
    from cachesim.text import Table, number, print_tables

    verdict = {True: "ok", False: "BEYOND"}
    counts = ("n_rays", "lost", "invented", "wrong", "unlike", "ambiguous")
    embree = [
        [r["scene"], r["tree"], r["rays"], number(r["n_rays"]), r["what"], f"{r['value']:.3g}", f"{r['limit']:.3g}",
         verdict[r["is_good"]]]
        for r in rows if "scene" in r
    ]  # fmt: skip
    hard = [
        [r["case"], r["structure"], *(number(r[name]) for name in counts), f"{r['t_error']:.2g}", f"{r['bound']:.2g}",
         verdict[r["is_good"]]]
        for r in rows if "case" in r
    ]  # fmt: skip
    tables = []
    if hard:
        header = ["Hard case", "Structure", "Rays", "Lost", "Invented", "Wrong", "Unlike", "Ambiguous", "t error", "Bound", ""]
        tables.append(Table("", header, hard, n_left=2))
    if embree:
        header = ["Scene", "Tree", "Rays", "Number", "Compared", "Value", "Limit", ""]
        tables.append(Table("", header, embree, n_left=3))
    print_tables(tables, [note], sys.stdout)


@nptrace.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--to", "form", type=click.Choice(["din"]), default="din", show_default=True, help="DineroIV's input format.")
@click.option("--binary", is_flag=True, help="DineroIV's binary records instead of text.")
@click.option(
    "--prefetch",
    type=click.Choice(["b", "read", "misc", "omit"]),
    default="b",
    show_default=True,
    help="Label of the pre-fetch requests: b, as reads (0), as misc (3), or leave them out.",
)
@output_option("-o", "--output", help="File, - for stdout; RUN.din by default.")
def export(run: Path, form: str, binary: bool, prefetch: str, output: Path | None) -> None:
    """Write a run as a trace that DineroIV itself replays.

    \b
    nptrace export traces/bunny-bvh --to din
    dineroIV -informat d -l1-usize 8k -l1-ubsize 32 -l1-uassoc 2 < bunny-bvh.din
    """
    from traces.din import export_din
    from traces.format import printable
    from traces.reader import open_run

    opened = open_run(run)
    target = output or Path(f"{opened.name}.{form}")
    form_of = "binary" if binary else "text"
    written = export_din(opened, target, fmt=form_of, prefetch=prefetch, warn=lambda text: click.echo(text, err=True))
    click.echo(f"{printable(str(target))}: {written:,} accesses", err=True)


@nptrace.command(name="compile")
def compile_() -> None:
    """Compile everything now, which the first use of each command does otherwise; kept until the program changes."""
    from jit import cache_folder
    from precompile import compile_all

    n_compiled = compile_all()
    kept = "" if "kernels" in compiling.lost else f", all ready in {cache_folder()}"
    click.echo(f"{n_compiled} kernels compiled{kept}")


@click.group(cls=Commands)
def npcache() -> None:
    """Stage 2: node accesses -> what a node cache makes of them."""


@npcache.command()
@click.argument("sources", metavar="[RUN | FILE.din | -]...", nargs=-1, type=click.Path(path_type=Path))
@traces_option()
@list_option("--size", item=parse_bytes, metavar="SIZES", default="8K", help="Cache sizes, e.g. 8K,16K.")
@list_option("--assoc", "--ways", item=str, metavar="WAYS", default="1", help="Ways, e.g. 1,2,full.")
@list_option("--line", item=parse_bytes, metavar="SIZES", default="32", help="Line sizes in bytes.")
@list_option(
    "--policy", item=str.lower, metavar="POLICIES", default="lru", help="lru, fifo, random; opt: no other has fewer misses."
)
@click.option("--seed", type=int, default=0, show_default=True, help="Of the random policy.")
@list_option("--prefetch", item=str, metavar="POLICIES", default="traced", help=PREFETCH_HELP)
@list_option("--layout", item=str, metavar="LAYOUTS", default="stored", help=LAYOUT_HELP)
@click.option("--3c", "three_c", is_flag=True, help="Classify misses as compulsory, capacity or conflict.")
@click.option("--report", type=click.Choice(["table", "dinero", "json", "csv"]), show_default="table")
@click.option("--json", "as_json", is_flag=True, help="The same as --report json.")
def replay(
    sources: tuple[Path, ...], folder: Path, size: list[int], assoc: list[str], line: list[int], policy: list[str], seed: int,
    prefetch: list[str], layout: list[str], three_c: bool, report: str | None, as_json: bool,
) -> None:  # fmt: skip
    """Replay runs, or DineroIV traces, through every combination of the cache options, exactly.

    \b
    npcache replay --size 8K --assoc 2
    npcache replay traces/bunny-bvh --size 8K,16K --assoc 1,2 --prefetch none,stack:tris*2 --json
    npcache replay x.din --size 2K --assoc 2 --report dinero
    """
    from cachesim.layout import parse_layout
    from cachesim.prefetch import parse_prefetch
    from cachesim.replay import replay as replay_source
    from cachesim.source import open_source

    form = one_form("--report", report, as_json)
    configs = [
        CacheConfig(one_size, parse_ways(ways, one_size, one_line), one_line, one_policy, seed)
        for one_line in line for one_policy in policy for one_size in size for ways in assoc
    ]  # fmt: skip
    policies, layouts = [parse_prefetch(text) for text in prefetch], [parse_layout(text) for text in layout]
    results: list[Result] = []
    for path in sources or default_sources(folder):
        for one_layout in layouts:
            source = open_source(path, one_layout)
            source.check_passes(len(policies))
            for one_prefetch in policies:
                with progress_bar("replay", source.n_events) as progress:
                    results += replay_source(source, configs, prefetch=one_prefetch, three_c=three_c, progress=progress)
    print_results(results, form)


def one_form(option: str, form: str | None, as_json: bool) -> str:
    """Return the form that an option and --json ask for, the table if none; they must not differ."""
    if as_json and form not in (None, "json"):
        raise BadInput(f"{option} {form} and --json ask for two forms; leave one out")
    return "json" if as_json else form or "table"


def default_sources(folder: Path) -> list[Path]:
    """Return the runs in a folder, at least one."""
    from traces.reader import find_runs

    found = find_runs(folder)
    if not found:
        raise BadInput(f"there is no run in {folder}; make one with `nptrace render SCENE`, or name runs or a .din file")
    return found


def print_results(results: "list[Result]", report: str) -> None:
    """Print results in the form asked for."""
    from cachesim import report as reports
    from cachesim.text import print_tables

    if report == "table":
        print_tables(*reports.tables(results), sys.stdout)
        return
    write = {"json": reports.to_json, "csv": reports.to_csv, "dinero": reports.to_dinero}[report]
    click.echo(write(results), nl=False)


@npcache.command()
@click.argument("sources", metavar="[RUN | FILE.din | -]...", nargs=-1, type=click.Path(path_type=Path))
@traces_option()
@list_option("--size", item=str, metavar="SIZES", default="4K..64K", help="Cache sizes and ranges, e.g. 4K..64K,96K.")
@list_option("--ways", "--assoc", item=str, metavar="WAYS", default="1..16", help="Ways and ranges, e.g. 1..16,full.")
@list_option("--line", item=parse_bytes, metavar="SIZES", default="32", help="Line sizes in bytes.")
@list_option("--prefetch", item=str, metavar="POLICIES", default="traced", help="none, traced, stack[:...], as in replay.")
@list_option("--layout", item=str, metavar="LAYOUTS", default="stored", help="Where nodes lie, as in replay.")
@threads_option()
@output_option("-o", "--output", help="A .parquet or .csv file; - is CSV on stdout.")
@output_option("--plot", "picture", help="A .png, .svg or .pdf file.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of CSV.")
def sweep(
    sources: tuple[Path, ...], folder: Path, size: list[str], ways: list[str], line: list[int], prefetch: list[str],
    layout: list[str], threads: int, output: Path | None, picture: Path | None, as_json: bool,
) -> None:  # fmt: skip
    """Count the misses of every LRU cache in ranges of sizes, ways and lines, exactly, in one pass over each trace.

    A cache is in the sweep if its size lies in a range and its number of sets is a power of two.

    \b
    npcache sweep --size 4K..64K --ways 1..16 --line 32,64 -o sweep.parquet --plot sweep.png
    npcache sweep traces/bunny-bvh --ways 1,2,4,full --prefetch none,stack:tris*2
    """
    from cachesim import sweep as sweeping
    from cachesim import sweep_files
    from cachesim.source import open_source

    all_ways = list(dict.fromkeys(way for text in ways for way in sweeping.parse_ways_range(text)))
    for path, endings in ((output, sweep_files.TABLES), (picture, sweep_files.PICTURES)):
        if path is not None:
            sweep_files.ending_of(path, endings)  # or it is known only when all is counted
    configs = sweeping.grid([sweeping.parse_range(text) for text in size], all_ways, line)
    rows: list[sweeping.Row] = []
    for path in sources or default_sources(folder):
        for one_layout in layout:
            source = open_source(path, one_layout)
            source.check_passes(len(prefetch))
            for one_prefetch in prefetch:
                with progress_bar("sweep", source.n_events) as progress:
                    rows += sweeping.sweep(source, configs, prefetch=one_prefetch, threads=threads, progress=progress)
    if output is not None:
        sweep_files.write(rows, output)
    if picture is not None:
        sweep_files.plot(rows, picture)
    if as_json:
        click.echo(json.dumps([row.to_dict() for row in rows], indent=2))
    elif output is None and picture is None:
        click.echo(sweep_files.to_csv(rows), nl=False)


def estimate_scenes(
    scenes: "Sequence[Scene]", accel: Sequence[str], configs: Sequence[CacheConfig], target: "Target", *, pixels: str,
    camera: str | None, light: str | None, order: str, batch: int, kd_text: str, bvh_builder: str, seed: int,
    exact_below: float, threads: int, resume: Path | None = None,
) -> "list[tuple[str, Scene, Estimated]]":  # fmt: skip
    """Hand the renderer of every scene and tree to the estimator; return (tree, scene, result) of each."""
    from cachesim.estimate import estimate as estimate_source
    from rtrace.camera import parse_camera, parse_point, parse_size
    from rtrace.render import Shooting
    from rtrace.scene import seen_from
    from rtrace.treecache import cached_tree
    from rtrace.units import RayUnits

    shooting = Shooting(*parse_size(pixels), order, batch, seed if order == "random" else 0)
    params: dict[str, dict[str, Any]] = {"kdtree": parse_kd(kd_text), "bvh": {"builder": bvh_builder}}
    eye, lamp = parse_camera(camera) if camera else None, parse_point(light) if light else None
    if resume is not None and len(scenes) * len(accel) > 1:
        raise BadInput(f"--resume {resume} keeps the counts of one run; name one SCENE and one --accel")
    found = []
    for scene in scenes:
        for kind in accel:
            source = RayUnits(seen_from(scene, eye, lamp), cached_tree(scene, kind, **params[kind]), shooting)
            with progress_bar(f"estimate {source.name}", None) as progress:
                result = estimate_source(
                    source, configs, target, seed=seed, threads=threads, exact_below=exact_below, resume=resume,
                    progress=progress,
                )  # fmt: skip
            found.append((kind, scene, result))
    return found


@npcache.command()
@click.argument("names", metavar="SCENE...", nargs=-1, required=True)
@click.option("--accel", type=click.Choice(["kdtree", "bvh"]), multiple=True, help="Tree to build; both by default.")
@list_option("--size", item=parse_bytes, metavar="SIZES", default="8K", help="Cache sizes, e.g. 8K,16K.")
@list_option("--assoc", "--ways", item=str, metavar="WAYS", default="1", help="Ways, e.g. 1,2,full.")
@click.option("--line", type=str, default="32", show_default=True, metavar="SIZE", help="Line size in bytes.")
@click.option("--table1", "is_table1", is_flag=True, help="The four caches of Table I, instead of --size and --assoc.")
@click.option(
    "--target-error", "error", default="2%,0.05pp", show_default=True, metavar="ERROR",
    help="Half-width allowed for every miss rate: of its value (2%), in points (0.05pp), or the wider of two.",
)  # fmt: skip
@picture_options
@output_option("--resume", help="File that keeps the counts; continued if there.")
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def estimate(
    names: tuple[str, ...], accel: tuple[str, ...], size: list[int], assoc: list[str], line: str, is_table1: bool, error: str,
    resume: Path | None, as_json: bool, strict: bool, offline: bool, **picture: Any,
) -> None:  # fmt: skip
    """Estimate the miss rates of a picture from as few of its rays as a target error takes.

    A SCENE is a mesh file or a name that `nptrace scenes` lists. It is rendered as `nptrace render` does with the same
    options, but only where the sample needs it, and nothing is written.

    \b
    npcache estimate sponza --table1
    npcache estimate model.obj --size 16K,64K --assoc 2,8 --target-error 5% --pixels 4096x4096 --accel bvh
    """
    from cachesim import estimate_text
    from cachesim.estimate import parse_target
    from cachesim.table1 import caches
    from cachesim.text import print_tables

    target = parse_target(error)
    configs = caches() if is_table1 else [
        CacheConfig(one_size, parse_ways(ways, one_size, parse_bytes(line)), parse_bytes(line))
        for one_size in size for ways in assoc
    ]  # fmt: skip
    found = estimate_scenes(
        load_scenes(names, strict, offline), accel or ("kdtree", "bvh"), configs, target, resume=resume, **picture
    )
    results = [result for _, _, result in found]
    if as_json:
        click.echo(json.dumps([result.to_dict() for result in results], indent=2))
    else:
        print_tables(*estimate_text.tables(results), sys.stdout)


@npcache.command()
@traces_option()
@click.option(
    "--target-error", "error", metavar="ERROR",
    help="Estimate it for large pictures instead, from no runs: 2%, 0.05pp or 2%,0.05pp, as in npcache estimate.",
)  # fmt: skip
@click.option(
    "--pixels", default="2048x2048", show_default=True, metavar="WxH", help="With --target-error: size of the picture."
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="With --target-error: of the sample.")
@click.option("--format", "form", type=click.Choice(FORMATS), show_default=FORMATS[0])
@click.option("--json", "as_json", is_flag=True, help="The same as --format json.")
@output_option("-o", "--output", help="Write to a file instead of stdout.")
def table1(
    folder: Path, error: str | None, pixels: str, seed: int, form: str | None, as_json: bool, output: Path | None
) -> None:  # fmt: skip
    """Print Table I of the paper beside ours, for the runs there are, or estimated for large pictures.

    \b
    npcache table1
    npcache table1 --format csv -o table1.csv
    npcache table1 --target-error 2%,0.05pp --pixels 2048x2048
    """

    from cachesim import table1 as table
    from cachesim import table1_text
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
        rows = table.table1(chosen.values(), progress=progress)
    for tree, scene in table.missing(chosen):
        click.echo(f"no run of {scene} as a {table.TREES[tree]}: nptrace render {scene} --accel {tree}", err=True)
    tables, notes = table1_text.tables(rows), table1_text.notes(rows)
    if form == "json":
        write_out(json.dumps(table.to_dicts(rows), indent=2) + "\n", output)
    elif form == "csv":
        write_out(table.to_csv(rows), output)
    else:
        write_tables(tables, notes, form, output)


def write_tables(tables: "list[Table]", notes: list[str], form: str, output: Path | None) -> None:
    """Write tables as ``table``, ``markdown`` or ``latex``."""
    import io

    from cachesim import text

    if form != "table":
        write_out({"markdown": text.to_markdown, "latex": text.to_latex}[form](tables, notes), output)
    elif output is None:
        text.print_tables(tables, notes, sys.stdout)
    else:
        printed = io.StringIO()
        text.print_tables(tables, notes, printed)
        write_out(printed.getvalue(), output)


def estimated_table1(error: str, pixels: str, seed: int, form: str, output: Path | None) -> None:
    """Write Table I estimated for the four scenes and both trees."""
    from cachesim import estimate_text
    from cachesim.estimate import EXACT_BELOW, parse_target
    from cachesim.table1 import SCENES, TREES, caches

    target = parse_target(error)
    if form == "csv":
        raise BadInput("--format csv has no place for half-widths; with --target-error write json, table, markdown or latex")
    scenes = load_scenes(SCENES, strict=False, offline=False)
    found = estimate_scenes(
        scenes, tuple(TREES), caches(), target, pixels=pixels, camera=None, light=None, order="scanline", batch=1, kd_text="",
        bvh_builder="sweep", seed=seed, exact_below=EXACT_BELOW, threads=os.cpu_count() or 1,
    )  # fmt: skip
    ordered = [(tree, scene.name, result) for tree in TREES for kind, scene, result in found if kind == tree]
    if form == "json":
        write_out(json.dumps(estimate_text.table1_dicts(ordered), indent=2) + "\n", output)
    else:
        write_tables(*estimate_text.table1_tables(ordered), form, output)
