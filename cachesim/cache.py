"""One cache, replayed exactly: lines and access types in; counts per access type, and the account of prefetches, out.

Any ways and policy, prefetches that fill and refresh as a read does, sequential prefetchers, the three kinds of misses, and
what became of every prefetch. Lines are keyed by dense ids (``Lines.ids``), so nothing depends on the number of ways.
"""

from typing import NamedTuple

import numpy as np

from cachesim.access import IFETCH, N_ACCESS_TYPES, PREFETCH, READ
from cachesim.config import CacheConfig
from cachesim.fast_lru import set_mask, set_of
from cachesim.next_use import NO_MORE
from cachesim.replacement import Lists, grow_lists, insert, make_lists, refresh
from nptrace_base.jit import kernel

#: Rows of the counts, one column per access type.
GENERATED, MISSES, COMPULSORY, CAPACITY, CONFLICT = range(5)

#: Entries of the account.
USEFUL, USELESS, POLLUTION = range(3)

#: Sequential prefetchers: when does a read of a line request the line after it?
NEVER, ALWAYS, ON_MISS, TAGGED = range(4)

# Facts about a line, one bit each.
RESIDENT = 1  # in the cache
UNUSED = 2  # filled by a prefetch and not demanded since
PUSHED_OUT = 4  # a prefetch evicted it, and nothing has filled it since
SHADOWED = 8  # in the fully associative cache of the 3C classification
TOUCHED = 16  # accessed at least once
# What became of a fill by an open prefetch (``cachesim.summary``): neither of the two means that the line was demanded.
PENDING = 32  # in the cache, and not demanded yet
LOST = 64  # evicted before that

_LATE = 1 << 62  # later than every access


class Cache(NamedTuple):
    """State of one cache; the arrays are updated in place."""

    lists: Lists
    shadow: Lists
    facts: np.ndarray  # (n_ids,) uint8: the bits above
    counts: np.ndarray  # (5 * N_ACCESS_TYPES,) int64
    account: np.ndarray  # (3,) int64
    first_ids: np.ndarray  # (n_ids,) uint32: every line accessed, in the order of first accesses
    first_types: np.ndarray  # (n_ids,) uint8: the access types of those
    n_first: np.ndarray  # (1,) int64
    mask: int  # of set_of
    three_c: bool


def make_cache(config: CacheConfig, n_ids: int, *, three_c: bool) -> Cache:
    """Return an empty cache for line ids below ``n_ids``."""
    return Cache(
        lists=make_lists(config, n_ids),
        shadow=make_lists(config, n_ids if three_c else 0, fully_associative=True),
        facts=np.zeros(n_ids, np.uint8),
        counts=np.zeros(5 * N_ACCESS_TYPES, np.int64),
        account=np.zeros(3, np.int64),
        first_ids=np.empty(n_ids, np.uint32),
        first_types=np.empty(n_ids, np.uint8),
        n_first=np.zeros(1, np.int64),
        mask=set_mask(config.n_sets),
        three_c=three_c,
    )


def grow_cache(cache: Cache, n_ids: int) -> Cache:
    """Return the same cache with room for more line ids."""
    facts, first_ids, first_types = np.zeros(n_ids, np.uint8), np.empty(n_ids, np.uint32), np.empty(n_ids, np.uint8)
    n = cache.facts.size
    facts[:n], first_ids[:n], first_types[:n] = cache.facts, cache.first_ids, cache.first_types
    shadow = grow_lists(cache.shadow, n_ids) if cache.three_c else cache.shadow
    lists = grow_lists(cache.lists, n_ids)
    return cache._replace(lists=lists, shadow=shadow, facts=facts, first_ids=first_ids, first_types=first_types)


def n_resident_unused(cache: Cache) -> int:
    """Return the number of lines that a prefetch filled, nothing demanded, and the cache still holds."""
    return int(np.count_nonzero((cache.facts & UNUSED) != 0))


@kernel(_nrt=False, forceinline=True)
def shadow_access(cache, line_id, fact):
    """Access a line in the fully associative cache, of which ``fact`` may say that it holds the line."""
    if fact & SHADOWED:
        refresh(cache.shadow, np.int64(0), line_id)
    else:
        left = insert(cache.shadow, np.int64(0), line_id)
        if left >= 0:
            cache.facts[left] &= 255 - SHADOWED


