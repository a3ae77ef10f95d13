"""Tasks -> their results, by workers: processes, any executor of ``concurrent.futures``, or a Dask cluster.

A task is a function of a module with arguments that can be pickled. It may run twice, so it must give the same both times.
What a worker finished before it was killed counts; the rest is done again.
"""

import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from functools import partial
from typing import Any, TypeVar

from nptrace_base.errors import NptraceError

#: Rounds of workers that are lost one after another, without one finished task, before this is given up.
_ROUNDS = 3
#: What a Dask scheduler has to answer.
_PATIENCE = "10s"

_T = TypeVar("_T")


class WorkersLostError(NptraceError):
    """Workers were killed and cannot be replaced; the message states what is known."""


class WorkerEndedError(Exception):
    """Something ended a task from within, as ``sys.exit`` does: to the engine, its worker is lost."""


class Engine:
    """Workers for tasks.

    Parameters
    ----------
    start : callable
        Returns an executor; called again when its workers are lost, up to ``_ROUNDS`` times in vain if ``can_restart``.
    what : str
        What a message calls a worker that is lost.
    lost : tuple of exception types
        What the executor raises then.
    n_workers : int
        How many there are, 0 if that is not known.
    """

    def __init__(
        self, start: Callable[[], Executor], what: str, *, can_restart: bool, lost: tuple[type[BaseException], ...] = (),
        n_workers: int = 0,
    ) -> None:  # fmt: skip
        self._start, self._what, self._can_restart, self.n_workers = start, what, can_restart, n_workers
        self._lost: tuple[type[BaseException], ...] = (BrokenExecutor, WorkerEndedError, *lost)

    def results(self, function: Callable[..., _T], tasks: Sequence[tuple]) -> Iterator[tuple[int, _T]]:
        """Yield the number of each task and what ``function`` returns for its arguments, in the order in which they end.

        Raises
        ------
        WorkersLostError
            The workers were lost, and new ones were too.
        """
        left, in_vain = dict(enumerate(tasks)), 0
        while left:
            n_before = len(left)
            # One task that kills its worker takes those beside it along: after a round in vain they go one by one.
            chosen = list(left) if not in_vain else [list(left)[(in_vain - 1) % n_before]]
            reason: BaseException | None = None
            others = set(multiprocessing.active_children())
            executor = self._start()
            try:
                futures: dict[Future[_T], int] = {}
                try:
                    with _interrupts_held():  # processes start here
                        for number in chosen:
                            futures[executor.submit(partial(guarded, function), *left[number])] = number
                except self._lost as e:
                    reason = e
                for future in as_completed(futures):
                    try:
                        result = future.result()
                    except self._lost as e:
                        reason = e
                        continue
                    del left[futures[future]]
                    yield futures[future], result
            except BaseException:
                for future in futures:
                    future.cancel()
                if self._can_restart:
                    executor.shutdown(wait=False, cancel_futures=True)
                    for process in set(multiprocessing.active_children()) - others:
                        process.terminate()  # or the program would wait for what it has no use for
                raise
            if self._can_restart:
                executor.shutdown()
            in_vain = in_vain + 1 if len(left) == n_before else 0
            if reason is not None and (in_vain == _ROUNDS or not self._can_restart):
                guard = "" if len(left) < len(tasks) else " (a script that asks for workers needs if __name__ == '__main__':)"
                raise WorkersLostError(
                    f"{self._what} was lost ({_name_of(reason)}) with {len(left)} of {len(tasks)} tasks left; give "
                    f"workers more memory or take fewer, and start the same command again; a render goes on from there{guard}"
                ) from reason


def _name_of(reason: BaseException) -> str:
    return str(reason) if isinstance(reason, WorkerEndedError) else type(reason).__name__


