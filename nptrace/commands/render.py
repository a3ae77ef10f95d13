"""nptrace render: scenes -> runs."""

import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from nptrace.groups import Command
from nptrace.options import threads_option
from nptrace.output import Output, results_options
from nptrace.progress import Progress, done, size_text
from nptrace.scene_options import (
    accel_option,
    bvh_nodes_option,
    check_run_names,
    load_scenes,
    own_rays,
    scene_options,
    tree_params,
)
from nptrace.sources import again

if TYPE_CHECKING:
    from nptrace_base.tables import Table
    from rtrace.render import Summary


@click.command(cls=Command, old={"--size": "--pixels"})
@click.argument("names", metavar="SCENE...", nargs=-1, required=True)
@accel_option()
@click.option("--pixels", default="128x128", show_default=True, metavar="WxH", help="Size of the picture in pixels.")
@click.option(
    "--camera", "cameras", multiple=True, metavar="TEXT",
    help="'eye=1,2,3 at=0,0,0 up=0,1,0 fov=45'; by default the scene's or a fitted one. Several make several runs.",
)  # fmt: skip
@click.option("--light", metavar="X,Y,Z", help="Position of the point light; by default the scene's or a fitted one.")
@click.option(
    "--order",
    type=click.Choice(["scanline", "tile", "morton", "hilbert", "random"]),
    default="scanline",
    show_default=True,
    help="Order in which the pixels are traced.",
)
@click.option(
    "--batch",
    type=click.IntRange(0),
    default=1,
    show_default=True,
    help="Primary rays traced before their shadow rays; 0 means all of them.",
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the random order.")
@click.option(
    "--kd",
    "kd_text",
    metavar="NAME=VALUE,...",
    default="",
    help="kd-tree builder: c_trav, c_isect, empty_bonus, max_level, min_leaf, max_leaf; `coarse` is max_level=16.",
)
@click.option(
    "--bvh",
    "bvh_text",
    metavar="BUILDER,NAME=VALUE,...",
    default="sweep",
    show_default=True,
    help="BVH builder: sweep, exact SAH over all centroids, or binned, up to 16 bins; c_trav, c_isect, min_leaf, max_leaf.",
)
@click.option(
    "--rays", "ray_file", type=click.Path(path_type=Path), metavar="FILE.parquet",
    help="Trace these rays instead of a picture's: columns origin, direction and, if you like, t_min, t_max, any_hit.",
)  # fmt: skip
@bvh_nodes_option("Bytes of a BVH node: 32 holds its own box, 64 both children's; give both for a run of each.")
@click.option("--out", type=click.Path(path_type=Path), default="traces", show_default=True, help="Folder for the runs.")
@click.option(
    "--name", "run_names", multiple=True, metavar="NAME",
    help="Name of the run, before -kdtree, -bvh or -bvh64, instead of the usual one; once per SCENE and --camera.",
)  # fmt: skip
@click.option("--overwrite", is_flag=True, help="Replace a run of other content that has the same name.")
@threads_option()
@scene_options
@results_options()
def render(
    names: tuple[str, ...], accel: list[str], pixels: str, cameras: tuple[str, ...], light: str | None, order: str,
    batch: int, seed: int, kd_text: str, bvh_text: str, bvh_nodes: tuple[str, ...], ray_file: Path | None, out: Path,
    run_names: tuple[str, ...], overwrite: bool, threads: int, strict: bool, offline: bool, output: Output,
) -> None:  # fmt: skip
    """Trace pictures of scenes and write one run per scene and tree.

    A SCENE is a mesh file or a name that `nptrace scenes` lists. A run is named <scene>-<tree>, <scene>-bvh64 if the BVH has
    nodes of 64 bytes, followed by what differs from the defaults, as in sponza-bvh-morton-512x512. The same command replaces
    its run; another run of that name is kept unless you give --overwrite.

    \b
    nptrace render bunny
    nptrace render a/scene.gltf b/scene.gltf --name chair --name table
    nptrace render model.obj --accel bvh --pixels 512x512 --camera "eye=0,2,5 at=0,0,0"
    """
    from nptrace.studies import rendered
    from rtrace.camera import parse_size
    from rtrace.ray_file import RayFile
    from rtrace.render import Shooting

    began = time.perf_counter()
    check_run_names(run_names, len(names) * max(len(cameras), 1))
    shooting: Shooting | RayFile
    shooting = picture = Shooting(*parse_size(pixels), order, batch, seed)
    if ray_file is not None:
        shooting = own_rays(ray_file, picture, [*cameras, *([light] if light else [])])
    chosen = tree_params(accel, kd_text, bvh_text, bvh_nodes)
    scenes = load_scenes(names, strict, offline, cameras, light)
    with Progress(len(scenes) * len(chosen)) as bar:
        runs = rendered(scenes, chosen, shooting, out, bar, names=run_names, overwrite=overwrite, threads=threads)
    output.write([run.to_dict() for run in runs], lambda: ([table_of(runs)], []))
    n_rays, n_bytes = sum(run.n_rays for run in runs), sum(run.n_bytes for run in runs)
    what = f"{len(runs)} run{'s' * (len(runs) != 1)}, {n_rays:,} rays, {size_text(n_bytes)}"
    done(what, began, f"npcache replay {again((), out)}--size 8K,16K")


def table_of(runs: "list[Summary]") -> "Table":
    """Return the table of the runs."""
    from nptrace_base.tables import Table, number, percent
    from traces.identity import labels

    header = ["Run", "Triangles", "Nodes", "Rays", "Hit %", "Shadow", "Shadowed %", "Accesses", "Per ray", "Prefetches"]
    names = labels((run.identity for run in runs), by_path=True)
    rows = [
        [
            names[run.identity], number(run.n_triangles), number(run.n_nodes), number(run.n_rays), percent(run.hit_share, 1),
            number(run.n_shadow_rays), percent(run.shadowed_share, 1), number(run.n_accesses), number(run.accesses_per_ray, 1),
            number(run.n_prefetches),
        ]
        for run in runs
    ]  # fmt: skip
    return Table("", header, rows, extra=("Shadowed %", "Hit %", "Shadow", "Triangles", "Nodes", "Per ray"))
