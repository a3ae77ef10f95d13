"""Which files a plot can be drawn into; a command asks before its work."""

import importlib
from collections.abc import Sequence
from pathlib import Path

from nptrace_base.atomic import is_special
from nptrace_base.errors import NptraceError

#: The formats of a plot, by the ending of a name.
PICTURES = (".png", ".svg", ".pdf")


def ending_of(path: Path, endings: Sequence[str]) -> str:
    """Return the ending that chooses the format; the first one for standard output and the like, whose names have none.

    Raises NptraceError for a file of another ending.
    """
    if path.suffix in endings:
        return path.suffix
    if is_special(path):
        return endings[0]
    raise NptraceError(f"cannot write {path}: its name must end in {' or '.join(sorted(endings))}")


def check_plot(path: Path) -> None:
    """Raise NptraceError if a plot cannot be drawn into a file: its ending is unknown, or matplotlib is missing."""
    ending_of(path, PICTURES)
    try:
        importlib.import_module("matplotlib")
    except ImportError:
        raise NptraceError(
            "a plot needs matplotlib, which is not installed; run: pip install matplotlib, or "
            "uv tool install --with matplotlib nptrace, or pipx inject nptrace matplotlib"
        ) from None
