"""Folders whose content is trusted from one run to the next: only their user may write to them."""

import os
import stat
from contextlib import suppress
from pathlib import Path


def private_folder(folder: Path) -> None:
    """Make a folder that only its user may change, and those above it that are missing; raise OSError if it is not private.

    Compiled kernels are executable and read with pickle; anybody may have made a folder in the shared
    temporary directory. So a folder is refused if it belongs to another user, is a link, or is writable by others.
    """
    missing = [part for part in (folder, *folder.parents) if not os.path.lexists(part)]
    for part in reversed(missing):
        with suppress(FileExistsError):  # another process made it meanwhile; it is checked like any other
            part.mkdir(mode=0o700)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode):
        raise OSError("it is a link or not a folder")
    if os.name == "posix" and found.st_uid != os.geteuid():
        raise OSError("it belongs to another user")
    if os.name == "posix" and found.st_mode & 0o022:
        raise OSError("others may write to it, which `chmod go-w` forbids")
