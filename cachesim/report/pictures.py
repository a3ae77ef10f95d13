"""Pictures: which files one can be drawn into, which a command asks before its work, and the style that all of them have."""

import importlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from nptrace_base.atomic import is_special, whole_file
from nptrace_base.errors import NptraceError

#: The formats of a plot, by the ending of a name.
PICTURES = (".png", ".svg", ".pdf")

#: Colours that people with any colour vision tell apart (Okabe and Ito 2008), those that print dark first.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#000000", "#999933")
#: Colour maps: of counts, even to the eye and in grey; of differences, with white for none.
SEQUENTIAL, DIVERGING = "viridis", "RdBu_r"

_STYLE: Any = {
    "svg.hashsalt": "npcache", "svg.fonttype": "none", "pdf.fonttype": 42, "font.size": 9, "axes.titlesize": 9,
    "axes.labelsize": 9, "xtick.labelsize": 8, "ytick.labelsize": 8, "legend.fontsize": 8, "legend.title_fontsize": 8,
    "axes.spines.top": False, "axes.spines.right": False, "axes.axisbelow": True,
}  # fmt: skip


def ending_of(path: Path, endings: Sequence[str]) -> str:
    """Return the ending that chooses the format; the first one for standard output and the like, whose names have none.

    Raises NptraceError for a file of another ending.
    """
    if path.suffix.lower() in endings:
        return path.suffix.lower()
    if is_special(path):
        return endings[0]
    raise NptraceError(f"cannot write {path}: its name must end in {' or '.join(sorted(endings))}")


def check_plot(path: Path) -> None:
    """Raise NptraceError if a plot cannot be drawn into a file: its ending is unknown, or matplotlib is missing."""
    ending_of(path, PICTURES)
    check_packages("a plot", {"matplotlib": "matplotlib"})


def check_packages(what: str, packages: Mapping[str, str]) -> None:
    """Raise NptraceError, with the way out, if modules that something needs are missing: names of packages by module."""
    lost = [package for module, package in packages.items() if not _is_there(module)]
    if lost:
        are = "is" if len(lost) == 1 else "are"
        raise NptraceError(
            f"{what} needs {' and '.join(lost)}, which {are} not installed; run: pip install {' '.join(lost)}, or "
            f"uv tool install {' '.join(f'--with {name}' for name in lost)} nptrace, or pipx inject nptrace {' '.join(lost)}"
        )


def _is_there(module: str) -> bool:
    try:
        importlib.import_module(module)
    except ImportError:
        return False
    return True


@contextmanager
def drawn(path: Path, width: float, height: float, *, dpi: int = 200, layout: Any = "constrained") -> Iterator[Any]:
    """Yield a matplotlib Figure of some inches, and write it to a file, in the format of its ending, unless something fails.

    No file has a time stamp: the same numbers give the same bytes.
    """
    check_plot(path)
    ending = ending_of(path, PICTURES)
    with whole_file(path) as temporary:
        from matplotlib import rc_context
        from matplotlib.figure import Figure

        with rc_context(_STYLE):
            figure = Figure(figsize=(width, height), layout=layout, dpi=dpi)
            yield figure
            stamps: dict[str, dict[str, None]] = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}
            figure.savefig(temporary, dpi=dpi, metadata=stamps.get(ending), format=ending[1:])
