"""What the traversers of all node formats share: the set-up of a ray, the leaf, the prefetch unit, and the rules.

An access is written as one uint32, ``node << 2 | kind``, with the kinds of ``traces.format``. A kernel serves closest-hit
and any-hit rays, traced or not (``events`` None compiles to a kernel without tracing).

Rules that hold for all (reasons in docs/correctness.md):

- The triangle test decides; boxes and planes only skip what cannot matter: they are moved outwards by a margin, per ray and
  axis (``intersect.margins``). So a ray lying in a face or a split plane is on both sides of it.
- A hit counts when t_min <= t <= t_max. Among equal t the lowest triangle number wins, so culling keeps equals.
- The prefetch unit of Park et al. 2013, Sec. 3: a push sets its pointer to the stack top, a pop lowers it to the top; at a
  non-empty leaf, before its triangles are tested, it requests the nodes below its pointer, which stays where it stops.
  Between two pushes the top only falls, so it is enough to lower the pointer at the leaf.
"""

import numpy as np

from nptrace_base.jit import inlined, kernel
from rtrace.intersect import CORNER_FLOATS, NO_PRIM, POINT_FLOATS, X, Y, Z, end_of, inverse, margins, shear, triangle_t
from rtrace.trees import tree as layout
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
PAIR_WORDS, FACE_WORDS, LINKS, LINK_WORDS, LINK_CHILD, LINK_META, AXIS_BITS, AXIS_MASK, LEAF_AXIS = (
    np.uint64(getattr(layout, name))
    for name in (
        *("PAIR_WORDS", "FACE_WORDS", "LINKS", "LINK_WORDS", "LINK_CHILD", "LINK_META"),
        *("AXIS_BITS", "AXIS_MASK", "LEAF_AXIS"),
    )
)
READ, PUSH, LEAF, PREFETCH = map(np.uint64, (run_format.READ, run_format.PUSH, run_format.LEAF, run_format.PREFETCH))
#: Low bits of an event: the kind of the access; above them the node.
KIND_BITS = np.uint64(2)


@inlined
def request_stack(events, n_events, stack, pp):
    """Request the nodes below the prefetch pointer, from the top; return the number of events."""
    while pp > ZERO:
        pp -= ONE
        events[n_events] = np.uint64(stack[pp]) << KIND_BITS | PREFETCH
        n_events += ONE
    return n_events


@inlined
def set_up(origins, directions, core, i):
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
def closest_in_leaf(prims, corners, first, n_prims, line, near_t, best, best_prim, any_hit):
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
def write_hit(prim, hit_t, i, best, best_prim):
    """Write what ray i met; a hit at -0 is at 0."""
    prim[i] = best_prim if best_prim != NO_PRIM else -1
    hit_t[i] = best + 0.0 if best_prim != NO_PRIM else np.inf


@inlined
def room_to_step(events, max_level):
    """Return how many events there may be before a ray goes on: the stores between two pops are not guarded.

    Between two pops a ray writes at most one event per level and one per stack entry.
    """
    return np.uint64(events.size - 2 * max_level - 3)


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
        write_hit(prim, hit_t, i, best, best_prim)
