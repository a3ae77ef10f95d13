"""Exact LRU replay as a fold: a part of a trace -> its summary; summaries of parts that follow each other -> that of all.

A summary is the replay of its part through an empty cache, and what has to be corrected if something came before. In a set of
the cache, an access is *open* if its line is not held and the set still has an empty way: whether it hits depends on what the
cache held before. The open accesses are thus the first min(ways, distinct) lines of each set. Every other access is *decided*:
a hit on a line that the part itself used, or a miss in a set that is full of such lines. So a summary has

- counts from the empty cache on, in which every open access is a miss;
- the open accesses in order, each a line with its access type;
- the lines of each set, newest first: its recency.

Three functions serve batches, threads, processes and job arrays. ``step`` takes the next accesses; a sequential replay is
nothing else, since the counts from the empty cache are its counts. ``then`` joins two parts:

1. replay the open accesses of the later part on a copy of the earlier state, with the same kernel. Up to an open access, the
   later part has used just the open lines before it in the set, and it evicts nothing but lines of the earlier part;
2. add the later part's counts, without its open accesses, which step 1 has counted;
3. put the later part's lines in front. After step 1 its open lines are in front already, as many as its set holds, so its
   ways are copied and the others stay.

``then`` is associative, and the empty summary is its neutral element. It changes neither of the two, because an engine may
run a task twice. ``finished`` makes results of a summary.

What more is counted needs more, and the same three steps:

- The sweep (``cachesim.all_associativity``): a line that is open at 2^k sets is open at every larger number, so an open
  access has the first number of sets at which it is open, and is replayed from there on.
- Stack distances (``cachesim.stack_distance``): one set with room for all lines; the first access to each line is open.
- The account and the three kinds of misses (``cachesim.cache_counts``): the first access to *every* line, because a miss in a
  full set is pollution if a prefetch of an earlier part pushed the line out, and not compulsory if an earlier part used it.
  Only the open ones step the cache. A fill by an open prefetch has a fate: its line was demanded, was evicted before that, or
  waits. If it turns out that the line was there, and demanded, the prefetch filled nothing, and its fate is taken back.

The state of a cache for which only misses are counted is bounded by the cache, the others' by the lines that a part uses.

What is no fold: under FIFO, random replacement and OPT, as with prefetchers that wait for misses, whether an open access hits
changes what the cache does with all that follow. These are replayed from the first access to the last.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, Self

import numpy as np

from cachesim.cache import ALWAYS, NEVER
from cachesim.config import CacheConfig
from cachesim.prefetch import Prefetch
from cachesim.source import Source
from nptrace_base.errors import NptraceError
from traces.identity import RunIdentity

#: A call that counts some accesses; those of one batch may run at the same time.
Step = tuple[Callable[..., None], *tuple[Any, ...]]


class Summary(Protocol):
    """What is known of a part of a trace, of all that a question asks for. Each cache's has ``step`` for ``steps``."""

    def steps(self, events: Any, access_types: np.ndarray) -> list[Step]:
        """Take a batch of events; return the calls that count it, which may run at the same time."""

    def then(self, later: Self) -> Self:
        """Return the summary of this part and of the one that follows; neither changes."""

    def arrays(self) -> dict[str, np.ndarray]:
        """Return all that the summary is, by name; equal summaries have equal arrays."""

    def load(self, arrays: dict[str, np.ndarray]) -> None:
        """Become the summary that has these arrays."""


@dataclass(frozen=True)
class About:
    """What results say of the trace.

    Attributes
    ----------
    identity : RunIdentity
    layout : str
    n_rays : int or None
    """

    identity: RunIdentity
    layout: str
    n_rays: int | None

    @classmethod
    def of(cls, source: Source) -> "About":
        """Return the facts of a source."""
        return cls(source.identity, str(source.layout), source.n_rays)


class Question(Protocol):
    """What is asked of a trace, without the trace: the summary it begins with, the results of the one it ends with."""

    @property
    def configs(self) -> tuple[CacheConfig, ...]:
        """The caches."""

    @property
    def policy(self) -> Prefetch:
        """The prefetch policy."""

    def begin(self, source: Source | None) -> Any:
        """Return the summary of no access, for the events of a source; None: for ``then`` and ``load`` alone."""

    def finished(self, summary: Any, about: About) -> list[Any]:
        """Return the results."""


def reason_against(configs: Sequence[CacheConfig], prefetch: Prefetch) -> str:
    """Return why the parts of a trace cannot be counted apart, as the end of a sentence; empty if they can."""
    if prefetch.trigger not in (NEVER, ALWAYS):
        return f"what {prefetch} requests depends on hits and misses, and so on all that went before"
    if not prefetch.policy.begins_anew and not prefetch.policy.needs_clock:  # no replay has a clock
        return f"what {prefetch} requests may depend on rays that went before"
    for config in configs:
        if config.policy != "lru":
            return f"under {config.policy} replacement, one hit or miss changes what {config} does with all that follow"
    return ""


def check_parts(configs: Sequence[CacheConfig], prefetch: Prefetch) -> None:
    """Raise NptraceError if the parts of a trace cannot be counted apart."""
    if reason := reason_against(configs, prefetch):
        raise NptraceError(f"parts of a trace cannot be counted apart: {reason}; replay the whole run without workers")


def prefixed(prefix: str, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the arrays under longer names."""
    return {f"{prefix}.{name}": array for name, array in arrays.items()}


def of_prefix(prefix: str, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the arrays that ``prefixed`` made, under their own names."""
    return {name.removeprefix(f"{prefix}."): array for name, array in arrays.items() if name.startswith(f"{prefix}.")}
