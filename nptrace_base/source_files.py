"""A source file -> a digest of all that it depends on: its text and every module of ours that it imports, directly or not.

What is kept between runs (compiled kernels, trees) is named by such digests, so that it cannot outlive what made it: a
constant of another module counts, a module that is not imported does not.
"""

import hashlib
import os
import re
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

#: The folder with all of our packages and modules.
ROOT = Path(__file__).resolve().parent.parent

#: What is ours of it: an installed program lies among everybody's packages.
OURS = ("nptrace", "nptrace_base", "traces", "rtrace", "cachesim", "cli")

#: A statement that imports something of ours: the module, and what of it. Every command waits for these lines: parsing whole
#: files takes ten times as long, and a path object for each name doubles it.
_IMPORT = re.compile(
    rf"^[ \t]*(?:import|from)[ \t]+((?:{'|'.join(OURS)})\b[.\w]*)"
    r"(?:[ \t]+import[ \t]+(\([^)]*\)|(?:[^\n\\]|\\\n)*))?",
    re.MULTILINE,
)
_COMMENT = re.compile("#.*")

#: How a package imports each file of its folder, so that adding one is adding a file.
_LISTING = re.compile(r"Path\(__file__\)\.parent\.glob\(")


def digest_of(paths: Iterable[Path]) -> str:
    """Return the sha256, in hexadecimal, of the given source files and of all they import."""
    digest = hashlib.sha256()
    for path in sorted(closure(paths)):
        digest.update(f"{path.relative_to(ROOT)}\0".encode() + path.read_bytes() + b"\0")
    return digest.hexdigest()


def closure(paths: Iterable[Path]) -> set[Path]:
    """Return the given source files and all of ours that they import, directly or through others."""
    found: set[str] = set()
    todo = [str(path) for path in paths]
    while todo:
        path = todo.pop()
        if path not in found:
            found.add(path)
            todo += _imported(path)
    return {Path(path) for path in found}


@cache
def _imported(path: str) -> tuple[str, ...]:
    """Return our files that a file imports anywhere in it, also inside functions, or finds by listing its own folder."""
    text = Path(path).read_text(encoding="utf-8")
    listed = sorted(map(str, Path(path).parent.glob("*.py"))) if _LISTING.search(text) else []
    return tuple(file for name in _names(text) for file in _files(name)) + tuple(listed)


def _names(text: str) -> Iterator[str]:
    """Yield what of ours a source imports as dotted names; of ``from a import b`` both ``a`` and ``a.b``, perhaps a module."""
    for base, names in _IMPORT.findall(text):
        yield base
        if names:
            words = _COMMENT.sub("", names).replace("\\", "").strip("()").split(",")
            yield from (f"{base}.{word.split()[0]}" for word in words if word.strip())


@cache
def _files(name: str) -> list[str]:
    """Return the files of ours that importing a dotted name runs: the packages on the way, and the module."""
    place, found = str(ROOT), []
    for part in name.split("."):
        place = f"{place}/{part}"
        if os.path.isfile(f"{place}/__init__.py"):
            found.append(f"{place}/__init__.py")
        elif os.path.isfile(f"{place}.py"):
            return [*found, f"{place}.py"]  # what follows is a name in the module
    return found
