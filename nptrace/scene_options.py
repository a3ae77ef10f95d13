"""Options that choose scenes, trees and rays, shared by the commands that trace."""

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import click

from nptrace.options import ListOf, merged, threads_option
from nptrace.progress import Progress, say
from nptrace_base.errors import NptraceError

if TYPE_CHECKING:
    from pathlib import Path

    from rtrace.camera import Camera
    from rtrace.ray_file import RayFile
    from rtrace.render import Shooting
    from rtrace.scenes.scene import Scene


def accel_option() -> Any:
    """Return the option for the trees, as a list of names."""
    return click.option(
        "--accel", type=ListOf("TREES", parse_tree), metavar="TREES", multiple=True, callback=merged,
        help="Trees to build, kdtree and bvh; both by default.",
    )  # fmt: skip


def parse_tree(name: str) -> str:
    """Return the name of a tree."""
    if name not in ("kdtree", "bvh"):
        raise NptraceError(f"{name!r} is no tree; write kdtree, bvh, or kdtree,bvh")
    return name


def scene_options(command: Any) -> Any:
    """Add the options that decide how scenes are found."""
    for option in (
        click.option("--offline", is_flag=True, help="Never download a scene."),
        click.option("--strict", is_flag=True, help="Refuse a mesh with bad triangles instead of leaving them out."),
    ):
        command = option(command)
    return command


def load_scenes(
    names: "Sequence[str | Scene]", strict: bool, offline: bool, cameras: Sequence[str] = (), light: str | None = None
) -> "list[Scene]":
    """Load scenes by name or file, each seen by every --camera and lit as --light says; notes on each go to stderr.

    A scene that is loaded already is taken as it is.
    """
    from rtrace.camera import parse_camera, parse_point
    from rtrace.scenes.catalog import load_scene
    from rtrace.scenes.scene import dropped_sentence, seen_from
    from traces.format import printable

    views: list[Camera | None] = [*map(parse_camera, cameras)] or [None]
    lamp = parse_point(light) if light else None
    scenes = []
    with Progress(len(names)) as progress:
        for name in names:
            progress.job(printable(name) if isinstance(name, str) else name.label)
            progress.phase("load")
            scene = load_scene(name, strict=strict, download=not offline, notify=say) if isinstance(name, str) else name
            for sentence in (dropped_sentence(scene), *scene.notes):
                if sentence:
                    say(sentence)
            scenes += [seen_from(scene, view, lamp) for view in views]
    return scenes


def own_rays(path: "Path", shooting: "Shooting", views: Sequence[str]) -> "RayFile":
    """Return the rays of --rays; NptraceError if options of a picture are given too."""
    from rtrace.ray_file import read_rays
    from rtrace.render import Shooting

    if views or shooting != Shooting():
        raise NptraceError(
            f"--rays {path} brings its own rays, and --pixels, --camera, --light, --order, --batch and --seed are those of a "
            "picture; leave them out"
        )
    return read_rays(path)


def check_run_names(names: Sequence[str], n_pictures: int) -> None:
    """Raise NptraceError unless there are no names, or one per picture and each can name a folder."""
    if names and len(names) != n_pictures:
        pictures = f"{n_pictures} picture{'s' * (n_pictures != 1)}"
        raise NptraceError(f"there are {len(names)} --name for {pictures}; give one per SCENE and --camera, in the same order")
    for name in names:
        if not re.fullmatch(r"[\w][\w.-]*", name):
            raise NptraceError(f"--name: {name!r} cannot name a run; use letters, digits, _ . and -, but no . or - first")


#: Parameters of the builders that a user may set, and the type of each.
BVH_PARAMS = {"c_trav": float, "c_isect": float, "min_leaf": int, "max_leaf": int}
KD_PARAMS = {"c_trav": float, "c_isect": float, "empty_bonus": float, "max_level": int, "min_leaf": int, "max_leaf": int}
BVH_BUILDERS = ("sweep", "binned")


def parse_kd(text: str) -> dict[str, Any]:
    """Return the builder's parameters that ``text`` sets: ``coarse`` or NAME=VALUE, separated by commas."""
    return _parse_builder("--kd", text, {"coarse": {"max_level": 16}}, KD_PARAMS)


