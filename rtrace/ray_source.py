"""Scene and tree -> the accesses of any stretch of the run, traced on demand into memory: the source of an estimate's samples.

The positions of a run are its pixels in shooting order; with all primary rays first, twice: once for the primary rays and once
for the shadow rays. Stretches of positions, joined in order, give the accesses of ``render`` one by one.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from nptrace_base.errors import NptraceError
from rtrace.camera import pixel_order
from rtrace.chunk import MOST_EVENTS, Chunk, shoot, smaller_pieces
from rtrace.render import Shooting, command_of, footer_of
from rtrace.run_names import run_name
from rtrace.scenes.scene import Scene
from rtrace.traverse import NoRoomError
from rtrace.trees.rtsah import cheaper_children
from rtrace.trees.tree import Tree, node_table
from traces.format import LEAF, PRIMARY, SHADOW
from traces.identity import identity_of
from traces.node_formats import NODE_FORMATS

_STRIP = 512  # pixels: eight squares of 8 x 8, one strip of Manta's tile
_LEAST_UNITS = 128  # of a picture with few rows
_LEAST_UNIT = 256  # pixels of a unit of a narrow picture: a smaller unit costs as much again to warm up
_SCOUT_SIDE, _SCOUT_STEPS = 128, (8, 32)  # scout rays along a side, and pixels between two of them
_LEAST_GROUP = 32  # scout rays of a group


class RayAccesses(NamedTuple):
    """Accesses of nodes in memory in the order of the run, and the number of rays that made them."""

    nodes: np.ndarray  # (n,) uint32
    kinds: np.ndarray  # (n,) uint8
    n_rays: int


class RayUnits:
    """The run of one scene, tree and shooting; any stretch of it can be traced.

    Attributes
    ----------
    identity : RunIdentity
        Under the name that ``render`` gives the run, which is not on disk.
    n_positions : int
    key : str
        The command that makes the run, and the scene: everything that decides its accesses.
    unit, row : int
        Positions to sample together, and the distance between a position and its neighbour in the next row.
    grain : int
        A stretch starts and ends at multiples of it: a batch of primary rays is never cut.
    node_bytes : int
    reads_leaves : bool
        Whether leaves are nodes in memory (``traces.node_formats``); entering one is no access where they are not.
    nodes : dict
        Columns ``parent``, ``level``, ``n_prims`` of the tree's nodes, as in ``nodes.parquet``.
    """

    def __init__(self, scene: Scene, tree: Tree, shooting: Shooting) -> None:
        if shooting.packet > 1:
            raise NptraceError(
                f"an estimate samples single rays, and not packets of {shooting.packet}; render the run and replay it instead"
            )
        if shooting.shadow_order == "cheaper":
            tree = tree._replace(cheaper=cheaper_children(tree))
        self._tree, self._light, self._shooting = tree, scene.light, shooting
        self._frame = scene.camera.frame(shooting.width, shooting.height)
        self._pixels = pixel_order(shooting.order, shooting.width, shooting.height, shooting.seed)
        self._n_pixels = len(self._pixels)
        self.identity = identity_of(footer_of(scene, tree, shooting, ""), run_name(scene, tree.kind, tree.params, shooting))
        # Counts are kept wherever the mesh lies.
        self.key = f"{scene.sha256}\n{command_of(scene._replace(source=Path(scene.source).name), tree, shooting)}"
        self.unit = unit_of(shooting)
        self.row = max(shooting.width, self.unit) if shooting.order == "scanline" else self.unit
        self.n_positions = self._n_pixels * (1 if shooting.batch else 2)
        self.grain = shooting.batch or 1
        self.node_bytes, self.reads_leaves = NODE_FORMATS[tree.kind].node_bytes, NODE_FORMATS[tree.kind].reads_leaves
        table = node_table(tree)
        self.nodes: Mapping[str, np.ndarray] = {name: table[name] for name in ("parent", "level", "n_prims")}

    def trace(self, cuts: Sequence[int]) -> list[RayAccesses]:
        """Return the accesses of the positions from each of ``cuts`` up to the next; they ascend."""
        if self._shooting.batch:
            stretches = _cut(self._chunks(self._pixels[cuts[0] : cuts[-1]], self._shooting.batch, None), cuts)
        else:
            stretches = [self._of_passes(start, stop) for start, stop in pairwise(cuts)]
        return self._accesses(stretches)

    def _accesses(self, stretches: list[RayAccesses]) -> list[RayAccesses]:
        """Return the rows of stretches that are accesses of nodes in memory."""
        if self.reads_leaves:
            return stretches
        kept = [each.kinds != LEAF for each in stretches]
        return [
            RayAccesses(each.nodes[keep], each.kinds[keep], each.n_rays) for each, keep in zip(stretches, kept, strict=True)
        ]

    def _of_passes(self, start: int, stop: int) -> RayAccesses:
        """Return a stretch of a run with all primary rays first."""
        chunks: list[Chunk] = []
        for which, first in ((PRIMARY, 0), (SHADOW, self._n_pixels)):
            low, high = max(start - first, 0), min(stop - first, self._n_pixels)
            if low < high:
                chunks += self._chunks(self._pixels[low:high], high - low, which)
        return _whole(chunks)

    def probe(self, n: int, seed: int) -> float:
        """Return the mean number of accesses, prefetches included, of a position, from ``n`` random pixels."""
        chosen = np.sort(np.random.default_rng(seed).integers(self._n_pixels, size=n))
        [all_of_them] = self._accesses([_whole(self._chunks(self._pixels[chosen], 1, None))])
        n_accesses = all_of_them.nodes.size
        return n_accesses / n * self._n_pixels / self.n_positions

    def scout(self, seed: int) -> tuple[np.ndarray, list[RayAccesses], np.ndarray]:
        """Return the rays of a lattice of pixels, in groups along the run.

        Returns
        -------
        places : (g,) float64
            Position in the run of the middle of every group, ascending.
        groups : list of RayAccesses
        looked : (k,) int64
            Positions traced.
        """
        width = self._shooting.width
        step = min(max(max(width, self._shooting.height) // _SCOUT_SIDE, _SCOUT_STEPS[0]), _SCOUT_STEPS[1])
        x, y = np.random.default_rng([seed, step]).integers(step, size=2)
        if self._shooting.order == "scanline":
            at = (np.arange(y, self._shooting.height, step)[:, None] * width + np.arange(x, width, step)).ravel()
        else:
            at = np.flatnonzero((self._pixels % width % step == x) & (self._pixels // width % step == y))
        cuts = [*range(0, len(at), max(-(-width // step), _LEAST_GROUP)), len(at)]
        places = np.array([at[low:high].mean() for low, high in pairwise(cuts)])
        pixels = self._pixels[at]
        if self._shooting.batch:
            return places, self._accesses(_cut(self._chunks(pixels, 1, None), cuts)), at
        groups = [
            _whole(self._chunks(pixels[low:high], high - low, which))
            for which in (PRIMARY, SHADOW)
            for low, high in pairwise(cuts)
        ]
        positions = np.concatenate([at, at + self._n_pixels])
        return np.concatenate([places, places + self._n_pixels]), self._accesses(groups), positions

    def _chunks(self, pixels: np.ndarray, batch: int, which: int | None) -> Iterator[Chunk]:
        """Yield the chunks of pixels: one, or as many as ``MOST_EVENTS`` takes, as when rendering."""
        waiting = [(0, len(pixels), which)]
        while waiting:
            start, stop, pass_ = waiting.pop()
            given = self._tree, self._frame, self._light, pixels[start:stop], self._shooting, batch
            try:
                yield shoot(*given, pass_, MOST_EVENTS)
            except NoRoomError:
                waiting += reversed(smaller_pieces(start, stop, batch, pass_))


def _whole(chunks: Iterable[Chunk]) -> RayAccesses:
    """Join chunks; the rest of their columns is let go one chunk after the other."""
    nodes, kinds, n_rays = np.empty(0, np.uint32), np.empty(0, np.uint8), 0
    for chunk in chunks:
        nodes, kinds = _joined(nodes, chunk.accesses["node"]), _joined(kinds, chunk.accesses["kind"])
        n_rays += len(chunk.rays["ray"])
    return RayAccesses(nodes, kinds, n_rays)


def _joined(array: np.ndarray, more: np.ndarray) -> np.ndarray:
    """Return an array with another behind it: in its own memory, because a join of all at the end takes all of it twice."""
    n = array.size
    if not n:
        return more
    if not array.flags.owndata:
        array = array.copy()  # the first of several
    array.resize(n + more.size, refcheck=False)
    array[n:] = more
    return array


def _cut(chunks: Iterable[Chunk], cuts: Sequence[int]) -> list[RayAccesses]:
    """Cut chunks at pixels; tracing them at once takes less time than one call for each piece."""
    types, counts = [np.empty(0, np.uint8)], [np.zeros(1, np.uint32)]

    def seen() -> Iterator[Chunk]:
        for chunk in chunks:
            types.append(chunk.rays["type"])
            counts.append(chunk.rays["count"])
            yield chunk

    nodes, kinds, n_rays = _whole(seen())
    # A cut lies before a primary ray; behind the last one there is none.
    ray_at = np.append(np.flatnonzero(np.concatenate(types) == PRIMARY), n_rays)[np.subtract(cuts, cuts[0])]
    row_at = np.cumsum(np.concatenate(counts), dtype=np.int64)[ray_at]
    return [
        RayAccesses(nodes[low:high], kinds[low:high], int(last - first))
        for (low, high), (first, last) in zip(pairwise(row_at), pairwise(ray_at), strict=True)
    ]


def unit_of(shooting: Shooting) -> int:
    """Return how many pixels in a row of the shooting order an estimate samples together.

    Scanline: a row, because whole rows differ little from their neighbours, while pieces of rows do not add up to anything
    that does; narrow pictures take several, flat ones are cut into pieces so that there are units to choose from. Other
    orders: a strip of a tile, or as much of a curve. Measured in docs/speed-error.md.
    """
    if shooting.order != "scanline":
        return _STRIP
    if shooting.height < _LEAST_UNITS:
        return -(-shooting.width // -(-_LEAST_UNITS // shooting.height))
    rows = min(-(-_LEAST_UNIT // shooting.width), shooting.height // _LEAST_UNITS)
    return rows * shooting.width
