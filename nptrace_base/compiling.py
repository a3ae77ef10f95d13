"""Announces one-time compilation, so that nobody waits for a compiler without knowing why.

Imports nothing heavy, so that ``cli`` can set ``announce`` before it knows which command runs.
"""

import threading
from collections.abc import Callable, Mapping
from pathlib import Path

#: Called with one sentence when the first kernel of this process has to be compiled, and when kernels or trees cannot be
#: stored. None disables the notice.
announce: Callable[[str], object] | None = None
#: Called with the number of kernels begun, and whether one is being compiled, whenever that changes; None disables it.
watch: Callable[[int, bool], object] | None = None
#: For ``gc.set_threshold``: importing and compiling make millions of lasting objects, and searching them for
#: cycles took a fifth of the time.
GC_THRESHOLD = 300_000, 50, 50
n_compiled = 0  # kernels compiled by this process; those loaded from the cache do not count
lost: dict[str, str] = {}  # what could not be stored, and the sentence about it
_busy = 0  # kernels being compiled: one waits for those it calls
_lock = threading.Lock()


def started(folder: Path | None) -> None:
    """Record that a kernel is being compiled (``jit`` calls this) to be stored in ``folder``; announce the first."""
    global n_compiled, _busy
    with _lock:
        n_compiled += 1
        _busy += 1
        number = n_compiled
    if number == 1 and announce is not None:
        # The message says once how long everything takes: in the first command after an installation or a change.
        is_first = folder is None or next(folder.glob("*/*.nbc"), None) is None
        how_long = " (all of it takes a minute or two)" if is_first else ", kernels that only this command needs"
        announce(f"compiling for this machine, once{how_long}" + (f": kept in {folder}" if folder else ""))
    if watch is not None:
        watch(number, True)


def ended() -> None:
    """Record that a kernel is compiled."""
    global _busy
    with _lock:
        _busy = max(_busy - 1, 0)
        is_busy = _busy > 0
    if watch is not None:
        watch(n_compiled, is_busy)


def not_kept(what: str, tried: Mapping[Path, Exception]) -> None:
    """Record that kernels or trees could not be stored in any of the cache folders, and why."""
    places = [f"{folder} ({getattr(error, 'strerror', None) or error})" for folder, error in tried.items()]
    lose(what, f"{what} could not be kept in {' or '.join(places)}: they are made again each time")


def lose(what: str, sentence: str) -> None:
    """Announce, once for each kind of thing, that it could not be stored."""
    if announce is not None and what not in lost:
        announce(sentence)
    lost.setdefault(what, sentence)
