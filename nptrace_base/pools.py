"""A thread pool that does not delay Ctrl-C."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager


@contextmanager
def thread_pool(threads: int) -> Iterator[ThreadPoolExecutor]:
    """Yield a pool of threads; Ctrl-C does not wait for their current work, which may be compiling."""
    pool = ThreadPoolExecutor(threads)
    try:
        yield pool
    except BaseException as e:
        pool.shutdown(wait=isinstance(e, Exception), cancel_futures=True)
        raise
    pool.shutdown()
