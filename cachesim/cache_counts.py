"""One cache for which everything is counted, as a summary: accesses in; counts, the account and three kinds of misses out.

``cachesim.summary`` says why two of them can be joined, and ``cachesim.cache`` what is counted.
"""

import numpy as np

from cachesim.access import N_ACCESS_TYPES, PREFETCH
from cachesim.cache import (
    COMPULSORY,
    LOST,
    MISSES,
    PENDING,
    TOUCHED,
    UNUSED,
    USEFUL,
    USELESS,
    access,
    count_miss,
    grow_cache,
    make_cache,
    replay_exact,
    replay_optimal,
    replay_sequential,
    shadow_access,
)
from cachesim.config import CacheConfig
from cachesim.fast_lru import set_of
from cachesim.prefetch import Prefetch
from cachesim.replacement import order_of, write_rings
from nptrace_base.jit import kernel


class CacheCounts:
    """A cache of any policy, with a sequential prefetcher or none.

    Attributes
    ----------
    cache : Cache
    """

    def __init__(self, config: CacheConfig, prefetch: Prefetch, *, three_c: bool) -> None:
        self._asked = config, prefetch
        self.cache = make_cache(config, 0, three_c=three_c)

    def step(
        self, lines: np.ndarray, access_types: np.ndarray, ids: np.ndarray, next_ids: np.ndarray, n_ids: int,
        next_use: np.ndarray | None, n_before: int,
    ) -> None:  # fmt: skip
        """Replay some accesses.

        Parameters
        ----------
        lines, ids, next_ids : (n,) uint32
            Line numbers, their dense ids below ``n_ids``, and those of the lines that a sequential prefetcher would request.
        access_types : (n,) uint8
        next_use : (n,) uint32, optional
            For opt: the number of the next access to the same line; ``n_before`` is that of the first access here.
        """
        self._make_room(n_ids)
        config, prefetch = self._asked
        if config.policy == "opt":
            replay_optimal(lines, ids, access_types, next_use, n_before, self.cache)
        elif prefetch.trigger:
            replay_sequential(lines, ids, next_ids, access_types, self.cache, prefetch.trigger, prefetch.distance)
        else:
            replay_exact(lines, ids, access_types, self.cache)

    def _make_room(self, n_ids: int) -> None:
        if n_ids > self.cache.facts.size:
            self.cache = grow_cache(self.cache, max(n_ids, 2 * self.cache.facts.size))

    def row(self, which: int) -> np.ndarray:
        """Return one row of the counts, per access type."""
        return self.cache.counts[which * N_ACCESS_TYPES : (which + 1) * N_ACCESS_TYPES]

    @property
    def misses(self) -> np.ndarray:
        """Misses per access type."""
        return self.row(MISSES)

    def then(self, later: "CacheCounts") -> "CacheCounts":
        """Return the summary of this part and the one that follows, under LRU, where ids are line numbers."""
        whole = self._copy()
        whole._make_room(later.cache.facts.size)
        cache, its = whole.cache, later.cache
        n = int(its.n_first[0])
        n_seen = np.zeros(cache.lists.n_sets, np.int32)
        replay_first(its.first_ids[:n], its.first_types[:n], its.facts, n_seen, cache)
        cache.counts[:] += its.counts
        cache.account[:] += its.account
        first = np.bincount(its.first_types[:n], minlength=N_ACCESS_TYPES)
        for which in (MISSES, COMPULSORY) if cache.three_c else (MISSES,):
            whole.row(which)[:] -= first
        put_in_front(its.facts, cache.facts)
        pairs = [(cache.lists, its.lists)] + ([(cache.shadow, its.shadow)] if cache.three_c else [])
        for mine, other in pairs:
            newest = order_of(other)
            write_rings(np.where(newest >= 0, newest, order_of(mine)), mine)
        return whole

    def _copy(self) -> "CacheCounts":
        copy = CacheCounts(*self._asked, three_c=self.cache.three_c)
        copy.load(self.arrays())
        return copy

    def arrays(self) -> dict[str, np.ndarray]:
        """Return all that the summary is; equal summaries have equal arrays."""
        cache, n = self.cache, int(self.cache.n_first[0])
        shadow = {"shadow": order_of(cache.shadow)} if cache.three_c else {}
        return shadow | {
            "counts": cache.counts, "account": cache.account, "facts": cache.facts, "order": order_of(cache.lists),
            "first_ids": cache.first_ids[:n], "first_types": cache.first_types[:n],
        }  # fmt: skip

    def load(self, arrays: dict[str, np.ndarray]) -> None:
        """Become the summary that has these arrays; this one is new."""
        self._make_room(arrays["facts"].size)
        cache, n = self.cache, arrays["first_ids"].size
        cache.counts[:], cache.account[:], cache.facts[:] = arrays["counts"], arrays["account"], arrays["facts"]
        cache.first_ids[:n], cache.first_types[:n], cache.n_first[0] = arrays["first_ids"], arrays["first_types"], n
        write_rings(arrays["order"].copy(), cache.lists)  # from a file it is read-only, to Numba another type
        if cache.three_c:
            write_rings(arrays["shadow"].copy(), cache.shadow)


@kernel(_nrt=False)
def replay_first(ids, types, later, n_seen, cache):
    """Replay the first accesses of a later part on the state of an earlier one.

    Parameters
    ----------
    ids : (n,) uint32
        Ids, which are line numbers.
    types : (n,) uint8
    later : (n_ids,) uint8
        The facts of the later part.
    n_seen : (n_sets,) int32
        0; the lines of each set so far.
    cache : Cache
        The earlier state, which goes on.
    """
    for i in range(ids.size):
        line_id, access_type = np.int64(ids[i]), types[i]
        s = set_of(line_id, cache.lists.n_sets, cache.mask)
        if n_seen[s] < cache.lists.ways:
            n_seen[s] += 1
            access(cache, line_id, line_id, access_type)
            if access_type & PREFETCH:
                settle(cache, line_id, later[line_id])
        else:  # decided: a miss that the later part's own lists and facts have seen
            fact = cache.facts[line_id]
            if cache.three_c:
                shadow_access(cache, line_id, fact)
            count_miss(cache, line_id, fact, access_type)


@kernel(_nrt=False, forceinline=True)
def settle(cache, line_id, found):
    """Give the fill by an open prefetch its fate, which is in the facts ``found`` in the later part.

    The later part has counted it. If the line was there, filled by an earlier prefetch and not demanded, the fate is that of
    the earlier fill; if it was there and demanded, there was no fill.
    """
    fact = cache.facts[line_id]
    if fact & UNUSED:
        if fact & PENDING and not found & PENDING:
            fact ^= PENDING
            cache.facts[line_id] = fact | (found & LOST)
    elif found & LOST:
        cache.account[USELESS] -= 1
    elif not found & PENDING:
        cache.account[USEFUL] -= 1


@kernel(_nrt=False)
def put_in_front(later, facts):
    """Replace the facts about every line that the later part has accessed by its own; fates stay those of open prefetches."""
    for line_id in range(later.size):
        found, fact = later[line_id], facts[line_id]
        if found & TOUCHED:
            if found & PENDING and not fact & UNUSED:
                found &= 255 - UNUSED
            facts[line_id] = (found & (255 - PENDING - LOST)) | (fact & (PENDING | LOST))
