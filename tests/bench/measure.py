"""Timing: interleaved repetitions -> medians, and ratios taken pair by pair, which hold when the machine's speed drifts."""

import statistics
import time
from collections.abc import Callable, Mapping


def times(
    functions: Mapping[str, Callable[[], object]], repeat: int, clock: Callable[[], float] = time.thread_time
) -> dict[str, list[float]]:
    """Call every function once to warm it up, then ``repeat`` times in turn; return the seconds of each call."""
    for function in functions.values():
        function()
    taken: dict[str, list[float]] = {name: [] for name in functions}
    for _ in range(repeat):
        for name, function in functions.items():
            start = clock()
            function()
            taken[name].append(clock() - start)
    return taken


def ratio(slow: list[float], fast: list[float]) -> float:
    """Return the median over the repetitions of slow / fast."""
    return statistics.median(a / b for a, b in zip(slow, fast, strict=True))
