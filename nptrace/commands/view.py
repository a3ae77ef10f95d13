"""nptrace view: the picture of runs, enlarged, or heat maps of what their pixels cost."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cachesim.clock.parameters import NUMBERS
from nptrace.clock_options import Machines, machine_options, machine_sources
from nptrace.groups import BadInput, Command
from nptrace.ignored import refuse
from nptrace.options import ListOf, gathered, merged, threads_option
from nptrace.output import output_option, unused
from nptrace.progress import Progress, done
from nptrace.sources import LAYOUT_HELP, PlaceOf, one_prefetch_option, policies
from nptrace.typed import given
from nptrace_base.errors import NptraceError
from nptrace_base.places import Place

if TYPE_CHECKING:
    from cachesim.heat import HeatMaps, HeatSetting
    from cachesim.report.heat_figure import Panel, Sheet
    from traces.reader import Run

#: What can be shown: ``cachesim.heat.KINDS``, which takes long to import, and the picture itself.
KINDS = (
    "picture", "accesses", "prefetches", "misses", "misses-without", "saved", "useful", "useless", "pollution",
    "miss-cycles", "late-cycles",
)  # fmt: skip


def parse_kind(text: str) -> str:
    """Return a kind of heat map."""
    if (kind := text.strip().lower()) not in KINDS:
        raise NptraceError(f"{text!r} is not a kind of heat map; choose from {', '.join(KINDS)}")
    return kind


@dataclass(frozen=True)
class ViewOptions:
    """What is shown of runs, by the names of the options; without kinds their pictures."""

    kinds: Sequence[str]
    difference: bool
    enlarge: int | None
    machines: Machines
    prefetch: str
    layout: str
    threads: int | None

    def check_machines(self) -> None:
        """Raise NptraceError if there are several caches or machines."""
        if len(self.machines.configs) * len(self.machines.clocks) > 1:
            raise NptraceError(
                f"view takes one cache and one machine, and the options ask for {len(self.machines.configs)} and "
                f"{len(self.machines.clocks)}; leave the others out"
            )

    def check(self, runs: "Sequence[Run]") -> None:
        """Raise NptraceError if the runs cannot be shown so."""
        if self.difference:
            _check_difference(runs, self.kinds)

    def draw(self, runs: "Sequence[Run]", path: Path) -> tuple[int, int]:
        """Write the picture, and return its size in dots."""
        from cachesim.heat import HeatMaps, HeatSetting
        from cachesim.prefetch import parse_prefetch
        from cachesim.report import heat_figure
        from cachesim.report.pictures import check_plot, ending_of
        from cachesim.source import RunSource

        if len(runs) == 1 and self.kinds in ([], ["picture"]):
            ending_of(path, [".png"])
            return _enlarge(runs[0], path, self.enlarge)
        check_plot(path)
        setting = HeatSetting(self.machines.configs[0], self.machines.clocks[0], parse_prefetch(self.prefetch))
        maps = [HeatMaps(RunSource(run, self.layout), setting, threads=self.threads) for run in runs]
        with Progress(len(runs)) as bar:
            sheet = _sheet(runs, maps, self.kinds or ["picture"], setting, bar, is_difference=self.difference)
            bar.phase("draw")
            panels = [panel for column in sheet.columns for panel in column]
            n = self.enlarge or heat_figure.enlargement([panel.values.shape for panel in panels], len(panels))
            return heat_figure.draw(sheet, path, n)


@click.command(
    cls=Command, lists={"Prefetch policies": policies, "Machines and where their numbers come from": machine_sources}
)
@click.argument("sources", metavar="RUN...", nargs=-1, type=PlaceOf())
@click.option(
    "--heat", "kinds", type=ListOf("KINDS", parse_kind), metavar="KINDS", multiple=True, callback=merged,
    help=f"Show numbers per pixel as colours: {', '.join(KINDS)}. misses to pollution are of a cache, cycles of a machine.",
)  # fmt: skip
@click.option("--difference", is_flag=True, help="Show the first run, and each other one minus the first.")
@click.option("--enlarge", type=click.IntRange(1, 64), metavar="N", help="Dots per pixel of the run, on either side.")
@machine_options("One cache and one machine.")
@one_prefetch_option(is_clocked=True)
@click.option("--layout", default="stored", show_default=True, metavar="LAYOUT", help=LAYOUT_HELP)
@threads_option()
@output_option(
    "-o",
    "--output",
    "path",
    binary="a picture",
    help="The picture: .png; heat maps also .svg and .pdf; - is stdout; by default RUN.png or RUN-KIND.png.",
)
@gathered("shown", ViewOptions)
def view(sources: tuple[Place, ...], shown: ViewOptions, path: Path | None) -> None:
    """Show the pictures of runs, enlarged, or what their pixels cost, as heat maps.

    All runs have one scale for each kind, so that colours can be compared. Without -o the picture is RUN.png or RUN-KIND.png
    in this folder.

    \b
    nptrace view traces/bunny-bvh
    nptrace view traces/bunny-kdtree traces/bunny-bvh --heat accesses
    nptrace view traces/bunny-bvh --heat picture,misses,saved --size 8K --assoc 2 -o bunny.png
    nptrace view traces/bunny-kdtree traces/bunny-bvh --heat misses --difference
    """
    from nptrace.sources import chosen_sources
    from traces.reader import find_runs, open_run

    began = time.perf_counter()
    if not sources:
        found = find_runs("traces")
        way = f"for instance nptrace view {found[0]}" if found else "which nptrace render SCENE makes"
        raise BadInput(f"nptrace view shows the runs that it is given, and none is named; name one, {way}")
    shown.check_machines()
    _check_used(shown.kinds, shown.prefetch)
    runs = [open_run(each) for each in chosen_sources(sources, Path())]
    shown.check(runs)
    path = path or _usual_path(runs, shown.kinds)
    size = shown.draw(runs, path)
    done(f"{path}: {size[0]} x {size[1]} pixels", began)


def _check_used(kinds: Sequence[str], prefetch: str) -> None:
    """Raise BadInput for an option of a cache, a machine or a policy that none of the kinds depends on."""
    of_cache = "machine", "size", "ways", "line", "policy", "seed", "layout"
    options = (*of_cache, *NUMBERS, "prefetch")
    if not set(kinds) - {"picture"}:
        refuse("pictures depend on no cache, machine or policy", *options, way=", or name what to show with --heat")
    if given(*options):
        from cachesim.heat import KINDS, needs
        from cachesim.prefetch import parse_prefetch

        policy, shown = parse_prefetch(prefetch), f"--heat {','.join(kinds)}"
        needed = {needs(kind, policy) for kind in kinds if kind in KINDS}
        if not needed & {"requests", "cache", "machine"}:
            refuse(f"{shown} depends on no policy", "prefetch")
        if not needed & {"cache", "machine"}:
            refuse(f"{shown} depends on no cache", *of_cache, *NUMBERS)
        if "machine" not in needed:
            refuse(f"{shown} depends on no machine, but on its cache alone", *NUMBERS)


def _usual_path(runs: "Sequence[Run]", kinds: Sequence[str]) -> Path:
    """Return the picture's name where -o gives none; a file of that name is kept."""
    return unused(Path("-".join([runs[0].name if len(runs) == 1 else "runs", *kinds]) + ".png"))


