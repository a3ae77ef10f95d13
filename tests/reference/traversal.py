"""A slow traverser in plain Python, written from the paper and the design, not from the kernels: the reference for visits.

It has a separate stack (a list) and prefetch unit (an object with the words of Park et al. 2013, Sec. 3).
Python floats are IEEE doubles, so results are compared bit by bit.
"""

import math
from fractions import Fraction

import numpy as np

READ, PUSH, LEAF, PREFETCH = 0, 1, 2, 3
PAD, ORIGIN_PAD, LEAST_PAD, HUGE = 2.0**-44, 2.0**-50, 1e-100, 1.7976931348623157e308
THIN = 2.0**-6


class PrefetchUnit:
    """The node stack and the additional top pointer that the pre-fetching unit owns."""

    def __init__(self):
        self.stack = []
        self.pointer = 0
        self.is_requested = lambda node: True  # whether it is a node in memory

    def push(self, entry):
        # "When the traversal unit inserts a node into the stack, it assigns the same position to the pre-fetching pointer"
        self.stack.append(entry)
        self.pointer = len(self.stack)

    def pop(self):
        entry = self.stack.pop()
        self.pointer = min(self.pointer, len(self.stack))
        return entry

    def requests(self):
        # "until every addresses in the stack is requested": the intersection test is assumed long enough
        while self.pointer > 0:
            self.pointer -= 1
            if self.is_requested(self.stack[self.pointer][0]):
                yield self.stack[self.pointer][0]


def inverse(d):
    """Return 1 / d, a huge number for a zero of either sign: products with it are never undefined."""
    return 1.0 / d if d != 0.0 else HUGE


def triangle_hit(corners, origin, direction):
    """Return t of Woop, Benthin, Wald 2013, or None."""
    size = [abs(d) for d in direction]
    kz = size.index(max(size))
    kx, ky = (kz + 1) % 3, (kz + 2) % 3
    scale = inverse(direction[kz])
    shear_x, shear_y = direction[kx] * scale, direction[ky] * scale
    moved = [[corner[k] - origin[k] for k in range(3)] for corner in corners]
    (ax, ay), (bx, by), (cx, cy) = [(p[kx] - shear_x * p[kz], p[ky] - shear_y * p[kz]) for p in moved]
    pairs = [(cx, by, cy, bx), (ax, cy, ay, cx), (bx, ay, by, ax)]
    u, v, w = (a * b - c * d for a, b, c, d in pairs)
    size = 0.0
    for a, b, c, d in pairs:
        size = size + abs(a * b) + abs(c * d)
    if abs(u + v + w) <= THIN * size or 0.0 in (u, v, w):
        u, v, w = (accurate_difference(*pair) for pair in pairs)
    # Signs as exact arithmetic on the sheared corners has them: the kernel must not differ, whatever it leaves out.
    exact = [Fraction(a) * Fraction(b) - Fraction(c) * Fraction(d) for a, b, c, d in pairs]
    assert [(x > 0) - (x < 0) for x in exact] == [(x > 0) - (x < 0) for x in (u, v, w)]
    if min(exact) < 0 < max(exact):
        return None
    det = u + v + w
    if det == 0.0:
        return None
    depths = [p[kz] for p in moved]
    return (u * depths[0] + v * depths[1] + w * depths[2]) / det * scale


def accurate_difference(a, b, c, d):
    """Return a * b - c * d from the rounded products and what their rounding lost, both as floats."""
    p, q = a * b, c * d
    lost = [float(Fraction(x) * Fraction(y) - Fraction(product)) for x, y, product in ((a, b, p), (c, d, q))]
    return (p - q) + (lost[0] - lost[1])


class Nearest:
    """The best hit so far: smallest t in [t_min, t_max], then smallest triangle number."""

    def __init__(self, t_min, t_max):
        self.t_min, self.t, self.prim = t_min, t_max, None

    def offer(self, t, prim):
        if t is None or not self.t_min <= t <= self.t:
            return
        if t < self.t or self.prim is None or prim < self.prim:
            self.t, self.prim = t, prim

    def answer(self):
        return (-1, math.inf) if self.prim is None else (self.prim, self.t)


class Seen:
    """The ray's origin as seen from the near and the far sides of planes: moved so that planes lie a margin farther out."""

    def __init__(self, tree, origin, direction):
        lower, upper = (b.astype(float).tolist() for b in tree.core)
        reach = [max(abs(lower[k] - origin[k]), abs(upper[k] - origin[k])) for k in range(3)]
        size = [abs(d) for d in direction]
        z = size.index(max(size))
        self.inverse = [inverse(d) for d in direction]
        along = reach[z] * abs(self.inverse[z])
        self.near, self.far = [], []
        for k in range(3):
            pad = PAD * (reach[k] + along * size[k]) + ORIGIN_PAD * abs(origin[k]) + LEAST_PAD
            if self.inverse[k] < 0:
                pad = -pad
            self.near.append(origin[k] + pad)
            self.far.append(origin[k] - pad)

    def enters(self, k, plane):
        return (plane - self.near[k]) * self.inverse[k]

    def leaves(self, k, plane):
        return (plane - self.far[k]) * self.inverse[k]


def box_interval(lower, upper, seen, t_min, t_max):
    """Return the ray's interval in a box."""
    for k in range(3):
        near, far = (upper[k], lower[k]) if seen.inverse[k] < 0 else (lower[k], upper[k])
        t_min = max(t_min, seen.enters(k, near))
        t_max = min(t_max, seen.leaves(k, far))
    return t_min, t_max


