"""The project's Numba decorator, with a compile cache that is never stale, belongs to this user alone and stops no command.

Numba's own cache looks only at the file that holds a kernel: a kernel that calls another module keeps running the old
code after that module changed. So the cache folder is named by a digest of every file that holds a kernel, of all that these
import, constants included, and of the versions that compile it. A changed source is another folder.

Kernels are executable and unpickled, so they are kept only where nobody else may write. Without a usable folder, or with a
full one, kernels are compiled again each time. Importing this module touches no folder: the first kernel that is called does.
"""

import hashlib
import os
import pickle
import re
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial, wraps
from glob import escape
from pathlib import Path
from typing import Any, ClassVar

import llvmlite
import llvmlite.binding as llvm
import numba
import numpy as np
from numba.core import event
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.runtime import rtsys
from numba.core.serialize import dumps
from numba.extending import intrinsic
from platformdirs import user_cache_path

from nptrace_base import compiling
from nptrace_base.atomic import replacing
from nptrace_base.folders import private_folder
from nptrace_base.source_files import ROOT, digest_of

_PACKAGES = ("rtrace", "traces", "cachesim")
_KEPT_FOLDERS = 4  # compiled sets of earlier sources; older ones are deleted


def kernel_digest() -> str:
    """Hash of every source file with a kernel and all that these import, of the versions, and of the bounds-check setting."""
    sources = [path for package in _PACKAGES for path in ROOT.glob(f"{package}/**/*.py")]
    kernels = [path for path in sources if b"from nptrace_base.jit import" in path.read_bytes()]
    digest = hashlib.sha256(digest_of(kernels).encode())
    digest.update(versions().encode())
    return digest.hexdigest()[:16]


def versions() -> str:
    """Return the versions of all that compiles kernels, and the bounds-check setting; Numba looks at the processor itself."""
    checks = os.environ.get("NUMBA_BOUNDSCHECK", "")
    return "\0".join([sys.version, np.__version__, numba.__version__, llvmlite.__version__, checks])


@cache
def cache_folder() -> Path | None:
    """Return a writable folder for these sources' kernels: in $NUMBA_CACHE_DIR, the user's cache, or a temporary one.

    None if no folder is writable by this user alone; then kernels are not stored.
    """
    root = os.environ.get("NUMBA_CACHE_DIR")
    candidates = [Path(root)] if root else [user_cache_path("nptrace") / "kernels"]
    with suppress(OSError):  # there may be no temporary folder
        candidates.append(Path(tempfile.gettempdir()) / f"nptrace-kernels-{os.geteuid() if os.name == 'posix' else 'user'}")
    errors: dict[Path, Exception] = {}
    for candidate in candidates:
        folder = candidate / kernel_digest()
        try:
            private_folder(candidate)
            private_folder(folder)
            with tempfile.TemporaryFile(dir=folder):
                pass
        except OSError as e:
            errors[candidate] = e
            continue
        _forget_old(folder)
        return folder
    compiling.not_kept("kernels", errors)
    return None


def _forget_old(folder: Path) -> None:
    """Delete the compiled sets of earlier sources, except the newest few."""
    import shutil

    with suppress(OSError):
        os.utime(folder)
        others = [p for p in folder.parent.iterdir() if re.fullmatch("[0-9a-f]{16}", p.name) and p != folder]
        for old in sorted(others, key=lambda p: p.lstat().st_mtime, reverse=True)[_KEPT_FOLDERS - 1 :]:
            shutil.rmtree(old, ignore_errors=True)


@cache
def _prepare() -> None:
    """Set up LLVM and the notice of compiling, before the first kernel is compiled."""
    # LLVM's loop strength reduction keeps a pointer into every array and moves them all in every turn of a loop: with it,
    # tracing cost a BVH's traversal 10 % instead of 6. An LLVM that does not know the option ignores it.
    llvm.set_option("nptrace", "-disable-lsr")
    event.register("numba:compile", _Noticed())


class _Noticed(event.Listener):
    """Tells ``compiling`` about every kernel that is compiled; loading one from the cache makes no event."""

    def on_start(self, event: event.Event) -> None:
        compiling.started(cache_folder())

    def on_end(self, event: event.Event) -> None:
        compiling.ended()


class _Place:
    """Where Numba keeps the kernels of one source file: in our folder, whatever Numba's settings are."""

    def __init__(self, function: Callable[..., Any], file: str, folder: Path) -> None:
        self._file, self._line = Path(file), function.__code__.co_firstlineno
        # Other files may have the same names; ours are the same in every environment that has this digest.
        parent = self._file.relative_to(ROOT).parent if self._file.is_relative_to(ROOT) else self._file.parent
        where = hashlib.sha256(os.fsencode(parent)).hexdigest()[:16]
        self._folder = folder / f"{self._file.parent.name}-{where}"

    @classmethod
    def from_function(cls, function: Callable[..., Any], file: str) -> "_Place | None":
        folder = cache_folder()
        return cls(function, file, folder) if folder and os.path.exists(file) else None

    def ensure_cache_path(self) -> None:
        self._folder.mkdir(mode=0o700, exist_ok=True)

    def get_cache_path(self) -> str:
        return str(self._folder)

    def get_source_stamp(self) -> str:
        return _stamp(self._file)

    def get_disambiguator(self) -> str:
        return str(self._line)


