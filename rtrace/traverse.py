"""The traversal kernels: rays -> hits, and, when asked for, every node access in the order the hardware would issue it.

An access is written as one uint32, ``node << 2 | kind``, with the kinds of ``traces.format``. One kernel per tree serves
closest-hit and any-hit rays, traced or not (``events`` None compiles to a kernel without tracing).

Rules that hold for both trees (reasons in docs/correctness.md):

- The triangle test decides; boxes and planes only skip what cannot matter: they are moved outwards by a margin, per ray and
  axis (``intersect.margins``). So a ray lying in a face or a split plane is on both sides of it.
- A hit counts when t_min <= t <= t_max. Among equal t the lowest triangle number wins, so culling keeps equals.
- The pre-fetch unit of Park et al. 2013, Sec. 3: a push sets its pointer to the stack top, a pop lowers it to the top; at a
  non-empty leaf, before its triangles are tested, it requests the nodes below its pointer, which stays where it stops.
  Between two pushes the top only falls, so it is enough to lower the pointer at the leaf.
"""

from typing import NamedTuple

import numpy as np

from nptrace_base.errors import NptraceError
from nptrace_base.jit import inlined, kernel
from rtrace.intersect import NO_PRIM, end_of, inverse, margins, shear, triangle_t
from rtrace.simd import larger, load, pack, scaled_difference, smaller, unpack
from rtrace.trees import tree as layout
from rtrace.trees.tree import Tree, words
from traces import format as contract

# Indices are uint64 throughout: Numba tests a signed index for wrap-around at every access, which made the kd-tree half as
# fast. A plain integer next to a uint64 becomes signed, hence the names.
ZERO, ONE, TWO, THREE, FOUR, FIVE, SIX, SEVEN, EIGHT, NINE, TEN = (np.uint64(k) for k in range(11))
LEAF = np.uint64(layout.LEAF)
#: Where the stack of ``trace_bvh`` begins: eight entries below are room for a copy.
BOTTOM = EIGHT
READ, PUSH, ENTER, PREFETCH = (np.uint64(k) for k in (contract.READ, contract.PUSH, contract.LEAF, contract.PREFETCH))

#: Room for the events of a batch at first, per ray; a batch that needs more gets it.
EVENTS_PER_RAY = 64


class Rays(NamedTuple):
    """A batch of rays; points of a ray are origin + t direction, t_min <= t <= t_max.

    Attributes
    ----------
    origin, direction : (n, 3) float32
        Directions need not have unit length; not zero, all components finite.
    t_min, t_max : (n,) float64
        0 <= t_min; an interval with t_min > t_max is empty.
    """

    origin: np.ndarray
    direction: np.ndarray
    t_min: np.ndarray
    t_max: np.ndarray


class Hits(NamedTuple):
    """What a batch of rays met.

    Attributes
    ----------
    prim : (n,) int32
        Triangle number, -1 for none.
    t : (n,) float64
        Ray parameter of the hit, infinity for none.
    """

    prim: np.ndarray
    t: np.ndarray


@inlined
def _closest_in_leaf(prims, first, n_prims, corners, origin, ray, k, shear_, near_t, best, best_prim, any_hit):
    """Test the triangles of a leaf; return the better of (best, best_prim) and the best hit among them."""
    kx, ky, kz = k
    sx, sy, sz = shear_
    ox, oy, oz = np.float64(origin[ray + kx]), np.float64(origin[ray + ky]), np.float64(origin[ray + kz])
    for i in range(first, first + n_prims):
        c = prims[i]
        t = triangle_t(corners, i * NINE, kx, ky, kz, ox, oy, oz, sx, sy, sz)
        if t >= near_t and (t < best or (t == best and c < best_prim)):
            best, best_prim = t, c
            if any_hit:
                break
    return best, best_prim


@inlined
def _request_stack(stack, pp, events, n_events):
    """Request the nodes below the pre-fetch pointer, from the top; return the number of events."""
    while pp > ZERO:
        pp -= ONE
        events[n_events] = np.uint64(stack[pp]) << TWO | PREFETCH
        n_events += ONE
    return n_events


