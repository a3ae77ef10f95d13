"""Temporary files of writers that are gone are deleted; those of writers that run are not, in this host or another."""

import os
import subprocess
import sys
import time

import pytest

from nptrace_base import atomic
from nptrace_base.atomic import PATIENCE, is_left, new_mark, whole_file
from tests.reference.traces import make_footer
from traces.format import SPLIT
from traces.writer import RunWriter


@pytest.fixture(scope="module")
def gone():
    """The mark of a process that has ended."""
    code = "from nptrace_base.atomic import new_mark; print(new_mark())"
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


def elsewhere(mark):
    """The mark as another host would write it."""
    pid, start, host, number = mark.split("-")
    return "-".join([pid, start, f"{int(host, 16) ^ 1:08x}", number])


def aged(path, seconds):
    for each in (path, *(path.iterdir() if path.is_dir() else ())):
        os.utime(each, (time.time() - seconds,) * 2)


def test_a_mark_is_new_each_time_and_says_which_process_it_was():
    one, other = new_mark(), new_mark()
    assert one != other and one.rpartition("-")[0] == other.rpartition("-")[0]
    assert int(one.split("-")[0]) == os.getpid()


def written_over(folder, name, mark, age=0):
    """Write a file, and return whether a temporary file with this mark is deleted on the way."""
    left = folder / f".out.{mark}.tmp.csv" if name == "out.csv" else folder / f".{name}.{mark}.tmp"
    if name == "out.csv":
        left.write_text("half")
    else:
        left.mkdir(exist_ok=True)
        (left / "accesses.parquet").write_text("half")
    aged(left, age)
    if name == "out.csv":
        with whole_file(folder / name) as part:
            part.write_text("whole")
    else:
        with pytest.raises(ValueError, match="stop"), RunWriter(folder / name, make_footer(), SPLIT):
            raise ValueError("stop")
    return not left.exists()


@pytest.mark.parametrize("name", ["out.csv", "run"])
def test_who_is_gone_is_known_of_this_host_alone(tmp_path, name, gone):
    old = "12-0a0b0c0d"  # as earlier versions wrote it, on any host
    assert written_over(tmp_path, name, gone)
    assert not written_over(tmp_path, name, new_mark(), 99 * PATIENCE)
    for mark in (elsewhere(gone), elsewhere(new_mark()), old):
        assert not written_over(tmp_path, name, mark)
        assert not written_over(tmp_path, name, mark, PATIENCE - 3600)
        assert not written_over(tmp_path, name, mark, -PATIENCE)  # by a clock that is fast
        assert written_over(tmp_path, name, mark, PATIENCE + 3600)


def test_a_pid_that_another_process_has_now_is_no_sign_of_life():
    pid, start, host, number = new_mark().split("-")
    if start == "0":
        return  # a system that does not say when a process started
    earlier = "-".join([pid, f"{int(start, 16) - 1:x}", host, number])
    assert not is_left(atomic.Path("x"), new_mark()) and is_left(atomic.Path("x"), earlier)


def test_a_folder_is_as_young_as_its_newest_file(tmp_path, gone):
    folder = tmp_path / "x"
    folder.mkdir()
    (folder / "old").write_text("")
    aged(folder, 2 * PATIENCE)
    (folder / "new").write_text("")
    os.utime(folder, (1, 1))
    assert not is_left(folder, elsewhere(gone))


@pytest.mark.parametrize("mark", ["b.12-ab", "12", "12-", "-ab", "x-ab", "12-ab-cd", "12-ab-cd-ef", "9" * 40 + "-ab"])
def test_other_names_are_not_ours(tmp_path, mark):
    (tmp_path / "x").write_text("")
    aged(tmp_path / "x", 2 * PATIENCE)
    assert not is_left(tmp_path / "x", mark)
