"""The traversal kernels: rays -> hits, and, when asked for, every node access in the order the hardware would issue it.

An access is written as one uint32, ``node << 2 | kind``, with the kinds of ``traces.format``. One kernel per node format
(``KERNELS``) serves closest-hit and any-hit rays, traced or not (``events`` None compiles to a kernel without tracing).

Rules that hold for all (reasons in docs/correctness.md):

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
from rtrace.intersect import CORNER_FLOATS, NO_PRIM, POINT_FLOATS, X, Y, Z, end_of, inverse, margins, shear, triangle_t
from rtrace.simd import larger, load, pack, pack_halves, scaled_difference, smaller, unpack, unpack_all
from rtrace.trees import tree as layout
from rtrace.trees.tree import Tree, tree_arrays
from traces import format as run_format

# Indices are uint64 throughout: Numba tests a signed index for wrap-around at every access, which made the kd-tree half as
# fast. A plain integer next to a uint64 becomes signed, hence the names.
ZERO, ONE, TWO = (np.uint64(k) for k in range(3))
AXES = np.uint64(3)
KD_WORDS, SPLIT, FIRST, KD_META, BVH_WORDS, LOWER, UPPER, CHILD, META = (
    np.uint64(getattr(layout, name))
    for name in (
        *("KD_WORDS", "SPLIT", "FIRST", "KD_META"),
        *("BVH_WORDS", "LOWER", "UPPER", "CHILD", "META"),
    )
)
PAIR_WORDS, FACE_WORDS, LINKS, LINK_WORDS, AXIS_BITS, AXIS_MASK, LEAF_AXIS = (
    np.uint64(getattr(layout, name))
    for name in ("PAIR_WORDS", "FACE_WORDS", "LINKS", "LINK_WORDS", "AXIS_BITS", "AXIS_MASK", "LEAF_AXIS")
)
READ, PUSH, LEAF, PREFETCH = map(np.uint64, (run_format.READ, run_format.PUSH, run_format.LEAF, run_format.PREFETCH))
#: Low bits of an event: the kind of the access; above them the node.
KIND_BITS = np.uint64(2)
#: Where a kd ray's table has, per axis, the inverse of the direction, and the origin as seen from a plane's two sides.
INVERSE, FROM_NEAR, FROM_FAR = np.uint64(0), np.uint64(4), np.uint64(8)

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
def _request_stack(events, n_events, stack, pp):
    """Request the nodes below the prefetch pointer, from the top; return the number of events."""
    while pp > ZERO:
        pp -= ONE
        events[n_events] = np.uint64(stack[pp]) << KIND_BITS | PREFETCH
        n_events += ONE
    return n_events


@inlined
def _set_up(origins, directions, core, i):
    """Return (origin, direction, inverses, margins, backwards) of ray i.

    Bit k of ``backwards``: the direction is negative along axis k, so the upper child of a node split there comes first.
    """
    at = i * POINT_FLOATS
    origin = np.float64(origins[at + X]), np.float64(origins[at + Y]), np.float64(origins[at + Z])
    direction = np.float64(directions[at + X]), np.float64(directions[at + Y]), np.float64(directions[at + Z])
    ix, iy, iz = inverse(direction[0]), inverse(direction[1]), inverse(direction[2])
    backwards = (ONE << X if ix < 0.0 else ZERO) | (ONE << Y if iy < 0.0 else ZERO) | (ONE << Z if iz < 0.0 else ZERO)
    inverses = ix, iy, iz
    return origin, direction, inverses, margins(core, origin, direction, inverses), backwards


@inlined
def _closest_in_leaf(prims, corners, first, n_prims, line, near_t, best, best_prim, any_hit):
    """Test the triangles of a leaf; return the better of (best, best_prim) and the best hit among them."""
    for i in range(first, first + n_prims):
        c = prims[i]
        t = triangle_t(corners, i * CORNER_FLOATS, line)
        if t >= near_t and (t < best or (t == best and c < best_prim)):
            best, best_prim = t, c
            if any_hit:
                break
    return best, best_prim


@inlined
def _write_hit(prim, hit_t, i, best, best_prim):
    prim[i] = best_prim if best_prim != NO_PRIM else -1
    hit_t[i] = best + 0.0 if best_prim != NO_PRIM else np.inf


@inlined
def _meets_box(nodes, box, from_lower, from_upper, scale, near_t, far_t):
    """Return whether the interval near_t to far_t meets the box at ``nodes[box]``, the ray's numbers being in lanes."""
    # The fourth lanes hold the next word of the node and are not looked at.
    lower = scaled_difference(load(nodes, box + LOWER), from_lower, scale)
    upper = scaled_difference(load(nodes, box + UPPER), from_upper, scale)
    x, y, z = unpack(smaller(lower, upper))
    t0, t1 = near_t, far_t
    t0 = x if x > t0 else t0
    t0 = y if y > t0 else t0
    t0 = z if z > t0 else t0
    x, y, z = unpack(larger(lower, upper))
    t1 = x if x < t1 else t1
    t1 = y if y < t1 else t1
    t1 = z if z < t1 else t1
    return t0 <= t1


