"""Scene and tree -> a run: chunks of pixels traced by threads, written in shooting order, with the picture.

The run's bytes do not depend on the number of threads: chunks have a fixed size and are written in order.
"""

import io
import shlex
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import asdict
from functools import lru_cache, partial
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from nptrace_base.errors import NptraceError
from nptrace_base.places import Place
from nptrace_base.pools import thread_pool
from nptrace_base.shell import word
from rtrace.camera import Camera, Point, format_camera
from rtrace.chunk import MOST_EVENTS, Chunk, shoot, smaller_pieces
from rtrace.counts import RunCounts
from rtrace.packets import packet_starts, shot_pixels
from rtrace.ray_file import RayFile, ray_chunks
from rtrace.run_names import run_name
from rtrace.scenes.scene import Scene
from rtrace.shooting import Shooting as Shooting
from rtrace.traverse import NoRoomError
from rtrace.trees.rtsah import cheaper_children
from rtrace.trees.tree import Tree, node_tables
from rtrace.trees.tree_cache import cached_tree
from traces.footer import CameraFacts, Footer, SceneFacts, TreeFacts
from traces.format import BOX, PRIMARY, ROW_GROUP, SHADOW, SPLIT, printable
from traces.identity import RunIdentity, identity_of
from traces.node_formats import NODE_FORMATS
from traces.writer import RunWriter, refuse_other

CHUNK = 8192  # pixels: some ms of work, so that threads end together, and some MB of accesses
AHEAD = 1  # chunks traced but not yet written, per thread

#: Called with a run, its phase, and an amount to do or None; returns what is called with the amount done.
Phase = Callable[[str, str, int | None], Callable[[int], object]]

Piece = tuple[int, int, int | None]  # first packet, the one after the last, which pass


class RunFacts(NamedTuple):
    """The counts of a run, for a line of output."""

    identity: RunIdentity
    n_triangles: int
    n_nodes: int
    n_rays: int
    n_hits: int  # primary rays that hit something
    n_shadow_rays: int
    n_shadowed: int
    n_accesses: int  # demand, of nodes in memory; prefetch requests are counted separately
    n_prefetches: int
    n_bytes: int  # of the four files

    def to_dict(self) -> dict[str, Any]:
        """Return the record of the run."""
        counts = {name: value for name, value in self._asdict().items() if name != "identity"}
        return {**self.identity.to_dict(), **counts}

    @property
    def hit_share(self) -> float | None:
        """Share of the primary rays that hit something; None without primary rays."""
        n = self.n_rays - self.n_shadow_rays
        return self.n_hits / n if n else None

    @property
    def shadowed_share(self) -> float | None:
        """Share of the shadow rays that are blocked; None without shadow rays."""
        return self.n_shadowed / self.n_shadow_rays if self.n_shadow_rays else None

    @property
    def accesses_per_ray(self) -> float:
        """Demand accesses per ray, of both types."""
        return self.n_accesses / self.n_rays


class CameraAndLight(NamedTuple):
    """What tracing takes of a scene beside its triangles, which a tree has."""

    camera: Camera
    light: Point


def chunks(
    tree: Tree, scene: Scene | CameraAndLight, shooting: Shooting, threads: int, stretch: Iterable[Piece] | None = None
) -> Iterator[Chunk]:
    """Yield the traced chunks in shooting order, at most ``AHEAD`` x threads of them in memory.

    A chunk has as many pixels as ``chunk.MOST_EVENTS`` allows, at most about ``CHUNK``. ``stretch`` are some of the picture's
    ``pieces``, one after the other; by default all.

    Raises
    ------
    ValueError
        threads is below 1.
    """
    if threads < 1:
        raise NptraceError(f"threads must be at least 1, got {threads}")
    frame = scene.camera.frame(shooting.width, shooting.height)
    pixels, starts = shot(shooting)
    batch = shooting.n_together or len(starts) - 1
    following = iter(pieces(shooting) if stretch is None else stretch)
    if shooting.shadow_order == "cheaper":
        tree = tree._replace(cheaper=cheaper_children(tree))
    waiting: deque[tuple[Piece, Future[Chunk]]] = deque()
    with thread_pool(threads) as pool:

        def submitted(piece: Piece) -> tuple[Piece, Future[Chunk]]:
            start, stop, which = piece
            chosen = pixels[starts[start] : starts[stop]]
            return piece, pool.submit(shoot, tree, frame, scene.light, chosen, shooting, batch, which, MOST_EVENTS)

        waiting.extend(map(submitted, islice(following, AHEAD * threads)))
        try:
            while waiting:
                piece, future = waiting.popleft()
                try:
                    chunk = future.result()
                except NoRoomError:
                    start, stop, which = piece
                    waiting.extendleft(map(submitted, reversed(smaller_pieces(start, stop, batch, which))))
                    continue
                yield chunk
                waiting.extend(map(submitted, islice(following, max(AHEAD * threads - len(waiting), 0))))
        finally:
            for _, future in waiting:
                future.cancel()


