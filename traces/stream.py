"""A file, a pipe or stdin -> its bytes, chunk by chunk: opened once, decompressed by its first bytes, not by its name."""

import bz2
import gzip
import io
import lzma
import os
import sys
import weakref
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa

from traces.format import RunError, printable

STDIN = Path("-")

#: The first bytes of compressed files.
_PACKED = {
    b"\x1f\x8b": "gzip", b"\x28\xb5\x2f\xfd": "zstd", b"\xfd7zXZ\0": "xz", b"BZh": "bzip2", b"\x04\x22\x4d\x18": "lz4"
}  # fmt: skip

#: The first bytes of other files that are given by mistake.
_OTHERS = {
    b"PAR1": "a Parquet file; give the directory of its run", b"PK\x03\x04": "a zip archive; unpack it",
    b"7z\xbc\xaf": "a 7z archive; unpack it", b"\x1f\x9d": "packed by compress; unpack it", b"\x89PNG": "a picture",
    b"%PDF": "a PDF file", b"\x7fELF": "a program",
}  # fmt: skip

_UNPACKING = (OSError, EOFError, zlib.error, lzma.LZMAError, pa.ArrowException)

_HEAD = 4096


class StreamError(RunError):
    """A file that cannot be read; the message states the reason and the way out."""


class Stream:
    """Bytes that can be read from their start repeatedly (a file) or once (a pipe).

    ``where`` names them in messages, ``name`` in results.
    """

    def __init__(self, path: Path | str) -> None:
        path = Path(path)
        self.where, self.name = ("stdin", "stdin") if path == STDIN else (str(path), printable(path.name))
        if path == STDIN:
            if sys.stdin is None:
                raise StreamError("stdin is closed; name a file, or give a trace on stdin")
            self._file: Any = sys.stdin.buffer
        else:
            try:
                self._file = path.open("rb", buffering=0)
            except OSError as e:
                raise StreamError(f"cannot read {path}: {e.strerror}; give a DineroIV trace or a run's directory") from e
            weakref.finalize(self, self._file.close)
        try:
            self._start: int | None = self._file.tell() if self._file.seekable() else None
        except OSError:  # it claims to be seekable, as terminals do, and is not
            self._start = None
        self._n_passes = 0
        self._head: bytes | None = None  # read before the first pass

    def head(self) -> bytes:
        """Return the first bytes, decompressed as far as they go, without taking them from the first pass."""
        if self._head is None:
            try:
                if self._start is not None:
                    self._file.seek(self._start)
                self._head = _read_fully(self._file, _HEAD)
            except OSError as e:
                raise StreamError(f"cannot read {self.where}: {e.strerror}") from e
        try:
            return _unpacked(io.BufferedReader(_HeadFirst(self._head, io.BytesIO())), _packing(self._head)).read(_HEAD // 8)
        except _UNPACKING:  # they end within a block
            return b""

    def check_passes(self, n_passes: int) -> None:
        """Raise a StreamError if the bytes cannot be read ``n_passes`` times."""
        if n_passes > 1 and self._start is None:
            raise StreamError(
                f"{self.where} is a pipe, and this command reads it {n_passes} times; write it to a file first, or use one "
                "prefetch policy and no opt"
            )

    def opened(self) -> Any:
        """Return all bytes, not decompressed, as a file that can seek: the file itself, or what came through the pipe."""
        self._n_passes += 1
        self.check_passes(self._n_passes)
        head, self._head = self._head, None
        if self._start is not None:
            head = None
            self._file.seek(self._start)
        if isinstance(self._file, io.FileIO) and self._start is not None:
            return os.fdopen(os.dup(self._file.fileno()), "rb")
        return io.BytesIO((head or b"") + self._file.read())

    def chunks(self, n_bytes: int, plain: Any) -> Iterator[bytes]:
        """Yield all bytes, decompressed, ``n_bytes`` at a time; fewer only at the end.

        ``plain`` returns whether the first bytes are the wanted format, whatever else they resemble.
        """
        self._n_passes += 1
        self.check_passes(self._n_passes)
        packing = ""
        try:
            head, self._head = self._head, None
            if self._start is not None:
                self._file.seek(self._start)
                head = None
            head = _read_fully(self._file, _HEAD) if head is None else head
            if not plain(head):
                packing = _packing(head)
                other = next((what for magic, what in _OTHERS.items() if head.startswith(magic)), "")
                if other:
                    raise StreamError(f"{self.where} is not a trace but {other}")
            file = _unpacked(io.BufferedReader(_HeadFirst(head, self._file), 1 << 16), packing)
            while chunk := _read_fully(file, n_bytes):
                yield chunk
        except _UNPACKING as e:
            if packing:
                raise StreamError(f"{self.where} is {packing} that cannot be unpacked ({e}); pack it again") from e
            raise StreamError(f"cannot read {self.where}: {getattr(e, 'strerror', None) or e}") from e


def _packing(head: bytes) -> str:
    """Return how a file with these first bytes is compressed, "" if it is not."""
    return next((name for magic, name in _PACKED.items() if head.startswith(magic)), "")


def _read_fully(file: Any, n_bytes: int) -> bytes:
    """Return the next ``n_bytes``, fewer only at the end: decompressors and pipes return fewer."""
    pieces, missing = [], n_bytes
    while missing and (piece := file.read(missing)):
        pieces.append(piece)
        missing -= len(piece)
    return pieces[0] if len(pieces) == 1 else b"".join(pieces)


def _unpacked(file: io.BufferedReader, packing: str) -> Any:
    if packing == "gzip":
        return gzip.GzipFile(fileobj=file)
    if packing == "bzip2":
        return bz2.BZ2File(file)
    if packing == "xz":
        return lzma.LZMAFile(file)
    return pa.CompressedInputStream(pa.PythonFile(file, mode="r"), packing) if packing else file


class _HeadFirst(io.RawIOBase):
    """A file whose first bytes have been read."""

    def __init__(self, head: bytes, file: Any) -> None:
        self._head, self._file = head, file

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        if not self._head:
            return self._file.readinto(buffer)
        n = min(len(buffer), len(self._head))
        buffer[:n] = self._head[:n]
        self._head = self._head[n:]
        return n
