"""The text of a mesh file -> lines of words and numbers, the same way for every kind of file.

Lines end with LF, CR or both and are counted from 1 as an editor counts them. UTF-8 with or without a mark, UTF-16 and UTF-32
are read; a Ctrl-Z or NUL bytes at the end are ignored.
"""

import codecs
import contextlib
import re
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from rtrace.scenes.meshes.raw import MeshError, show

#: The mark of UTF-32 begins like that of UTF-16.
_MARKS = {
    codecs.BOM_UTF8: "",
    codecs.BOM_UTF32_LE: "utf-32-le",
    codecs.BOM_UTF32_BE: "utf-32-be",
    codecs.BOM_UTF16_LE: "utf-16-le",
    codecs.BOM_UTF16_BE: "utf-16-be",
}
#: A # begins a comment unless it is part of a number as old Microsoft libraries write NaN and infinity: -1.#IND00.
_COMMENT = re.compile(rb"(?<!1\.)#|#(?![A-Z])")
_NOT_A_NUMBER = re.compile(rb"[+-]?(?:1\.#[A-Z]+\d*|nan\(\w*\))", re.IGNORECASE)
_WHOLE = re.compile(rb"[+-]?\d+")
_LARGEST = 1 << 62  # no file has so many vertices: a larger number is out of range anyway


def plain_text(data: bytes) -> bytes:
    """Return a text in an encoding that contains ASCII, without a byte order mark and without padding at its end."""
    mark = next((mark for mark in _MARKS if data.startswith(mark)), b"")
    data = data[len(mark) :]
    if coding := _MARKS[mark] if mark else _unmarked_coding(data[:64]):
        data = data.decode(coding, "replace").encode()
    return data.rstrip(b"\0\x1a")


def _unmarked_coding(start: bytes) -> str:
    """Return the encoding of a text without a mark: ASCII letters of UTF-16 have a NUL byte on one side."""
    first, second = start[0:-1:2], start[1::2]
    if len(second) < 4 or b"\0" not in start:
        return ""
    return "utf-16-le" if not any(second) and all(first) else "utf-16-be" if not any(first) and all(second) else ""


class Text:
    """The lines of a text file. ``joined`` has, after ``rows``, the numbers of lines that were continued in the next."""

    def __init__(self, data: bytes) -> None:
        data = plain_text(data)
        self._lines = data.splitlines()
        self._signs = {sign: sign in data for sign in (b"#", b"\\", b"_")}
        self.joined: set[int] = set()

    def rows(self, *, joins: bool = False, skip: tuple[bytes, ...] = ()) -> Iterator[tuple[int, list[bytes]]]:
        """Yield number and words of each line that has words, without its comment.

        With ``joins`` a backslash at the end continues a line in the next; in a comment it does not. Lines that begin with one
        of ``skip`` are skipped.
        """
        lines = iter(enumerate(self._lines, 1))
        comments, joins = self._signs[b"#"], joins and self._signs[b"\\"]
        for number, line in lines:
            if skip and line.startswith(skip) and not (joins and b"\\" in line):
                continue
            if comments and b"#" in line:
                line = _COMMENT.split(line, maxsplit=1)[0]
            if joins and b"\\" in line:
                line = self._continued(number, line, lines)
            words = line.split()
            if words:
                yield number, words

    def _continued(self, number: int, line: bytes, lines: Iterator[tuple[int, bytes]]) -> bytes:
        while (line := line.rstrip()).endswith(b"\\"):
            following = next(lines, (0, b""))[1]
            line = line[:-1] + b" " + _COMMENT.split(following, maxsplit=1)[0]
            self.joined.add(number)
        return line

    def floats(self, words: Sequence[bytes], where: Callable[[int], str]) -> np.ndarray:
        """Return the numbers that words of this text spell, float64; ``where(k)`` returns the place of word k for an error."""
        with contextlib.suppress(ValueError):
            if self._no_underscore(words):
                return np.fromiter(map(float, words), np.float64, len(words))
        return np.array([_number(word, where, k) for k, word in enumerate(words)], np.float64)

    def whole_numbers(self, words: Sequence[bytes], where: Callable[[int], str]) -> np.ndarray:
        """Return the whole numbers that words spell, int64; a number beyond int64 becomes 2^62 or its negative."""
        with contextlib.suppress(ValueError, OverflowError):
            if self._no_underscore(words):
                return np.fromiter(map(int, words), np.int64, len(words))
        for k, word in enumerate(words):
            if not _WHOLE.fullmatch(word) or len(word) > 4000:  # Python reads no longer ones
                raise MeshError(f"{where(k)}: {show(word)} is not a whole number")
        return np.array([min(max(int(word), -_LARGEST), _LARGEST) for word in words], np.int64)

    def _no_underscore(self, words: Sequence[bytes]) -> bool:
        """Return whether Python accepts no word that is not a number here, such as 1_000."""
        return not self._signs[b"_"] or b"_" not in b"".join(words)


def _number(word: bytes, where: Callable[[int], str], k: int) -> float:
    if _NOT_A_NUMBER.fullmatch(word):
        return np.inf if b"#INF" in word.upper() else np.nan
    try:
        if b"_" not in word:
            return float(word)
    except ValueError:
        pass
    way_out = "export the mesh again"
    if re.fullmatch(rb"[+-]?\d*,\d+", word):
        way_out = "write decimals with a point, not a comma"
    elif re.fullmatch(rb"[+-]?[\d.]+[dD][+-]?\d+", word):
        way_out = "write exponents with an E"
    raise MeshError(f"{where(k)}: {show(word)} is not a number", way_out)
