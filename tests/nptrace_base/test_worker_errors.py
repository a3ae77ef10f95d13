"""An error of a worker, of any kind, reaches the process that asked: as itself, as one sentence, or as a bug's traceback."""

import os
import signal
import time

import pytest

from nptrace_base.engines import Engine, WorkersLostError, engine_of, guarded, processes
from nptrace_base.errors import NptraceError


class Odd(Exception):
    """It can be pickled, and not made again."""

    def __init__(self, value, rule):
        super().__init__(f"{value} breaks {rule}")


class OddSentence(Odd, NptraceError):
    """The same of an error that is a sentence."""


class OddMemory(Odd, MemoryError):
    """The same of a lack of memory."""


class Locked(Exception):
    """It cannot be pickled at all."""

    def __init__(self, text):
        super().__init__(text)
        self.lines = (line for line in text)


def end(kind):
    """End a task in some way, or work for a long time beside one that ends."""
    if kind == "works":
        time.sleep(600)
    if kind == "_exit":
        os._exit(7)
    if kind == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    raise {
        "bug": ValueError("no"), "sentence": NptraceError("value, rule, way out"), "memory": MemoryError("9 GB"),
        "file": FileNotFoundError(2, "No such file or directory", "x"), "exit": SystemExit(3),
        "interrupt": KeyboardInterrupt(), "odd": Odd(1, "a rule"), "odd sentence": OddSentence(1, "a rule"),
        "odd memory": OddMemory(1, "a rule"), "locked": Locked("no"),
    }[kind]  # fmt: skip


ARRIVES = {
    "bug": (ValueError, "^no$"), "sentence": (NptraceError, "^value, rule, way out$"), "memory": (MemoryError, "^9 GB$"),
    "file": (FileNotFoundError, "No such file or directory: 'x'"), "odd": (RuntimeError, "^Odd: 1 breaks a rule$"),
    "odd sentence": (NptraceError, "^1 breaks a rule$"), "odd memory": (MemoryError, "^1 breaks a rule$"),
    "locked": (RuntimeError, "^Locked: no$"),
}  # fmt: skip


@pytest.mark.parametrize("kind", ARRIVES)
def test_an_exception_arrives(kind):
    type_, text = ARRIVES[kind]
    with pytest.raises(type_, match=text) as caught:
        guarded(end, kind)
    assert caught.type is type_


@pytest.mark.slow
def test_it_does_so_from_a_process_and_waits_for_nobody():
    began = time.monotonic()
    with pytest.raises(RuntimeError, match="^Odd: 1 breaks a rule$"):
        list(processes(2).results(end, [("works",), ("odd",)]))
    assert time.monotonic() - began < 60


@pytest.mark.parametrize(("kind", "name"), [("exit", "SystemExit"), ("interrupt", "KeyboardInterrupt")])
def test_what_ends_a_worker_does_not_end_the_program(kind, name):
    from concurrent.futures import ThreadPoolExecutor

    with (
        ThreadPoolExecutor(1) as pool,
        engine_of(pool) as engine,
        pytest.raises(WorkersLostError, match=f"a worker of the executor was lost \\({name}\\) with 1 of 1 tasks left"),
    ):
        list(engine.results(end, [(kind,)]))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["_exit", "killed"])
def test_a_worker_that_always_ends_is_given_up(kind):
    with pytest.raises(WorkersLostError, match=r"a worker process was lost \(BrokenProcessPool\) with 1 of 1 tasks left"):
        list(processes(1).results(end, [(kind,)]))


def test_a_task_that_ended_its_worker_is_done_again():
    from concurrent.futures import ThreadPoolExecutor

    seen = []

    def now_and_then(x):
        seen.append(x)
        if len(seen) == 2:
            raise SystemExit
        return x

    engine = Engine(lambda: ThreadPoolExecutor(1), "a worker", can_restart=True)
    assert dict(engine.results(now_and_then, [(0,), (1,), (2,)])) == {0: 0, 1: 1, 2: 2}
    assert seen == [0, 1, 2, 1]
