"""The kernels of packets against a slow recursion (accesses and hits), the single rays, and scenes worked out by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtrace.checks import hard_cases
from rtrace.rays import Rays, make_rays
from rtrace.traverse import Together, trace, trace_recorded
from rtrace.trees.rtsah import cheaper_children
from rtrace.trees.tree import BVH_NODE, KD_NODE, Tree
from rtrace.trees.tree_cache import build_tree
from tests.reference.packets import traverse_packets
from tests.reference.traversal import LEAF, PREFETCH, PUSH, READ, events_of
from tests.rtrace.test_traverse import SCENES, camera_rays, directions, point, triangle_lists
from tests.rtrace.test_visit_rules import no_rays

TREES = ("kdtree", "bvh")


def with_cheaper(tree):
    return tree._replace(cheaper=cheaper_children(tree))


def by_ray(count, events):
    """Return the accesses of each ray as lists of (node, kind)."""
    return [events_of(each) for each in np.split(events, np.cumsum(count)[:-1])]


def check(tree, rays, number, any_hit, *, cheaper=False, drains=False):
    """Check accesses and hits against the slow recursion; return the hits."""
    hits, count, events = trace_recorded(tree, rays, any_hit=any_hit, together=Together(number, cheaper, drains))
    answers, wanted = traverse_packets(
        tree, rays, number, any_hit=any_hit, drains=drains, cheaper=tree.cheaper.tolist() if cheaper else None
    )
    assert by_ray(count, events) == wanted
    assert list(zip(hits.prim.tolist(), hits.t.tolist(), strict=True)) == answers
    return hits


def packets_of(n, size):
    return (np.arange(n) // size).astype(np.uint32)


@pytest.mark.parametrize("kind", TREES)
@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("size", [3, 64])
def test_packets_equal_the_slow_recursion(kind, scene, size):
    tree = with_cheaper(build_tree(SCENES[scene], kind))
    rays = camera_rays(SCENES[scene], 128, seed=7)
    rays = rays._replace(t_max=np.where(np.arange(128) % 3 == 0, 1.0, np.inf))
    for any_hit, cheaper, drains in ((False, False, False), (True, False, False), (True, True, False), (True, True, True)):
        hits = check(tree, rays, packets_of(128, size), any_hit, cheaper=cheaper, drains=drains)
        assert 5 < (hits.prim >= 0).sum() < 128


@given(
    triangle_lists, st.lists(st.tuples(point, directions, st.sampled_from([0.5, 1.0, 4.0, np.inf])), min_size=1, max_size=12),
    st.sampled_from(TREES), st.integers(1, 5), st.booleans(), st.booleans(), st.booleans(),
)  # fmt: skip
@settings(max_examples=200)
def test_packets_on_a_lattice(corners, lines, kind, size, any_hit, cheaper, drains):
    """Rays in planes and edges, opposite rays in one packet, flat boxes; as many packets as the sizes make."""
    tree = with_cheaper(build_tree(np.array(corners, np.float32), kind))
    origins, ways, ends = (np.array(values) for values in zip(*lines, strict=True))
    rays = make_rays(origins, ways, 0.0, ends)
    hits = check(tree, rays, packets_of(len(ends), size), any_hit, cheaper=cheaper, drains=drains)
    alone = trace(tree, rays)
    if any_hit:
        np.testing.assert_array_equal(hits.prim >= 0, alone.prim >= 0)
    else:
        np.testing.assert_array_equal(hits.prim, alone.prim)
        np.testing.assert_array_equal(hits.t, alone.t)


@pytest.mark.parametrize("case", hard_cases.CASES)
def test_a_packet_of_one_ray_is_the_ray(case):
    triangles, rays = hard_cases.CASES[case](False)[:2]
    rays = Rays(*(values[:1500] for values in rays))
    for kind in TREES:
        tree = build_tree(triangles[:20_000], kind)
        for any_hit in (False, True):
            alone = trace_recorded(tree, rays, any_hit=any_hit)
            packets = trace_recorded(tree, rays, any_hit=any_hit, together=Together(packets_of(len(rays.t_min), 1)))
            for got, wanted in zip((*packets[0], *packets[1:]), (*alone[0], *alone[1:]), strict=True):
                np.testing.assert_array_equal(got, wanted)


@pytest.mark.parametrize("kind", TREES)
@pytest.mark.parametrize("scene", SCENES)
def test_a_packet_reads_what_one_of_its_rays_would(kind, scene):
    """Of rays that look for their closest hits and agree in their signs: each node once, and the hits of the rays alone."""
    tree = build_tree(SCENES[scene], kind)
    rays = camera_rays(SCENES[scene], 4096, seed=3)
    octant = ((rays.direction < 0) @ [1, 2, 4]).argsort(kind="stable")
    rays = Rays(*(values[octant] for values in rays))
    number = packets_of(4096, 64) + 1000 * ((rays.direction < 0) @ [1, 2, 4]).astype(np.uint32)
    alone, packets = trace_recorded(tree, rays), trace_recorded(tree, rays, together=Together(number))
    np.testing.assert_array_equal(alone[0].prim, packets[0].prim)
    np.testing.assert_array_equal(alone[0].t, packets[0].t)
    singles, together = by_ray(*alone[1:]), by_ray(*packets[1:])
    assert sum(map(len, together)) < 0.8 * sum(map(len, singles))
    for each in np.unique(number):
        members = np.flatnonzero(number == each)
        read = [node for node, kind_ in together[members[0]] if kind_ != PREFETCH]
        assert not any(together[member] for member in members[1:])
        wanted = {node for member in members for node, kind_ in singles[member] if kind_ != PREFETCH}
        assert len(read) == len(set(read)) and set(read) == wanted


@pytest.mark.parametrize("kind", TREES)
@pytest.mark.parametrize("any_hit", [False, True])
def test_what_is_no_ray_does_not_disturb_its_packet(kind, any_hit):
    good, bad = camera_rays(SCENES["icosphere"], 60, seed=5), no_rays()
    rays = Rays(*(np.concatenate([a, b, a]) for a, b in zip(good, bad, strict=True)))
    hits = check(build_tree(SCENES["icosphere"], kind), rays, packets_of(len(rays.t_min), 64), any_hit)
    np.testing.assert_array_equal(hits.prim[:60] >= 0, hits.prim[-60:] >= 0)  # of any hits, each packet may find others
    assert (hits.prim[60:-60] == -1).all() and (hits.prim[:60] >= 0).any()


@pytest.mark.parametrize("kind", TREES)
def test_packets_go_on_in_another_buffer(kind, monkeypatch):
    tree, rays = build_tree(SCENES["soup"], kind), camera_rays(SCENES["soup"], 400, seed=13)
    wanted = trace_recorded(tree, rays, together=Together(packets_of(400, 16)))
    monkeypatch.setattr("rtrace.traverse.EVENTS_PER_RAY", 0)
    got = trace_recorded(tree, rays, together=Together(packets_of(400, 16)))
    for a, b in zip((*got[0], *got[1:]), (*wanted[0], *wanted[1:]), strict=True):
        np.testing.assert_array_equal(a, b)


# A room 4 x 4 x 4, seen from above: node 0 parts it at x = 2 into 1 (left) and 2 (right); 1 parts the left half at y = 2 into
# 3 (y < 2) and 4, and 2 the right half into 5 (y < 2) and 6. Walls face along x: A at x = 1 in node 3, B at x = 3 in 5, C at
# x = 3 in 6; the BVH has D at x = 1 in 4 too, the kd-tree nothing. Each is a triangle with its tip at z = 4, so that at z = 1,
# where all rays run, it is 1.5 wide: 0.25 < y < 1.75, or 2.25 < y < 3.75.
def wall(x, y):
    return [[x, y, 0], [x, y + 2, 0], [x, y + 1, 4]]


A, B, C, D = wall(1, 0), wall(3, 0), wall(3, 2), wall(1, 2)
BOUNDS = np.float32([[0, 0, 0], [4, 4, 4]])


def room_kdtree():
    nodes = np.zeros(7, KD_NODE)
    for number, axis, child in ((0, 0, 1), (1, 1, 3), (2, 1, 5)):
        nodes[number]["split"], nodes[number]["meta"] = 2.0, child << 2 | axis
    for number, first, count in ((3, 0, 1), (4, 1, 0), (5, 1, 1), (6, 2, 1)):
        nodes[number]["first"], nodes[number]["meta"] = first, count << 2 | 3
    return _room("kdtree", nodes, np.float32([A, B, C]))


def room_bvh():
    nodes = np.zeros(7, BVH_NODE)
    boxes = {1: (A, D), 2: (B, C), 3: (A,), 4: (D,), 5: (B,), 6: (C,)}
    for number in range(7):
        corners = np.float32(boxes.get(number, (A, B, C, D))).reshape(-1, 3)
        nodes[number]["lower"], nodes[number]["upper"] = corners.min(axis=0), corners.max(axis=0)
    for number, axis, child in ((0, 0, 1), (1, 1, 3), (2, 1, 5)):
        nodes[number]["child"], nodes[number]["meta"] = child, axis
    for number, first in ((3, 0), (4, 1), (5, 2), (6, 3)):
        nodes[number]["child"], nodes[number]["meta"] = first, 1 << 2 | 3
    return _room("bvh", nodes, np.float32([A, D, B, C]))


def _room(kind, nodes, triangles):
    prims = np.arange(len(triangles), dtype=np.int32)
    return Tree(kind, nodes, prims, triangles, triangles, BOUNDS, BOUNDS, 2, {})


def along_x(*rays):
    """Return rays in z = 1 along x: each (x, y, length), which may be negative."""
    x, y, length = np.array(rays, float).T
    return make_rays(np.stack([x, y, np.ones(len(x))], axis=1), length[:, None] * [1.0, 0.0, 0.0])


def told(tree, rays, *, any_hit=False, drains=False):
    """Return the accesses of one packet by ray, those with none left out, and the hits' t."""
    number = np.zeros(len(rays.t_min), np.uint32)
    if any_hit:
        rays = rays._replace(t_max=np.ones(len(number)))
    hits, count, events = trace_recorded(tree, rays, any_hit=any_hit, together=Together(number, drains=drains))
    return {i: each for i, each in enumerate(by_ray(count, events)) if each}, hits.t.tolist()


