"""nptrace map: the break-even map, from scenes to one table of speed-ups."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from nptrace.following import again
from nptrace.groups import Command
from nptrace.options import gathered, threads_option
from nptrace.output import Output, output_option, results_options
from nptrace.progress import Progress, done
from nptrace.scene_options import Scenes, scene_options
from nptrace_base.errors import NptraceError
from nptrace_base.places import place

if TYPE_CHECKING:
    from rtrace.scenes.scene import Scene


@click.command("map", cls=Command, old={"--part": "--one-in"})
@click.argument("names", metavar="SCENE...", nargs=-1, required=True)
@click.option("--pixels", default="128x128", show_default=True, metavar="WxH", help="Size of the picture in pixels.")
@click.option("--quick", is_flag=True, help="Two leaf sizes and two machines, in a minute.")
@click.option(
    "--one-in", type=click.IntRange(1, 16), metavar="N", default=1, show_default=True,
    help="Time one piece of the rays in N, for speed-ups with 95 % intervals in less time.",
)  # fmt: skip
@click.option(
    "--out", type=click.Path(path_type=Path), default="traces/map", show_default=True,
    help="Folder for the runs and the finished parts; the same command goes on where it stopped.",
)  # fmt: skip
@threads_option()
@output_option("--plot", "picture", binary="a picture", help="Write a plot as .png, .svg or .pdf.")
@scene_options
@results_options()
@gathered("scenes", Scenes)
def map_(
    scenes: Scenes, pixels: str, quick: bool, one_in: int, out: Path, threads: int, picture: Path | None, output: Output,
) -> None:  # fmt: skip
    """Map where prefetching pays: leaf size x triangle test x miss latency x rays in flight x cache, for each tree.

    The paper's unit (stack) and the request at the push (push), against no prefetching.

    \b
    nptrace map bunny --quick --one-in 8
    nptrace map bunny conference sibenik sponza -o map.parquet --plot map.png
    """
    from cachesim.report import map_tables
    from cachesim.report.pictures import check_plot

    began = time.perf_counter()
    if picture is not None:
        check_plot(picture)
    rows = mapped(scenes.load, pixels, out, quick=quick, one_in=one_in, threads=threads)
    if picture is not None:
        map_tables.plot(rows, picture)
    if picture is None or output.is_asked_for:
        output.write(rows, lambda: map_tables.tables(rows))
    what = f"{len(rows)} cells of {len(scenes.names)} scene{'s' * (len(scenes.names) != 1)}"
    done(what, began, " ".join(filter(None, ["npcache compare", again((), out, ())])))


def mapped(
    load: "Callable[[], list[Scene]]", pixels: str, out: Path, *, quick: bool, one_in: int, threads: int
) -> list[dict[str, Any]]:  # fmt: skip
    """Return the rows of the map of the scenes that ``load`` loads, which it does once the options are checked."""
    from cachesim.clock.sampled_rays import LEAST
    from nptrace.break_even import QUICK, Grid, break_even
    from rtrace.camera import parse_size
    from rtrace.render import Shooting

    if not isinstance(place(out), Path):
        raise NptraceError(f"--out {place(out)}: a map keeps rows beside its runs; name a folder of this machine")
    grid, shooting = QUICK if quick else Grid(), Shooting(*parse_size(pixels))
    if one_in > 1 and shooting.width * shooting.height < LEAST:
        raise NptraceError(
            f"--one-in takes {LEAST:,} primary rays, and {pixels} pixels have fewer; time all rays, or take more pixels"
        )
    scenes = load()
    with Progress(len(scenes) * len(grid.leaves) * len(grid.trees)) as bar:

        def on_phase(run: str, phase: str, total: int | None) -> Callable[[int], object]:
            if phase == "build":
                bar.job(run)
            return bar.phase(phase, total)

        return break_even(scenes, shooting, grid, out, threads=threads, on_phase=on_phase, one_in=one_in)
