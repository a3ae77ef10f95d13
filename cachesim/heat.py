"""Heat maps: a run, and a cache or a machine where the kind needs one, in; a number per pixel out."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cachesim.by_group import GroupedResult, events_by, replay_by
from cachesim.clock.by_pixel import cycles_by_pixel
from cachesim.clock.parameters import Clock
from cachesim.clock.timing import timed_policy
from cachesim.config import CacheConfig
from cachesim.prefetch import Prefetch
from cachesim.source import RunSource
from traces.identity import RunIdentity

#: What each kind of heat map shows, per pixel, and what it needs: nothing, the requests, a cache, or a machine too.
KINDS = {
    "accesses": ("node reads", ""),
    "prefetches": ("prefetch requests", "requests"),
    "misses": ("demand misses", "cache"),
    "misses-without": ("demand misses without prefetching", "cache"),
    "saved": ("demand misses that prefetching saves (blue: adds)", "cache"),
    "useful": ("useful prefetches", "cache"),
    "useless": ("useless prefetches", "cache"),
    "pollution": ("demand misses on lines that a prefetch evicted", "cache"),
    "miss-cycles": ("cycles that rays wait for demand misses", "machine"),
    "late-cycles": ("cycles that rays wait for late prefetches", "machine"),
}

#: The kinds whose numbers may be negative.
SIGNED = ("saved",)

_COUNTS = {
    "misses": "demand_misses", "misses-without": "demand_misses_without", "useful": "useful", "useless": "useless",
    "pollution": "pollution",
}  # fmt: skip
_CYCLES = {"miss-cycles": "demand miss", "late-cycles": "late prefetch"}


@dataclass(frozen=True)
class HeatSetting:
    """What a run goes through: a cache, a machine and a prefetch policy."""

    config: CacheConfig
    clock: Clock
    prefetch: Prefetch

    def text(self, kind: str) -> str:
        """Return what of it decides a heat map, for its legend."""
        cache, prefetch, needed = str(self.config), f"prefetch {self.prefetch}", needs(kind, self.prefetch)
        if needed == "machine":
            return f"{cache}, machine {self.clock.name}, prefetch {timed_policy(self.prefetch)}"
        return {"": "", "requests": prefetch, "cache": f"{cache}, {prefetch}"}[needed]


def needs(kind: str, prefetch: Prefetch) -> str:
    """Return what decides a kind: nothing, the requests, a cache, or a machine too."""
    found = KINDS[kind][1]
    return "cache" if found == "requests" and prefetch.trigger else found  # which makes the requests


class HeatMaps:
    """The heat maps of one run under one setting; each pass over the run is made once, when a kind needs it."""

    def __init__(self, source: RunSource, setting: HeatSetting, *, threads: int | None = None) -> None:
        self._source, self._setting, self._threads = source, setting, threads
        self.identity: RunIdentity = source.identity
        self.shape = source.run.footer.height, source.run.footer.width

    def values(self, kind: str, progress: Callable[[int], None] | None = None) -> np.ndarray:
        """Return the numbers of a kind in ``KINDS``, (height, width) int64."""
        self._progress = progress
        if kind == "accesses":
            found = self._events[:, 0]
        elif kind == "prefetches" and self._setting.prefetch.trigger:
            found = self._counts.counts["prefetch_accesses"]
        elif kind == "prefetches":
            found = self._events[:, 1]
        elif kind == "saved":
            found = self._counts.counts["demand_misses_without"] - self._counts.counts["demand_misses"]
        elif kind in _COUNTS:
            found = self._counts.counts[_COUNTS[kind]]
        else:
            found = self._cycles[_CYCLES[kind]]
        return found.reshape(self.shape)

    @cached_property
    def _events(self) -> np.ndarray:
        return events_by(self._source, "pixel", self._setting.prefetch)

    @cached_property
    def _counts(self) -> GroupedResult:
        [result] = replay_by(
            self._source, [self._setting.config], "pixel", prefetch=self._setting.prefetch, threads=self._threads,
            progress=self._progress,
        )  # fmt: skip
        return result

    @cached_property
    def _cycles(self) -> dict[str, np.ndarray]:
        setting = self._setting
        return cycles_by_pixel(self._source, setting.config, setting.clock, setting.prefetch, self._progress)
