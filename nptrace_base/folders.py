"""Folders whose content is trusted from one run to the next: nobody but their user may put something there."""

import os
import stat
from contextlib import suppress
from pathlib import Path


def private_folder(folder: Path) -> None:
    """Make a folder that only its user may change, and those above it that are missing; raise OSError if it is not such a one.

    Compiled kernels are executable and read with pickle; a folder in the shared temporary directory may have been made by
    anybody. So a folder is refused that belongs to another user, is a link, or may be written to by others.
    """
    missing = [part for part in (folder, *folder.parents) if not os.path.lexists(part)]
    for part in reversed(missing):
        with suppress(FileExistsError):  # somebody else made it meanwhile: it is looked at like any other
            part.mkdir(mode=0o700)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode):
        raise OSError("it is a link or no folder")
    if os.name == "posix" and found.st_uid != os.geteuid():
        raise OSError("it belongs to another user")
    if os.name == "posix" and found.st_mode & 0o022:
        raise OSError("others may write to it, which `chmod go-w` forbids")
