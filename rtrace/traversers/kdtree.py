"""The traverser of 8-byte kd-tree nodes."""

import numpy as np

from nptrace_base.jit import kernel
from rtrace.intersect import NO_PRIM, POINT_FLOATS, X, Y, Z, end_of, shear
from rtrace.traversers.common import (
    AXES,
    AXIS_BITS,
    AXIS_MASK,
    FIRST,
    KD_META,
    KD_WORDS,
    KIND_BITS,
    LEAF,
    LEAF_AXIS,
    ONE,
    PUSH,
    READ,
    SPLIT,
    ZERO,
    closest_in_leaf,
    request_stack,
    room_to_step,
    set_up,
    write_hit,
)

#: Where a kd ray's table has, per axis, the inverse of the direction, and the origin as seen from a plane's two sides.
INVERSE, FROM_NEAR, FROM_FAR = np.uint64(0), np.uint64(4), np.uint64(8)


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
        limit = room_to_step(events, max_level)
    for i in range(np.uint64(first), np.uint64(t_min.size)):
        start = n_events
        if events is not None and n_events > limit:
            return np.int64(i)
        origin, direction, inverses, (px, py, pz), backwards = set_up(origins, directions, core, i)
        # The origin as seen from a plane's near and far side is so moved that the plane lies a margin farther out. A table:
        # choosing among three variables at every node takes 1.08 to 1.13 times the time (`make bench`).
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
                        n_events = request_stack(events, n_events, stack, min(pp, sp))
                        pp = ZERO
                leaf = np.uint64(meta[b + FIRST])
                best, best_prim = closest_in_leaf(prims, corners, leaf, n_prims, line, near_t, best, best_prim, any_hit)
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
        write_hit(prim, hit_t, i, best, best_prim)
    return t_min.size