@inlined
def _request_deep_stack(stack, pp, events, n_events):
    """Request as ``_request_stack``, from a stack that begins at ``BOTTOM``, by copying eight entries without a branch.

    Those too many are written over by what comes next. At a BVH's leaves four or five nodes wait; a loop mispredicts its
    end each time, which was a third of the cost of tracing. Single words: a wide load has to wait for the stores before it.
    """
    e0, e1 = np.uint64(stack[pp - ONE]) << TWO, np.uint64(stack[pp - TWO]) << TWO
    e2, e3 = np.uint64(stack[pp - THREE]) << TWO, np.uint64(stack[pp - FOUR]) << TWO
    e4, e5 = np.uint64(stack[pp - FIVE]) << TWO, np.uint64(stack[pp - SIX]) << TWO
    e6, e7 = np.uint64(stack[pp - SEVEN]) << TWO, np.uint64(stack[pp - EIGHT]) << TWO
    events[n_events], events[n_events + ONE] = e0 | PREFETCH, e1 | PREFETCH
    events[n_events + TWO], events[n_events + THREE] = e2 | PREFETCH, e3 | PREFETCH
    events[n_events + FOUR], events[n_events + FIVE] = e4 | PREFETCH, e5 | PREFETCH
    events[n_events + SIX], events[n_events + SEVEN] = e6 | PREFETCH, e7 | PREFETCH
    end = n_events + pp - BOTTOM
    n_events += EIGHT
    pp -= EIGHT
    while n_events < end:
        pp -= ONE
        events[n_events] = np.uint64(stack[pp]) << TWO | PREFETCH
        n_events += ONE
    return end


@kernel
def trace_bvh(
    nodes, meta, prims, corners, core, max_level, origin, direction, t_min, t_max, any_hit, first, prim, hit_t, count, events
):
    """Trace rays ``first``... through a BVH; return the first ray that did not fit into ``events``, else their number.

    The far child is pushed untested; a node is read and its own box tested when it is visited.
    ``nodes`` and ``meta`` are the nodes as flat float32 and uint32; ``corners``, ``core``, ``origin``, ``direction`` are flat.
    ``prim``, ``hit_t`` and ``count`` (accesses of each ray) are filled. Stores into ``events`` are unguarded: between two pops
    a ray writes at most one event per level and one per stack entry, so room for that is checked at each pop.
    """
    stack = np.empty(8 + max_level + 1, np.uint32)
    n_events, limit = ZERO, ZERO
    if events is not None:
        limit = np.uint64(events.size - 2 * max_level - 11)
    for i in range(np.uint64(first), np.uint64(t_min.size)):
        start = n_events
        if events is not None and n_events > limit:
            return np.int64(i)
        ray = i * THREE
        dx, dy, dz = np.float64(direction[ray]), np.float64(direction[ray + ONE]), np.float64(direction[ray + TWO])
        ox, oy, oz = np.float64(origin[ray]), np.float64(origin[ray + ONE]), np.float64(origin[ray + TWO])
        ix, iy, iz = inverse(dx), inverse(dy), inverse(dz)
        # Bit k: the direction is negative along axis k, so the upper child of a node split there comes first.
        backwards = (ONE if ix < 0.0 else ZERO) | (TWO if iy < 0.0 else ZERO) | (FOUR if iz < 0.0 else ZERO)
        k, shear_ = shear(dx, dy, dz, ix, iy, iz)
        px, py, pz = margins(core, ox, oy, oz, dx, dy, dz, ix, iy, iz)
        # The origin as seen from a box's lower and upper faces: so moved that they lie a margin farther out.
        from_lower, from_upper = pack(ox + px, oy + py, oz + pz), pack(ox - px, oy - py, oz - pz)
        scale = pack(ix, iy, iz)
        best, best_prim, near_t = end_of(t_max[i], ox, oy, oz, dx, dy, dz), NO_PRIM, t_min[i]
        sp, pp, node = BOTTOM, BOTTOM, ZERO
        while True:
            b = node * EIGHT
            t0, t1 = near_t, best
            # The fourth lanes hold the next word of the node and are not looked at.
            lower = scaled_difference(load(nodes, b), from_lower, scale)
            upper = scaled_difference(load(nodes, b + THREE), from_upper, scale)
            x, y, z = unpack(smaller(lower, upper))
            t0 = x if x > t0 else t0
            t0 = y if y > t0 else t0
            t0 = z if z > t0 else t0
            x, y, z = unpack(larger(lower, upper))
            t1 = x if x < t1 else t1
            t1 = y if y < t1 else t1
            t1 = z if z < t1 else t1
            if t0 <= t1:
                m, child = np.uint64(meta[b + SEVEN]), np.uint64(meta[b + SIX])
                if m & THREE != LEAF:
                    if events is not None:
                        events[n_events] = node << TWO | PUSH
                        n_events += ONE
                    upper_first = backwards >> m & ONE
                    stack[sp] = child + ONE - upper_first
                    sp += ONE
                    pp = sp
                    node = child + upper_first
                    continue
                if events is not None:
                    events[n_events] = node << TWO | ENTER
                    n_events = _request_deep_stack(stack, min(pp, sp), events, n_events + ONE)
                    pp = BOTTOM
                best, best_prim = _closest_in_leaf(
                    prims, child, m >> TWO, corners, origin, ray, k, shear_, near_t, best, best_prim, any_hit
                )
                if any_hit and best_prim != NO_PRIM:
                    break
            elif events is not None:
                events[n_events] = node << TWO | READ
                n_events += ONE
            if sp == BOTTOM:
                break
            if events is not None and n_events > limit:
                return np.int64(i)
            sp -= ONE
            node = np.uint64(stack[sp])
        if events is not None:
            count[i] = n_events - start
        prim[i] = best_prim if best_prim != NO_PRIM else -1
        hit_t[i] = best + 0.0 if best_prim != NO_PRIM else np.inf
    return t_min.size


