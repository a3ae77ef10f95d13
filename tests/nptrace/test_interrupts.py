"""Ctrl-C in every command: exit status 130, promptly, silently, without incomplete files."""

import os
import pty
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import cli
from nptrace_base.pools import thread_pool
from rtrace.scenes.shapes import soup
from traces.din import RECORD

ROOT = Path(cli.__file__).resolve().parent

# Commands that are at work for long.
BUSY = {
    "render": ("nptrace", ["render", "soup.obj", "--accel", "bvh", "--pixels", "8000x8000"]),
    "check": ("nptrace", ["check", "soup.obj", "--pixels", "3000x3000"]),
    "replay": (
        "npcache",
        ["replay", "big.din", "--policy", "random,fifo", "--size", "1K,2K,4K,8K,16K,32K", "--assoc", "1,2,4"],
    ),
    "sweep": ("npcache", ["sweep", "big.din", "--ways", "1..64", "-o", "x.csv"]),
    "estimate": (
        "npcache",
        ["estimate", "soup.obj", "--pixels", "8000x8000", "--accel", "bvh", "--exact-below", "0", "--resume", "kept"],
    ),
}


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("inputs")
    lines = ["v {} {} {}".format(*map(float, corner)) for corner in soup(3000, seed=1).reshape(-1, 3)]
    lines += [f"f {3 * i + 1} {3 * i + 2} {3 * i + 3}" for i in range(3000)]
    (folder / "soup.obj").write_text("\n".join(lines))
    records = np.zeros(8_000_000, RECORD)
    records["address"], records["size"] = np.arange(records.size) * 7919 % 99991 * 32, 4
    records.tofile(folder / "big.din")
    return folder


@pytest.fixture
def folder(tmp_path, inputs):
    for path in inputs.iterdir():
        (tmp_path / path.name).symlink_to(path)
    return tmp_path


def start(folder, program, args, *, handler=signal.default_int_handler, environment=None, **options):
    """Start a command in a group of its own with signals as a terminal gives them, whatever pytest inherited."""
    return subprocess.Popen(
        [sys.executable, "-c", f"import cli; print('ready', flush=True); cli.{program}()", *args], cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), **(environment or {})}, start_new_session=True, text=True,
        stdout=subprocess.PIPE, preexec_fn=lambda: signal.signal(signal.SIGINT, handler), **options,
    )  # fmt: skip


def interrupt(process, wait):
    """Send Ctrl-C to the whole group, as a terminal does, some time after the program began; return status, output, errors."""
    assert process.stdout.readline() == "ready\n"
    time.sleep(wait)
    assert process.poll() is None, "it was done before it could be interrupted"
    os.killpg(process.pid, signal.SIGINT)
    printed, errors = process.communicate(timeout=60)
    lines = (errors or "").splitlines()
    return process.returncode, printed, [x for x in lines if "float32" not in x and not x.startswith("compiling")]


@pytest.mark.parametrize("name", BUSY)
@pytest.mark.parametrize("wait", [0.3, 2.5])
def test_a_command_ends_quietly_and_leaves_nothing(folder, name, wait):
    program, args = BUSY[name]
    before = sorted(p.name for p in folder.iterdir())
    process = start(folder, program, args, stderr=subprocess.PIPE)
    assert interrupt(process, wait) == (130, "", [])
    left = sorted(p.name for p in folder.rglob("*") if p.name not in ("traces", "kept"))
    assert left == before


@pytest.mark.parametrize("wait", [0.3, 1.0, 1.4, 3.0])
def test_workers_end_quietly_with_the_program(folder, wait):
    """Also those that are about to start."""
    args = ["render", "soup.obj", "--accel", "bvh", "--pixels", "8000x8000", "--workers", "2"]
    process = start(folder, "nptrace", args, stderr=subprocess.PIPE)
    assert interrupt(process, wait) == (130, "", [])


SWALLOWS = """
import time
from nptrace.groups import Interrupt

class Slow:
    def __del__(self):
        time.sleep(0.4)

def work():
    for _ in range(2):
        slow = Slow()
        del slow
        try:
            time.sleep(0.4)
        except BaseException:
            pass

interrupt = Interrupt()
print("ready", flush=True)
try:
    work()
    time.sleep(20)
finally:
    time.sleep(0.5)
    print("cleaned up")
"""


@pytest.mark.parametrize("wait", [0.2, 0.6])
def test_an_interrupt_that_is_swallowed_comes_again(tmp_path, wait):
    """In a destructor, whose exceptions Python drops, and in a bare ``except``; what cleans up is not disturbed."""
    process = subprocess.Popen(
        [sys.executable, "-c", SWALLOWS], env={**os.environ, "PYTHONPATH": str(ROOT)}, start_new_session=True, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    began = time.monotonic()
    assert interrupt(process, wait) == (130, "cleaned up\n", [])
    assert time.monotonic() - began < 15


def environment_of(pid):
    try:
        return Path("/proc", pid, "environ").read_bytes()
    except OSError:
        return b""


def test_compiling_ends_quietly_with_its_processes(tmp_path):
    kept = {"NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
    process = start(tmp_path, "nptrace", ["compile"], stderr=subprocess.PIPE, environment=kept)
    assert interrupt(process, 5) == (130, "", [])
    time.sleep(0.5)
    assert not any(str(tmp_path).encode() in environment_of(pid) for pid in filter(str.isdigit, os.listdir("/proc")))
    assert [p for p in tmp_path.rglob("*") if ".tmp" in p.name] == []


def test_a_progress_bar_is_taken_away(folder):
    """On a terminal. The cursor, which the bar hides, is there again."""
    master, slave = pty.openpty()
    process = start(folder, *BUSY["render"], stderr=slave, environment={"TERM": "xterm"})
    os.close(slave)
    shown = b""
    while b"trace" not in shown:
        shown += os.read(master, 65536)
    interrupt(process, 0)
    try:
        while piece := os.read(master, 65536):
            shown += piece
    except OSError:  # the other end is closed
        pass
    os.close(master)
    assert process.returncode == 130
    assert b"Traceback" not in shown and b"Abort" not in shown
    assert shown.rfind(b"\x1b[?25h") > shown.rfind(b"\x1b[?25l") > 0


def test_an_ignored_signal_stays_ignored(folder):
    """Behind nohup or in the background of a script Ctrl-C is not meant for the command."""
    args = ["render", "soup.obj", "--accel", "bvh", "--pixels", "400x400"]
    process = start(folder, "nptrace", args, handler=signal.SIG_IGN, stderr=subprocess.PIPE)
    interrupt(process, 0.5)
    assert process.returncode == 0
    assert os.listdir(folder / "traces") == ["soup-bvh-400x400"]


def test_who_is_interrupted_does_not_wait_for_threads():
    done = threading.Event()
    with pytest.raises(SystemExit), thread_pool(1) as pool:
        pool.submit(done.wait, 20)
        pool.submit(pytest.fail)
        began = time.monotonic()
        raise SystemExit
    assert time.monotonic() - began < 10
    done.set()
    finished = []
    with pytest.raises(ZeroDivisionError), thread_pool(1) as pool:
        pool.submit(lambda: (time.sleep(0.2), finished.append(1)))
        time.sleep(0.05)
        raise ZeroDivisionError
    assert finished == [1]
