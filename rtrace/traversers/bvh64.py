"""The traverser of 64-byte BVH nodes, which hold their children's boxes."""

import numpy as np

from nptrace_base.jit import inlined, kernel
from rtrace.intersect import NO_PRIM, Y, Z, end_of, shear
from rtrace.simd import larger, load, pack_halves, scaled_difference, unpack_all
from rtrace.traversers.common import (
    AXIS_BITS,
    AXIS_MASK,
    FACE_WORDS,
    KIND_BITS,
    LEAF,
    LEAF_AXIS,
    LINK_CHILD,
    LINK_META,
    LINK_WORDS,
    LINKS,
    ONE,
    PAIR_WORDS,
    PREFETCH,
    PUSH,
    READ,
    ZERO,
    closest_in_leaf,
    room_to_step,
    set_up,
    write_hit,
)


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
        if np.uint64(links[_links_at(node) + LINK_META]) & AXIS_MASK != LEAF_AXIS:
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
        limit = room_to_step(events, max_level)
    for i in range(np.uint64(first), np.uint64(t_min.size)):
        start = n_events
        if events is not None and n_events > limit:
            return np.int64(i)
        origin, direction, inverses, (px, py, pz), backwards = set_up(origins, directions, core, i)
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
            child, m = np.uint64(links[link + LINK_CHILD]), np.uint64(links[link + LINK_META])
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
                best, best_prim = closest_in_leaf(prims, corners, child, n_prims, line, near_t, best, best_prim, any_hit)
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
        write_hit(prim, hit_t, i, best, best_prim)
    return t_min.size
