"""Tasks on workers: results whatever is killed, one sentence where nothing is left to try."""

import os
import signal
import time
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest

from nptrace_base.engines import Engine, WorkersLostError, engine_of, processes
from nptrace_base.errors import NptraceError


class Flaky(Executor):
    """Runs tasks at once; ``kills`` says which tasks lose the pool, and with it all that follow."""

    def __init__(self, kills):
        self._kills, self._is_broken = kills, False

    def submit(self, function, *args):
        if self._is_broken and args[0] % 2:
            raise BrokenProcessPool("it was broken before")
        future = Future()
        self._is_broken = self._is_broken or self._kills(*args)
        if self._is_broken:
            future.set_exception(BrokenProcessPool("a process was terminated abruptly"))
        else:
            try:
                future.set_result(function(*args))
            except Exception as e:
                future.set_exception(e)
        return future


def square(x):
    return x * x


def results(kills, n=6):
    engine = Engine(lambda: Flaky(kills), "a worker process", can_restart=True)
    return dict(engine.results(square, [(x,) for x in range(n)]))


def test_tasks_of_a_lost_worker_are_done_again():
    seen = []

    def first_time(x):
        seen.append(x)
        return x == 3 and seen.count(3) == 1

    assert results(first_time) == {x: x * x for x in range(6)}
    assert seen.count(0) == 1  # what arrived counts


def test_one_task_that_kills_does_not_take_the_others_along():
    for bad in range(6):
        with pytest.raises(WorkersLostError, match=r"a worker process was lost \(BrokenProcessPool\) with 1 of 6 tasks left"):
            results(lambda x, bad=bad: x == bad)


def test_losses_count_only_in_a_row():
    """Workers that are lost now and then do not add up to an end, and after a loss all tasks run side by side again."""
    sizes = []

    class Now(Flaky):
        def submit(self, function, *args):
            sizes[-1] += 1
            return super().submit(function, *args)

    def start():
        sizes.append(0)
        is_lost = len(sizes) % 2 == 1 and len(sizes) < 11
        return Now(lambda x: is_lost)

    engine = Engine(start, "a worker process", can_restart=True)
    assert dict(engine.results(square, [(2 * x,) for x in range(10)])) == {x: 4 * x * x for x in range(10)}
    assert sizes == [10, 1, 9, 1, 8, 1, 7, 1, 6, 1, 5]


def test_results_that_came_before_the_end_are_given():
    engine = Engine(lambda: Flaky(lambda x: x == 2), "a worker process", can_restart=True)
    found = {}
    with pytest.raises(WorkersLostError):
        for number, result in engine.results(square, [(x,) for x in range(4)]):
            found[number] = result
    assert found == {0: 0, 1: 1, 3: 9}


def test_an_executor_of_ones_own_is_not_started_again_nor_ended():
    with ThreadPoolExecutor(2) as pool, engine_of(pool) as engine:
        assert dict(engine.results(square, [(2,), (3,)])) == {0: 4, 1: 9}
        assert dict(engine.results(square, [(4,)])) == {0: 16}
    with (
        engine_of(Flaky(lambda x: x == 1)) as engine,
        pytest.raises(WorkersLostError, match="a worker of the executor was lost .* with 2 of 3 tasks left"),
    ):
        list(engine.results(square, [(0,), (1,), (2,)]))


def test_an_error_of_a_task_is_its_own():
    def fails(x):
        if x:
            raise NptraceError(f"{x} is too large")
        return x

    with ThreadPoolExecutor(1) as pool, engine_of(pool) as engine, pytest.raises(NptraceError, match="^2 is too large$"):
        list(engine.results(fails, [(0,), (2,), (0,)]))


def test_no_workers_are_no_engine_and_two_kinds_are_refused():
    with engine_of() as engine:
        assert engine is None
    with pytest.raises(NptraceError, match="workers must be at least 1, got -1"), engine_of(-1):
        pass
    with pytest.raises(NptraceError, match="leave one out"), engine_of(2, "tcp://127.0.0.1:1"):
        pass


def sleeping(seconds):
    time.sleep(seconds)
    return os.getpid()


@pytest.mark.slow
def test_workers_end_with_the_process_that_started_them(tmp_path):
    """Also where it is killed, and cannot end them."""
    import subprocess
    import sys

    script = (
        "from pathlib import Path\nfrom nptrace_base.engines import processes\n"
        "from tests.nptrace_base.test_engines import sleeping\n"
        "if __name__ == '__main__':\n"
        "    results = processes(1).results(sleeping, [(0,), (600,)])\n"
        f"    Path({str(tmp_path / 'pid')!r}).write_text(str(next(results)[1]))\n"
        "    next(results)\n"
    )
    (tmp_path / "parent.py").write_text(script)
    environment = os.environ | {"PYTHONPATH": os.getcwd()}
    parent = subprocess.Popen([sys.executable, tmp_path / "parent.py"], env=environment, stderr=subprocess.PIPE)
    while not (tmp_path / "pid").exists() or not (tmp_path / "pid").read_text():
        time.sleep(0.1)
        assert parent.poll() is None
    worker = int((tmp_path / "pid").read_text())
    os.kill(worker, 0)
    parent.send_signal(signal.SIGKILL)
    assert parent.communicate()[1] == b""  # nor does anything that it started say something
    for _ in range(100):
        try:
            os.kill(worker, 0)
            if "(zombie)" in Path(f"/proc/{worker}/status").read_text():
                return
        except (ProcessLookupError, FileNotFoundError):
            return
        time.sleep(0.1)
    pytest.fail("the worker goes on")


def test_processes_give_results():
    assert sorted(processes(1).results(square, [(2,), (3,)])) == [(0, 4), (1, 9)]
