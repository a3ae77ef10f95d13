"""Arrays -> one file that any process maps: it is named by its content, checked once in a process, and lies in memory once.

The file is 8 bytes with the length of a header, the header in JSON, and the arrays, each at a multiple of 64 bytes.
"""

import hashlib
import json
import tempfile
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from nptrace_base.places import Place
from traces.format import RunError
from traces.manifest import FileFacts

_ALIGN = 64


def laid_out(arrays: Mapping[str, np.ndarray], facts: Mapping[str, Any]) -> list[Any]:
    """Return the content of a file as buffers, in order; the arrays are not copied. ``facts`` is what JSON can hold."""
    places, pieces, at = {}, [], 0
    for name, array in arrays.items():
        flat = np.ascontiguousarray(array)
        places[name] = [flat.dtype.str, flat.shape, at]
        pieces += [flat.reshape(-1).view(np.uint8).data, bytes(-flat.nbytes % _ALIGN)]
        at += flat.nbytes + -flat.nbytes % _ALIGN
    header = json.dumps({"arrays": places, "facts": dict(facts)}, sort_keys=True).encode()
    header += b" " * (-(8 + len(header)) % _ALIGN)
    return [len(header).to_bytes(8, "little"), header, *pieces]


@lru_cache(2)
def mapped(where: Place, file: FileFacts) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Return the arrays of a file, and its facts; a file of an object store is copied to a temporary one first.

    The arrays are writable, and what is written stays in this process: Numba would compile other code for read-only ones.

    Raises
    ------
    RunError
        The file is not the one that was written: kernels trust the numbers of a tree.
    """
    try:
        if isinstance(where, Path):
            memory = np.asarray(np.memmap(where, np.uint8, "c"))
        else:
            with tempfile.TemporaryFile() as copy:
                where.copy_to(copy)
                memory = np.asarray(np.memmap(copy, np.uint8, "c"))
    except (OSError, ValueError) as e:
        raise RunError(f"cannot map {where}: {e}; give an --out that all workers see, and start the render again") from e
    if memory.nbytes != file.bytes or hashlib.sha256(memory.data).hexdigest() != file.sha256:
        raise RunError(f"{where} has been changed since it was written (its checksum is wrong); start the render again")
    start = 8 + int.from_bytes(memory[:8].tobytes(), "little")
    header = json.loads(memory[8:start].tobytes())
    return {name: _array(memory[start:], *each) for name, each in header["arrays"].items()}, header["facts"]


def _array(memory: np.ndarray, dtype: str, shape: Sequence[int], at: int) -> np.ndarray:
    n_bytes = int(np.prod(shape)) * np.dtype(dtype).itemsize
    return memory[at : at + n_bytes].view(dtype).reshape(shape)
