"""Where the cycles of a run fall: a run, a cache, a machine and a policy in; the cycles of each pixel, by what took them, out.

The clock can log every read and test with its ray, for a timeline. Here it goes on by a few rays at a time, and the log is
added up pixel by pixel and emptied each time, so memory does not grow with the trace.
"""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from cachesim.clock.kernel import N_CAUSES
from cachesim.clock.log import LOG_BOX, LOG_READ, LOG_TRIANGLES
from cachesim.clock.parameters import Clock
from cachesim.clock.state import CYCLES, SPENT_BOX, SPENT_HIT, SPENT_LATE, SPENT_MISS, SPENT_TRIANGLE, Rows
from cachesim.clock.stretches import Stretches
from cachesim.clock.timing import Workshop, check, timed_policy
from cachesim.config import CacheConfig
from cachesim.prefetch import Prefetch
from cachesim.source import RunSource
from nptrace_base.jit import kernel

#: Rows of the trace after which the log is emptied, and its first length: a row makes three entries or fewer, and one for
#: each line that is requested at it.
ROWS, ENTRIES = 1 << 14, 1 << 17

#: What the cycles of a pixel are spent on; waits for the port, an MSHR or a unit belong to no ray of the log.
SPENT = (SPENT_BOX, SPENT_TRIANGLE, SPENT_HIT, SPENT_MISS, SPENT_LATE)


def cycles_by_pixel(
    source: RunSource, config: CacheConfig, clock: Clock, prefetch: Prefetch | str = "stack",
    progress: Callable[[int], object] | None = None,
) -> dict[str, np.ndarray]:  # fmt: skip
    """Return the cycles of each pixel, (n_pixels,) int64 in rows from the top, by the names in ``clock.state.CYCLES``.

    Their sums are those of ``timing.time_run``. ``progress`` is called with the number of rows done after each batch.

    Raises
    ------
    NptraceError
        As ``timing.time_run``.
    """
    prefetch = timed_policy(prefetch)
    footer = source.run.footer
    rays = source.run.columns("rays", ["x", "y", "count"])
    reads = rays["count"] > 0
    pixels = rays["y"][reads].astype(np.uint32) * np.uint32(footer.width) + rays["x"][reads]
    stretches = Stretches(source)
    check([config], [clock], stretches.n_rays)
    workshop = Workshop(source, 1, progress)
    scout = workshop.job(config, clock, prefetch, is_scout=True)
    if scout is not None:
        workshop.run_all([scout], stretches)
    n_entries, counts = ENTRIES, None
    while counts is None:
        job = workshop.job(config, clock, prefetch, scout=scout, log=(n_entries, 0))
        counts = _counted(job, stretches, pixels, footer.width * footer.height, progress)
        n_entries *= 8
    return {CYCLES[cause]: counts[:, cause] for cause in SPENT}


def _counted(
    job: Any, stretches: Stretches, pixels: np.ndarray, n_pixels: int, progress: Callable[[int], object] | None
) -> np.ndarray | None:
    """Step a job through the run; return the cycles, (n_pixels, N_CAUSES), None if the log was too short for them."""
    clock, counts = job.clock, np.zeros((n_pixels, N_CAUSES), np.int64)
    stretches.keep(0, 0)
    for rows in stretches:
        for piece in _pieces(rows):
            job.step(piece)
            n_logged = int(clock.numbers["n_logged"][0])
            if n_logged == len(clock.log):
                return None
            add_up(clock.log[:n_logged], pixels, counts)
            clock.numbers["n_logged"][0] = 0
        ray = min(job.first_needed, rows.first_ray + rows.waits_for.size)
        stretches.keep(int(rows.first[ray - rows.first_ray]), ray)
        if progress is not None:
            progress(rows.nodes.size)
    return counts


def _pieces(rows: Rows) -> Iterator[Rows]:
    """Yield a stretch as far as its first rays, of about ``ROWS`` rows, then as far as the next, and at last whole."""
    ends = np.searchsorted(rows.first, np.arange(rows.first[0] + ROWS, rows.first[-1], ROWS))
    for end in np.unique(ends[ends < rows.waits_for.size]):
        yield rows._replace(first=rows.first[: end + 1], types=rows.types[:end], waits_for=rows.waits_for[:end], is_last=False)
    yield rows


@kernel
def add_up(log, pixels, counts):
    """Add the cycles of logged reads and tests to those of the pixels of their rays."""
    for i in range(log.shape[0]):
        what, number = log[i, 3], log[i, 5]
        if what == LOG_READ:
            counts[pixels[number // N_CAUSES], number % N_CAUSES] += log[i, 1]
        elif what == LOG_BOX:
            counts[pixels[number], SPENT_BOX] += log[i, 1]
        elif what == LOG_TRIANGLES:
            counts[pixels[number], SPENT_TRIANGLE] += log[i, 1]
