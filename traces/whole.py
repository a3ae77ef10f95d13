"""Files that are whole or not there, whoever kills their writer: a temporary name beside the file, renamed when complete."""

import glob
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary name, with the ending of ``path``, that becomes ``path`` unless something is raised.

    Two writers at once do not meet: the later rename wins. What killed writers of the same file left is deleted.
    """
    path = Path(path)
    _sweep(path)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}-{secrets.token_hex(4)}.tmp{path.suffix}")
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def _sweep(path: Path) -> None:
    head, tail = f".{path.stem}.", f".tmp{path.suffix}"
    for left in path.parent.glob(f"{glob.escape(head)}*-*{glob.escape(tail)}"):
        pid = left.name[len(head) :].partition("-")[0]
        if pid.isdigit() and not is_alive(int(pid)):
            with suppress(OSError):
                left.unlink()


def is_alive(pid: int) -> bool:
    """Return whether a process may still run; True where that cannot be known."""
    if os.name != "posix" or pid == os.getpid():
        return True
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        pass
    return True
