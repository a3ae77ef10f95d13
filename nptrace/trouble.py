"""An error of the machine -> the sentence of a command, or of a function of ``import nptrace``."""

import errno

#: What a full disk says, whose error may not name a file: standard output has none.
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def trouble(error: OSError) -> str | None:
    """Return the sentence about a file that the machine refuses; None if the error is of no file, which is a bug."""
    if error.filename is None and error.errno not in _FULL:
        return None
    return f"{error.filename or 'standard output'}: {error.strerror}; name another file or folder"
