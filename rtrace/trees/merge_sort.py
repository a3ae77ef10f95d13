"""Sorting inside kernels: the numbers of a leaf's triangles, the events of a split."""

from nptrace_base.jit import kernel

_RUN = 16  # what insertion sorts faster than a merge


@kernel
def sort(keys, n, spare):
    """Sort keys[:n] ascending, in place: runs of 16 by insertion, then merged pairwise.

    Not quadratic, and without the 1.7 s that compiling np.sort takes.

    Parameters
    ----------
    keys : array of any integer type
    n : int
    spare : array of the same type
        Scratch for at least n keys.
    """
    for begin in range(0, n, _RUN):
        for i in range(begin + 1, min(begin + _RUN, n)):
            key = keys[i]
            j = i
            while j > begin and keys[j - 1] > key:
                keys[j] = keys[j - 1]
                j -= 1
            keys[j] = key
    run = _RUN
    while run < n:
        for begin in range(0, n - run, 2 * run):
            end = min(begin + 2 * run, n)
            for i in range(run):
                spare[i] = keys[begin + i]
            i, j, out = 0, begin + run, begin
            while i < run:
                if j < end and keys[j] < spare[i]:
                    keys[out] = keys[j]
                    j += 1
                else:
                    keys[out] = spare[i]
                    i += 1
                out += 1
        run *= 2
