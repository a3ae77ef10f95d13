"""One cache, replayed exactly, with its counts kept by group: as ``cachesim.cache``, which counts a whole trace.

What an access finds is written in the facts about its line (``cache.Cache.facts``), so each access is counted from the facts
before it, and the cache itself is stepped by the kernel of a plain replay.
"""

from typing import NamedTuple

import numpy as np

from cachesim.access import IFETCH, PREFETCH, READ
from cachesim.cache import (
    ALWAYS,
    NEVER,
    PUSHED_OUT,
    RESIDENT,
    SHADOWED,
    TAGGED,
    TOUCHED,
    UNUSED,
    Cache,
    access,
)
from cachesim.next_use import NO_MORE
from nptrace_base.jit import inlined, kernel

_LATE = 1 << 62  # later than every access

#: Columns of the counts. FILLED, USEFUL: of the group of the request that filled the line; POLLUTION and the last three, of
#: the group of the demand access that missed.
COUNTED = (
    "demand_accesses", "demand_misses", "prefetch_accesses", "filled", "useful", "pollution", "compulsory", "capacity",
    "conflict",
)  # fmt: skip
DEMAND, MISSED, REQUESTED, FILLED, USEFUL, POLLUTION, COMPULSORY, CAPACITY, CONFLICT = map(np.int64, range(len(COUNTED)))


class Accesses(NamedTuple):
    """Some accesses of one stream, in order, all (n,) arrays."""

    lines: np.ndarray  # uint32
    ids: np.ndarray  # uint32: dense id of each line
    next_ids: np.ndarray  # uint32: of the lines that a sequential prefetcher would request; otherwise equal to ids
    access_types: np.ndarray  # uint8
    groups: np.ndarray  # uint32
    next_use: np.ndarray  # uint32, only for opt, else empty: number of the next access to the same line
    n_before: int  # number of the first of these accesses


class Groups(NamedTuple):
    """The counts of one cache by group, updated in place."""

    counts: np.ndarray  # (n_groups, len(COUNTED)) int64
    filled_by: np.ndarray  # (n_ids,) uint32: group of the last prefetch that filled each line


def make_groups(n_groups: int, n_ids: int) -> Groups:
    """Return counts of nothing."""
    return Groups(np.zeros((n_groups, len(COUNTED)), np.int64), np.zeros(n_ids, np.uint32))


def resident_by_group(cache: Cache, groups: Groups) -> np.ndarray:
    """Return, per group, the lines that its prefetches filled, nothing demanded, and the cache still holds."""
    filled_by = groups.filled_by[: cache.facts.size][(cache.facts & UNUSED) != 0]
    return np.bincount(filled_by, minlength=len(groups.counts))


@kernel(_nrt=False)
def replay_groups(accesses, cache, groups, trigger, distance):
    """Replay accesses as the kernels of ``cachesim.cache`` do, and count them by group.

    ``trigger``, ``distance``: of a sequential prefetcher, whose requests are of the group of the access that triggers them.
    """
    for i in range(accesses.lines.size):
        line, line_id = np.int64(accesses.lines[i]), np.int64(accesses.ids[i])
        access_type, group = accesses.access_types[i], np.int64(accesses.groups[i])
        if accesses.next_use.size > 0:
            due = np.int64(accesses.next_use[i])
            if accesses.next_use[i] == NO_MORE:
                due = _LATE - accesses.n_before - i
            cache.lists.due[line_id] = due
            if cache.three_c:
                cache.shadow.due[line_id] = due
        was_resident = (cache.facts[line_id] & RESIDENT) != 0
        is_new = _access(cache, groups, line, line_id, access_type, group)
        if trigger == NEVER or (access_type != READ and access_type != IFETCH):
            continue
        if trigger == ALWAYS or (is_new and (trigger == TAGGED or not was_resident)):
            request = np.uint8(access_type | PREFETCH)
            _access(cache, groups, line + distance, np.int64(accesses.next_ids[i]), request, group)


@inlined
def _access(cache, groups, line, line_id, access_type, group):
    """Count an access from the facts before it, and access the line; return what ``cache.access`` does."""
    fact, counts = cache.facts[line_id], groups.counts
    if access_type & PREFETCH:
        counts[group, REQUESTED] += 1
        if not fact & RESIDENT:
            counts[group, FILLED] += 1
            groups.filled_by[line_id] = group
    else:
        counts[group, DEMAND] += 1
        if not fact & RESIDENT:
            counts[group, MISSED] += 1
            if fact & PUSHED_OUT:
                counts[group, POLLUTION] += 1
            if cache.three_c:
                counts[group, CONFLICT if fact & SHADOWED else CAPACITY if fact & TOUCHED else COMPULSORY] += 1
        elif fact & UNUSED:
            counts[np.int64(groups.filled_by[line_id]), USEFUL] += 1
    return access(cache, line, line_id, access_type)


@kernel
def groups_of_rays(nodes, access_types, of_ray, n_begun, groups):
    """Write the group of the ray that makes each access; return how many rays have begun, -1 if more than there are.

    A ray begins with the demand read of the root, node 0, which it reads once. ``n_begun`` had begun before.
    """
    for i in range(nodes.size):
        if nodes[i] == 0 and access_types[i] < PREFETCH:
            n_begun += 1
        if n_begun < 1 or n_begun > of_ray.size:
            return np.int64(-1)
        groups[i] = of_ray[n_begun - 1]
    return np.int64(n_begun)


@kernel
def count_events(groups, access_types, counts):
    """Count events, demand and prefetch, into counts[group, 0] and counts[group, 1]."""
    for i in range(groups.size):
        counts[np.int64(groups[i]), np.int64(access_types[i] >= PREFETCH)] += 1
