"""Camera, light and tree -> one chunk of traced rays, as columns of a run's tables, and its shaded pixels.

A chunk is a run of consecutive pixels in shooting order. Chunks do not depend on one another, so any number of threads
gives the same rays, accesses and picture.
"""

import threading
from typing import NamedTuple

import numpy as np

from nptrace_base.jit import kernel
from rtrace.packets import packet_numbers, packet_starts
from rtrace.rays import Hits, Rays
from rtrace.shading import shade, shadow_rays
from rtrace.shooting import Shooting
from rtrace.traverse import Room, Together, trace, trace_recorded
from rtrace.traversers.common import KIND_BITS
from rtrace.trees.tree import Tree
from traces.format import LEAF, PREFETCH, PRIMARY, SHADOW
from traces.rays import primary_directions
from traces.writer import empty_column

#: Events of one type of rays that a chunk holds at most, unless a single ray has more: 8 MB, and 19 MB of columns. Usual
#: chunks hold an eighth of it.
MOST_EVENTS = 2**21


_local = threading.local()  # the memory for the events of this thread's chunk, one Room for each type of rays


class Chunk(NamedTuple):
    """The rays of some pixels, as columns of the run's tables; ray numbers and first rows start at 0."""

    rays: dict[str, np.ndarray]
    accesses: dict[str, np.ndarray]
    pixels: np.ndarray  # (n,) uint32: y * width + x
    colours: np.ndarray  # (n, 3) uint8
    n_prefetches: int
    n_leaves: int  # rows of leaves entered
    n_hits: int  # primary rays that hit something
    n_shadow: int
    n_shadowed: int
    is_shaded: bool  # not so after a pass of primary rays, which sees no shadows


class Traced(NamedTuple):
    """What the rays of one type met, and their accesses (``traverse.trace_recorded``)."""

    prim: np.ndarray  # (n,) int32
    t: np.ndarray  # (n,) float64
    n_accesses: np.ndarray  # (n,) uint32
    events: np.ndarray  # (sum of count,) uint32


@kernel
def _sequence(n, owner, ends, sequence):
    """Write the order of the rays: the primaries of a batch, then their shadow rays (numbered from ``n`` on), and so on.

    ``ends`` is where each batch ends among the primaries.
    """
    at, shadow, start = 0, 0, 0
    for end in ends:
        for i in range(start, end):
            sequence[at] = i
            at += 1
        start = end
        while shadow < owner.size and owner[shadow] < end:
            sequence[at] = n + shadow
            at += 1
            shadow += 1


@kernel
def _ray_columns(sequence, pixels, owner, width, primary, shadow, columns):
    """Write the columns of both types of rays in the order of ``sequence``; return how many primary, shadow rays hit."""
    # Unpacked once: taking an array out of a tuple counts references.
    prim, t, count, _ = primary
    shadow_prim, shadow_t, shadow_count, _ = shadow
    x, y, type_, first, counts, prims, ts = columns  # in the order in which ``shoot`` makes them
    n = pixels.size
    row, n_hits, n_shadowed = np.uint64(0), 0, 0
    for i in range(sequence.size):
        s = sequence[i]
        if s < n:
            pixel, c, p, distance = pixels[s], count[s], prim[s], t[s]
            n_hits += p >= 0
            type_[i] = PRIMARY
        else:
            s -= n
            pixel, c, p, distance = pixels[owner[s]], shadow_count[s], shadow_prim[s], shadow_t[s]
            n_shadowed += p >= 0
            type_[i] = SHADOW
        x[i], y[i] = pixel % width, pixel // width
        first[i], counts[i], prims[i], ts[i] = row, c, p, distance
        row += np.uint64(c)
    return n_hits, n_shadowed


@kernel
def _access_columns(sequence, n, primary, shadow, columns):
    """Write the accesses of both types of rays in the order of ``sequence``; return the numbers of requests and of leaves."""
    _, _, count, events = primary
    _, _, shadow_count, shadow_events = shadow
    ray, node, kind = columns
    node_shift, kind_mask = np.uint32(KIND_BITS), np.uint32((1 << KIND_BITS) - 1)
    at, primary_at, shadow_at = np.uint64(0), np.uint64(0), np.uint64(0)
    n_prefetches = n_leaves = 0
    for r in range(sequence.size):
        s = sequence[r]
        if s < n:
            k, source, length = primary_at, events, np.uint64(count[s])
            primary_at += length
        else:
            k, source, length = shadow_at, shadow_events, np.uint64(shadow_count[s - n])
            shadow_at += length
        for j in range(length):
            event = source[k + j]
            ray[at + j] = r
            node[at + j] = event >> node_shift
            kind[at + j] = event & kind_mask
            n_prefetches += event & kind_mask == PREFETCH
            n_leaves += event & kind_mask == LEAF
        at += length
    return n_prefetches, n_leaves


