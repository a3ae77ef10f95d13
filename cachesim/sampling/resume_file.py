"""Counts of units in a file: the counts of an estimate -> one NPZ file, and back, with every value checked.

Estimates of the same run with other targets or seeds may share a file; its key names everything that determines the counts.
"""

import os
import struct
import zipfile
import zlib
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from nptrace_base.atomic import whole_file
from nptrace_base.errors import NptraceError


class Kept(NamedTuple):
    """The counts of a run of N units and C caches.

    Attributes
    ----------
    units : (n,) int64
        Units counted, ascending.
    before : (n,) int64
        Positions of their short warm-up.
    counts : (n, 3) float64
    known, unknown : (n, 3 C) int64
    long_ : (m, 2) int64
        Unit and long warm-up of each repeated count.
    settled, bracket : (m, 3 C) int64
    spans : (s, 2) int64
        Stretches traced, of positions.
    looked : (k,) int64
        Single positions traced.
    work : (11,) float64
        Numbers of ``work.Work``.
    """

    units: np.ndarray
    before: np.ndarray
    counts: np.ndarray
    known: np.ndarray
    unknown: np.ndarray
    long_: np.ndarray
    settled: np.ndarray
    bracket: np.ndarray
    spans: np.ndarray
    looked: np.ndarray
    work: np.ndarray


def check_place(path: Path) -> None:
    """Raise NptraceError if a file cannot be written here, before there is anything to store."""
    folder = path.parent
    if not folder.is_dir():
        raise NptraceError(f"{path} cannot store the counts: there is no folder {folder}; create it or name another file")
    if not os.access(folder, os.W_OK) or (path.exists() and not os.access(path, os.W_OK)):
        raise NptraceError(f"{path} cannot store the counts: it is not writable; name another file")


def write(path: Path, key: str, kept: Kept) -> None:
    """Write the counts to a file, atomically."""
    with whole_file(path) as temporary, open(temporary, "wb") as file:
        np.savez(file, key=np.array(key), **kept._asdict())


def read(path: Path, key: str, n_units: int, n_caches: int, n_positions: int) -> Kept:
    """Return the counts in a file.

    Raises
    ------
    NptraceError
        The file belongs to another run, or is damaged.
    """
    try:
        with open(path, "rb") as file:
            own, arrays = _arrays(file)
            if own == key:
                return _checked(Kept(**arrays), n_units, 3 * n_caches, n_positions)
        reason = "it belongs to another scene, tree, picture or set of caches"
    except OSError as e:
        reason = str(e.strerror or "it cannot be read")
    except _DAMAGED:
        reason = "it is damaged, or not a file of counts"
    raise NptraceError(f"{path} cannot be resumed from: {reason}; name another file or remove it")


#: What ``zipfile`` and ``numpy`` raise for files that are cut off, changed or no archives of arrays.
_DAMAGED = (
    ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, zlib.error, struct.error, NotImplementedError, RuntimeError,
    ArithmeticError, MemoryError, SyntaxError,
)  # fmt: skip


def _arrays(file: BinaryIO) -> tuple[str, dict[str, np.ndarray]]:
    with zipfile.ZipFile(file) as members:
        # Nothing compressed, nothing larger than the file: a few bytes cannot ask for all memory.
        if any(member.compress_type != zipfile.ZIP_STORED for member in members.infolist()):
            raise ValueError("compressed")
        arrays = {}
        for name in ("key", *Kept._fields):
            with members.open(f"{name}.npy") as member:
                arrays[name] = np.lib.format.read_array(member, allow_pickle=False, max_header_size=1000)
    return str(arrays.pop("key")), arrays


def _checked(kept: Kept, n_units: int, n_columns: int, n_positions: int) -> Kept:
    """Return the arrays as they should be, or raise a ValueError."""
    n, m = len(kept.units), len(kept.long_)
    shapes = {
        "units": (n,), "before": (n,), "counts": (n, 3), "known": (n, n_columns), "unknown": (n, n_columns), "long_": (m, 2),
        "settled": (m, n_columns), "bracket": (m, n_columns), "spans": (len(kept.spans), 2), "looked": (len(kept.looked),),
        "work": (11,),
    }  # fmt: skip
    for name, shape in shapes.items():
        array = getattr(kept, name)
        wanted = np.float64 if name in ("counts", "work") else np.int64
        if array.shape != shape or array.dtype != wanted or not np.isfinite(array).all() or (array < 0).any():
            raise ValueError(name)
    for units in (kept.units, kept.long_[:, 0]):
        if (units >= n_units).any():
            raise ValueError("units")
    if not set(kept.long_[:, 0].tolist()) <= set(kept.units.tolist()):
        raise ValueError("units")
    if (kept.spans > n_positions).any() or (kept.spans[:, 0] > kept.spans[:, 1]).any() or (kept.looked >= n_positions).any():
        raise ValueError("positions")
    return kept
