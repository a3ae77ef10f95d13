"""The one writer of output files: atomic for plain files, even if the program is killed; copied at the end to others."""

import glob
import os
import re
import shutil
import stat
import sys
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import IO

from nptrace_base.errors import NptraceError

#: Seconds without a change after which what a process of another host writes counts as left behind. From here nobody can ask
#: whether that process still runs; clocks may differ by hours, and a large file may wait for its next piece as long.
PATIENCE = 7 * 24 * 3600

_WAY_OUT = "name another file"
#: What a temporary name says of its writer; earlier versions wrote neither its start nor its host.
_MARK = re.compile(r"(\d{1,9})-(?:([0-9a-f]{1,16})-([0-9a-f]{8})-)?[0-9a-f]+")


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path, with the ending of ``path``, whose content becomes that of ``path`` unless something is raised.

    A plain file is replaced in one step, under the permissions it had; a link leads to the file that is replaced. Concurrent
    writers do not disturb each other: the last rename wins. Temporary files of writers that are gone (``is_left``) are
    deleted. Into a FIFO, a device, an open file (/dev/stdout, /dev/fd/N) and ``-``, standard output, the whole content is
    copied at the end.

    Raises
    ------
    NptraceError
        The file cannot be written: it is a folder, its folder is missing or read-only, the disk is full.
    """
    path = Path(path)
    check_writable(path)
    real = Path(os.path.realpath(path))
    places = {path.parent, real.parent}
    try:
        with _straight(path) if is_special(path) else replacing(real) as temporary:
            places.add(temporary.parent)
            yield temporary
    except BrokenPipeError:
        raise  # the reader has closed the pipe; the command ends quietly
    except OSError as e:
        if e.filename is None or Path(os.fsdecode(e.filename)).parent in places:
            raise NptraceError(f"cannot write {path}: {e.strerror or e}; {_WAY_OUT}") from e
        raise  # not about this file


def check_writable(path: Path) -> None:
    """Raise NptraceError if ``whole_file`` could not write ``path``: for commands that work long before they write."""
    if str(path) == "-" or _descriptor(path) is not None:
        return
    real = Path(os.path.realpath(path))
    try:
        mode = real.stat().st_mode if os.path.lexists(real) else None
    except OSError as e:
        raise NptraceError(f"cannot write {path}: {e.strerror}; {_WAY_OUT}") from e
    reason = None
    if mode is not None and stat.S_ISDIR(mode):
        reason = "it is a folder"
    elif not real.parent.is_dir():
        reason = f"there is no folder {real.parent if path.is_symlink() else path.parent}"
    elif not (mode is None or _may_write(real)) or not (_may_write(real.parent) or is_special(path)):
        reason = "Permission denied"
    if reason:
        raise NptraceError(f"cannot write {path}: {reason}; {_WAY_OUT}")


def is_special(path: Path) -> bool:
    """Return whether a path is not that of a plain file, present or future: standard output, a FIFO, a device."""
    if str(path) == "-" or _descriptor(path) is not None:
        return True
    try:
        mode = os.stat(path).st_mode
    except OSError:
        return False
    return not stat.S_ISREG(mode) and not stat.S_ISDIR(mode)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside ``path``, a plain file's, to which it is renamed; for caches, which handle an OSError."""
    _delete_left(path)
    temporary = path.with_name(f".{path.stem}.{new_mark()}.tmp{path.suffix}")
    try:
        yield temporary
        with suppress(FileNotFoundError):
            temporary.chmod(stat.S_IMODE(path.stat().st_mode))
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def _straight(path: Path) -> Iterator[Path]:
    """Yield a temporary path elsewhere, whose content is copied into ``path``, which is opened now: its reader waits."""
    import tempfile  # with its random numbers, a tenth of what a command's help imports

    with _opened(path) as sink, tempfile.TemporaryDirectory() as folder:
        temporary = Path(folder) / f"whole{path.suffix}"
        yield temporary
        with open(temporary, "rb") as source:
            shutil.copyfileobj(source, sink, 1 << 20)
        sink.flush()


@contextmanager
def _opened(path: Path) -> Iterator[IO[bytes]]:
    descriptor = _descriptor(path)
    if str(path) == "-" or descriptor == 1:
        if sys.stdout is None:
            raise NptraceError(f"cannot write {path}: standard output is closed; {_WAY_OUT}")
        sys.stdout.flush()
    if str(path) == "-":
        yield sys.stdout.buffer
        return
    # Never created and never cut: what it is must not change between the check and the opening.
    with open(os.open(path, os.O_WRONLY) if descriptor is None else os.dup(descriptor), "wb") as sink:
        yield sink


def _descriptor(path: Path) -> int | None:
    """Return N of a path that leads to an open file of this process, such as /dev/fd/N or /dev/stdout."""
    for _ in range(40):  # links, as many as Linux follows
        folder = os.path.realpath(path.parent)
        if path.name.isdigit() and re.fullmatch(rf"/dev/fd|/proc/{os.getpid()}(/task/\d+)?/fd", folder):
            return int(path.name)
        if not path.is_symlink():
            return None
        path = path.parent / os.readlink(path)
    return None


def _may_write(path: Path) -> bool:
    return os.access(path, os.W_OK, effective_ids=os.access in os.supports_effective_ids)


def _delete_left(path: Path) -> None:
    head, tail = f".{path.stem}.", f".tmp{path.suffix}"
    for left in path.parent.glob(f"{glob.escape(head)}*-*{glob.escape(tail)}"):
        if is_left(left, left.name[len(head) : -len(tail)]):
            with suppress(OSError):
                left.unlink()


def new_mark() -> str:
    """Return what a temporary name says of its writer: process, its start and its host; and a number that no other has."""
    return f"{os.getpid()}-{_start_of(os.getpid()):x}-{_host()}-{os.urandom(4).hex()}"


def is_left(path: Path, mark: str) -> bool:
    """Return whether the writer of a temporary file or folder is gone; ``mark`` is what its name says of that.

    That is known of the processes of this host. A shared folder has others' files too, which count as left behind after
    ``PATIENCE``. A name that is none of ours is not.
    """
    found = _MARK.fullmatch(mark)
    if found is None:
        return False
    pid, start, host = found.groups()
    if host == _host():
        return not _runs(int(pid), int(start, 16))
    with suppress(OSError):  # its writer has just renamed it
        inside = path.iterdir() if path.is_dir() and not path.is_symlink() else ()
        written = max(os.lstat(each).st_mtime for each in (path, *inside))
        return time.time() - written > PATIENCE
    return False


@cache
def _host() -> str:
    """Return eight digits, the same for two processes if either can see whether the other runs: of one boot and container."""
    facts = [os.uname().nodename if hasattr(os, "uname") else os.environ.get("COMPUTERNAME", "")]
    with suppress(OSError):
        facts.append(Path("/proc/sys/kernel/random/boot_id").read_text())
        facts.append(os.readlink("/proc/self/ns/pid"))
    return f"{zlib.crc32(os.fsencode('|'.join(facts))):08x}"


def _runs(pid: int, start: int) -> bool:
    """Return whether the process that started then may still run; True where that cannot be known."""
    if os.name != "posix":
        return True
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        pass
    return _start_of(pid) in (start, 0)


def _start_of(pid: int) -> int:
    """Return when a process of this host started, in ticks since the boot; 0 where the system does not say."""
    try:
        return int(Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()[19])
    except (OSError, ValueError, IndexError):
        return 0
