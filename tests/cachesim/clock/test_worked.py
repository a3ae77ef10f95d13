"""Seven nodes, four rays, two of them in flight: worked out by hand, cycle by cycle.

The nodes are numbered as ever: 1 and 2 are the children of 0, 3 and 4 those of 1, 5 and 6 those of 2. Leaf 3 has two
triangles, the others have one. Every node has a line of its own. The rays, with what each read pushes:

    A: 0 (2), 1 (4), leaf 3, pops leaf 4 and hits there         B: 0 (2), 1, leaf 4, pops 2, leaf 5
    C: 0, 2 (5), leaf 6, pops leaf 5                            D: 0, 1, leaf 3

The machine: hit 1, miss 4, two MSHRs, one port, box test 1, a triangle 2, a cache of two sets of two ways, LRU. A miss in t
has its data in cycle t + 4, the box test takes that cycle, the next read is ready in t + 5; after a hit it is ready in t + 2.
Below, H, M, L: waits for the data of a hit, a miss, a late prefetch; p: for the port; b: box test; T: triangles; -: idle.
A read stands in the cycle in which the port takes it, as its node and what it finds: h hit, m miss, j a
line in flight, l late.

Without prefetches:

    cycle      0         1         2         3         4
               01234567890123456789012345678901234567890123456
    ray of 0   A                      C                 -
    does       MMMMbMMMMbMMMMbTTTTHbTTMMMMbHbMMMMbTTHbTT------
    reads      0m   1m   3m       4h  0m   2h6m     5h
    ray of 1   B                              D
    does       pMMMbpMMMbpMMMMbTTMMMMbpMMMMbTTHbMMMMbMMMMbTTTT
    reads       0j   1j   4m     2m    5m     0h1m   3m
    evicts                           0    41     2  3    1

With the paper's unit: at leaf 3 ray A requests 4 in cycle 15 (it has just come: redundant) and 2 in cycle 16 (filled);
at leaf 4 ray B requests 2 in cycle 17 (joined) and reads it in cycle 18: late, as it comes in cycle 20, two cycles before
it would have and one after a hit's. At leaf 6 ray C requests 5 in cycle 35: redundant.

    cycle      0         1         2         3         4
               012345678901234567890123456789012345678901234
    ray of 0   A                      C                 -
    does       MMMMbMMMMbMMMMbTTTTHbTTMMMMbHbMMMMbTTHbTT----
    reads      0m   1m   3m       4h  0m   2h6m     5h
    requests                  42                  5
    ray of 1   B                           D
    does       pMMMbpMMMbpMMMMbTTLLbMMMMbTTpHbMMMMbMMMMbTTTT
    reads       0j   1j   4m     2l 5m      0h1m   3m
    requests                    2
    evicts                         0    1 4      23    1
"""

import numpy as np
import pytest

from cachesim.clock.state import CYCLES
from cachesim.config import CacheConfig
from cachesim.policies.machine import NodeColumns
from tests.reference.clock import NoPolicy, SlowStack, visits_of
from tests.reference.clock_cases import Case, fast_account, slow_account
from tests.reference.traces import Trace

PARENT, LEVEL, N_PRIMS = [-1, 0, 0, 1, 1, 2, 2], [0, 1, 1, 2, 2, 2, 2], [0, 0, 0, 2, 1, 1, 1]
RAYS = [
    [(0, 1), (1, 1), (3, 2), (4, 2)],
    [(0, 1), (1, 0), (4, 2), (2, 0), (5, 2)],
    [(0, 0), (2, 1), (6, 2), (5, 2)],
    [(0, 0), (1, 0), (3, 2)],
]
MACHINE = {"hit": 1, "extra": 3, "mshrs": 2, "ports": 1, "transfer": 0, "box": 1, "triangle": 2, "every": 2, "n_units": 0}
CACHE = CacheConfig(128, 2, 32)
LETTERS = {
    "b": "box test", "T": "triangle test", "H": "hit", "M": "demand miss", "L": "late prefetch", "p": "port", "-": "idle",
}  # fmt: skip


def worked_case():
    case = object.__new__(Case)
    rows = [row for ray in RAYS for row in ray]
    case.trace = Trace("kdtree", PARENT, LEVEL, N_PRIMS, [1, 3, 5, 0, 0, 0, 0], [], len(RAYS))
    case.line_bytes, case.lines, case.n_lines = 8, [[node] for node in range(7)], 7
    case.first = np.concatenate([[0], np.cumsum([len(ray) for ray in RAYS])])
    case.waits_for = [-1] * len(RAYS)
    case.types = np.zeros(len(RAYS), np.uint8)
    case.nodes, case.kinds = (np.array([row[i] for row in rows], dtype) for i, dtype in ((0, np.uint32), (1, np.uint8)))
    case.tree = NodeColumns(
        np.array(N_PRIMS, np.uint32), np.array(LEVEL, np.uint16), np.array(PARENT, np.int32), np.arange(7, dtype=np.uint32),
        np.ones(7, np.uint8),
    )  # fmt: skip
    case.rays = [visits_of(ray, PARENT, N_PRIMS, case.lines, first) for ray, first in zip(RAYS, case.first, strict=False)]
    return case


def drawn(which):
    """Return what the two slots do in each cycle, from the docstring."""
    lines = [line.split() for line in __doc__.splitlines() if line.strip().startswith("does")]
    return [text for _, text in lines][2 * which : 2 * which + 2]


WORKED = {
    "none": (47, {"hits": 4, "misses": 10, "joined by demand": 2}),
    "stack": (45, {
        "hits": 4, "misses": 9, "joined by demand": 2, "redundant": 2, "joined": 1, "filled": 1, "late": 1, "saved": 2,
        "waited": 1, "candidates: offered": 4, "candidates: issued": 4,
    }),
}  # fmt: skip


@pytest.mark.parametrize("policy", WORKED)
def test_it_is_as_worked_out(policy):
    total, counts = WORKED[policy]
    does = "".join(drawn(list(WORKED).index(policy)))
    assert len(does) == 2 * total
    case = worked_case()
    fast = fast_account(case, MACHINE, CACHE, 2, policy)
    wanted = dict.fromkeys(fast, 0) | {"total": total} | counts
    wanted |= {name: does.count(letter) for letter, name in LETTERS.items()}
    assert fast == wanted
    slow = NoPolicy() if policy == "none" else SlowStack(case.lines, LEVEL, N_PRIMS)
    assert slow_account(case, MACHINE, CACHE, 2, slow) == wanted


@pytest.mark.parametrize("policy", WORKED)
def test_the_model_does_in_every_cycle_what_is_drawn(policy):
    case, seen = worked_case(), ["", ""]

    class Watched(SlowStack):
        def clock_ticks(self):
            for slot in self.clock.slots:
                seen[slot.number] += next((letter for letter, name in LETTERS.items() if name == slot.state), "?")

    budget = 0 if policy == "none" else None
    slow_account(case, MACHINE, CACHE, 2, Watched(case.lines, LEVEL, N_PRIMS, budget))
    assert seen == drawn(list(WORKED).index(policy))
    assert set(CYCLES) >= set(LETTERS.values())
