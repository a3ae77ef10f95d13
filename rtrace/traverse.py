"""Rays through a tree: hits, and, when asked for, every node access in the order the hardware would issue it."""

import numpy as np

from rtrace.rays import Hits, Rays, flat
from rtrace.traversers.bvh import trace_bvh
from rtrace.traversers.bvh64 import trace_bvh64
from rtrace.traversers.common import trace_brute
from rtrace.traversers.kdtree import trace_kdtree
from rtrace.trees.tree import Tree, tree_arrays

#: The kernel of each node format.
KERNELS = {"kdtree": trace_kdtree, "bvh": trace_bvh, "bvh64": trace_bvh64}

#: Room for the events of a batch at first, per ray; a batch that needs more gets it.
EVENTS_PER_RAY = 64


def trace(tree: Tree, rays: Rays, *, any_hit: bool = False) -> Hits:
    """Trace rays without recording accesses: the closest hits, or for ``any_hit`` the first hit found."""
    return _trace(tree, rays, any_hit, None)[0]


class NoRoomError(Exception):
    """The events of several rays are more than a Room is to hold; those of fewer rays may fit."""


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
    tree: Tree, rays: Rays, *, any_hit: bool = False, room: Room | None = None
) -> tuple[Hits, np.ndarray, np.ndarray]:
    """Trace rays and record their node accesses.

    Parameters
    ----------
    room : Room, optional
        Where the events are written; its next use overwrites them. NoRoomError is raised when they are too many for it.

    Returns
    -------
    hits : Hits
    count : (n,) uint32
        Accesses of each ray, prefetch requests included.
    events : (sum of count,) uint32
        ``node << 2 | kind`` of all rays, in ray order.
    """
    return _trace(tree, rays, any_hit, room or Room())


def _trace(tree: Tree, rays: Rays, any_hit: bool, room: Room | None) -> tuple[Hits, np.ndarray, np.ndarray]:
    arrays, flat_rays = tree_arrays(tree), flat(rays)
    n = len(rays.t_min)
    hits, count = Hits(np.empty(n, np.int32), np.empty(n, np.float64)), np.zeros(n, np.uint32)
    trace_rays = KERNELS[tree.kind]
    if room is None:
        trace_rays(arrays, flat_rays, any_hit, 0, hits, count, None)
        return hits, count, np.empty(0, np.uint32)
    room.grow(EVENTS_PER_RAY * n + 4 * tree.max_level + 64)
    if room.most is not None and room.events.size > 4 * room.most:
        room.events = np.empty(EVENTS_PER_RAY * n + 4 * tree.max_level + 64, np.uint32)  # grown for a single long ray
    first = n_events = 0
    while first < n:
        done = trace_rays(arrays, flat_rays, any_hit, first, hits, count, room.events[n_events:])
        n_events += int(count[first:done].sum())
        if done < n:
            if n > 1 and room.most is not None and room.events.size >= room.most:
                raise NoRoomError
            room.grow(2 * room.events.size, n_events)
        first = done
    return hits, count, room.events[:n_events]


def trace_all(triangles: np.ndarray, rays: Rays) -> Hits:
    """Return the closest hits by testing every triangle."""
    n = len(rays.t_min)
    hits = Hits(np.empty(n, np.int32), np.empty(n, np.float64))
    trace_brute(triangles.reshape(-1), flat(rays), hits)
    return hits
