"""The one Numba decorator of the project, with a compile cache that cannot be stale.

Numba's own cache looks only at the file that holds a kernel: a kernel that calls another module keeps running the old
code after that module changed. So the cache folder is named by a hash of every file that holds a kernel, and of the
versions that compile it. A changed source is another folder.
"""

import hashlib
import os
import sys
import tempfile
from collections.abc import Callable
from functools import partial, wraps
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numba
import numpy as np
from numba.core import event
from numba.extending import intrinsic
from platformdirs import user_cache_path

import compiling

_HERE = Path(__file__).parent
_PACKAGES = ("rtrace", "traces", "cachesim")
_KEPT_FOLDERS = 4  # compiled sets of earlier sources; older ones are deleted


def kernel_digest() -> str:
    """Hash of every source file with a kernel, of Python, NumPy and Numba, and of the bounds-check setting."""
    digest = hashlib.sha256(Path(__file__).read_bytes())
    for version in (sys.version, np.__version__, numba.__version__, os.environ.get("NUMBA_BOUNDSCHECK", "")):
        digest.update(version.encode() + b"\0")
    for path in sorted(p for package in _PACKAGES for p in _HERE.glob(f"{package}/*.py")):
        source = path.read_bytes()
        if b"from jit import" in source or b"from numba" in source:
            digest.update(path.name.encode() + b"\0" + source)
    return digest.hexdigest()[:16]


def _cache_folder() -> Path:
    """Return a writable folder for these sources' kernels: in $NUMBA_CACHE_DIR, the user's cache, or a temporary one."""
    root = os.environ.get("NUMBA_CACHE_DIR")
    candidates = [Path(root)] if root else [user_cache_path("nptrace") / "kernels"]
    candidates.append(Path(tempfile.gettempdir()) / f"nptrace-kernels-{os.getuid() if hasattr(os, 'getuid') else 'user'}")
    for candidate in candidates:
        folder = candidate / kernel_digest()
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                pass
        except OSError:
            continue
        return folder
    return Path(tempfile.mkdtemp(prefix="nptrace-kernels-"))


def _forget_old(folder: Path) -> None:
    """Delete the compiled sets of earlier sources, except the newest few."""
    import shutil

    os.utime(folder)
    others = [p for p in folder.parent.iterdir() if p.is_dir() and len(p.name) == len(folder.name) and p != folder]
    for old in sorted(others, key=lambda p: p.stat().st_mtime, reverse=True)[_KEPT_FOLDERS - 1 :]:
        shutil.rmtree(old, ignore_errors=True)


# LLVM's loop strength reduction keeps a pointer into every array and moves them all in every turn of a loop: with it, tracing
# cost a BVH's traversal 10 % instead of 6. An LLVM that does not know the option ignores it.
llvm.set_option("nptrace", "-disable-lsr")

CACHE_FOLDER = _cache_folder()
_forget_old(CACHE_FOLDER)
numba.config.CACHE_DIR = str(CACHE_FOLDER)  # type: ignore[attr-defined]


class _Noticed(event.Listener):
    """Tells ``compiling`` of every kernel that is compiled; one that is loaded from the cache makes no such event."""

    def on_start(self, event: event.Event) -> None:
        compiling.started(CACHE_FOLDER)

    def on_end(self, event: event.Event) -> None:
        pass


event.register("numba:compile", _Noticed())


def _in_python(function: Callable[..., Any] | None = None, **options: Any) -> Callable[..., Any]:
    """Return a kernel that is not compiled: NumPy's scalars warn where a processor wraps around, or divides by zero."""
    if function is None:
        return _in_python

    @wraps(function)
    def run(*args: Any) -> Any:
        with np.errstate(all="ignore"):
            return function(*args)

    return run


def _as_written(twin: Callable[..., Any]) -> Callable[[Any], Any]:
    return (lambda function: twin) if IS_PLAIN else intrinsic


#: Whether nothing is compiled: NUMBA_DISABLE_JIT=1, a hundred times as slow, with the same results.
IS_PLAIN: bool = bool(numba.config.DISABLE_JIT)  # type: ignore[attr-defined]

#: Decorator of every kernel: compiled once per source, releases the GIL, divides by zero as IEEE 754 does, no fastmath
#: (so no fused multiply-add: the counts are the same on every machine).
kernel: Any = _in_python if IS_PLAIN else partial(numba.njit, cache=True, nogil=True, error_model="numpy")

#: Decorator of a small function that only kernels call: pasted into them, without counting references to its arrays.
inlined: Any = _in_python if IS_PLAIN else partial(kernel, _nrt=False, forceinline=True)

#: ``instructions(twin)``: decorator of a function written in LLVM's own instructions (``numba.extending.intrinsic``); ``twin``
#: is the same in Python, for when nothing is compiled.
instructions: Any = _as_written