@kernel
def trace_kdtree(
    nodes,
    meta,
    prims,
    corners,
    core,
    bounds,
    max_level,
    origin,
    direction,
    t_min,
    t_max,
    any_hit,
    first,
    prim,
    hit_t,
    count,
    events,
):
    """Trace rays ``first``... through a kd-tree; as ``trace_bvh``.

    The test against the scene's box is free. A ray lying in a split plane (within the margin) visits both cells with its whole
    interval; a popped entry that begins beyond the best hit is skipped, and never ends the ray, because such rays put
    entries on the stack out of order.
    """
    stack = np.empty(max_level + 1, np.uint32)
    seen = np.empty(12, np.float64)
    entry = np.empty(max_level + 1, np.float64)
    exit_ = np.empty(max_level + 1, np.float64)
    n_events, limit = ZERO, ZERO
    if events is not None:
        limit = np.uint64(events.size - 2 * max_level - 3)
    for i in range(np.uint64(first), np.uint64(t_min.size)):
        start = n_events
        if events is not None and n_events > limit:
            return np.int64(i)
        ray = i * THREE
        dx, dy, dz = np.float64(direction[ray]), np.float64(direction[ray + ONE]), np.float64(direction[ray + TWO])
        ox, oy, oz = np.float64(origin[ray]), np.float64(origin[ray + ONE]), np.float64(origin[ray + TWO])
        ix, iy, iz = inverse(dx), inverse(dy), inverse(dz)
        px, py, pz = margins(core, ox, oy, oz, dx, dy, dz, ix, iy, iz)
        # Per axis: the inverse, and the origin as seen from a plane's near and far side, so moved that it lies a margin
        # farther out. A table: choosing among three variables at every node took a fifth more time.
        seen[ZERO], seen[ONE], seen[TWO] = ix, iy, iz
        seen[FOUR], seen[FIVE], seen[SIX] = ox + np.copysign(px, ix), oy + np.copysign(py, iy), oz + np.copysign(pz, iz)
        seen[EIGHT], seen[NINE], seen[TEN] = ox - np.copysign(px, ix), oy - np.copysign(py, iy), oz - np.copysign(pz, iz)
        backwards = (ONE if ix < 0.0 else ZERO) | (TWO if iy < 0.0 else ZERO) | (FOUR if iz < 0.0 else ZERO)
        best, best_prim, near_t = end_of(t_max[i], ox, oy, oz, dx, dy, dz), NO_PRIM, t_min[i]
        t0, t1 = near_t, best
        for axis in range(THREE):
            near = (backwards >> axis & ONE) * THREE
            low = (bounds[near + axis] - seen[FOUR + axis]) * seen[axis]
            high = (bounds[THREE - near + axis] - seen[EIGHT + axis]) * seen[axis]
            t0 = low if low > t0 else t0
            t1 = high if high < t1 else t1
        if t0 <= t1:
            k, shear_ = shear(dx, dy, dz, ix, iy, iz)
            sp, pp, node = ZERO, ZERO, ZERO
            while True:
                b = node * TWO
                m = np.uint64(meta[b + ONE])
                axis = m & THREE
                if axis != LEAF:
                    low = (nodes[b] - seen[FOUR + axis]) * seen[axis]
                    high = (nodes[b] - seen[EIGHT + axis]) * seen[axis]
                    upper_first = backwards >> axis & ONE
                    visits_near, visits_far = high >= t0, low <= t1
                    child = m >> TWO
                    near = child + upper_first
                    far = child + ONE - upper_first
                    # In this order: the near child is nearly always visited, and testing it first cost a third of the speed.
                    if visits_far and visits_near:
                        if events is not None:
                            events[n_events] = node << TWO | PUSH
                            n_events += ONE
                        stack[sp] = far
                        entry[sp] = low if low > t0 else t0
                        exit_[sp] = t1
                        sp += ONE
                        pp = sp
                        t1 = high if high < t1 else t1
                        node = near
                    else:
                        if events is not None:
                            events[n_events] = node << TWO | READ
                            n_events += ONE
                        node = near if visits_near else far
                    continue
                n_prims = m >> TWO
                if events is not None:
                    events[n_events] = node << TWO | ENTER
                    n_events += ONE
                    if n_prims > ZERO:
                        n_events = _request_stack(stack, min(pp, sp), events, n_events)
                        pp = ZERO
                leaf = np.uint64(meta[b])
                best, best_prim = _closest_in_leaf(
                    prims, leaf, n_prims, corners, origin, ray, k, shear_, near_t, best, best_prim, any_hit
                )
                if any_hit and best_prim != NO_PRIM:
                    break
                while sp > ZERO and entry[sp - ONE] > best:
                    sp -= ONE
                if sp == ZERO:
                    break
                if events is not None and n_events > limit:
                    return np.int64(i)
                sp -= ONE
                node, t0, t1 = np.uint64(stack[sp]), entry[sp], exit_[sp]
        if events is not None:
            count[i] = n_events - start
        prim[i] = best_prim if best_prim != NO_PRIM else -1
        hit_t[i] = best + 0.0 if best_prim != NO_PRIM else np.inf
    return t_min.size


