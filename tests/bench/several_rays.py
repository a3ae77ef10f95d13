"""Several rays at once, by the C++ beside this file, against one at a time: what packets and rays in flight would bring."""

import ctypes

import numpy as np

from rtrace.rays import Rays
from rtrace.render import CHUNK
from rtrace.traverse import Room, trace_recorded
from rtrace.trees.tree import Tree
from tests.bench.measure import ratio, times
from tests.bench.stage1 import call_peer, pieces

#: What several_rays.cpp does, and over what its time is given.
_SEVERAL = {
    "packets": ("packets of four rays, in C++ with AVX", "ours"),
    "in_flight": ("four rays in flight, in C++, over one in C++", "one"),
}


def bench_several(tree: Tree, rays: Rays, any_hit: bool, repeat: int, peer: ctypes.CDLL | None) -> dict[str, float]:
    """Return the time of tracing several rays at once over that of one at a time, both with the events in ray order.

    Raises
    ------
    ValueError
        The peer's events are not ours.
    """
    out: dict[str, float] = {}
    if peer is None:
        return out
    cut, room, events = pieces(rays), Room(), np.empty(CHUNK * 2 * (tree.max_level + 200), np.uint32)
    name = f"{'BVH' if tree.kind == 'bvh' else 'kd-tree'}, {'any' if any_hit else 'closest'} hit"
    hows = [how for how in _SEVERAL if hasattr(peer, f"{how}_{tree.kind}")]
    for how in hows:
        for piece in cut:
            ours = trace_recorded(tree, piece, any_hit=any_hit, room=room)[2]
            if not np.array_equal(call_peer(peer, tree, piece, any_hit, events, how), ours):
                raise ValueError(f"{name}: the events of {_SEVERAL[how][0]} are not ours")

    def peers(how):
        return lambda: [call_peer(peer, tree, piece, any_hit, events, how) for piece in cut]

    functions = {"ours": lambda: [trace_recorded(tree, piece, any_hit=any_hit, room=room) for piece in cut]}
    taken = times(functions | {"one": peers("trace")} | {how: peers(how) for how in hows}, repeat)
    for how in hows:
        what, over = _SEVERAL[how]
        out[f"{name}: {what}: time"] = ratio(taken[how], taken[over])
    return out