def test_four_rays_in_a_kdtree_by_hand():
    """Two end at A (t = 2), before x = 2 (t = 3); two pass the empty leaf 4 and end at C (t = 4).

    0: all cross x = 2 inside, so both are visited: 2 waits for all four, from t = 3 on. 1: the first two are below y = 2, the
    others above: 4 waits for these. 3 has A: the unit requests 4 and 2, from the top. 4 is popped, empty, and requests
    nothing. 2 is popped for the last two alone, whose best is not below 3; they are above y = 2: 6, where the stack is empty.
    """
    accesses, t = told(room_kdtree(), along_x((-1, 0.5, 1), (-1, 1.5, 1), (-1, 2.5, 1), (-1, 3.5, 1)))
    assert accesses == {0: [(0, PUSH), (1, PUSH), (3, LEAF), (4, PREFETCH), (2, PREFETCH), (4, LEAF), (2, READ), (6, LEAF)]}
    assert t == [2, 2, 4, 4]


def test_a_kdtree_packet_ends_where_a_sign_changes_by_hand():
    """From the right, 2 is near and 1 waits, from t = 3 on; the first ray is below y = 2, the second above.

    They hit B and C at t = 2: 5 requests 6 and 1; 6, popped, has requested all; 1 is popped unread. The third ray runs the
    other way, a packet of its own: 0, 1, where it is below y = 2 as a whole, 3. The fourth is the first one alone.
    """
    accesses, t = told(room_kdtree(), along_x((5, 0.5, -1), (5, 3.5, -1), (-1, 0.5, 1), (5, 1, -1)))
    assert accesses == {
        0: [(0, PUSH), (2, PUSH), (5, LEAF), (6, PREFETCH), (1, PREFETCH), (6, LEAF)],
        2: [(0, PUSH), (1, READ), (3, LEAF), (2, PREFETCH)],
        3: [(0, PUSH), (2, READ), (5, LEAF), (1, PREFETCH)],
    }
    assert t == [2, 2, 2, 2]