@kernel
def trace_brute(tri, origin, direction, t_min, t_max, prim, hit_t):
    """Closest hit against every triangle: the truth that both trees must reproduce bit by bit."""
    for ray in range(t_min.size):
        i = np.uint64(ray) * THREE
        dx, dy, dz = np.float64(direction[i]), np.float64(direction[i + ONE]), np.float64(direction[i + TWO])
        ix, iy, iz = inverse(dx), inverse(dy), inverse(dz)
        (kx, ky, kz), (sx, sy, sz) = shear(dx, dy, dz, ix, iy, iz)
        ox, oy, oz = np.float64(origin[i + kx]), np.float64(origin[i + ky]), np.float64(origin[i + kz])
        best, best_prim = end_of(t_max[ray], ox, oy, oz, dx, dy, dz), NO_PRIM
        for c in range(tri.size // 9):
            t = triangle_t(tri, np.uint64(c) * NINE, kx, ky, kz, ox, oy, oz, sx, sy, sz)
            if t >= t_min[ray] and (t < best or (t == best and c < best_prim)):
                best, best_prim = t, np.int32(c)
        prim[ray] = best_prim if best_prim != NO_PRIM else -1
        hit_t[ray] = best + 0.0 if best_prim != NO_PRIM else np.inf


def make_rays(
    origin: np.ndarray, direction: np.ndarray, t_min: float | np.ndarray = 0.0, t_max: float | np.ndarray = np.inf
) -> Rays:
    """Return checked rays; origins and intervals are broadcast to the directions.

    Raises
    ------
    ValueError
        A component is NaN or infinite, a direction is zero, or t_min is negative or NaN.
    """
    direction = np.ascontiguousarray(direction, np.float32).reshape(-1, 3)
    n = len(direction)
    # Copies: a broadcast array is read-only, for which Numba would compile the kernels once more.
    origin = np.broadcast_to(np.asarray(origin, np.float32), (n, 3)).copy()
    low = np.broadcast_to(np.asarray(t_min, np.float64), n).copy()
    high = np.broadcast_to(np.asarray(t_max, np.float64), n).copy()
    for name, bad, rule in (
        ("origin", ~np.isfinite(origin).all(axis=1), "all components must be finite"),
        ("direction", ~np.isfinite(direction).all(axis=1), "all components must be finite"),
        ("direction", ~direction.any(axis=1), "it must not be zero"),
        ("t_min", ~(low >= 0.0), "it must be 0 or more"),
        ("t_max", np.isnan(high), "it must be a number"),
    ):
        if bad.any():
            i = int(np.flatnonzero(bad)[0])
            values: dict[str, np.ndarray] = {"origin": origin, "direction": direction, "t_min": low, "t_max": high}
            raise NptraceError(f"ray {i} has {name} {values[name][i]}: {rule}; {int(bad.sum())} of {n} rays are bad")
    return Rays(origin, direction, low, high)


def trace(tree: Tree, rays: Rays, *, any_hit: bool = False) -> Hits:
    """Trace rays without recording accesses: the closest hits, or for ``any_hit`` the first hit found."""
    return _trace(tree, rays, any_hit, None)[0]


class NoRoomError(Exception):
    """The events of several rays are more than a Room is to hold; those of fewer rays may fit."""


class Room:
    """Memory for the events of a batch, which grows as needed and serves one batch after another.

    Fresh memory for every batch costs the system up to half the time of the tracing.

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
        Accesses of each ray, pre-fetch requests included.
    events : (sum of count,) uint32
        ``node << 2 | kind`` of all rays, in ray order.
    """
    return _trace(tree, rays, any_hit, room or Room())


def _trace(tree: Tree, rays: Rays, any_hit: bool, room: Room | None) -> tuple[Hits, np.ndarray, np.ndarray]:
    nodes, meta = words(tree)
    n = len(rays.t_min)
    prim, t, count = np.empty(n, np.int32), np.empty(n, np.float64), np.zeros(n, np.uint32)
    fixed: tuple[np.ndarray, ...] = (nodes, meta, tree.prims, tree.corners.reshape(-1), tree.core.reshape(-1))
    kernel_of = trace_bvh
    if tree.kind == "kdtree":
        kernel_of, fixed = trace_kdtree, (*fixed, tree.bounds.reshape(-1))
    given = (rays.origin.reshape(-1), rays.direction.reshape(-1), rays.t_min, rays.t_max, any_hit)
    if room is None:
        kernel_of(*fixed, tree.max_level, *given, 0, prim, t, count, None)
        return Hits(prim, t), count, np.empty(0, np.uint32)
    room.grow(EVENTS_PER_RAY * n + 4 * tree.max_level + 64)
    if room.most is not None and room.events.size > 4 * room.most:
        room.events = np.empty(EVENTS_PER_RAY * n + 4 * tree.max_level + 64, np.uint32)  # grown for a single long ray
    first = n_events = 0
    while first < n:
        done = kernel_of(*fixed, tree.max_level, *given, first, prim, t, count, room.events[n_events:])
        n_events += int(count[first:done].sum())
        if done < n:
            if n > 1 and room.most is not None and room.events.size >= room.most:
                raise NoRoomError
            room.grow(2 * room.events.size, n_events)
        first = done
    return Hits(prim, t), count, room.events[:n_events]


def trace_all(triangles: np.ndarray, rays: Rays) -> Hits:
    """Return the closest hits by testing every triangle."""
    n = len(rays.t_min)
    prim, t = np.empty(n, np.int32), np.empty(n, np.float64)
    given = (rays.origin.reshape(-1), rays.direction.reshape(-1), rays.t_min, rays.t_max)
    trace_brute(triangles.reshape(-1), *given, prim, t)
    return Hits(prim, t)
