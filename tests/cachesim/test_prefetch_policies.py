"""Every policy of the prefetch unit, run inside the slow traverser: the same stream as derived from the demand accesses.

The traverser of ``tests.reference.traversal`` gets a unit with another policy, so requests are made while the
ray walks the tree: no stack is rebuilt. Then runs in every order of rays: their traced requests are the derived ones.
"""

import itertools

import numpy as np
import pytest

from cachesim.prefetch import UnitReplay, parse_prefetch
from cachesim.source import RunSource
from rtrace.camera import ORDERS
from rtrace.rays import make_rays
from rtrace.render import Shooting, render
from rtrace.scenes.scene import scene_from_triangles
from rtrace.scenes.shapes import boxes, icosphere, soup
from rtrace.traverse import trace_recorded
from rtrace.trees.tree import node_table
from rtrace.trees.tree_cache import TREES, build_tree
from tests.reference import traversal as reference
from tests.reference.cache import derive
from traces.format import LEAF, PREFETCH
from traces.node_formats import NODE_FORMATS
from traces.reader import open_run

BUDGETS = {
    "unlimited": (None, 0),
    "budget=0": (0, 0),
    "budget=1": (1, 0),
    "budget=3": (3, 0),
    "tris*1": (0, 1),
    "tris*2": (0, 2),
}
OPTIONS = ["", ":once", ":empty", ":once:empty"]
POLICIES = [f"stack:{budget}{option}" for budget, option in itertools.product(BUDGETS, OPTIONS)]
SCENES = {"soup": soup(150, seed=4), "boxes": boxes(2), "ball": icosphere(2)}


class Unit(reference.PrefetchUnit):
    """A unit that waits to be asked, and remembers which entries of its stack it has requested."""

    def __init__(self):
        super().__init__()
        self.was_requested = []
        Unit.latest = self

    def push(self, entry):
        super().push(entry)
        self.was_requested.append(False)

    def pop(self):
        self.was_requested.pop()
        return super().pop()

    def requests(self):
        return iter(())

    def at_leaf(self, policy, n_triangles):
        """Yield the nodes requested at a leaf: top to bottom from the pointer, until the budget is used up."""
        fixed, per_triangle = BUDGETS[policy.split(":")[1]]
        left = len(self.stack) if fixed is None else fixed + per_triangle * n_triangles
        if n_triangles == 0 and "empty" not in policy:
            return
        while left > 0 and self.pointer > 0:
            self.pointer -= 1
            if "once" in policy and self.was_requested[self.pointer]:
                continue
            self.was_requested[self.pointer] = True
            if not self.is_requested(self.stack[self.pointer][0]):
                continue
            yield self.stack[self.pointer][0]
            left -= 1


class Stream(list):
    """The events of one ray; a leaf that is entered makes the unit request."""

    def __init__(self, tree, policy):
        super().__init__()
        self.tree, self.policy = tree, policy

    def append(self, event):
        if event[1] != LEAF or self.tree.kind != "bvh64":
            super().append((event[0], False))
        if event[1] == LEAF:
            n_triangles = int(self.tree.nodes[event[0]]["meta"]) >> 2
            self.extend((node, True) for node in list(Unit.latest.at_leaf(self.policy, n_triangles)))


def events_while_walking(tree, rays, any_hit, policy):
    """Return (node, is a request) of all rays, requests made on the way."""
    made = []
    for i in range(len(rays.t_min)):
        stream = Stream(tree, policy)
        best = reference.Nearest(rays.t_min[i], rays.t_max[i])
        walk = reference.WALKS[tree.kind]
        walk(tree, rays.origin[i].astype(float).tolist(), rays.direction[i].astype(float).tolist(), best, any_hit, stream)
        made += stream
    return made


def random_rays(triangles, n, seed):
    rng = np.random.default_rng(seed)
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    origin = rng.uniform(low - 0.5 * (high - low), high + 0.5 * (high - low), (n, 3)).astype(np.float32)
    return make_rays(origin, rng.uniform(low, high, (n, 3)).astype(np.float32) - origin)


@pytest.mark.parametrize("any_hit", [False, True])
@pytest.mark.parametrize("kind", TREES)
@pytest.mark.parametrize("scene", SCENES)
def test_the_derived_stream_is_that_of_a_unit_that_walks_along(monkeypatch, record_property, scene, kind, any_hit):
    monkeypatch.setattr(reference, "PrefetchUnit", Unit)
    tree = build_tree(SCENES[scene], kind, **({"c_trav": 0.3, "max_level": 12} if kind == "kdtree" else {}))
    rays = random_rays(SCENES[scene], 12, seed=3)
    packed = trace_recorded(tree, rays, any_hit=any_hit)[2]
    nodes, kinds = packed >> 2, (packed & 3).astype(np.uint8)
    table, n_requests, n_events = node_table(tree), {}, 0
    for policy in POLICIES:
        unit = UnitReplay(
            parse_prefetch(policy), NODE_FORMATS[kind], *(table[name] for name in ("n_prims", "level", "parent"))
        )
        derived = [(int(node), bool(label)) for node, label in zip(*unit.events(nodes, kinds), strict=True)]
        wanted = events_while_walking(tree, rays, any_hit, policy)
        assert derived == wanted, policy
        n_requests[policy] = sum(is_request for _, is_request in wanted)
        n_events += len(wanted)
    record_property("cases", n_events)
    assert n_requests["stack:budget=0"] == 0 < n_requests["stack:budget=1"] < n_requests["stack:unlimited"]
    if (scene, tree.kind, any_hit) == ("soup", "kdtree", False):
        assert len(set(n_requests.values())) > 8  # the options do matter


@pytest.mark.parametrize("batch", [1, 16, 0])
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("kind", TREES)
def test_runs_in_every_order(tmp_path, kind, order, batch):
    """The traced requests are the derived ones, and every policy is that of the model that rebuilds the stack slowly."""
    scene = scene_from_triangles(SCENES["soup"], "soup")
    render(scene, build_tree(scene.triangles, kind), Shooting(11, 9, order, batch, 3), tmp_path / "run")
    run = open_run(tmp_path / "run")
    source, n_prims = RunSource(run), run.columns("nodes", ["n_prims"])["n_prims"].tolist()
    [(nodes, kinds)] = run.batches()
    rows = list(zip(nodes.tolist(), kinds.tolist(), strict=True))
    assert events_of(source, "stack:unlimited") == events_of(source, "traced")
    assert events_of(source, "traced") == [
        (node, row == PREFETCH) for node, row in rows if row != LEAF or kind != "bvh64"
    ]  # fmt: skip
    for policy in ("stack:budget=1:once", "stack:tris*1", "stack:budget=3:empty"):
        fixed, per_triangle = BUDGETS[policy.split(":")[1]]
        wanted = derive(rows, kind, n_prims, fixed or per_triangle, per_triangle > 0, "once" in policy, "empty" in policy)
        assert events_of(source, policy) == wanted


def events_of(source, policy):
    batches = list(source.events(parse_prefetch(policy)))
    return [(int(node), bool(label)) for batch in batches for node, label in zip(*batch, strict=True)]
