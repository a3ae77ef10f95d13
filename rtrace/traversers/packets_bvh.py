"""The traverser of packets in 32-byte BVH nodes, as Manta's recursion reads them (2013)."""

import numpy as np

from nptrace_base.jit import inlined, kernel
from rtrace.simd import pack
from rtrace.traversers.bvh import meets_box
from rtrace.traversers.common import (
    AXIS_BITS,
    AXIS_MASK,
    BVH_WORDS,
    CHILD,
    KIND_BITS,
    LEAF,
    LEAF_AXIS,
    META,
    ONE,
    PUSH,
    READ,
    ZERO,
    request_stack,
    room_to_step,
)
from rtrace.traversers.packets import MOST, begin_packet, test_leaf, write_hits


@kernel(_nrt=False)
def trace_bvh_packets(tree, rays, packets, first, state, hits, count, events):
    """Trace packets from ray ``first`` on; return the first ray of the packet that did not fit into ``events``, else n.

    A node is read and its box tested by all active rays; if one of them meets it, both children are visited, the second one
    pushed untested. Rays that have ended test no more, but what waits on the stack is read as long as a ray of the packet has
    not ended (with ``drains`` always): the stack does not know for which rays.

    Parameters
    ----------
    tree : TreeArrays
    rays : Rays
        Flat arrays.
    packets : Packets
    first : int
    state : PacketState
        Overwritten.
    hits : Hits
        Filled, as is ``count``, (n,) uint32: the accesses of the packet at its first ray; 0 there before.
    events : uint32 array
        Room for the events of all packets, one after another.
    """
    nodes, meta, prims, corners, core, _, max_level = tree
    prim, hit_t = hits
    stack = state.stack
    n_events, limit = ZERO, room_to_step(events, max_level)
    i, n = np.uint64(first), np.uint64(count.size)
    while i < n:
        if n_events > limit:
            return np.int64(i)
        start = n_events
        n_rays = begin_packet(rays, core, packets.number, i, False, state)
        n_active, n_live = n_rays, n_rays
        sp, pp, node = ZERO, ZERO, ZERO
        while True:
            b = node * BVH_WORDS
            n_active = _that_meet(nodes, b, state, n_active)
            if n_active > ZERO:
                m, child = np.uint64(meta[b + META]), np.uint64(meta[b + CHILD])
                axis = m & AXIS_MASK
                if axis != LEAF_AXIS:
                    events[n_events] = node << KIND_BITS | PUSH
                    n_events += ONE
                    upper_first = state.backwards[state.active[ZERO]] >> axis & ONE
                    if packets.cheaper.size > 0:
                        upper_first = np.uint64(packets.cheaper[node])
                    stack[sp] = child + ONE - upper_first
                    _wait(state, sp, n_active)
                    sp += ONE
                    pp = sp
                    node = child + upper_first
                    continue
                events[n_events] = node << KIND_BITS | LEAF
                n_events = request_stack(events, n_events + ONE, stack, min(pp, sp))
                pp = ZERO
                n_live -= test_leaf(prims, corners, child, m >> AXIS_BITS, packets.any_hit, state, n_active)
                if n_live == ZERO and not packets.drains:
                    break
            else:
                events[n_events] = node << KIND_BITS | READ
                n_events += ONE
            if sp == ZERO:
                break
            if n_events > limit:
                return np.int64(i)
            sp -= ONE
            node = np.uint64(stack[sp])
            n_active = _go_on(state, sp)
        count[i] = n_events - start
        write_hits(prim, hit_t, i, n_rays, state)
        i += n_rays
    return np.int64(n)


@inlined
def _that_meet(nodes, box, state, n_active):
    """Let those of the active rays be active that meet the box at ``nodes[box]``; return how many they are."""
    lower, upper, inverse, n_meet = state.from_lower, state.from_upper, state.inverse, ZERO
    for j in range(n_active):
        x = state.active[j]
        y, z = MOST + x, MOST + MOST + x
        from_lower, from_upper = pack(lower[x], lower[y], lower[z]), pack(upper[x], upper[y], upper[z])
        scale = pack(inverse[x], inverse[y], inverse[z])
        if meets_box(nodes, box, from_lower, from_upper, scale, state.near_t[x], state.best[x]):
            state.active[n_meet] = x
            n_meet += ONE
    return n_meet


@inlined
def _wait(state, sp, n_active):
    """Note that the active rays wait for entry ``sp`` of the stack."""
    for j in range(n_active):
        state.waiting[sp * MOST + j] = state.active[j]
    state.n_waiting[sp] = n_active


@inlined
def _go_on(state, sp):
    """Let the rays that wait for entry ``sp`` be active, but those that have ended; return how many they are."""
    n_active = ZERO
    for j in range(state.n_waiting[sp]):
        r = state.waiting[sp * MOST + j]
        if not state.is_done[r]:
            state.active[n_active] = r
            n_active += ONE
    return n_active