@inlined
def _room_to_step(events, max_level):
    """Return how many events there may be before a ray goes on: the stores between two pops are not guarded.

    Between two pops a ray writes at most one event per level and one per stack entry.
    """
    return np.uint64(events.size - 2 * max_level - 3)


@kernel
def trace_bvh(tree, rays, any_hit, first, hits, count, events):
    """Trace rays ``first``... through a BVH; return the first ray that did not fit into ``events``, else their number.

    The far child is pushed untested; a node is read and its own box tested when it is visited.

    Parameters
    ----------
    tree : TreeArrays
    rays : Rays
        Flat arrays.
    any_hit : bool
    first : int
    hits : Hits
        Filled, as is ``count``, (n,) uint32: the accesses of each ray.
    events : uint32 array or None
        Room for the events of all rays, one after another; None: nothing is traced.
    """
    # Unpacked once: taking an array out of a tuple counts references. Tuples as arguments cost time only at a call, which is
    # for thousands of rays.
    nodes, meta, prims, corners, core, _, max_level = tree
    origins, directions, t_min, t_max = rays
    prim, hit_t = hits
    stack = np.empty(max_level + 1, np.uint32)
    n_events, limit = ZERO, ZERO
    if events is not None:
        limit = _room_to_step(events, max_level)
    for i in range(np.uint64(first), np.uint64(t_min.size)):
        start = n_events
        if events is not None and n_events > limit:
            return np.int64(i)
        origin, direction, inverses, (px, py, pz), backwards = _set_up(origins, directions, core, i)
        line = shear(origin, direction, inverses)
        # The origin as seen from a box's lower and upper faces: so moved that they lie a margin farther out.
        ox, oy, oz = origin
        from_lower, from_upper = pack(ox + px, oy + py, oz + pz), pack(ox - px, oy - py, oz - pz)
        scale = pack(inverses[0], inverses[1], inverses[2])
        best, best_prim, near_t = end_of(t_max[i], origin, direction), NO_PRIM, t_min[i]
        sp, pp, node = ZERO, ZERO, ZERO
        while True:
            b = node * BVH_WORDS
            if _meets_box(nodes, b, from_lower, from_upper, scale, near_t, best):
                m, child = np.uint64(meta[b + META]), np.uint64(meta[b + CHILD])
                axis = m & AXIS_MASK
                if axis != LEAF_AXIS:
                    if events is not None:
                        events[n_events] = node << KIND_BITS | PUSH
                        n_events += ONE
                    upper_first = backwards >> axis & ONE
                    stack[sp] = child + ONE - upper_first
                    sp += ONE
                    pp = sp
                    node = child + upper_first
                    continue
                if events is not None:
                    events[n_events] = node << KIND_BITS | LEAF
                    n_events = _request_stack(events, n_events + ONE, stack, min(pp, sp))
                    pp = ZERO
                n_prims = m >> AXIS_BITS
                best, best_prim = _closest_in_leaf(prims, corners, child, n_prims, line, near_t, best, best_prim, any_hit)
                if any_hit and best_prim != NO_PRIM:
                    break
            elif events is not None:
                events[n_events] = node << KIND_BITS | READ
                n_events += ONE
            if sp == ZERO:
                break
            if events is not None and n_events > limit:
                return np.int64(i)
            sp -= ONE
            node = np.uint64(stack[sp])
        if events is not None:
            count[i] = n_events - start
        _write_hit(prim, hit_t, i, best, best_prim)
    return t_min.size