def guarded(function: Callable[..., _T], *arguments: Any) -> _T:
    """Return what a function returns, in a worker; its exception becomes one that arrives.

    ``SystemExit`` and ``KeyboardInterrupt`` would end the program that asked, without a word. An exception that can be pickled
    and not made again breaks a pool of processes, which then looks as if its workers had been killed.
    """
    try:
        return function(*arguments)
    except (SystemExit, KeyboardInterrupt) as e:
        raise WorkerEndedError(type(e).__name__) from e
    except Exception as e:
        try:
            pickle.loads(pickle.dumps(e))
        except Exception:
            kind = next((each for each in (NptraceError, MemoryError) if isinstance(e, each)), None)
            raise (RuntimeError(f"{type(e).__name__}: {e}") if kind is None else kind(str(e))) from e
        raise


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C back: processes that start meanwhile hold it too until they have taken their stand to it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def processes(n: int) -> Engine:
    """Return ``n`` processes of this machine; those that are killed are replaced."""
    if n < 1:
        raise NptraceError(f"workers must be at least 1, got {n}; leave it out to work in this process")
    _begin_tracker()
    # Not forked: Numba's and Arrow's threads do not survive it.
    context = multiprocessing.get_context("spawn")
    return Engine(lambda: ProcessPoolExecutor(n, context, _begin_worker), "a worker process", can_restart=True, n_workers=n)


def _begin_tracker() -> None:
    """Start the process that frees semaphores after one that ended at once, as Ctrl-C ends it, without a warning of that."""
    from multiprocessing import resource_tracker

    usual = os.environ.get("PYTHONWARNINGS")
    os.environ["PYTHONWARNINGS"] = ",".join(filter(None, [usual, "ignore:resource_tracker:UserWarning"]))
    try:
        resource_tracker.ensure_running()
    finally:
        if usual is None:
            del os.environ["PYTHONWARNINGS"]
        else:
            os.environ["PYTHONWARNINGS"] = usual


def _begin_worker() -> None:
    """Leave Ctrl-C to the process that started this one, and end with it, however it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    parent = multiprocessing.parent_process()

    def wait() -> None:
        if parent is not None:
            parent.join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


@contextmanager
def engine_of(workers: int | Executor = 0, scheduler: str | None = None) -> Iterator[Engine | None]:
    """Yield the engine that options ask for: None for 0 workers, processes, an executor, or a Dask scheduler's workers.

    Raises
    ------
    NptraceError
        Both are given, the extra ``cluster`` is not installed, the scheduler does not answer, or lacks this program.
    """
    if scheduler is not None:
        if workers:
            raise NptraceError("--workers are processes of this machine, and --scheduler has its own; leave one out")
        with _dask(scheduler) as engine:
            yield engine
    elif isinstance(workers, Executor):
        yield Engine(lambda: workers, "a worker of the executor", can_restart=False)
    else:
        yield processes(workers) if workers else None


@contextmanager
def _dask(address: str) -> Iterator[Engine]:
    try:
        from distributed import Client
        from distributed.comm import get_address_host
        from distributed.comm.core import CommClosedError
        from distributed.scheduler import KilledWorker
    except ImportError as e:
        raise NptraceError(f"--scheduler needs Dask ({e}); install it with pip install 'nptrace[cluster]'") from e
    try:
        get_address_host(address)  # a client of an address that is none tries to close for 20 s when it is deleted
        client: Any = Client(address, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as e:
        reason = (str(e) or type(e).__name__).splitlines()[0]
        raise NptraceError(f"there is no Dask scheduler at {address} ({reason}); start one with `dask scheduler`") from e
    lost = (CommClosedError, KilledWorker, CancelledError)
    try:
        _check_installed(client, address)
        yield Engine(lambda: client.get_executor(pure=False), "a worker of the cluster", can_restart=False, lost=lost)
    finally:
        client.close(timeout=5)


def _check_installed(client: Any, address: str) -> None:
    """Refuse a cluster whose scheduler or workers cannot import this program, for which Dask would wait without a word."""
    for where, ask in (("the scheduler", client.run_on_scheduler), ("a worker of the scheduler", client.run)):
        try:
            ask(guarded, int)
        except Exception as e:  # as it was raised there
            reason = (str(e) or type(e).__name__).splitlines()[0]
            way_out = "install it there, in the same version"
            raise NptraceError(f"{where} at {address} cannot run nptrace ({reason}); {way_out}") from e