def primary_rays(frame: np.ndarray, pixels: np.ndarray, width: int) -> Rays:
    """Return one ray through the centre of each pixel (``y * width + x``), of unit direction, from the eye to infinity."""
    n = len(pixels)
    direction = np.empty((n, 3), np.float32)
    primary_directions(frame, pixels, np.uint32(width), direction)
    origin = np.broadcast_to(frame[0].astype(np.float32), (n, 3)).copy()
    return Rays(origin, direction, np.zeros(n), np.full(n, np.inf))


def shoot(
    tree: Tree,
    frame: np.ndarray,
    light: tuple[float, float, float],
    pixels: np.ndarray,
    shooting: Shooting,
    batch: int,
    pass_: int | None,
    most: int | None = None,
) -> Chunk:
    """Trace the rays of ``pixels`` and shade them.

    Parameters
    ----------
    frame : (4, 3) float64
        ``Camera.frame``.
    pixels : (n,) uint32
        Of whole packets.
    batch : int
        Primary rays, or packets of them, shot before their shadow rays.
    pass_ : {None, PRIMARY, SHADOW}
        Record both types of rays, or only one (all primaries first takes two passes).
    most : int, optional
        Events of one type of rays that are taken into memory, unless a single ray has more; NoRoomError is raised beyond.
    """
    if not hasattr(_local, "rooms"):
        _local.rooms = Room(), Room()
    rooms = _local.rooms
    for room in rooms:
        room.most = most
    rays, packet = primary_rays(frame, pixels, shooting.width), None
    if shooting.packet > 1:
        packet = packet_numbers(pixels, shooting)
    if pass_ == SHADOW:
        primary = _untraced(trace(tree, rays))
    else:
        primary = _traced(*trace_recorded(tree, rays, room=rooms[PRIMARY], together=Together(packet)))
    hits = Hits(primary.prim, primary.t)
    to_light, owner, surface = shadow_rays(tree, rays, hits, light, shooting.shadow)
    if pass_ == PRIMARY:
        shadow, owner = _untraced(Hits(np.empty(0, np.int32), np.empty(0))), owner[:0]
    else:
        together = Together(
            None if packet is None else packet[owner], shooting.shadow_order == "cheaper", shooting.shadow_end == "drain"
        )
        shadow = _traced(*trace_recorded(tree, to_light, any_hit=True, room=rooms[SHADOW], together=together))
    colours = shade(rays, hits, surface, owner, Hits(shadow.prim, shadow.t))

    n = len(pixels)
    sequence = np.empty(n + len(owner), np.int32)
    ends = np.arange(batch, n, batch) if packet is None else packet_starts(pixels, shooting)[batch:-1:batch]
    _sequence(n, owner, np.append(ends, n), sequence)
    if pass_ == SHADOW:
        sequence = sequence[sequence >= n]
    n_rays, total = len(sequence), len(primary.events) + len(shadow.events)
    accesses: dict[str, np.ndarray] = {
        "ray": empty_column(total, np.uint32),
        "node": empty_column(total, np.uint32),
        "kind": empty_column(total, np.uint8),
    }
    n_prefetches, n_leaves = _access_columns(sequence, n, primary, shadow, tuple(accesses.values()))
    columns: dict[str, np.ndarray] = {
        "x": np.empty(n_rays, np.uint16),
        "y": np.empty(n_rays, np.uint16),
        "type": np.empty(n_rays, np.uint8),
        "first": np.empty(n_rays, np.uint64),
        "count": np.empty(n_rays, np.uint32),
        "prim": np.empty(n_rays, np.int32),
        "t": np.empty(n_rays, np.float32),
    }
    n_hits, n_shadowed = _ray_columns(
        sequence, pixels, owner, np.uint32(shooting.width), primary, shadow, tuple(columns.values())
    )
    columns["ray"] = np.arange(n_rays, dtype=np.uint32)
    n_shadow, is_shaded = n_rays if pass_ == SHADOW else n_rays - n, pass_ != PRIMARY
    return Chunk(columns, accesses, pixels, colours, n_prefetches, n_leaves, n_hits, n_shadow, n_shadowed, is_shaded)


def _traced(hits: Hits, count: np.ndarray, events: np.ndarray) -> Traced:
    return Traced(hits.prim, hits.t, count, events)


def _untraced(hits: Hits) -> Traced:
    return _traced(hits, np.zeros(len(hits.prim), np.uint32), np.empty(0, np.uint32))


def smaller_pieces(start: int, stop: int, batch: int, pass_: int | None) -> list[tuple[int, int, int | None]]:
    """Return the (start, stop, pass) that together make the rows of a chunk, in order, and take less memory.

    ``start`` and ``stop`` count pixels, or packets of them, as ``batch`` does.

    Halves of whole batches; a single batch is traced twice, first its primary rays, then its shadow rays.
    """
    n_batches = -(-(stop - start) // batch)
    if pass_ is None and n_batches == 1:
        return [(start, stop, PRIMARY), (start, stop, SHADOW)]
    middle = start + (n_batches // 2 * batch if pass_ is None else (stop - start) // 2)
    return [(start, middle, pass_), (middle, stop, pass_)]