def parse_bvh(text: str) -> dict[str, Any]:
    """Return the builder and its parameters that ``text`` sets: ``sweep``, ``binned`` or NAME=VALUE, separated by commas."""
    return {"builder": "sweep"} | _parse_builder("--bvh", text, {name: {"builder": name} for name in BVH_BUILDERS}, BVH_PARAMS)


def _parse_builder(
    option: str, text: str, words: dict[str, dict[str, Any]], names: dict[str, type[float] | type[int]]
) -> dict[str, Any]:
    params: dict[str, Any] = {}
    for part in filter(None, text.split(",")):
        name, equals, value = part.partition("=")
        if part in words:
            params |= words[part]
        elif not equals or name not in names:
            either = " nor ".join([*words, "NAME=VALUE"])
            raise NptraceError(f"{option}: {part!r} is neither {either} with one of the names {', '.join(names)}")
        else:
            try:
                params[name] = names[name](value)
            except ValueError:
                raise NptraceError(f"{option}: {name} must be a number, got {value!r}; write e.g. {name}=2") from None
    return params


#: The bytes of a BVH's node, one for each of its formats in ``traces.node_formats``, which a command's help does not load.
BVH_NODES = ["32", "64"]


def tree_params(accel: Sequence[str], kd_text: str, bvh_text: str, bvh_nodes: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return the parameters of the builder of each kind of tree, from --accel (both if empty), --kd, --bvh and --bvh-nodes."""
    from traces.node_formats import NODE_FORMATS, formats_of

    params: dict[str, dict[str, Any]] = {"kdtree": parse_kd(kd_text)}
    formats = formats_of("bvh")
    bvh = parse_bvh(bvh_text)
    for node_bytes in bvh_nodes:
        if node_bytes not in BVH_NODES:
            raise NptraceError(f"bvh_nodes: {node_bytes!r} is not one of {', '.join(BVH_NODES)}")
    params |= {formats[int(node_bytes)].name: bvh for node_bytes in bvh_nodes}
    return {kind: given for kind, given in params.items() if not accel or NODE_FORMATS[kind].tree in accel}


def bvh_nodes_option(help_: str) -> Any:
    """Return the option for the node formats of BVHs."""
    return click.option(
        "--bvh-nodes", type=click.Choice(BVH_NODES), multiple=True, default=["32"], show_default=True, help=help_
    )  # fmt: skip


@dataclass(frozen=True)
class Picture:
    """The values of ``picture_options``: the rays and the trees."""

    pixels: str = "2048x2048"
    order: str = "scanline"
    batch: int = 1
    kd_text: str = ""
    bvh_text: str = ""
    bvh_nodes: tuple[str, ...] = ("32",)
    seed: int = 0
    exact_below: int = 100_000_000
    threads: int = field(default_factory=lambda: os.cpu_count() or 1)

    def shooting(self) -> "Shooting":
        """Return the rays; the seed is also that of the sample, which must not change a run of another order."""
        from rtrace.camera import parse_size
        from rtrace.render import Shooting

        return Shooting(*parse_size(self.pixels), self.order, self.batch, self.seed if self.order == "random" else 0)


SAME = "As in nptrace render."


def picture_options(command: Any) -> Any:
    """Add the options of `nptrace render` that decide the rays and the trees, for commands that trace on demand."""
    orders = ["scanline", "tile", "morton", "hilbert", "random"]
    for option in reversed((
        click.option("--pixels", default="2048x2048", show_default=True, metavar="WxH", help="Size of the picture."),
        click.option("--camera", metavar="TEXT", help=SAME),
        click.option("--light", metavar="X,Y,Z", help=SAME),
        click.option("--order", type=click.Choice(orders), default="scanline", show_default=True, help=SAME),
        click.option("--batch", type=click.IntRange(0), default=1, show_default=True, help=SAME),
        click.option("--kd", "kd_text", metavar="NAME=VALUE,...", default="", help=SAME),
        click.option("--bvh", "bvh_text", metavar="BUILDER,NAME=VALUE,...", default="sweep", show_default=True, help=SAME),
        bvh_nodes_option(SAME),
        click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the sample and the order."),
        click.option(
            "--exact-below", type=click.IntRange(0), default=100_000_000, show_default=True, metavar="N",
            help="Count runs of up to N predicted accesses exactly, without sampling.",
        ),
        threads_option(),
        scene_options,
    )):  # fmt: skip
        command = option(command)
    return command
