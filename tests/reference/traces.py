"""Small random trees and traces that follow the contract of a run: the inputs of cachesim's tests."""

import random
from dataclasses import dataclass

import numpy as np

from tests.reference.cache import Unit
from traces.footer import CameraFacts, Footer, SceneFacts, TreeFacts
from traces.format import BOX, SPLIT
from traces.reader import open_run
from traces.writer import RunWriter


@dataclass
class Trace:
    """A tree (one entry per node) and the rows of its accesses."""

    kind: str
    parent: list
    level: list
    n_prims: list
    child: list  # lower child, 0 for a leaf
    rows: list  # (ray, node, kind)
    n_rays: int

    @property
    def node_bytes(self):
        return {"kdtree": 8, "bvh": 32, "bvh64": 64}[self.kind]

    @property
    def node_kinds(self):
        return [(node, kind) for _, node, kind in self.rows]

    @property
    def accesses(self):
        """The rows that access a node in memory: (node, whether it is a request)."""
        return [(node, kind == 3) for node, kind in self.node_kinds if not (self.kind == "bvh64" and kind == 2)]

    @property
    def addresses(self):
        """The address of every node as stored; that of a leaf which is nowhere in memory is -1."""
        if self.kind != "bvh64":
            return [self.node_bytes * node for node in range(len(self.parent))]
        return [64 * (child // 2) if child else -1 for child in self.child]


def make_tree(rng, max_level):
    """Return parent, level, n_prims and child: pairs from 1 on, a pair, then its left subtree, then its right."""
    parent, level, n_prims, child = [-1], [0], [0], [0]

    def grow(node):
        if level[node] == max_level or rng.random() < 0.15 * (level[node] > 1):
            n_prims[node] = rng.choice([0, 1, 2, 5])
            return
        first = child[node] = len(parent)
        for column, value in ((parent, node), (level, level[node] + 1), (n_prims, 0), (child, 0)):
            column += [value, value]
        grow(first)
        grow(first + 1)

    grow(0)
    return parent, level, n_prims, child


def make_trace(kind, seed, n_rays=20, max_level=6):
    """Return a random tree and rays through it; the kind-3 rows are those of an unlimited budget."""
    rng = random.Random(seed)
    parent, level, n_prims, child = make_tree(rng, max_level)
    if kind == "bvh64":
        n_prims = [n if below else max(n, 1) for n, below in zip(n_prims, child, strict=True)]
    rows = []
    for ray in range(n_rays):
        walk = {"kdtree": _kd_ray, "bvh": _bvh_ray, "bvh64": _bvh64_ray}[kind]
        rows += [(ray, *row) for row in walk(rng, n_prims, child)]
    return Trace(kind, parent, level, n_prims, child, rows, n_rays)


def _kd_ray(rng, n_prims, child):
    unit, node = Unit(), 0
    while True:
        if child[node]:
            near = child[node] + rng.randrange(2)
            pushes = rng.random() < 0.6
            yield node, int(pushes)
            if pushes:
                unit.push(((near - 1) ^ 1) + 1)
            node = near
            continue
        yield node, 2
        if n_prims[node]:
            yield from ((request, 3) for request in unit.leaf(None))
        if not unit.stack or rng.random() < 0.1:  # nothing left, or a hit in this leaf
            return
        node = unit.pop()
        while unit.stack and rng.random() < 0.2:  # entries beyond the nearest hit: popped, never read
            node = unit.pop()


def _bvh_ray(rng, n_prims, child):
    unit, node = Unit(), 0
    while True:
        is_hit = node == 0 or rng.random() < 0.7
        if is_hit and child[node]:
            near = child[node] + rng.randrange(2)
            yield node, 1
            unit.push(((near - 1) ^ 1) + 1)
            node = near
            continue
        yield node, 2 if is_hit else 0
        if is_hit and n_prims[node]:
            yield from ((request, 3) for request in unit.leaf(None))
        if not unit.stack or (is_hit and rng.random() < 0.1):
            return
        node = unit.pop()


def _bvh64_ray(rng, n_prims, child):
    unit, node = Unit({node for node, n in enumerate(n_prims) if n}), 0
    while True:
        if child[node]:
            near, n_hit = child[node] + rng.randrange(2), rng.choice([0, 1, 1, 2, 2, 2])
            yield node, int(n_hit == 2)
            if n_hit == 2:
                unit.push(((near - 1) ^ 1) + 1)
            if n_hit:
                node = near
                continue
        else:
            yield node, 2
            yield from ((request, 3) for request in unit.leaf(None))
            if rng.random() < 0.1:  # a hit in this leaf
                return
        while unit.stack and rng.random() < 0.2:  # entries beyond the nearest hit
            unit.pop()
        if not unit.stack:
            return
        node = unit.pop()


def make_footer(**changes):
    """Return a footer of nothing in particular with some entries changed."""
    entries = {
        "tool_version": "", "command": "", "scene": SceneFacts("test", "test", "", "", 8, False),
        "camera": CameraFacts((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), 45.0), "light": (0.0, 0.0, 0.0),
        "width": 1, "height": 2, "order": "scanline", "batch": 1, "seed": 0, "tree": TreeFacts("kdtree", 8),
    }  # fmt: skip
    return Footer(**(entries | changes))


def write(trace, path, repeat=1, scene="bunny", stand_in=False, **changes):
    """Write a trace as a run and open it; ``repeat`` shoots the same rays again and again, ``changes`` are the footer's."""
    n = len(trace.parent)
    footer = make_footer(
        scene=SceneFacts(scene, scene.title(), "", "", sum(trace.n_prims), stand_in),
        tree=TreeFacts(trace.kind, trace.node_bytes), width=1, height=trace.n_rays, **changes,
    )  # fmt: skip
    rays, nodes, kinds = (np.array(column) for column in zip(*trace.rows, strict=True))
    columns = {
        "node": np.arange(n), "parent": np.array(trace.parent), "level": np.array(trace.level),
        "axis": np.where(np.array(trace.child) > 0, 0, 3), "n_prims": np.array(trace.n_prims),
        "address": np.array(trace.addresses, np.int64).astype(np.uint64),
    }  # fmt: skip
    fields = SPLIT if trace.kind == "kdtree" else BOX
    columns |= {field.name: np.zeros(n) for field in fields}
    types, counts = np.arange(trace.n_rays) % 2, np.bincount(rays, minlength=trace.n_rays)
    with RunWriter(path, footer, fields) as run:
        run.append("nodes", columns)
        for turn in range(repeat):
            first = turn * rays.size + np.cumsum(counts) - counts
            ids = turn * trace.n_rays + np.arange(trace.n_rays)
            run.append("accesses", {"ray": rays + turn * trace.n_rays, "node": nodes, "kind": kinds})
            run.append("rays", {
                "ray": ids, "x": np.zeros_like(ids), "y": (ids - ids[0]) % 65536, "type": types, "first": first,
                "count": counts, "prim": np.full(ids.size, -1), "t": np.full(ids.size, np.inf),
            })  # fmt: skip
        run.image(b"")
    return open_run(path)
