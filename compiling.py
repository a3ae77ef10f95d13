"""Saying when kernels are being compiled: a study should not wait for a compiler unawares.

Imports nothing heavy, so that ``cli`` can set ``announce`` before it knows which command runs.
"""

from collections.abc import Callable
from pathlib import Path

#: Called with one sentence when the first kernel of this process has to be compiled; None: nobody wants to know.
announce: Callable[[str], object] | None = None
#: For ``gc.set_threshold``: importing and compiling make millions of objects that live on, and looking through them for
#: cycles took a fifth of the time.
GC_THRESHOLD = 100_000, 50, 50
n_compiled = 0  # kernels compiled by this process; those loaded from the cache do not count


def started(folder: Path) -> None:
    """Note that a kernel is being compiled (``jit`` calls this); say so the first time."""
    global n_compiled
    n_compiled += 1
    if n_compiled == 1 and announce is not None:
        announce(f"compiling for this machine, once (all of it takes about half a minute): kept in {folder}")
