"""nptrace render: scenes -> runs."""

import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from nptrace.following import named
from nptrace.groups import Command
from nptrace.ignored import refuse
from nptrace.options import gathered, threads_option, workers_options
from nptrace.output import Output, results_options
from nptrace.progress import Progress, done, size_text
from nptrace.scene_options import (
    PictureOptions,
    Scenes,
    Trees,
    check_run_names,
    own_rays,
    packet_options,
    ray_options,
    scene_options,
    tree_options,
)
from nptrace.sources import PlaceOf
from nptrace_base.places import Place

if TYPE_CHECKING:
    from nptrace_base.tables import Table
    from rtrace.ray_file import RayFile
    from rtrace.render import RunFacts, Shooting


@click.command(cls=Command, old={"--size": "--pixels"})
@click.argument("names", metavar="SCENE...", nargs=-1, required=True)
@tree_options
@ray_options("128x128")
@packet_options
@click.option(
    "--rays", "ray_file", type=click.Path(path_type=Path), metavar="FILE.parquet",
    help="Trace these rays instead of a picture's: columns origin, direction and, if you like, t_min, t_max, any_hit.",
)  # fmt: skip
@click.option(
    "--out", type=PlaceOf(), default="traces", show_default=True,
    help="Folder for the runs, also in an object store: s3://, gs:// or abfs://, with keys from the environment.",
)  # fmt: skip
@click.option(
    "--name", "run_names", multiple=True, metavar="NAME",
    help="Name of the run, before -kdtree, -bvh or -bvh64, instead of the usual one; once per SCENE and --camera.",
)  # fmt: skip
@click.option("--overwrite", is_flag=True, help="Replace a run of other content that has the same name.")
@workers_options
@threads_option()
@scene_options
@results_options()
@gathered("scenes", Scenes)
@gathered("trees", Trees)
@gathered("picture", PictureOptions)
# Many parameters: one per option, as click passes them.
def render(
    scenes: Scenes, trees: Trees, picture: PictureOptions, ray_file: Path | None, out: Place, run_names: tuple[str, ...],
    overwrite: bool, workers: int, scheduler: str | None, threads: int, output: Output,
) -> None:  # fmt: skip
    """Trace pictures of scenes and write one run per scene and tree.

    A SCENE is a mesh file or a name that `nptrace scenes` lists. A run is named <scene>-<tree>, <scene>-bvh64 if the BVH has
    nodes of 64 bytes, followed by what differs from the defaults, as in sponza-bvh-morton-512x512. The same command replaces
    its run; another run of that name is kept unless you give --overwrite.

    \b
    nptrace render bunny
    nptrace render a/scene.gltf b/scene.gltf --name chair --name table
    nptrace render model.obj --accel bvh --pixels 512x512 --camera "eye=0,2,5 at=0,0,0"
    nptrace render sponza --pixels 512x512 --order tile --packet 64
    """
    from nptrace.studies import rendered
    from nptrace_base.engines import engine_of

    began = time.perf_counter()
    check_run_names(run_names, len(scenes.names) * max(len(scenes.cameras), 1))
    shooting: Shooting | RayFile = picture.shooting()
    if ray_file is not None:
        of_picture = "pixels", "cameras", "light", "order", "batch", "seed", "packet", "shadow", "shadow_order", "shadow_end"
        refuse(f"--rays {ray_file} brings its own rays, and has no picture", *of_picture)
        shooting = own_rays(ray_file, picture.shooting(), scenes.views)
    params, seen = trees.params(), scenes.load()
    with engine_of(workers, scheduler) as engine, Progress(len(seen) * len(params)) as bar:
        runs = rendered(
            seen, params, shooting, out, bar, names=run_names, overwrite=overwrite, threads=threads, engine=engine
        )  # fmt: skip
    output.write([run.to_dict() for run in runs], lambda: ([table_of(runs)], []))
    n_rays, n_bytes = sum(run.n_rays for run in runs), sum(run.n_bytes for run in runs)
    what = f"{len(runs)} run{'s' * (len(runs) != 1)}, {n_rays:,} rays, {size_text(n_bytes)}"
    subject = named([out / run.identity.run for run in runs])
    done(what, began, " ".join(filter(None, ["npcache replay", subject, "--size 8K,16K"])))


def table_of(runs: "list[RunFacts]") -> "Table":
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