@inlined
def _links_at(node):
    """Return where the links of a node are among the words of the pairs."""
    place = node + ONE
    return (place >> ONE) * PAIR_WORDS + LINKS + (place & ONE) * LINK_WORDS


@inlined
def _request_inner(events, n_events, links, stack, pp):
    """Request the inner nodes below the prefetch pointer, from the top: a leaf is no node in memory and is passed by."""
    while pp > ZERO:
        pp -= ONE
        node = np.uint64(stack[pp])
        if np.uint64(links[_links_at(node) + ONE]) & AXIS_MASK != LEAF_AXIS:
            events[n_events] = node << KIND_BITS | PREFETCH
            n_events += ONE
    return n_events


@kernel
def trace_bvh64(tree, rays, any_hit, first, hits, count, events):
    """Trace rays ``first``... through a BVH whose nodes hold their children's boxes; as ``trace_bvh``.

    A read tests both children's boxes. The child that the ray enters first is followed (at equal distance the one that comes
    first along the split axis), the other pushed if it is hit. An entry that begins beyond the best hit is popped unread. The
    root's own box is nowhere, so every ray reads the root, unless it is a leaf.
    """
    faces, links, prims, corners, core, _, max_level = tree
    origins, directions, t_min, t_max = rays
    prim, hit_t = hits
    stack = np.empty(max_level + 1, np.uint32)
    entry = np.empty(max_level + 1, np.float64)
    n_events, limit = ZERO, ZERO
    if events is not None:
        limit = _room_to_step(events, max_level)
    for i in range(np.uint64(first), np.uint64(t_min.size)):
        start = n_events
        if events is not None and n_events > limit:
            return np.int64(i)
        origin, direction, inverses, (px, py, pz), backwards = _set_up(origins, directions, core, i)
        line = shear(origin, direction, inverses)
        ox, oy, oz = origin
        ix, iy, iz = inverses
        px, py, pz = np.copysign(px, ix), np.copysign(py, iy), np.copysign(pz, iz)
        # Of each axis: where its nearer faces begin, the origin as seen from nearer and from farther faces, and the inverse,
        # negative for the farther ones, so that the larger of the lanes is the later entry and the sooner exit.
        near_x, near_y, near_z = (backwards & ONE) << ONE, (backwards >> Y & ONE) << ONE, (backwards >> Z & ONE) << ONE
        seen_x, seen_y, seen_z = pack_halves(ox + px, ox - px), pack_halves(oy + py, oy - py), pack_halves(oz + pz, oz - pz)
        scale_x, scale_y, scale_z = pack_halves(ix, -ix), pack_halves(iy, -iy), pack_halves(iz, -iz)
        best, best_prim, near_t = end_of(t_max[i], origin, direction), NO_PRIM, t_min[i]
        sp, pp, node = ZERO, ZERO, ZERO
        link = _links_at(node)
        while True:
            child, m = np.uint64(links[link]), np.uint64(links[link + ONE])
            axis = m & AXIS_MASK
            if axis != LEAF_AXIS:
                at = (child + ONE >> ONE) * PAIR_WORDS
                x = scaled_difference(load(faces, at + near_x), seen_x, scale_x)
                y = scaled_difference(load(faces, at + FACE_WORDS + near_y), seen_y, scale_y)
                z = scaled_difference(load(faces, at + FACE_WORDS + FACE_WORDS + near_z), seen_z, scale_z)
                ends = larger(larger(z, y), larger(x, pack_halves(near_t, -best)))
                lower_t, upper_t, lower_end, upper_end = unpack_all(ends)
                # The order along the axis is known before the distances are, so that the processor goes ahead with its child.
                # Where the links of that are follows from the pair: by its number took 1.1 times as long.
                upper_first = backwards >> axis & ONE
                if upper_first:
                    meets_near, meets_far = upper_t <= -upper_end, lower_t <= -lower_end
                    near_entry, far_entry = upper_t, lower_t
                else:
                    meets_near, meets_far = lower_t <= -lower_end, upper_t <= -upper_end
                    near_entry, far_entry = lower_t, upper_t
                near, far = child + upper_first, child + ONE - upper_first
                link = at + LINKS + upper_first * LINK_WORDS
                far_link = at + LINKS + (ONE - upper_first) * LINK_WORDS
                if meets_near and meets_far:
                    if events is not None:
                        events[n_events] = node << KIND_BITS | PUSH
                        n_events += ONE
                    if far_entry < near_entry:
                        stack[sp], entry[sp] = near, near_entry
                        node, link = far, far_link
                    else:
                        stack[sp], entry[sp] = far, far_entry
                        node = near
                    sp += ONE
                    pp = sp
                    continue
                if events is not None:
                    events[n_events] = node << KIND_BITS | READ
                    n_events += ONE
                if meets_near:
                    node = near
                    continue
                if meets_far:
                    node, link = far, far_link
                    continue
            else:
                if events is not None:
                    events[n_events] = node << KIND_BITS | LEAF
                    n_events = _request_inner(events, n_events + ONE, links, stack, min(pp, sp))
                    pp = ZERO
                n_prims = m >> AXIS_BITS
                best, best_prim = _closest_in_leaf(prims, corners, child, n_prims, line, near_t, best, best_prim, any_hit)
                if any_hit and best_prim != NO_PRIM:
                    break
            while sp > ZERO and entry[sp - ONE] > best:
                sp -= ONE
            if sp == ZERO:
                break
            if events is not None and n_events > limit:
                return np.int64(i)
            sp -= ONE
            node = np.uint64(stack[sp])
            link = _links_at(node)
        if events is not None:
            count[i] = n_events - start
        _write_hit(prim, hit_t, i, best, best_prim)
    return t_min.size