@cache
def _stamp(file: Path) -> str:
    """Return a digest of a file and of all of ours that it imports; of the file alone if it is not ours."""
    return digest_of([file]) if file.is_relative_to(ROOT) else hashlib.sha256(file.read_bytes()).hexdigest()


class _Files:
    """The files of one kernel, one for each signature, named by all that its code depends on.

    Numba keeps an index of them. Two processes that compile two signatures of a kernel at a time can then each overwrite the
    other's code, and the index goes on to name it.
    """

    def __init__(self, folder: str, name: str, stamp: str) -> None:
        self._folder, self._name, self._stamp = Path(folder), name, stamp

    def _path(self, key: Any) -> Path:
        digest = hashlib.sha256(repr((self._stamp, key)).encode()).hexdigest()[:16]
        return self._folder / f"{self._name}.{digest}.nbc"

    def load(self, key: Any) -> Any:
        """Return what was saved under a key, None if nothing was."""
        try:
            found, data = pickle.loads(self._path(key).read_bytes())
        except FileNotFoundError:
            return None
        return data if found == key else None

    def save(self, key: Any, data: Any) -> None:
        """Save data under a key."""
        self._folder.mkdir(mode=0o700, exist_ok=True)
        with replacing(self._path(key)) as temporary:
            temporary.write_bytes(dumps((key, data)))

    def flush(self) -> None:
        """Forget all signatures."""
        for path in self._folder.glob(f"{escape(self._name)}.*.nbc"):
            path.unlink(missing_ok=True)


class _Kept(CompileResultCacheImpl):
    _locator_classes: ClassVar[list[type]] = [_Place]  # type: ignore[misc, assignment]


class _Cache(FunctionCache):
    """Numba's cache of one kernel; opened when the kernel is first called; no failure of the cache stops a command."""

    _impl_class = _Kept

    def __init__(self, function: Callable[..., Any], is_kept: bool) -> None:
        self._function, self._is_kept, self._is_open = function, is_kept, False

    def _open(self) -> bool:
        _prepare()
        if self._is_kept and not self._is_open:
            try:
                super().__init__(self._function)
            except (OSError, RuntimeError):  # no folder, or no source file
                self._is_kept = False
                return False
            impl = self._impl
            files: Any = _Files(self._cache_path, impl.filename_base, impl.locator.get_source_stamp())
            self._cache_file = files
            self._is_open = True
        return self._is_kept

    @property
    def cache_path(self) -> str | None:
        return self._cache_path if self._open() else None

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            if not self._open():
                return None
            # Numba's own method begins with importing all that it can compile, half of the time that a command takes to
            # start. A stored kernel needs only the runtime; the compiler does the rest when it is asked for.
            rtsys.initialize(target_context)
            return self._load_overload(sig, target_context)
        except Exception:  # whatever reading a damaged pickle raises: the kernel is compiled and stored again
            with suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            if all(map(_is_ours, data.signature.args)) and self._open():
                super().save_overload(sig, data)
        except OSError as e:
            compiling.not_kept("kernels", {Path(self._cache_path).parent: e})


def _is_ours(type_: Any) -> bool:
    """Return whether no class of another package is part of a type: a kernel with its methods inside outlives its source."""
    if isinstance(type_, numba.types.BaseNamedTuple) and _package(type_) not in _PACKAGES:
        return False
    return not isinstance(type_, numba.types.BaseTuple) or all(map(_is_ours, type_))  # type: ignore[call-overload]


def _package(type_: Any) -> str:
    """Return the package of a named tuple's class."""
    return str(type_.instance_class.__module__).partition(".")[0]


def kernel(function: Callable[..., Any] | None = None, *, is_kept: bool = True, **options: Any) -> Any:
    """Decorate a kernel: compiled once per source, releases the GIL, divides by zero as IEEE 754 does, no fastmath.

    Without fastmath there is no fused multiply-add: the counts are the same on every machine.
    """
    if function is None:
        return partial(kernel, is_kept=is_kept, **options)
    if IS_PLAIN:
        return _in_python(function)
    made: Any = numba.njit(nogil=True, error_model="numpy", **options)(function)
    made._cache = _Cache(function, is_kept)
    return made


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


def inlined(function: Callable[..., Any]) -> Any:
    """Decorate a small function that kernels call: pasted into them, without counting references to its arrays.

    It is stored as a part of them, and without the code that unpacks Python's objects, which took longer to compile than the
    function itself. Python calls a twin that has it.
    """
    if IS_PLAIN:
        return _in_python(function)
    made = kernel(function, is_kept=False, _nrt=False, forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
    twin = kernel(function, is_kept=False)

    def add_overload(compiled: Any) -> None:
        made.overloads[tuple(compiled.signature.args)] = compiled  # and not to the table for calls from Python

    made.add_overload, made._compile_for_args = add_overload, lambda *args: twin
    return made


#: ``instructions(twin)``: decorator of a function written in LLVM's own instructions (``numba.extending.intrinsic``); ``twin``
#: is the same in Python, for when nothing is compiled.
instructions: Any = _as_written
