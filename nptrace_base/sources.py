"""A source file -> a digest of all that it depends on: its text and every module of ours that it imports, directly or not.

What is kept between runs (compiled kernels, trees) is named by such digests, so that it cannot outlive what made it: a
constant of another module counts, a module that is not imported does not.
"""

import ast
import hashlib
import re
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

#: The folder with all of our packages and modules.
ROOT = Path(__file__).resolve().parent.parent

#: What is ours of it: an installed program lies among everybody's packages.
OURS = ("nptrace", "nptrace_base", "traces", "rtrace", "cachesim", "cli")

#: A statement that imports. Parsing whole files took ten times as long, and every command waits for it.
_IMPORT = re.compile(r"^[ \t]*(?:from|import)[ \t](?:[^\n\\(]|\\\n|\([^)]*\))*", re.MULTILINE)

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
    found: set[Path] = set()
    todo = list(paths)
    while todo:
        path = todo.pop()
        if path not in found:
            found.add(path)
            todo += _imported(path)
    return found


@cache
def _imported(path: Path) -> tuple[Path, ...]:
    """Return our files that a file imports anywhere in it, also inside functions, or finds by listing its own folder."""
    listed = sorted(path.parent.glob("*.py")) if _LISTING.search(path.read_text(encoding="utf-8")) else []
    return tuple(file for name in _names(path) for file in _files(name)) + tuple(listed)


def _names(path: Path) -> Iterator[str]:
    """Yield what a file imports as dotted names; of ``from a import b`` both ``a`` and ``a.b``, which may be a module."""
    package = path.relative_to(ROOT).parent.parts
    for statement in _IMPORT.findall(path.read_text(encoding="utf-8")):
        try:
            (node,) = ast.parse(statement.strip()).body
        except SyntaxError:  # a sentence of a docstring
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            start = package[: len(package) - node.level + 1] if node.level else ()
            base = ".".join((*start, *filter(None, [node.module])))
            yield base
            yield from (f"{base}.{alias.name}" for alias in node.names)


@cache
def _files(name: str) -> list[Path]:
    """Return the files of ours that importing a dotted name runs: the packages on the way, and the module."""
    parts = name.split(".")
    if parts[0] not in OURS:
        return []
    packages = [ROOT.joinpath(*parts[:n], "__init__.py") for n in range(1, len(parts) + 1)]
    return [file for file in (*packages, ROOT.joinpath(*parts).with_suffix(".py")) if file.is_file()]