@kernel
def trace_kdtree(tree, rays, any_hit, first, hits, count, events):
    """Trace rays ``first``... through a kd-tree; as ``trace_bvh``.

    The test against the scene's box is free. A ray lying in a split plane (within the margin) visits both cells with its whole
    interval; a popped entry that begins beyond the best hit is skipped, and never ends the ray, because such rays put
    entries on the stack out of order.
    """
    nodes, meta, prims, corners, core, bounds, max_level = tree
    origins, directions, t_min, t_max = rays
    prim, hit_t = hits
    stack = np.empty(max_level + 1, np.uint32)
    seen = np.empty(12, np.float64)
    entry = np.empty(max_level + 1, np.float64)
    exit_ = np.empty(max_level + 1, np.float64)
    n_events, limit = ZERO, ZERO
    if events is not None:
        limit = _room_to_step(events, max_level)
    for i in range(np.uint64(first), np.uint64(t_min.size)):
        start = n_events
        if events is not None and n_events > limit:
            return np.int64(i)
        origin, direction, inverses, (px, py, pz), backwards = _set_up(origins, directions, core, i)
        # The origin as seen from a plane's near and far side is so moved that the plane lies a margin farther out. A table:
        # choosing among three variables at every node took 1.16 to 1.25 times the time.
        ox, oy, oz = origin
        ix, iy, iz = inverses
        seen[INVERSE + X], seen[INVERSE + Y], seen[INVERSE + Z] = ix, iy, iz
        px, py, pz = np.copysign(px, ix), np.copysign(py, iy), np.copysign(pz, iz)
        seen[FROM_NEAR + X], seen[FROM_NEAR + Y], seen[FROM_NEAR + Z] = ox + px, oy + py, oz + pz
        seen[FROM_FAR + X], seen[FROM_FAR + Y], seen[FROM_FAR + Z] = ox - px, oy - py, oz - pz
        best, best_prim, near_t = end_of(t_max[i], origin, direction), NO_PRIM, t_min[i]
        t0, t1 = near_t, best
        for axis in range(AXES):
            near_side = (backwards >> axis & ONE) * POINT_FLOATS  # where the corner starts that the ray meets first
            far_side = POINT_FLOATS - near_side
            low = (bounds[near_side + axis] - seen[FROM_NEAR + axis]) * seen[INVERSE + axis]
            high = (bounds[far_side + axis] - seen[FROM_FAR + axis]) * seen[INVERSE + axis]
            t0 = low if low > t0 else t0
            t1 = high if high < t1 else t1
        if t0 <= t1:
            line = shear(origin, direction, inverses)
            sp, pp, node = ZERO, ZERO, ZERO
            while True:
                b = node * KD_WORDS
                m = np.uint64(meta[b + KD_META])
                axis = m & AXIS_MASK
                if axis != LEAF_AXIS:
                    low = (nodes[b + SPLIT] - seen[FROM_NEAR + axis]) * seen[INVERSE + axis]
                    high = (nodes[b + SPLIT] - seen[FROM_FAR + axis]) * seen[INVERSE + axis]
                    upper_first = backwards >> axis & ONE
                    visits_near, visits_far = high >= t0, low <= t1
                    child = m >> AXIS_BITS
                    near = child + upper_first
                    far = child + ONE - upper_first
                    # In this order: the near child is nearly always visited, but testing it first is slower.
                    if visits_far and visits_near:
                        if events is not None:
                            events[n_events] = node << KIND_BITS | PUSH
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
                            events[n_events] = node << KIND_BITS | READ
                            n_events += ONE
                        node = near if visits_near else far
                    continue
                n_prims = m >> AXIS_BITS
                if events is not None:
                    events[n_events] = node << KIND_BITS | LEAF
                    n_events += ONE
                    if n_prims > ZERO:
                        n_events = _request_stack(events, n_events, stack, min(pp, sp))
                        pp = ZERO
                leaf = np.uint64(meta[b + FIRST])
                best, best_prim = _closest_in_leaf(prims, corners, leaf, n_prims, line, near_t, best, best_prim, any_hit)
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
        _write_hit(prim, hit_t, i, best, best_prim)
    return t_min.size


