"""The traverser of 32-byte BVH nodes, each with its own box."""

import numpy as np

from nptrace_base.jit import inlined, kernel
from rtrace.intersect import NO_PRIM, end_of, shear
from rtrace.simd import larger, load, pack, scaled_difference, smaller, unpack
from rtrace.traversers.common import (
    AXIS_BITS,
    AXIS_MASK,
    BVH_WORDS,
    CHILD,
    KIND_BITS,
    LEAF,
    LEAF_AXIS,
    LOWER,
    META,
    ONE,
    PUSH,
    READ,
    UPPER,
    ZERO,
    closest_in_leaf,
    request_stack,
    room_to_step,
    set_up,
    write_hit,
)


@inlined
def meets_box(nodes, box, from_lower, from_upper, scale, near_t, far_t):
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
        limit = room_to_step(events, max_level)
    for i in range(np.uint64(first), np.uint64(t_min.size)):
        start = n_events
        if events is not None and n_events > limit:
            return np.int64(i)
        origin, direction, inverses, (px, py, pz), backwards = set_up(origins, directions, core, i)
        line = shear(origin, direction, inverses)
        # The origin as seen from a box's lower and upper faces: so moved that they lie a margin farther out.
        ox, oy, oz = origin
        from_lower, from_upper = pack(ox + px, oy + py, oz + pz), pack(ox - px, oy - py, oz - pz)
        scale = pack(inverses[0], inverses[1], inverses[2])
        best, best_prim, near_t = end_of(t_max[i], origin, direction), NO_PRIM, t_min[i]
        sp, pp, node = ZERO, ZERO, ZERO
        while True:
            b = node * BVH_WORDS
            if meets_box(nodes, b, from_lower, from_upper, scale, near_t, best):
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
                    n_events = request_stack(events, n_events + ONE, stack, min(pp, sp))
                    pp = ZERO
                n_prims = m >> AXIS_BITS
                best, best_prim = closest_in_leaf(prims, corners, child, n_prims, line, near_t, best, best_prim, any_hit)
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
        write_hit(prim, hit_t, i, best, best_prim)
    return t_min.size