def _check_difference(runs: "Sequence[Run]", kinds: Sequence[str]) -> None:
    if len(runs) < 2 or not set(kinds) - {"picture"}:
        raise NptraceError("--difference compares numbers of two runs or more; name them, and a kind with --heat")
    first, *others = ((run.footer.width, run.footer.height) for run in runs)
    for run, size in zip(runs[1:], others, strict=True):
        if size != first:
            raise NptraceError(
                f"--difference takes pictures of one size, and {runs[0].path} has {first[0]}x{first[1]} pixels, {run.path} "
                f"{size[0]}x{size[1]}; render one of them again with --pixels"
            )


def _enlarge(run: "Run", path: Path, enlarge: int | None) -> tuple[int, int]:
    """Write the picture of a run, every pixel as a square."""
    from PIL import Image

    from cachesim.report.heat_figure import enlargement
    from nptrace_base.atomic import whole_file

    picture = Image.fromarray(picture_of(run))
    n = enlarge or enlargement([picture.size], 1)
    large = picture.resize((picture.width * n, picture.height * n), Image.Resampling.NEAREST)
    with whole_file(path) as temporary:
        large.save(temporary, format="PNG", optimize=True)
    return large.size


def _sheet(
    runs: "Sequence[Run]", maps: "Sequence[HeatMaps]", kinds: Sequence[str], setting: "HeatSetting", bar: Progress, *,
    is_difference: bool,
) -> "Sheet":  # fmt: skip
    """Return the panels: a column for each kind, in it one panel for each run."""
    from cachesim.report.heat_figure import Sheet
    from traces.identity import labels

    values: dict[str, list] = {kind: [] for kind in kinds}
    for run, of_run in zip(runs, maps, strict=True):
        bar.job(of_run.identity.run)
        for kind in kinds:
            progress = bar.phase(kind, run.n_accesses)
            values[kind].append(picture_of(run) if kind == "picture" else of_run.values(kind, progress))
    names = labels(each.identity for each in maps)
    titles = [names[each.identity] for each in maps]
    return Sheet([_column(kind, titles, values[kind], setting, is_difference=is_difference) for kind in kinds])


def _column(kind: str, titles: list[str], values: list, setting: "HeatSetting", *, is_difference: bool) -> "list[Panel]":
    """Return the panels of one kind."""
    from cachesim.heat import KINDS, SIGNED
    from cachesim.report.heat_figure import Panel, scale_of

    if kind == "picture":
        return [Panel(title, picture) for title, picture in zip(titles, values, strict=True)]
    label = ", ".join(filter(None, [f"{KINDS[kind][0]} per pixel", setting.text(kind)]))
    n_plain = 1 if is_difference else len(values)
    scale = scale_of(label, values[:n_plain], is_signed=kind in SIGNED)
    panels = [Panel(title, each, scale) for title, each in zip(titles[:n_plain], values[:n_plain], strict=True)]
    if is_difference:
        changes = [each - values[0] for each in values[1:]]
        scale = scale_of(f"difference: {label}; red: more than {titles[0]}, blue: fewer", changes, is_signed=True)
        others = [f"{title} \N{MINUS SIGN} {titles[0]}" for title in titles[1:]]
        panels += [Panel(title, each, scale) for title, each in zip(others, changes, strict=True)]
    return panels


def picture_of(run: "Run") -> Any:
    """Return the picture of a run, (height, width, 3) uint8."""
    import io

    import numpy as np
    from PIL import Image

    try:
        with Image.open(io.BytesIO(run.image())) as picture:
            return np.asarray(picture.convert("RGB"))
    except (OSError, SyntaxError) as e:  # Pillow's errors of what is no PNG
        raise NptraceError(f"{run.path / 'image.png'} is not a picture ({e}); render the run again") from e
