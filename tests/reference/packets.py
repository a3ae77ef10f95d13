"""A slow traverser of packets in plain Python: the recursion of Manta's papers, not the kernels' loops.

A node is read when it is entered. A packet goes on as the list of those of its rays that are active. The stack is there for
the prefetch unit alone: the recursion itself knows what to do next.
"""

import math
from contextlib import suppress

from tests.reference.traversal import LEAF, PREFETCH, PUSH, READ, Nearest, PrefetchUnit, Seen, box_interval, triangle_hit


class Ray:
    """A ray of a packet, with a best hit of its own; an any-hit ray has ended when it has one."""

    def __init__(self, tree, origin, direction, t_min, t_max):
        self.origin, self.direction = [float(x) for x in origin], [float(x) for x in direction]
        is_ray = all(map(math.isfinite, self.origin + self.direction)) and any(self.direction)
        self.best = Nearest(float(t_min), float(t_max) if is_ray else math.nan)
        self.seen = Seen(tree, self.origin, self.direction)
        self.signs = [x < 0 for x in self.seen.inverse]

    def offer(self, tree, prim):
        self.best.offer(triangle_hit(tree.triangles[prim].astype(float).tolist(), self.origin, self.direction), int(prim))


class AllEndedError(Exception):
    """Every ray of the packet has ended, and the packet with them."""


class Walk:
    """One packet in one tree; ``events`` are its accesses, (node, kind)."""

    def __init__(self, tree, rays, any_hit, drains, cheaper):
        self.tree, self.rays, self.any_hit, self.drains, self.cheaper = tree, rays, any_hit, drains, cheaper
        self.unit, self.events = PrefetchUnit(), []

    def has_ended(self, ray):
        return self.any_hit and ray.best.prim is not None

    def test(self, number, first, count, active):
        """Enter a leaf: the unit requests the stack, then each active ray tests the triangles up to its end."""
        self.events.append((number, LEAF))
        if count:
            self.events.extend((node, PREFETCH) for node in self.unit.requests())
        for ray in active:
            for prim in self.tree.prims[first : first + count]:
                if not self.has_ended(ray):
                    ray.offer(self.tree, prim)


class BvhWalk(Walk):
    """Every node that is entered is read, and its box tested by the rays that met the parent's and have not ended."""

    def run(self):
        with suppress(AllEndedError):
            self.enter(0, self.rays)
        return self.events

    def enter(self, number, rays):
        node = self.tree.nodes[number]
        child, axis, count = int(node["child"]), int(node["meta"]) & 3, int(node["meta"]) >> 2
        corners = [node[name].astype(float).tolist() for name in ("lower", "upper")]
        active = []
        for ray in rays:
            enters, leaves = box_interval(*corners, ray.seen, ray.best.t_min, ray.best.t)
            if not self.has_ended(ray) and enters <= leaves:
                active.append(ray)
        if not active:
            self.events.append((number, READ))
        elif axis == 3:
            self.test(number, child, count, active)
            if all(map(self.has_ended, self.rays)) and not self.drains:
                raise AllEndedError
        else:
            self.events.append((number, PUSH))
            upper_first = active[0].signs[axis] if self.cheaper is None else bool(self.cheaper[number])
            first, second = (child + 1, child) if upper_first else (child, child + 1)
            self.unit.push((second,))
            self.enter(first, active)
            self.unit.pop()
            self.enter(second, active)


class KdWalk(Walk):
    """All rays have the same signs, and each an interval of its own: ``active`` is a list of (ray, enters, leaves)."""

    def run(self):
        lower, upper = (b.astype(float).tolist() for b in self.tree.bounds)
        whole = [(ray, *box_interval(lower, upper, ray.seen, ray.best.t_min, ray.best.t)) for ray in self.rays]
        active = [(ray, enters, leaves) for ray, enters, leaves in whole if enters <= leaves]
        if active:
            self.enter(0, active)
        return self.events

    def enter(self, number, active):
        node = self.tree.nodes[number]
        meta = int(node["meta"])
        axis = meta & 3
        if axis == 3:
            self.test(number, int(node["first"]), meta >> 2, [ray for ray, _, _ in active])
            return
        is_backwards = active[0][0].signs[axis]
        children = {"near": (meta >> 2) + is_backwards, "far": (meta >> 2) + (not is_backwards)}
        parts = {"near": [], "far": []}
        for ray, enters, leaves in active:
            sooner, later = (f(axis, float(node["split"])) for f in (ray.seen.enters, ray.seen.leaves))
            if later >= enters and sooner <= leaves:
                parts["near"].append((ray, enters, min(leaves, later)))
                parts["far"].append((ray, max(enters, sooner), leaves))
            else:
                parts["near" if later >= enters else "far"].append((ray, enters, leaves))
        order = ["near", "far"]
        if self.cheaper is not None and children["far"] == (meta >> 2) + self.cheaper[number]:
            order.reverse()
        if not parts["near"] or not parts["far"]:
            [only] = [side for side in order if parts[side]]
            self.events.append((number, READ))
            self.enter(children[only], parts[only])
            return
        self.events.append((number, PUSH))
        first, second = order
        self.unit.push((children[second],))
        self.enter(children[first], parts[first])
        self.unit.pop()
        rest = [each for each in parts[second] if not self.has_ended(each[0]) and each[1] <= each[0].best.t]
        if rest:
            self.enter(children[second], rest)


def traverse_packets(tree, rays, number, *, any_hit=False, drains=False, cheaper=None):
    """Return ([(prim, t) of each ray], [events of each ray]): those of a packet at its first ray.

    ``rays`` are ``rtrace.rays.Rays``; neighbours of one ``number`` are a packet.
    """
    is_kd = tree.kind == "kdtree"
    if is_kd and drains:
        any_hit = False
    every = [Ray(tree, *given) for given in zip(*rays, strict=True)]
    packets = []
    for i, ray in enumerate(every):
        is_new = i == 0 or number[i] != number[i - 1] or (is_kd and ray.signs != every[i - 1].signs)
        if is_new:
            packets.append([])
        packets[-1].append(ray)
    events = []
    for packet in packets:
        events.append((KdWalk if is_kd else BvhWalk)(tree, packet, any_hit, drains, cheaper).run())
        events += [[] for _ in packet[1:]]
    return [ray.best.answer() for ray in every], events
