"""The goals of the project, one per figure of the bench: what the median over scenes has to reach or stay below."""

#: Figure -> (what it is, goal). Ratios are faster / slower in the direction in which more is better, unless the goal is "<=".
GOALS: dict[str, tuple[str, str]] = {}

_TREES = {"bvh": "BVH", "kdtree": "kd-tree"}

for _tree, _least in (("bvh", "0.55"), ("kdtree", "0.60")):
    GOALS[f"closest {_tree} traced / embree"] = (
        f"closest hit, {_TREES[_tree]}, traced, one thread, against embreex robust", f">= {_least}"
    )  # fmt: skip
GOALS["closest bvh64 traced / embree"] = (
    "closest hit, BVH of 64-byte nodes, traced, one thread, against embreex robust",
    ">= 0.70",
)
for _tree in _TREES:
    GOALS[f"any {_tree} traced / embree"] = (
        f"any hit, {_TREES[_tree]}, traced, one thread, against embreex OCCLUDED", ">= 0.50"
    )  # fmt: skip
GOALS["any bvh64 traced / embree"] = ("any hit, BVH of 64-byte nodes, traced, one thread, against embreex OCCLUDED", "")
for _tree in _TREES:
    GOALS[f"both {_tree} two threads / embree"] = (
        f"primary and shadow rays, {_TREES[_tree]}, traced into memory by two threads, against embreex untraced", ">= 1.0"
    )  # fmt: skip
for _tree in _TREES:
    GOALS[f"both {_tree} two threads / one"] = (
        f"the same by two threads over one, {_TREES[_tree]}: what the second is worth",
        "",
    )
for _tree in _TREES:
    GOALS[f"render {_tree} M accesses/s"] = (
        f"a whole render, {_TREES[_tree]}: trace, Parquet, picture; M accesses a second of wall time on two cores", ">= 70"
    )  # fmt: skip
for _kind in ("closest", "any"):
    for _tree in _TREES:
        GOALS[f"{_kind} {_tree} cost of tracing"] = (f"cost of tracing, {_kind} hit, {_TREES[_tree]}", "<= 1.08")
for _kind in ("closest", "any"):
    for _tree in _TREES:
        GOALS[f"{_kind} {_tree} / c++"] = (f"{_kind} hit, {_TREES[_tree]}, against the same in scalar C++", ">= 0.95")
GOALS |= {
    "build binned / embree": ("CPU time of the binned BVH's build over embreex build and commit", "<= 0.35"),
    "build sweep / embree": ("CPU time of the full-sweep BVH's build, likewise", ""),
    "build kd / embree": ("CPU time of the kd-tree's build, likewise", "<= 4"),
    "DineroIV text / 2-way": ("one 2-way replay from memory, against DineroIV", ">= 30"),
    "DineroIV / npcache replay": (
        "DineroIV over npcache replay from Parquet, whole processes, 8K 2-way, reads of a picture of 512x512, CPU time",
        ">= 3",
    ),
    "pycachesim / 2-way": ("one 2-way replay from memory, against pycachesim", ">= 8"),
    "1-way, ns per access": ("one direct-mapped replay from memory, ns per access", ""),
    "2-way, ns per access": ("one 2-way replay from memory, ns per access", "<= 3"),
    "clock, 1 rays, ns per access": ("the clock, one ray in flight, no prefetches, CPU ns per access", "<= 15"),
    "clock, 64 rays, ns per access": ("the clock, 64 rays in flight, no prefetches, CPU ns per access", "<= 40"),
    "compare, s": ("npcache compare of a picture of 128x128, all policies and baselines, s of wall time on two cores", "<= 5"),
    "compare --no-baselines, s": ("the same without baselines", ""),
    "24 configurations, one thread / two": ("24 configurations of the clock in one call, by one thread over two", ">= 1.5"),
    "128 caches in one pass / one 2-way": ("all of 2^4..2^11 sets x 1..16 ways in one pass, over one 2-way replay", "<= 15"),
    "stack distances / one 2-way": ("exact stack distances, over one 2-way replay", "<= 6"),
    "replay from Parquet / 2-way from memory": ("one replay straight from Parquet, over one from memory", "<= 5"),
    "decode node + kind, M accesses/s": ("reading node and kind, M accesses a second on one core", ">= 120"),
    "replay of 4 caches, unfiltered / filtered": ("four caches with prefetches: without over with the exact filter", ""),
    "counts in parts / whole": (
        "parts of 2^20 accesses, replayed from nothing and joined, over one replay; 8K 2-way",
        "<= 1.25",
    ),
    "counts, 64K 8-way in parts / whole": ("the same, 64K 8-way", "<= 1.25"),
    "sweep in parts / whole": ("the same, all of 2^4..2^11 sets x 1..16 ways in one pass", "<= 1.20"),
    "account in parts / whole": ("the same, 8K 2-way with the account of prefetches", "<= 1.15"),
    "8 ways, move to front / linked lists": ("misses of 64K 8-way alone, over the replay that keeps an account", "<= 0.7"),
    "bytes of a summary of a line, counts alone": ("bytes of a summary of 64K 4-way for each of its lines, with zstd", "<= 9"),
    "one long run, one core / two": (
        "the replay of a picture of 1024x1024 from Parquet, 8K 2-way, wall time: one core over two",
        ">= 1.6",
    ),
    "cold compile of everything, s": ("cold compilation of everything by two processes, s of wall time", "<= 25"),
    "cold compile of everything, CPU s": ("the same, CPU s of both", ""),
    "warm start to the first ray, s": ("warm start to the first traced ray, CPU s", "<= 1.0"),
    "warm start to a first replay, s": ("npcache replay of a picture of 16x16, the whole process, warm, CPU s", "<= 0.5"),
    "warm start of an empty program, s": (
        "the same of a program with one kernel and nothing else but NumPy and pyarrow, CPU s",
        "",
    ),
}
#: Why a figure may be missing.
ABSENT = {
    "/ c++": "no C++ compiler",
    "DineroIV": "DINERO names no binary",
    "one long run": "no run is long enough",
    "pycachesim": "PYCACHESIM names no Python with pycachesim",
}


def is_met(goal: str, value: float) -> bool | None:
    """Return whether a value meets a goal; None without one."""
    if not goal:
        return None
    sign, limit = goal.split()
    return value >= float(limit) if sign == ">=" else value <= float(limit)
