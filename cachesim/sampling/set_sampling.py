"""Part of the sets of a cache: a source and LRU caches in, their counts estimated from 1/2, 1/4 ... of the sets out.

One set of a cache does not depend on the others, so the sampled sets are simulated exactly, from the start, without a warm-up
(Kessler, Hill and Wood 1994). The misses of the sampled sets are scaled up. All accesses are counted, because the set that
holds the root has more accesses than others, but hardly more misses. A set is selected by the line number modulo the greatest
common divisor of the numbers of sets, so all caches see the same lines.

Set sampling is unsuitable for small direct-mapped caches, where a few sets have most of the conflicts; docs/speed-error.md
gives the errors.
"""

from collections.abc import Sequence
from math import gcd

import numpy as np

from cachesim.access import PREFETCH
from cachesim.config import CacheConfig
from cachesim.prefetch import parse_prefetch
from cachesim.sampling.cold_start import ALONE, DEMAND, REQUESTS, KnownReplay, check_lru
from cachesim.source import Source
from cachesim.stack_distance import check_one_pass
from cachesim.sweep import SweepRow
from nptrace_base.errors import NptraceError
from nptrace_base.jit import kernel


def sample_sets(
    source: Source, configs: Sequence[CacheConfig], every: int, *, which: int = 0, seed: int = 0, prefetch: str = "traced"
) -> list[SweepRow]:
    """Return a SweepRow for each cache, in order, with misses estimated from one ``every``-th of its sets.

    Parameters
    ----------
    source : Source
    configs : sequence of CacheConfig
        LRU, of one line size.
    every : int
        Must divide the number of sets of every cache.
    which, seed : int
        ``seed`` deals the sets into ``every`` parts at random, of which ``which`` is taken: together they are all sets.
    prefetch : str
        Any policy whose requests do not depend on the cache.
    """
    check_lru(configs)
    policy = parse_prefetch(prefetch)
    check_one_pass(policy)
    n_classes = gcd(*(config.n_sets for config in configs))
    if every < 1 or n_classes % every:
        raise NptraceError(
            f"cannot sample one in {every} sets of caches whose numbers of sets have the common divisor {n_classes}; "
            f"choose a divisor of {n_classes}"
        )
    if not 0 <= which < every:
        raise NptraceError(f"part {which} of {every} does not exist; choose 0 to {every - 1}")
    is_taken = np.zeros(n_classes, np.bool_)
    is_taken[np.random.default_rng(seed).permutation(n_classes)[which::every]] = True
    lines_of, replay = source.lines(configs[0].line_bytes, 0), KnownReplay(configs, from_start=True)
    misses = np.zeros((len(configs), 3), np.int64)
    n_accesses = n_prefetches = 0
    for events, event_types in source.events(policy):
        lines, access_types = lines_of.accesses(events, event_types)
        n_requests = int(np.count_nonzero(access_types >= PREFETCH))
        n_prefetches += n_requests
        n_accesses += lines.size - n_requests
        misses += replay.step(*in_classes(lines, access_types, is_taken)).misses
    return [
        SweepRow(
            source.identity, config, str(policy), str(source.layout), n_accesses, int(found[DEMAND]) * every, n_prefetches,
            int(found[REQUESTS]) * every, int(found[ALONE]) * every,
        )
        for config, found in zip(configs, misses, strict=True)
    ]  # fmt: skip


def in_classes(lines: np.ndarray, access_types: np.ndarray, is_taken: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the (line, access type) pairs whose line modulo ``is_taken.size`` is marked there."""
    kept, kept_types = np.empty(lines.size, np.uint32), np.empty(lines.size, np.uint8)
    n = keep_classes(lines, access_types, is_taken, kept, kept_types)
    return kept[:n], kept_types[:n]


@kernel
def keep_classes(lines, access_types, is_taken, kept, kept_types):
    """Copy the pairs of marked classes; return how many."""
    n, n_classes = 0, np.uint32(is_taken.size)
    is_power = n_classes & (n_classes - np.uint32(1)) == 0
    mask = n_classes - np.uint32(1)
    for i in range(lines.size):
        line = lines[i]
        # No branch: which lines are kept cannot be predicted.
        kept[n] = line
        kept_types[n] = access_types[i]
        n += is_taken[line & mask] if is_power else is_taken[line % n_classes]
    return n
