"""Options that choose scenes, trees and rays, shared by the commands that trace."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import click

from nptrace.options import Choice, ListOf, list_option, merged, seed_option
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
    if (found := name.strip().lower()) not in ("kdtree", "bvh"):
        raise NptraceError(f"{name!r} is not a tree; write kdtree, bvh, or kdtree,bvh")
    return found


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
            f"--rays {path} brings its own rays, and --pixels, --camera, --light, --order, --batch, --seed, --packet and "
            "--shadow are those of a picture; leave them out"
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


def refuse_one_name(names: Sequence[str], verb: str) -> None:
    """Raise NptraceError if two of a command's scenes would have one name in its rows; ``verb`` is what is done with them."""
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise NptraceError(
            f"two scenes, or two cameras, would both be {twice} in every row; rename a file, or {verb} them apart"
        )


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


def parse_bvh_nodes(text: str) -> str:
    """Return the bytes of a BVH's node."""
    if text not in BVH_NODES:
        raise NptraceError(f"{text!r} is not one of {', '.join(BVH_NODES)}")
    return text


def tree_params(accel: Sequence[str], kd_text: str, bvh_text: str, bvh_nodes: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return the parameters of the builder of each kind of tree, from --accel (both if empty), --kd, --bvh and --bvh-nodes."""
    from traces.node_formats import NODE_FORMATS, formats_of

    params: dict[str, dict[str, Any]] = {"kdtree": parse_kd(kd_text)}
    formats = formats_of("bvh")
    bvh = parse_bvh(bvh_text)
    for node_bytes in bvh_nodes:
        try:
            parse_bvh_nodes(node_bytes)
        except NptraceError as e:
            raise NptraceError(f"bvh_nodes: {e}") from e
    params |= {formats[int(node_bytes)].name: bvh for node_bytes in bvh_nodes}
    return {kind: given for kind, given in params.items() if not accel or NODE_FORMATS[kind].tree in accel}


@dataclass(frozen=True)
class Scenes:
    """The scenes that options name, and how they are seen."""

    names: tuple[str, ...]
    strict: bool = False
    offline: bool = False
    cameras: tuple[str, ...] = ()
    light: str | None = None

    def load(self) -> "list[Scene]":
        """Return the scenes, each seen by every camera."""
        return load_scenes(self.names, self.strict, self.offline, self.cameras, self.light)

    @property
    def views(self) -> list[str]:
        """The cameras, and the light, that are given."""
        return [*self.cameras, *([self.light] if self.light else [])]


@dataclass(frozen=True)
class Trees:
    """The values of ``tree_options``."""

    accel: Sequence[str] = ()
    kd_text: str = ""
    bvh_text: str = ""
    bvh_nodes: Sequence[str] = ("32",)

    def params(self) -> dict[str, dict[str, Any]]:
        """Return the parameters of the builder of each kind of tree."""
        return tree_params(self.accel, self.kd_text, self.bvh_text, self.bvh_nodes)


@dataclass(frozen=True)
class PictureOptions:
    """The values of ``ray_options``, and of ``packet_options`` where a command has them."""

    pixels: str = "2048x2048"
    order: str = "scanline"
    batch: int = 1
    seed: int = 0
    packet: int | str = 1
    shadow: str = "lit"
    shadow_order: str = "sign"
    shadow_end: str = "stop"

    def shooting(self) -> "Shooting":
        """Return the rays."""
        from rtrace.camera import parse_size
        from rtrace.shooting import Shooting

        shot = Shooting(*parse_size(self.pixels), self.order, self.batch, self.seed)
        return replace(
            shot, packet=int(self.packet), shadow=self.shadow, shadow_order=self.shadow_order, shadow_end=self.shadow_end
        )


def tree_options(command: Any) -> Any:
    """Add the options that decide the trees."""
    for option in reversed((
        accel_option(),
        click.option(
            "--kd", "kd_text", metavar="NAME=VALUE,...", default="",
            help="kd-tree builder: c_trav, c_isect, empty_bonus, max_level, min_leaf, max_leaf; `coarse` is max_level=16.",
        ),
        click.option(
            "--bvh", "bvh_text", metavar="BUILDER,NAME=VALUE,...", default="sweep", show_default=True,
            help="BVH builder: sweep, exact SAH over all centroids, or binned, up to 16 bins; c_trav, c_isect, min_leaf, "
            "max_leaf.",
        ),
        list_option(
            "--bvh-nodes", item=parse_bvh_nodes, metavar="BYTES", default="32",
            help="Bytes of a BVH node: 32 holds its own box, 64 both children's; 32,64 makes a run of each.",
        ),
    )):  # fmt: skip
        command = option(command)
    return command


def ray_options(pixels: str, seed_help: str = "Seed of the random order.") -> Any:
    """Return a decorator that adds the options that decide the view and the rays; ``pixels`` is the usual size."""

    def add(command: Any) -> Any:
        for option in reversed((
            click.option("--pixels", default=pixels, show_default=True, metavar="WxH", help="Size of the picture in pixels."),
            click.option(
                "--camera", "cameras", multiple=True, metavar="TEXT",
                help="'eye=1,2,3 at=0,0,0 up=0,1,0 fov=45'; by default the scene's or a fitted one. May be repeated.",
            ),
            click.option(
                "--light", metavar="X,Y,Z", help="Position of the point light; by default the scene's or a fitted one."
            ),
            click.option(
                "--order", type=Choice(["scanline", "tile", "morton", "hilbert", "random"]), default="scanline",
                show_default=True, help="Order in which the pixels are traced.",
            ),
            click.option(
                "--batch", type=click.IntRange(0), default=1, show_default=True,
                help="Primary rays traced before their shadow rays; 0 means all of them.",
            ),
            seed_option(seed_help),
        )):  # fmt: skip
            command = option(command)
        return command

    return add


def packet_options(command: Any) -> Any:
    """Add the options that decide which rays walk a tree as one, and how shadow rays do."""
    for option in reversed((
        click.option(
            "--packet", type=Choice(["1", "4", "16", "64"]), default="1", show_default=True,
            help="Primary rays that walk the tree as one, then their shadow rays: the pixels of aligned squares, in the order "
            "of their first pixels. A node is read once for all of them; 64 with --order tile is Manta.",
        ),
        click.option(
            "--shadow", type=Choice(["lit", "hit", "all"]), default="lit", show_default=True,
            help="Pixels that send a shadow ray: with a hit on a surface that faces the light, with a hit, or all.",
        ),
        click.option(
            "--shadow-order", type=Choice(["sign", "cheaper"]), default="sign", show_default=True,
            help="Child that a shadow ray searches first: by the sign of its direction, or the cheaper to search (RTSAH).",
        ),
        click.option(
            "--shadow-end", type=Choice(["stop", "drain"]), default="stop", show_default=True,
            help="After the hit of a shadow ray: stop, or read on as Manta's packets do: what waits on a BVH's stack, or a "
            "kd-tree up to the closest hit.",
        ),
    )):  # fmt: skip
        command = option(command)
    return command
