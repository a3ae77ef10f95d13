"""A cell's events on one axis -> the plane across it that the surface area heuristic finds cheapest, in one sweep."""

import numpy as np

from nptrace_base.jit import inlined, kernel
from rtrace.trees.clip import value
from rtrace.trees.kd_events import BOX, END, KIND, PLACE, PLANAR, START, UPPER


@kernel
def half_area_of(boxes, cell):
    """Return half the surface area of a cell, in float64: no product of float32 lengths is lost at either end."""
    lower = BOX * cell
    upper = lower + UPPER
    dx, dy, dz = boxes[upper] - boxes[lower], boxes[upper + 1] - boxes[lower + 1], boxes[upper + 2] - boxes[lower + 2]
    return dx * dy + dy * dz + dz * dx


@inlined
def _plane_at(event, first_above):
    """Return the plane through an event's position; ``first_above`` is the least kind of events there that are above it.

    PLANAR puts the triangles that lie in the plane above it, START below.
    """
    return (event & PLACE) + first_above


@kernel
def sweep(events, axis, span, boxes, cell, n, costs, best):
    """Return the cheapest plane across one axis, (cost, plane), or ``best`` when that is as cheap.

    Costs are in intersections x half the cell's area; half a child's area is linear in the position: cap + rim * length.
    ``plane`` is the least event above the plane, so it tells the position and the side of the triangles lying in it.

    A plane is tried at *every* event. In a run of events at one position the counts are not final and so too high, never
    too low: the least cost is that of the final ones, without a branch on the kind of event. But counts too high may cost as
    little, by rounding, so ``kd_events.classify`` counts again at the plane found.
    """
    (begin, end), (trav, empty_bonus), (cost, plane) = span, costs, best
    lo, hi = boxes[BOX * cell + axis], boxes[BOX * cell + UPPER + axis]
    y, z = BOX * cell + (axis + 1) % 3, BOX * cell + (axis + 2) % 3
    dy, dz = boxes[y + UPPER] - boxes[y], boxes[z + UPPER] - boxes[z]
    cap, rim = dy * dz, dy + dz
    fixed = trav * (cap + (hi - lo) * rim)
    below, above = np.int64(0), n
    first, last = value(events[axis, begin] >> 32), value(events[axis, end - 1] >> 32)

    # Only the first and the last plane can leave a child empty.
    trial = empty_bonus * (fixed + (cap + (hi - first) * rim) * n)
    if trial < cost and first > lo:
        cost, plane = trial, _plane_at(events[axis, begin], PLANAR)
    i, stop = np.uint64(begin), np.uint64(end)  # unsigned: no test for a negative index, 15 % of a sweep
    while i < stop:
        event = events[axis, i]
        kind = event & KIND
        x = value(event >> 32)
        area_below, area_above = cap + (x - lo) * rim, cap + (hi - x) * rim
        if kind != PLANAR:
            above -= kind == END
            trial = fixed + (area_below * below + area_above * above)
            if trial < cost and lo < x < hi:
                cost, plane = trial, _plane_at(event, PLANAR if kind == END else START)
            below += kind == START
            i += np.uint64(1)
        else:
            planar = np.int64(0)
            while i < stop and events[axis, i] >> 30 == event >> 30:
                planar += 1
                i += np.uint64(1)
            # At the cell's border only the flat side is of use: it takes the planar triangles out of the cell.
            trial = fixed + (area_below * (below + planar) + area_above * (above - planar))
            if x < hi and (trial < cost or (trial == cost < best[0] and plane >> 32 == event >> 32)):
                cost, plane = trial, _plane_at(event, START)
            trial = fixed + (area_below * below + area_above * above)
            if trial < cost and x > lo:
                cost, plane = trial, _plane_at(event, PLANAR)
            below += planar
            above -= planar
    trial = empty_bonus * (fixed + (cap + (last - lo) * rim) * n)
    if last < hi and (trial < cost or (trial == cost < best[0] and plane >> 32 == events[axis, end - 1] >> 32)):
        cost, plane = trial, _plane_at(events[axis, end - 1], START)
    return cost, plane