def test_four_shadow_rays_in_a_kdtree_by_hand():
    """They end at t = 1. The first is stopped by A, the second by C; the third passes C, and the fourth ends before x = 2.

    0: the fourth does not reach x = 2 (t = 4 / 3), so 2 waits for the first three. 1 parts the first from the others. 3 stops
    the first. 4 is empty. 2 is popped for the second and the third; both are above y = 2.
    """
    rays = along_x((-1, 0.5, 6), (-1, 2.5, 6), (-1, 3.9, 6), (0, 3.9, 1.5))
    accesses, t = told(room_kdtree(), rays, any_hit=True)
    assert accesses == {0: [(0, PUSH), (1, PUSH), (3, LEAF), (4, PREFETCH), (2, PREFETCH), (4, LEAF), (2, READ), (6, LEAF)]}
    assert t == [1 / 3, 2 / 3, np.inf, np.inf]
    # Once all are stopped the packet has ended: the first alone leaves 2 unread, and without end it is searched as it was.
    assert told(room_kdtree(), along_x((-1, 0.5, 6)), any_hit=True)[0] == {0: [(0, PUSH), (1, READ), (3, LEAF), (2, PREFETCH)]}
    # Drained, a ray goes on to its closest hit: that of the first lies before x = 2 already, so nothing changes.
    assert told(room_kdtree(), rays, any_hit=True, drains=True)[0] == accesses


