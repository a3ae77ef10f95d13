"""What the clock notes for a timeline: one row per event, written by its kernels, read by ``timeline`` and ``by_pixel``."""

import numpy as np

from nptrace_base.jit import inlined

#: What an entry of the log is about.
LOG_READ, LOG_BOX, LOG_TRIANGLES, LOG_PREFETCH = map(np.int64, range(4))  # as NumPy's: literals are compiled one by one


@inlined
def note(clock, cycle, length, slot, what, node, number):
    """Keep an event for the timeline."""
    if clock.log.shape[0] == 0 or clock.numbers[0].next_ray < clock.log_from:
        return
    n = clock.numbers[0].n_logged
    if n < clock.log.shape[0]:
        clock.log[n, 0], clock.log[n, 1], clock.log[n, 2] = cycle, length, slot
        clock.log[n, 3], clock.log[n, 4], clock.log[n, 5] = what, node, number
        clock.numbers[0].n_logged = n + 1