#: The kernel of each node format.
KERNELS = {"kdtree": trace_kdtree, "bvh": trace_bvh, "bvh64": trace_bvh64}


@kernel
def trace_brute(corners, rays, hits):
    """Closest hit against every triangle: the truth that both trees must reproduce bit by bit."""
    origins, directions, t_min, t_max = rays
    prim, hit_t = hits
    for i in range(np.uint64(t_min.size)):
        at = i * POINT_FLOATS
        origin = np.float64(origins[at + X]), np.float64(origins[at + Y]), np.float64(origins[at + Z])
        direction = np.float64(directions[at + X]), np.float64(directions[at + Y]), np.float64(directions[at + Z])
        line = shear(origin, direction, (inverse(direction[0]), inverse(direction[1]), inverse(direction[2])))
        best, best_prim = end_of(t_max[i], origin, direction), NO_PRIM
        for c in range(corners.size // 9):
            t = triangle_t(corners, np.uint64(c) * CORNER_FLOATS, line)
            if t >= t_min[i] and (t < best or (t == best and c < best_prim)):
                best, best_prim = t, np.int32(c)
        _write_hit(prim, hit_t, i, best, best_prim)


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
        Accesses of each ray, pre-fetch requests included.
    events : (sum of count,) uint32
        ``node << 2 | kind`` of all rays, in ray order.
    """
    return _trace(tree, rays, any_hit, room or Room())


def _trace(tree: Tree, rays: Rays, any_hit: bool, room: Room | None) -> tuple[Hits, np.ndarray, np.ndarray]:
    arrays, flat = tree_arrays(tree), _flat(rays)
    n = len(rays.t_min)
    hits, count = Hits(np.empty(n, np.int32), np.empty(n, np.float64)), np.zeros(n, np.uint32)
    trace_rays = KERNELS[tree.kind]
    if room is None:
        trace_rays(arrays, flat, any_hit, 0, hits, count, None)
        return hits, count, np.empty(0, np.uint32)
    room.grow(EVENTS_PER_RAY * n + 4 * tree.max_level + 64)
    if room.most is not None and room.events.size > 4 * room.most:
        room.events = np.empty(EVENTS_PER_RAY * n + 4 * tree.max_level + 64, np.uint32)  # grown for a single long ray
    first = n_events = 0
    while first < n:
        done = trace_rays(arrays, flat, any_hit, first, hits, count, room.events[n_events:])
        n_events += int(count[first:done].sum())
        if done < n:
            if n > 1 and room.most is not None and room.events.size >= room.most:
                raise NoRoomError
            room.grow(2 * room.events.size, n_events)
        first = done
    return hits, count, room.events[:n_events]


def _flat(rays: Rays) -> Rays:
    return Rays(rays.origin.reshape(-1), rays.direction.reshape(-1), rays.t_min, rays.t_max)


def trace_all(triangles: np.ndarray, rays: Rays) -> Hits:
    """Return the closest hits by testing every triangle."""
    n = len(rays.t_min)
    hits = Hits(np.empty(n, np.int32), np.empty(n, np.float64))
    trace_brute(triangles.reshape(-1), _flat(rays), hits)
    return hits