def traverse(tree, origin, direction, t_min=0.0, t_max=math.inf, any_hit=False):
    """Return (prim, t, [(node, kind), ...]) for one ray."""
    origin, direction = [float(x) for x in origin], [float(x) for x in direction]
    walk = WALKS[tree.kind]
    if not all(map(math.isfinite, origin + direction)) or not any(direction):
        t_max = math.nan  # that is no ray
    best, events = Nearest(t_min, t_max), []
    walk(tree, origin, direction, best, any_hit, events)
    return (*best.answer(), events)


def _test_leaf(tree, first, count, origin, direction, best, any_hit):
    for prim in tree.prims[first : first + count]:
        best.offer(triangle_hit(tree.triangles[prim].astype(float).tolist(), origin, direction), int(prim))
        if any_hit and best.prim is not None:
            return True
    return False


def _traverse_bvh(tree, origin, direction, best, any_hit, events):
    unit = PrefetchUnit()
    seen = Seen(tree, origin, direction)
    number = 0
    while number is not None:
        node = tree.nodes[number]
        lower, upper = node["lower"].astype(float).tolist(), node["upper"].astype(float).tolist()
        enters, leaves = box_interval(lower, upper, seen, best.t_min, best.t)
        child, axis, count = int(node["child"]), int(node["meta"]) & 3, int(node["meta"]) >> 2
        if not enters <= leaves:
            events.append((number, READ))
        elif axis != 3:
            events.append((number, PUSH))
            backwards = seen.inverse[axis] < 0
            number, second = (child + 1, child) if backwards else (child, child + 1)
            unit.push((second,))
            continue
        else:
            events.append((number, LEAF))
            if count:
                events.extend((n, PREFETCH) for n in unit.requests())
            if _test_leaf(tree, child, count, origin, direction, best, any_hit):
                return
        number = unit.pop()[0] if unit.stack else None


def _traverse_bvh64(tree, origin, direction, best, any_hit, events):
    """An inner node holds the boxes of its two children; leaves are told by their parent and are nowhere in memory."""
    unit = PrefetchUnit()
    unit.is_requested = lambda node: int(tree.nodes[node]["meta"]) & 3 != 3
    seen = Seen(tree, origin, direction)
    number = 0
    while number is not None:
        child, axis, count = (int(x) for x in (tree.nodes[number]["child"], tree.nodes[number]["meta"] & 3,
                                               tree.nodes[number]["meta"] >> 2))  # fmt: skip
        hit = []
        if axis == 3:
            events.append((number, LEAF))
            if count:
                events.extend((n, PREFETCH) for n in unit.requests())
            if _test_leaf(tree, child, count, origin, direction, best, any_hit):
                return
        else:
            for each in (child, child + 1):
                corners = [tree.nodes[each][name].astype(float).tolist() for name in ("lower", "upper")]
                enters, leaves = box_interval(*corners, seen, best.t_min, best.t)
                if enters <= leaves:
                    hit.append((enters, each))
            hit.sort(reverse=seen.inverse[axis] < 0)  # by number along the axis
            hit.sort(key=lambda each: each[0])  # by distance
            events.append((number, PUSH if len(hit) == 2 else READ))
            if len(hit) == 2:
                unit.push((hit[1][1], hit[1][0]))
        if hit:
            number = hit[0][1]
            continue
        number = None
        while unit.stack and number is None:
            popped, enters = unit.pop()
            number = None if enters > best.t else popped


def _traverse_kdtree(tree, origin, direction, best, any_hit, events):
    lower, upper = (b.astype(float).tolist() for b in tree.bounds)
    seen = Seen(tree, origin, direction)
    enters, leaves = box_interval(lower, upper, seen, best.t_min, best.t)
    if not enters <= leaves:
        return
    unit = PrefetchUnit()
    number = 0
    while True:
        node = tree.nodes[number]
        meta = int(node["meta"])
        axis = meta & 3
        if axis == 3:
            events.append((number, LEAF))
            count = meta >> 2
            if count:
                events.extend((n, PREFETCH) for n in unit.requests())
            if _test_leaf(tree, int(node["first"]), count, origin, direction, best, any_hit):
                return
            while unit.stack:
                number, enters, leaves = unit.pop()
                if enters <= best.t:
                    break
            else:
                return
            continue
        below, above = meta >> 2, (meta >> 2) + 1
        near, far = (above, below) if seen.inverse[axis] < 0 else (below, above)
        split = float(node["split"])
        sooner, later = seen.enters(axis, split), seen.leaves(axis, split)
        visits = []
        if later >= enters:
            visits.append((near, enters, min(leaves, later)))
        if sooner <= leaves:
            visits.append((far, max(enters, sooner), leaves))
        if len(visits) == 1:
            visits = [(visits[0][0], enters, leaves)]
        if len(visits) == 2:
            events.append((number, PUSH))
            unit.push(visits[1])
        else:
            events.append((number, READ))
        number, enters, leaves = visits[0]


WALKS = {"kdtree": _traverse_kdtree, "bvh": _traverse_bvh, "bvh64": _traverse_bvh64}


def events_of(packed):
    """Unpack ``node << 2 | kind``."""
    packed = np.asarray(packed)
    return list(zip((packed >> 2).tolist(), (packed & 3).tolist(), strict=True))