@lru_cache(1)
def shot(shooting: Shooting) -> tuple[np.ndarray, Sequence[int] | np.ndarray]:
    """Return the pixels of a picture, (n,) uint32 in shooting order, and where each packet begins among them, as ``packets``.

    The last ones are kept, for a worker that traces part after part of a picture.
    """
    pixels = shot_pixels(shooting)
    return pixels, packet_starts(pixels, shooting)


def pieces(shooting: Shooting) -> Iterator[Piece]:
    """Yield the (start, stop, pass) of the chunks of a picture, in packets; a single ray is a packet of one.

    Of batches beyond a chunk the primary rays come first.
    """
    n, most = len(shot(shooting)[1]) - 1, CHUNK // shooting.packet
    batch = shooting.n_together or n
    if batch <= most:
        step = batch * (most // batch)
        yield from ((start, min(start + step, n), None) for start in range(0, n, step))
        return
    for first in range(0, n, batch):
        for which in (PRIMARY, SHADOW):
            last = min(first + batch, n)
            yield from ((start, min(start + most, last), which) for start in range(first, last, most))


def command_of(scene: Scene, tree: Tree, shooting: Shooting | RayFile) -> str:
    """Return the command that makes this run again, with every option spelled out."""
    given = [f"{name}={value}" for name, value in tree.params.items() if name not in ("builder", "max_refs")]
    node_format = NODE_FORMATS[tree.kind]
    if node_format.tree == "kdtree":
        builder = ["--kd", ",".join(given)]
    else:
        builder = ["--bvh", ",".join([tree.params["builder"], *given])]
    if node_format.version > 1:
        builder += ["--bvh-nodes", str(node_format.node_bytes)]
    words = ["nptrace", "render", word(scene.source), "--accel", node_format.tree]
    if isinstance(shooting, RayFile):
        return " ".join([*words, "--rays", word(shooting.source), *map(shlex.quote, builder)])
    options = [
        "--pixels", f"{shooting.width}x{shooting.height}",
        "--camera", format_camera(scene.camera), "--light", ",".join(map(repr, scene.light)),
        "--order", shooting.order, "--batch", str(shooting.batch), "--seed", str(shooting.seed), *_knobs(shooting), *builder,
    ]  # fmt: skip
    return " ".join([*words, *map(shlex.quote, options)])


def _knobs(shooting: Shooting) -> list[str]:
    """Return the options of packets and shadow rays that are not as usual, so that usual commands are as they always were."""
    names, usual = ("packet", "shadow", "shadow_order", "shadow_end"), Shooting()
    given = [(name, getattr(shooting, name)) for name in names if getattr(shooting, name) != getattr(usual, name)]
    return [word for name, value in given for word in (f"--{name.replace('_', '-')}", str(value))]


def footer_of(scene: Scene, tree: Tree, shooting: Shooting | RayFile, tool_version: str) -> Footer:
    """Return the footer of a run: everything that decides its bytes, and nothing else."""
    return Footer(
        tool_version=tool_version,
        command=command_of(scene, tree, shooting),
        scene=SceneFacts(scene.name, scene.label, printable(scene.source), scene.sha256, len(scene.triangles), scene.stand_in),
        camera=CameraFacts(**asdict(scene.camera)),
        light=scene.light,
        **(shooting.facts() if isinstance(shooting, RayFile) else asdict(shooting)),
        tree=TreeFacts(tree.kind, NODE_FORMATS[tree.kind].node_bytes, tree.params),
    )


def render(
    scene: Scene,
    tree: Tree,
    shooting: Shooting | RayFile,
    path: Path,
    *,
    threads: int = 2,
    tool_version: str = "",
    progress: Callable[[int], object] = lambda pixels: None,
    on_write: Callable[[], object] = lambda: None,
) -> RunFacts:
    """Trace a picture, or the rays of a file, and write the run at ``path`` atomically.

    Parameters
    ----------
    progress : callable
        Called with the number of pixels done, chunk by chunk.
    on_write : callable
        Called when all is traced and the files are completed.
    """
    node_format = NODE_FORMATS[tree.kind]
    fields = SPLIT if node_format.tree == "kdtree" else BOX
    if isinstance(shooting, RayFile):
        width, height, traced = 1, 1, ray_chunks(tree, shooting, threads)  # there is no picture
    else:
        width, height, traced = shooting.width, shooting.height, chunks(tree, scene, shooting, threads)
    picture = np.zeros((height * width, 3), np.uint8)
    counts = RunCounts()
    footer = footer_of(scene, tree, shooting, tool_version)
    with RunWriter(path, footer, fields) as run:
        run.append("nodes", partial(node_tables, tree, ROW_GROUP))
        for chunk in traced:
            counts.add(chunk)
            run.append("rays", chunk.rays)
            run.append("accesses", chunk.accesses)
            if chunk.is_shaded:
                picture[chunk.pixels] = chunk.colours
                progress(len(chunk.pixels))
        on_write()
        run.complete()
        run.image(png(picture.reshape(height, width, 3)))
    return summary(footer, path, counts, len(tree.nodes), sum(file.stat().st_size for file in path.iterdir()))


def summary(footer: Footer, path: Place, counts: RunCounts, n_nodes: int, n_bytes: int) -> RunFacts:
    """Return the counts of the run at a place."""
    n_leaves = 0 if footer.tree.node_format.reads_leaves else counts.n_leaves
    return RunFacts(
        identity_of(footer, printable(path.name), printable(str(path))), footer.scene.n_triangles, n_nodes, counts.n_rays,
        counts.n_hits, counts.n_shadow, counts.n_shadowed, counts.n_accesses - counts.n_prefetches - n_leaves,
        counts.n_prefetches, n_bytes,
    )  # fmt: skip


# Many parameters: those of one render, and how the runs of several are named and made.
def render_all(
    scenes: Sequence[Scene],
    params: Mapping[str, Mapping[str, Any]],
    shooting: Shooting | RayFile,
    folder: Place,
    *,
    names: Sequence[str] = (),
    overwrite: bool = True,
    threads: int = 2,
    tool_version: str = "",
    on_phase: Phase = lambda run, phase, total: lambda done: None,
    render_one: Callable[..., RunFacts] = render,
) -> Iterator[RunFacts]:
    """Render each scene with each tree of ``params`` (kind -> builder parameters) as a run in ``folder``.

    ``run_names`` names the runs; with ``names``, one per scene, they are ``<name>-<tree>``. The trees are built by threads
    ahead of the pictures; summaries come as the runs are written. ``on_phase`` is called at the start of each phase of a run,
    ``build``, ``trace`` and ``write``, with the run's name, and for ``trace`` with the number of pixels; what it returns is
    called with the number done. ``render_one`` is ``render``, or ``part_render.render_parts``.

    Raises
    ------
    NptraceError
        Two scenes would have one run, or another run exists and ``overwrite`` is not set; nothing is traced then.
    """
    paths = [
        folder / (f"{names[i]}-{kind}" if names else run_name(scene, kind, given, shooting))
        for i, scene in enumerate(scenes) for kind, given in params.items()
    ]  # fmt: skip
    twice = next((path for path in paths if paths.count(path) > 1), None)
    if twice is not None:
        raise NptraceError(f"two scenes would both be {twice}; name them apart with --name, once per SCENE and --camera")
    if isinstance(shooting, Shooting):
        for kind in params:
            shooting.check_format(kind)
    n_steps = shooting.n_rays if isinstance(shooting, RayFile) else shooting.width * shooting.height
    build = partial(cached_tree, threads=threads)
    with thread_pool(threads) as pool:
        jobs = [(s, pool.submit(build, s, kind, **given)) for s in scenes for kind, given in params.items()]
        for path, (scene, tree) in zip(paths, jobs, strict=True):
            if path.exists() and not overwrite:
                refuse_other(path, footer_of(scene, tree.result(), shooting, tool_version))
        for path, (scene, tree) in zip(paths, jobs, strict=True):
            on_phase(path.name, "build", None)
            built = tree.result()
            traced = on_phase(path.name, "trace", n_steps)
            yield render_one(
                scene, built, shooting, path, threads=threads, tool_version=tool_version, progress=traced,
                on_write=partial(on_phase, path.name, "write", None),
            )  # fmt: skip


def png(pixels: np.ndarray) -> bytes:
    """Return the PNG file of a picture, (height, width, 3) uint8."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG", compress_level=1)
    return buffer.getvalue()
