"""The traverser of packets in 8-byte kd-tree nodes, as Manta's recursion reads them (2013)."""

import numpy as np

from nptrace_base.jit import inlined, kernel
from rtrace.intersect import POINT_FLOATS
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
    request_stack,
    room_to_step,
)
from rtrace.traversers.packets import MOST, begin_packet, test_leaf, write_hits


@kernel(_nrt=False)
def trace_kdtree_packets(tree, rays, packets, first, state, hits, count, events):
    """Trace packets from ray ``first`` on; as ``trace_bvh_packets``.

    Each ray has an interval of its own and is active where the interval is not empty. Near and far are the same for all rays:
    where a direction changes sign on any axis, a packet of its own begins. A popped entry is read if the interval of a ray
    that waits for it begins no later than the ray's best hit. With ``packets.cheaper`` the far child may be visited first.
    """
    nodes, meta, prims, corners, core, bounds, max_level = tree
    prim, hit_t = hits
    stack = state.stack
    n_events, limit = ZERO, room_to_step(events, max_level)
    i, n = np.uint64(first), np.uint64(count.size)
    while i < n:
        if n_events > limit:
            return np.int64(i)
        start = n_events
        n_rays = begin_packet(rays, core, packets.number, i, True, state)
        n_active = _enter(bounds, state, n_rays)
        sp, pp, node = ZERO, ZERO, ZERO
        while n_active > ZERO:
            b = node * KD_WORDS
            m = np.uint64(meta[b + KD_META])
            axis = m & AXIS_MASK
            if axis != LEAF_AXIS:
                upper_first = state.backwards[ZERO] >> axis & ONE
                some_near, some_far = _cross(nodes[b + SPLIT], axis, state, n_active)
                near = (m >> AXIS_BITS) + upper_first
                far = (m >> AXIS_BITS) + ONE - upper_first
                if some_near and some_far:
                    events[n_events] = node << KIND_BITS | PUSH
                    near_first = packets.cheaper.size == 0 or np.uint64(packets.cheaper[node]) == upper_first
                    stack[sp] = far if near_first else near
                    n_active = _part(state, sp, n_active, near_first)
                    sp += ONE
                    pp = sp
                    node = near if near_first else far
                else:
                    events[n_events] = node << KIND_BITS | READ
                    node = near if some_near else far
                n_events += ONE
                continue
            n_prims = m >> AXIS_BITS
            events[n_events] = node << KIND_BITS | LEAF
            n_events += ONE
            if n_prims > ZERO:
                n_events = request_stack(events, n_events, stack, min(pp, sp))
                pp = ZERO
            test_leaf(prims, corners, np.uint64(meta[b + FIRST]), n_prims, packets.any_hit, state, n_active)
            n_active = ZERO
            while sp > ZERO and n_active == ZERO:
                sp -= ONE
                node = np.uint64(stack[sp])
                n_active = _go_on(state, sp)
            if n_active > ZERO and n_events > limit:
                return np.int64(i)
        count[i] = n_events - start
        write_hits(prim, hit_t, i, n_rays, state)
        i += n_rays
    return np.int64(n)


@inlined
def _crossing(plane, axis, is_far, state, r):
    """Return where ray ``r`` crosses a plane, on the side of it that it meets first, or with ``is_far`` the other one."""
    at = axis * MOST + r
    is_lower = (state.backwards[r] >> axis & ONE) == (ONE if is_far else ZERO)
    return (plane - (state.from_lower[at] if is_lower else state.from_upper[at])) * state.inverse[at]


@inlined
def _enter(bounds, state, n_rays):
    """Let the rays be active that meet the scene's box, each with its interval there; return how many they are."""
    n_active = ZERO
    for r in range(n_rays):
        t0, t1 = state.near_t[r], state.best[r]
        for axis in range(AXES):
            near_side = (state.backwards[r] >> axis & ONE) * POINT_FLOATS  # where the corner starts that the ray meets first
            low = _crossing(bounds[near_side + axis], axis, False, state, r)
            high = _crossing(bounds[POINT_FLOATS - near_side + axis], axis, True, state, r)
            t0 = low if low > t0 else t0
            t1 = high if high < t1 else t1
        if t0 <= t1:
            state.t0[r], state.t1[r] = t0, t1
            state.active[n_active] = r
            n_active += ONE
    return n_active


@inlined
def _cross(plane, axis, state, n_active):
    """Note where the active rays cross a plane; return whether one of them visits the near child, and one the far child."""
    some_near, some_far = False, False
    for j in range(n_active):
        r = state.active[j]
        low, high = _crossing(plane, axis, False, state, r), _crossing(plane, axis, True, state, r)
        visits_near = high >= state.t0[r]
        some_near |= visits_near
        some_far |= low <= state.t1[r] or not visits_near
        state.low[r], state.high[r] = low, high
    return some_near, some_far


@inlined
def _part(state, sp, n_active, near_first):
    """Let the active rays go on in the child that is visited first, and wait for the other as entry ``sp`` of the stack.

    A ray does what it visits: one of the two, or both. Returns how many rays stay active.
    """
    n_stay, n_wait = ZERO, ZERO
    for j in range(n_active):
        r = state.active[j]
        low, high, t0, t1 = state.low[r], state.high[r], state.t0[r], state.t1[r]
        visits_near = high >= t0
        visits_far = low <= t1 or not visits_near
        near_end, far_start = high if high < t1 else t1, low if low > t0 else t0
        at = sp * MOST + n_wait
        if near_first:
            stays, waits = visits_near, visits_far
            state.entry[at], state.exit[at] = far_start, t1
            state.t1[r] = near_end
        else:
            stays, waits = visits_far, visits_near
            state.entry[at], state.exit[at] = t0, near_end
            state.t0[r] = far_start
        state.waiting[at] = r
        n_wait += ONE if waits else ZERO
        state.active[n_stay] = r
        n_stay += ONE if stays else ZERO
    state.n_waiting[sp] = n_wait
    return n_stay


@inlined
def _go_on(state, sp):
    """Let the rays that wait for entry ``sp`` be active, but those that have ended or hit before it; return their number."""
    n_active = ZERO
    for j in range(state.n_waiting[sp]):
        at = sp * MOST + j
        r = state.waiting[at]
        if not state.is_done[r] and not state.entry[at] > state.best[r]:
            state.t0[r], state.t1[r] = state.entry[at], state.exit[at]
            state.active[n_active] = r
            n_active += ONE
    return n_active