def test_four_rays_in_a_bvh_by_hand():
    """All meet 0 and 1. The first goes forward along x and y, so 1 comes before 2, and 3 before 4.

    3: the box of A is met by the first two, which hit at t = 2; 4 and 2 are requested. 4: D is hit by the others. 2: all of
    them begin it at t = 4, beyond their hits: read, and missed.
    """
    accesses, t = told(room_bvh(), along_x((-1, 0.5, 1), (-1, 1.5, 1), (-1, 2.5, 1), (-1, 3.5, 1)))
    assert accesses == {0: [(0, PUSH), (1, PUSH), (3, LEAF), (4, PREFETCH), (2, PREFETCH), (4, LEAF), (2, READ)]}
    assert t == [2, 2, 2, 2]


def test_shadow_rays_of_both_directions_in_a_bvh_by_hand():
    """The first ray goes back along x, so 2 comes first for both; each is stopped: at C from the right, at A from the left.

    0: 1 waits. 2: both meet its box; along y neither goes back: 5 first, 6 waits. 5: only the second passes through B's box
    (0 < y < 2), and hits it only after A, but any hit ends it: at t = 4 / 6. 6: the first, at t = 2 / 6, and all have ended.
    Drained, 1 is read too, its box not tested.
    """
    rays = along_x((5, 3.5, -6), (-1, 0.5, 6))
    accesses, t = told(room_bvh(), rays, any_hit=True)
    wanted = [(0, PUSH), (2, PUSH), (5, LEAF), (6, PREFETCH), (1, PREFETCH), (6, LEAF)]
    assert accesses == {0: wanted} and t == [2 / 6, 4 / 6]
    assert told(room_bvh(), rays, any_hit=True, drains=True)[0] == {0: [*wanted, (1, READ)]}


@pytest.mark.parametrize("tree", [room_kdtree(), room_bvh()], ids=TREES)
def test_the_slow_recursion_agrees_with_the_hand(tree):
    rays = along_x(
        (-1, 0.5, 1), (-1, 1.5, 1), (-1, 2.5, 1), (5, 3.5, -1), (5, 0.5, -1), (-1, 0.5, 1), (5, 1, -1), (-1, 3.9, 6)
    )
    for any_hit in (False, True):
        for size in (1, 2, 4, 8):
            check(tree, rays, packets_of(8, size), any_hit)
