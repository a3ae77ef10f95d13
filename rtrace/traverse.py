"""Rays through a tree: hits, and, when asked for, every node access in the order the hardware would issue it."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from rtrace.rays import Hits, Rays, flat
from rtrace.traversers.bvh import trace_bvh
from rtrace.traversers.bvh64 import trace_bvh64
from rtrace.traversers.common import trace_brute
from rtrace.traversers.kdtree import trace_kdtree
from rtrace.traversers.packets import Packets, make_state
from rtrace.traversers.packets_bvh import trace_bvh_packets
from rtrace.traversers.packets_kdtree import trace_kdtree_packets
from rtrace.trees.tree import Tree, tree_arrays

#: The kernel of each node format.
KERNELS = {"kdtree": trace_kdtree, "bvh": trace_bvh, "bvh64": trace_bvh64}

#: Those that trace packets.
PACKET_KERNELS = {"kdtree": trace_kdtree_packets, "bvh": trace_bvh_packets}

#: Room for the events of a batch at first, per ray; a batch that needs more gets it.
EVENTS_PER_RAY = 64


def trace(tree: Tree, rays: Rays, *, any_hit: bool = False) -> Hits:
    """Trace rays without recording accesses: the closest hits, or for ``any_hit`` the first hit found."""
    return _trace(tree, rays, any_hit, None)[0]


class NoRoomError(Exception):
    """The events of several rays or packets are more than a Room is to hold; those of fewer may fit."""


class Together(NamedTuple):
    """How rays are traced when each is not traced alone, in the order of the nearer child, up to its end.

    Attributes
    ----------
    packet : (n,) uint32 or None
        Rays next to each other with the same number are a packet; None: each is alone.
    cheaper : bool
        Whether the child that ``Tree.cheaper`` names is searched first.
    drains : bool
        Whether the end of a ray ends no visit, as in Manta's packets: in a BVH all that waits on the stack is read, in a
        kd-tree the ray is traced as one that looks for its closest hit.
    """

    packet: np.ndarray | None = None
    cheaper: bool = False
    drains: bool = False


#: Each ray is traced alone.
ALONE = Together()


class Room:
    """Memory for the events of a batch, which grows as needed and serves one batch after another.

    It stays with its thread, so that a chunk of rays needs no fresh memory from the system (docs/performance.md).

    Parameters
    ----------
    most : int, optional
        Events it holds at most, unless a single ray has more.
    """

    def __init__(self, most: int | None = None) -> None:
        self.events, self.most = np.empty(0, np.uint32), most

    def grow(self, n_events: int, n_used: int = 0) -> None:
        """Make room for at least so many events; the first ``n_used`` are kept."""
        if n_events > self.events.size:
            events = np.empty(n_events, np.uint32)
            events[:n_used] = self.events[:n_used]
            self.events = events


def trace_recorded(
    tree: Tree, rays: Rays, *, any_hit: bool = False, room: Room | None = None, together: Together = ALONE
) -> tuple[Hits, np.ndarray, np.ndarray]:
    """Trace rays and record their node accesses.

    Parameters
    ----------
    together : Together, optional
        Which rays are a packet, and how any-hit rays search; each is traced alone by default.
    room : Room, optional
        Where the events are written; its next use overwrites them. NoRoomError is raised when they are too many for it.

    Returns
    -------
    hits : Hits
    count : (n,) uint32
        Accesses of each ray, prefetch requests included; of a packet, they are those of its first ray. (In a kd-tree a packet
        ends where a direction changes sign.)
    events : (sum of count,) uint32
        ``node << 2 | kind`` of all rays, in ray order.
    """
    return _trace(tree, rays, any_hit, room or Room(), together)


def _trace(
    tree: Tree, rays: Rays, any_hit: bool, room: Room | None, together: Together = ALONE
) -> tuple[Hits, np.ndarray, np.ndarray]:
    arrays, flat_rays = tree_arrays(tree), flat(rays)
    n = len(rays.t_min)
    hits, count = Hits(np.empty(n, np.int32), np.empty(n, np.float64)), np.zeros(n, np.uint32)
    if room is None:
        KERNELS[tree.kind](arrays, flat_rays, any_hit, 0, hits, count, None)
        return hits, count, np.empty(0, np.uint32)
    trace_from, n_together = _tracer(tree, (arrays, flat_rays), any_hit, together, (hits, count))
    room.grow(EVENTS_PER_RAY * n + 4 * tree.max_level + 64)
    if room.most is not None and room.events.size > 4 * room.most:
        room.events = np.empty(EVENTS_PER_RAY * n + 4 * tree.max_level + 64, np.uint32)  # grown for a single long ray
    first = n_events = 0
    while first < n:
        done = trace_from(first, room.events[n_events:])
        n_events += int(count[first:done].sum())
        if done < n:
            if n_together > 1 and room.most is not None and room.events.size >= room.most:
                raise NoRoomError
            room.grow(2 * room.events.size, n_events)
        first = done
    return hits, count, room.events[:n_events]


def _tracer(
    tree: Tree, given: tuple[Any, Any], any_hit: bool, together: Together, out: tuple[Hits, np.ndarray]
) -> tuple[Callable[[int, np.ndarray], int], int]:
    """Return what traces from a ray on, into some room, up to the first ray that does not fit; and how many do not mix."""
    n, (packet, cheaper, drains) = out[1].size, together
    if drains and any_hit and tree.kind == "kdtree":
        any_hit, drains = False, False
    if packet is None and not cheaper and not drains:
        trace_rays = KERNELS[tree.kind]
        return lambda first, events: trace_rays(*given, any_hit, first, *out, events), n
    trace_packets, state = PACKET_KERNELS[tree.kind], make_state(tree.max_level)
    numbers = np.arange(n, dtype=np.uint32) if packet is None else packet
    first_child = np.empty(0, np.uint8)
    if cheaper:
        assert tree.cheaper is not None
        first_child = tree.cheaper
    packets = Packets(numbers, any_hit, drains, first_child)
    n_packets = 1 + np.count_nonzero(np.diff(numbers))
    return lambda first, events: trace_packets(*given, packets, np.uint64(first), state, *out, events), int(n_packets)


def trace_all(triangles: np.ndarray, rays: Rays) -> Hits:
    """Return the closest hits by testing every triangle."""
    n = len(rays.t_min)
    hits = Hits(np.empty(n, np.int32), np.empty(n, np.float64))
    trace_brute(triangles.reshape(-1), flat(rays), hits)
    return hits
