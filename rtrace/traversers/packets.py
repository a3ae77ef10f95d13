"""What the traversers of packets share: which rays go together, the state of a packet, and its leaf.

A packet walks the tree as one ray does: a node is read once for all of its rays, and the stack and the prefetch unit are the
packet's. Each ray keeps its own best hit, and is active at a node if it would visit the node alone; a node is visited if a ray
is active there. A packet's accesses are those of its first ray; the others have none. The rules of ``common`` hold for each
ray, so its hit is, bit for bit, that of the ray alone.
"""

from typing import NamedTuple

import numpy as np

from nptrace_base.jit import inlined
from rtrace.intersect import NO_PRIM, end_of, shear
from rtrace.traversers.common import ONE, ZERO, closest_in_leaf, set_up, write_hit

#: The most rays of a packet, and so the distance between the numbers of two axes, or of two entries of the stack.
MOST = np.uint64(64)
#: Where the shears begin among the numbers of ``PacketState.sheared``.
SHEARS = np.uint64(3 * MOST)


class Packets(NamedTuple):
    """How rays are traced together.

    Attributes
    ----------
    number : (n,) uint32
        Rays next to each other with the same number are a packet, of up to ``MOST``.
    any_hit : bool
        Whether a ray ends at the first hit found.
    drains : bool
        Whether a BVH's packet reads what waits on its stack when all of its rays have ended.
    cheaper : (n_nodes,) uint8
        Of two children that are both visited the first one, 1 for the upper (``trees.rtsah``); empty: the one that comes first
        in the direction of the packet's first active ray.
    """

    number: np.ndarray
    any_hit: bool
    drains: bool
    cheaper: np.ndarray


class PacketState(NamedTuple):
    """The memory of the packet that is traced; ``r`` counts its rays, and ``axis * MOST + r`` its rays axis by axis.

    Attributes
    ----------
    from_lower, from_upper, inverse : (3 * MOST,) float64
        The origin as seen from the lower and upper side of planes: so moved that they lie a margin farther out; 1 / direction.
    axes : (3 * MOST,) uint64
    sheared : (6 * MOST,) float64
        What ``intersect.shear`` returned: the axes, and the origin and the shears.
    backwards : (MOST,) uint64
        As ``common.set_up`` returns it.
    near_t, best, best_prim : (MOST,) float64, float64 and int32
        Where the ray begins, and its best hit so far.
    is_done : (MOST,) bool
        Whether it has ended before its packet.
    active : (MOST,) uint64
        The rays that are active at the node, in their order; the first of them.
    t0, t1 : (MOST,) float64
        kd-tree: the interval of each ray in the node.
    low, high : (MOST,) float64
        kd-tree: where each active ray crosses the node's plane, its near and its far side.
    stack : (depth,) uint32
    n_waiting : (depth,) uint64
        How many rays wait for each entry of the stack.
    waiting, entry, exit : (depth * MOST,) uint64, float64 and float64
        Which ones, and (kd-tree) their intervals there.
    """

    from_lower: np.ndarray
    from_upper: np.ndarray
    inverse: np.ndarray
    axes: np.ndarray
    sheared: np.ndarray
    backwards: np.ndarray
    near_t: np.ndarray
    best: np.ndarray
    best_prim: np.ndarray
    is_done: np.ndarray
    active: np.ndarray
    t0: np.ndarray
    t1: np.ndarray
    low: np.ndarray
    high: np.ndarray
    stack: np.ndarray
    n_waiting: np.ndarray
    waiting: np.ndarray
    entry: np.ndarray
    exit: np.ndarray


def make_state(max_level: int) -> PacketState:
    """Return the memory for packets in a tree of that many levels."""
    rays, depth = int(MOST), max_level + 1
    return PacketState(
        from_lower=np.empty(3 * rays), from_upper=np.empty(3 * rays), inverse=np.empty(3 * rays),
        axes=np.empty(3 * rays, np.uint64), sheared=np.empty(6 * rays), backwards=np.empty(rays, np.uint64),
        near_t=np.empty(rays), best=np.empty(rays), best_prim=np.empty(rays, np.int32), is_done=np.empty(rays, np.bool_),
        active=np.empty(rays, np.uint64), t0=np.empty(rays), t1=np.empty(rays), low=np.empty(rays), high=np.empty(rays),
        stack=np.empty(depth, np.uint32), n_waiting=np.empty(depth, np.uint64),
        waiting=np.empty(depth * rays, np.uint64), entry=np.empty(depth * rays), exit=np.empty(depth * rays),
    )  # fmt: skip


@inlined
def begin_packet(rays, core, number, first, one_sign, state):
    """Set up the rays from ``first`` on that go together, all of them active; return how many they are.

    With ``one_sign`` the packet ends before the first ray whose direction has another sign on any axis.
    """
    origins, directions, t_min, t_max = rays
    r = ZERO
    while r < MOST and first + r < np.uint64(number.size) and number[first + r] == number[first]:
        i = first + r
        origin, direction, inverses, pads, backwards = set_up(origins, directions, core, i)
        if one_sign and r > ZERO and backwards != state.backwards[ZERO]:
            break
        axes, moved, shears = shear(origin, direction, inverses)
        for k in range(3):
            at = np.uint64(k) * MOST + r
            state.from_lower[at], state.from_upper[at] = origin[k] + pads[k], origin[k] - pads[k]
            state.inverse[at], state.axes[at] = inverses[k], axes[k]
            state.sheared[at], state.sheared[SHEARS + at] = moved[k], shears[k]
        state.backwards[r] = backwards
        state.near_t[r], state.best[r], state.best_prim[r] = t_min[i], end_of(t_max[i], origin, direction), NO_PRIM
        state.is_done[r] = False
        state.active[r] = r
        r += ONE
    return r


@inlined
def line_of(state, r):
    """Return what ``intersect.shear`` returned for ray ``r``."""
    x, y, z = r, MOST + r, MOST + MOST + r
    axes, sheared = state.axes, state.sheared
    return (
        (axes[x], axes[y], axes[z]),
        (sheared[x], sheared[y], sheared[z]),
        (sheared[SHEARS + x], sheared[SHEARS + y], sheared[SHEARS + z]),
    )


@inlined
def test_leaf(prims, corners, first, n_prims, any_hit, state, n_active):
    """Test the triangles of a leaf with the active rays; return how many of them have ended there."""
    n_ended = ZERO
    for j in range(n_active):
        r = state.active[j]
        line, near_t, best, best_prim = line_of(state, r), state.near_t[r], state.best[r], state.best_prim[r]
        best, best_prim = closest_in_leaf(prims, corners, first, n_prims, line, near_t, best, best_prim, any_hit)
        state.best[r], state.best_prim[r] = best, best_prim
        if any_hit and best_prim != NO_PRIM:
            state.is_done[r] = True
            n_ended += ONE
    return n_ended


@inlined
def write_hits(prim, hit_t, first, n_rays, state):
    """Write what the rays of a packet met."""
    for r in range(n_rays):
        write_hit(prim, hit_t, first + r, state.best[r], state.best_prim[r])
