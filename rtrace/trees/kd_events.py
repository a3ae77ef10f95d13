"""The sorted events of a kd-tree's triangles: made once for the scene, then parted between the two children of every split.

An *event* is a place on one axis where a triangle's bounds start, end, or lie flat. The triangles on one side of a plane
keep their events, in order. A *straddler*, a triangle that the plane cuts, gets new ones on both sides: its old events
move to the bounds of its part, are sorted and merged in.
"""

from typing import NamedTuple

import numpy as np

from nptrace_base.jit import kernel
from rtrace.trees.clip import PartBounds

#: An event is one int64: rank of the position << 32 | kind << 30 | triangle. Sorted, what ends at a position comes before
#: what lies in it, and that before what starts there. NumPy's integers, because Numba compiles a kernel for each literal.
END, PLANAR, START = np.int64(0), np.int64(1 << 30), np.int64(2 << 30)
KIND = 3 << 30
TRIANGLE = (1 << 30) - 1
PLACE = -1 << 32

#: Numbers of a cell's box, or a triangle's bounds, and where its upper corner starts; signed, as the kernels here index.
BOX, UPPER = 6, 3

#: On which sides of a plane a triangle is: bits.
BELOW, ABOVE, BOTH = 1, 2, 3


class Straddlers(NamedTuple):
    """The triangles that a plane cuts, each with a slot of its own: ``listed[slot[triangle]] == triangle``."""

    slot: np.ndarray  # (n_triangles,) int32
    listed: np.ndarray  # (n_triangles,) int32
    bounds: PartBounds  # by slot


class Parted(NamedTuple):
    """The events of a cell whose plane is chosen; those of the upper child stay in the arena."""

    kept: np.ndarray  # (3, 2 n_triangles) int64, the lower child's
    cut: np.ndarray  # (3, 2 n_triangles) int64, the straddlers'
    n_kept: np.ndarray  # (3,) int64
    n_cut: np.ndarray  # (3,) int64
    end_above: np.ndarray  # (3,) int64, where the upper child's end in the arena


def first_events(lower, upper):
    """Return the sorted events of whole triangles, a (3, room) array, and how many there are on each axis."""
    n = len(lower)
    events = np.empty((3, 4 * n + 64), np.int64)
    counts = np.empty(3, np.int64)
    for k in range(3):
        bits = np.stack((lower[:, k], upper[:, k])).view(np.int32)
        lo, hi = np.where(bits < 0, np.int32(-(2**31)) - bits, bits)  # ranks, as clip.rank has them
        flat = lo == hi
        ends = np.flatnonzero(~flat)
        counts[k] = n + ends.size
        starts, rest = events[k, :n], events[k, n : counts[k]]
        np.left_shift(lo, 32, out=starts, dtype=np.int64)
        starts |= np.where(flat, PLANAR, START)
        starts |= np.arange(n)
        np.left_shift(hi[ends], 32, out=rest, dtype=np.int64)
        rest |= ends
        events[k, : counts[k]].sort()
    return events, counts


@kernel
def classify(events, axis, span, plane, n, side):
    """Write on which side of the plane each of the cell's n triangles is; return how many are on it (below, above)."""
    n_below, n_above = np.int64(0), n
    i, stop = np.uint64(span[0]), np.uint64(span[1])
    while i < stop and events[axis, i] < plane:
        event = events[axis, i]
        kind = event & KIND
        side[np.uint64(event & TRIANGLE)] = BOTH if kind == START else BELOW
        n_below += kind != END
        n_above -= kind != START
        i += np.uint64(1)
    while i < stop:
        event = events[axis, i]
        triangle = np.uint64(event & TRIANGLE)
        side[triangle] = side[triangle] if event & KIND == END else ABOVE
        i += np.uint64(1)
    return n_below, n_above


# Without counting references (_nrt=False): unpacking the tuples would count one for each array, at every split.
@kernel(_nrt=False)
def partition(events, axis, span, side, straddlers, n_straddlers, parted):
    """Part the events of one axis: the upper child's to the front, the lower one's to ``kept``, straddlers' to ``cut``.

    Return the number of straddlers; the first axis lists them, every axis writes its part of their bounds.
    """
    slot, listed, bounds = straddlers.slot, straddlers.listed, straddlers.bounds.whole
    kept, cut = parted.kept, parted.cut
    begin, end = np.uint64(span[0]), np.uint64(span[1])
    n_below, n_cut, n_above = np.uint64(0), np.uint64(0), begin  # unsigned as in a sweep
    for i in range(begin, end):
        event = events[axis, i]
        triangle = np.uint64(event & TRIANGLE)
        where = side[triangle]
        kept[axis, n_below] = event
        n_below += np.uint64(where == BELOW)
        events[axis, n_above] = event
        n_above += np.uint64(where == ABOVE)
        if where == BOTH:
            kind = event & KIND
            if axis == 0 and kind != END:
                slot[triangle] = n_straddlers
                listed[n_straddlers] = event & TRIANGLE
                n_straddlers += 1
            cut[axis, n_cut] = event
            n_cut += np.uint64(1)
            at = BOX * slot[triangle] + axis
            if kind != END:
                bounds[at] = event >> 32
            if kind != START:
                bounds[at + UPPER] = event >> 32
    parted.n_kept[axis], parted.n_cut[axis], parted.end_above[axis] = n_below, n_cut, n_above
    return n_straddlers


@kernel
def renew(cut, axis, n_cut, slot, bounds, fresh):
    """Write the straddlers' events, moved to new bounds, to ``fresh``; return their number."""
    n = np.int64(0)
    for i in range(n_cut):
        kind, triangle = cut[axis, i] & KIND, cut[axis, i] & TRIANGLE
        at = BOX * slot[triangle] + axis
        lo, hi = np.int64(bounds[at]), np.int64(bounds[at + UPPER])
        flat = lo == hi
        fresh[n] = ((hi if kind == END else lo) << 32) | (PLANAR if flat else kind) | triangle
        n += 0 if flat and kind == END else 1
    return n


@kernel
def merge(events, axis, begin, end, fresh, n):
    """Merge n sorted events into the sorted events[axis, begin:end]; return the new end."""
    i, j, out = end - 1, n - 1, end + n - 1
    while j >= 0:
        if i >= begin and events[axis, i] > fresh[j]:
            events[axis, out] = events[axis, i]
            i -= 1
        else:
            events[axis, out] = fresh[j]
            j -= 1
        out -= 1
    return end + n


@kernel
def list_triangles(events, begin, end, fresh):
    """Write the triangles of a cell to ``fresh``; return their number."""
    n = np.int64(0)
    for i in range(begin, end):
        fresh[n] = events[0, i] & TRIANGLE
        n += events[0, i] & KIND != END
    return n