@kernel(_nrt=False, forceinline=True)
def count_miss(cache, line_id, fact, access_type):
    """Count a miss of a line about which ``fact`` was known before."""
    counts = cache.counts
    counts[MISSES * N_ACCESS_TYPES + access_type] += 1
    if cache.three_c:
        if fact & SHADOWED:
            counts[CONFLICT * N_ACCESS_TYPES + access_type] += 1
        elif fact & TOUCHED:
            counts[CAPACITY * N_ACCESS_TYPES + access_type] += 1
        else:
            counts[COMPULSORY * N_ACCESS_TYPES + access_type] += 1
    if not fact & TOUCHED:
        n = cache.n_first[0]
        cache.first_ids[n], cache.first_types[n] = line_id, access_type
        cache.n_first[0] = n + 1
    if fact & PUSHED_OUT and not access_type & PREFETCH:
        cache.account[POLLUTION] += 1


@kernel(_nrt=False, forceinline=True)
def access(cache, line, line_id, access_type):
    """Access one line; return whether it missed, or was demanded for the first time since a prefetch filled it."""
    facts, account = cache.facts, cache.account
    is_prefetch = (access_type & PREFETCH) != 0
    fact = facts[line_id]
    now = fact | TOUCHED
    if cache.three_c:
        shadow_access(cache, line_id, fact)
        now |= SHADOWED
    s = set_of(line, cache.lists.n_sets, cache.mask)
    if fact & RESIDENT:
        refresh(cache.lists, s, line_id)
        is_first_use = False
        if not is_prefetch and fact & UNUSED:
            account[USEFUL] += 1
            now &= 255 - UNUSED - PENDING
            is_first_use = True
        facts[line_id] = now
        return is_first_use
    count_miss(cache, line_id, fact, access_type)
    now = (now & (255 - PUSHED_OUT)) | RESIDENT
    if is_prefetch:
        now |= UNUSED
    victim = insert(cache.lists, s, line_id)
    if victim >= 0:
        lost = facts[victim]
        if lost & UNUSED:
            account[USELESS] += 1
            if lost & PENDING:
                lost ^= PENDING | LOST
        lost &= 255 - RESIDENT - UNUSED
        facts[victim] = lost | PUSHED_OUT if is_prefetch else lost
    elif is_prefetch:
        now |= PENDING
    facts[line_id] = now
    return True


@kernel(_nrt=False)
def replay_exact(lines, ids, access_types, cache):
    """Replay accesses in order; the prefetches among them are requests of their own.

    Parameters
    ----------
    lines : (n,) uint32
        Line numbers; those of a source may start at its lowest line.
    ids : (n,) uint32
        Dense id of each line.
    access_types : (n,) uint8
        READ, IFETCH or MISC, with PREFETCH or-ed for a prefetch.
    cache : Cache
    """
    for i in range(lines.size):
        access(cache, np.int64(lines[i]), np.int64(ids[i]), access_types[i])


@kernel(_nrt=False)
def replay_optimal(lines, ids, access_types, next_use, start, cache):
    """Replay accesses in order through a cache that knows the future: as ``replay_exact``, under the policy ``opt``.

    Of lines that are not used again, the one goes whose last use is longest ago.

    Parameters
    ----------
    next_use : (n,) uint32
        Number of the next access to the same line, NO_MORE for none.
    start : int
        Number of the first of these accesses.
    """
    for i in range(lines.size):
        line_id, due = np.int64(ids[i]), np.int64(next_use[i])
        if next_use[i] == NO_MORE:
            due = _LATE - start - i
        cache.lists.due[line_id] = due
        if cache.three_c:
            cache.shadow.due[line_id] = due
        access(cache, np.int64(lines[i]), line_id, access_types[i])


@kernel(_nrt=False)
def replay_sequential(lines, ids, next_ids, access_types, cache, trigger, distance):
    """Replay accesses in order with a sequential prefetcher, whose request follows the access that triggers it.

    As ``replay_exact``, and ``next_ids`` are the ids of the lines ``distance`` further on. Only reads and instruction
    fetches trigger. ALWAYS: each of them; ON_MISS: those that miss; TAGGED: those that miss, and the first to a line since
    a prefetch filled it.
    """
    for i in range(lines.size):
        line, line_id, access_type = np.int64(lines[i]), np.int64(ids[i]), access_types[i]
        was_resident = (cache.facts[line_id] & RESIDENT) != 0
        is_new = access(cache, line, line_id, access_type)
        if access_type != READ and access_type != IFETCH:
            continue
        if trigger == ALWAYS or (is_new and (trigger == TAGGED or not was_resident)):
            request = np.uint8(access_type | PREFETCH)
            cache.counts[GENERATED * N_ACCESS_TYPES + request] += 1
            access(cache, line + distance, np.int64(next_ids[i]), request)
