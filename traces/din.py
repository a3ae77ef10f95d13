"""DineroIV traces, text and binary: x.din -> (address, size, type) batch by batch; a run -> x.din that DineroIV can replay.

Text (its input format ``d``) has one access per line, ``type address`` in hexadecimal, 0x allowed; the rest of the line is
ignored. Binary (format ``b``) has records of eight bytes: address uint32, size uint16, type uint8, one byte unused, little
endian. As in DineroIV, a text access is 4 bytes at ``address & ~3``. Unlike DineroIV, blank lines, CR and UTF-16 are allowed,
traces may be compressed (``traces.stream``), and an address at 2^32 or beyond is an error instead of being truncated.

Access types (DineroIV's labels): 0 read, 2 instruction fetch, 3 miscellaneous (a read that triggers nothing), b an explicit
prefetch (8 | 3). Nodes are
read-only, so writes (1), copy-backs (4), invalidations (5) and everything else are errors.
"""

import codecs
import itertools
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np

from nptrace_base.atomic import whole_file
from nptrace_base.jit import kernel
from traces.format import LEAF, PREFETCH
from traces.reader import Run
from traces.stream import Stream, StreamError
from traces.validation import LEAF_AXIS

LABELS = (0x0, 0x2, 0x3, 0xB)
TEXT_ACCESS_BYTES = 4

#: Access types of a run's prefetch requests in an export; None leaves them out.
PREFETCH_LABELS = {"b": 0xB, "read": 0x0, "misc": 0x3, "omit": None}

RECORD = np.dtype([("address", "<u4"), ("size", "<u2"), ("label", "u1"), ("pad", "u1")])

_CHUNK_BYTES = 1 << 20  # some 150,000 accesses; a larger chunk took as long and more memory
_HEX = np.full(256, 255, np.uint8)
for _digit, _char in enumerate("0123456789abcdef"):
    _HEX[ord(_char)] = _HEX[ord(_char.upper())] = _digit
_OK, _BAD_LABEL, _BAD_ADDRESS, _WIDE_ADDRESS = range(4)


class DinError(StreamError):
    """A trace that cannot be read or written; the message has the line, the rule and the way out."""


class DinTrace:
    """A DineroIV trace in a file, a pipe or stdin (``-``). It is read in chunks, so memory does not grow with its length."""

    def __init__(self, source: Stream | Path | str) -> None:
        self.stream = source if isinstance(source, Stream) else Stream(source)

    def batches(self) -> Iterator[tuple[np.ndarray, np.ndarray | int, np.ndarray]]:
        """Yield (address uint32, size in bytes, access type uint8); the size is one number for text, an array for binary."""
        chunks, n = self.stream.chunks(_CHUNK_BYTES, _has_records), 0
        first = next(chunks, b"")
        encoding = _encoding(first)
        rest = itertools.chain([first], chunks)
        for batch in self._text(_lines_of(rest, encoding)) if encoding else self._binary(rest):
            n += batch[0].size
            yield batch
        if not n:
            raise DinError(f"{self.stream.where} holds no access; a trace has lines such as `0 1a2b40`")

    def _text(self, chunks: Iterable[bytes]) -> Iterator[tuple[np.ndarray, int, np.ndarray]]:
        rest, lines_before = b"", 0
        for chunk in chunks:
            text, newline, rest_after = (rest + chunk).rpartition(b"\n")
            if len(rest_after) > _CHUNK_BYTES // 4:
                line = lines_before + 1 + text.count(b"\n") + len(newline)
                raise DinError(f"{self.stream.where}: line {line} has no end within {len(rest_after)} B; this is not a trace")
            rest = rest_after
            if newline:
                yield self._parse(text + newline, lines_before)
                lines_before += text.count(b"\n") + 1
        if rest:
            yield self._parse(rest + b"\n", lines_before)

    def _parse(self, text: bytes, lines_before: int) -> tuple[np.ndarray, int, np.ndarray]:
        data = np.frombuffer(text, np.uint8)
        address = np.empty(text.count(b"\n"), np.uint32)
        label = np.empty(address.size, np.uint8)
        n, n_lines, error = parse(data, _HEX, address, label)
        if error:
            bad = text.split(b"\n", n_lines + 1)[n_lines].strip().decode("ascii", "replace")
            raise DinError(f"{self.stream.where}, line {lines_before + n_lines + 1}: {_explain(error, bad)}")
        return address[:n], TEXT_ACCESS_BYTES, label[:n]

    def _binary(self, chunks: Iterable[bytes]) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        done = 0
        for chunk in chunks:
            if len(chunk) % RECORD.itemsize:
                raise DinError(
                    f"{self.stream.where} is truncated: its size is not a whole number of {RECORD.itemsize}-byte records"
                )
            records = np.frombuffer(chunk, RECORD)
            address, size, label = (np.ascontiguousarray(records[name]) for name in ("address", "size", "label"))
            at = int(first_bad_record(address, size, label))
            if at < address.size:
                reason = explain_record(int(address[at]), int(size[at]), int(label[at]))
                raise DinError(f"{self.stream.where}, record {done + at + 1}: {reason}")
            done += address.size
            yield address, size, label


def _has_records(head: bytes) -> bool:
    """Return whether bytes are valid binary records."""
    records = np.frombuffer(head[: len(head) // RECORD.itemsize * RECORD.itemsize], RECORD)
    good = np.isin(records["label"], LABELS) & (records["size"] > 0) & (records["pad"] == 0)
    return records.size > 0 and bool(good.all())


#: Texts that begin with a byte order mark, and their encodings.
_MARKS = {b"\xef\xbb\xbf": "utf-8", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}

_TEXT_BYTES = np.array([9, 10, 13, *range(32, 127)], np.uint8)


def _encoding(head: bytes) -> str:
    """Return the encoding of text by its first bytes, "" for binary records."""
    head = head[:4096]
    if _has_records(head):
        return ""
    for mark, encoding in _MARKS.items():
        if head.startswith(mark):
            return encoding
    pairs = np.frombuffer(head[: min(len(head), 64) // 2 * 2], np.uint8).reshape(-1, 2)
    for k, encoding in enumerate(("utf-16-le", "utf-16-be")):  # without a mark: every other byte of its digits is 0
        if pairs.size and (pairs[:, 1 - k] == 0).all() and np.isin(pairs[:, k], _TEXT_BYTES).all():
            return encoding
    return "" if b"\0" in head else "ascii"  # text has no zero byte; a record has one in its unused byte


def _lines_of(chunks: Iterable[bytes], encoding: str) -> Iterator[bytes]:
    """Yield text as one byte per character, with LF for every line end (CR, LF or both)."""
    decoder = None if encoding in ("ascii", "utf-8") else codecs.getincrementaldecoder(encoding)("replace")
    is_first, held = True, b""
    for chunk in chunks:
        if decoder is not None:
            chunk = decoder.decode(chunk).encode("ascii", "replace")
        elif is_first:
            chunk = chunk.removeprefix(codecs.BOM_UTF8)
        is_first = False
        if held or b"\r" in chunk:
            chunk, held = held + chunk, b""
            if chunk.endswith(b"\r"):  # an LF may follow
                chunk, held = chunk[:-1], b"\r"
            chunk = chunk.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        yield chunk
    if held:
        yield b"\n"


#: Access types that DineroIV knows and that a trace of reads cannot have.
_FOREIGN = {1: "a write, and nodes are read-only", 4: "a copy-back, and nodes are read-only",
            5: "an invalidation, and nothing invalidates nodes", 8: "DineroIV's end mark"}  # fmt: skip
_KNOWN = "access types are 0 (read), 2 (instruction fetch), 3 (misc) and b (prefetch)"


def _explain(error: int, line: str) -> str:
    fields = line.split()
    if error == _BAD_LABEL:
        label = fields[0] if fields else repr(line)  # a control character that Python takes for a blank
        if label.lower() in ("r", "w", "i", "m", "c", "v"):
            return f"access type {label} is of DineroIV's extended format (-informat D), which is not read; write `0 1a2b40`"
        try:
            kind = _FOREIGN.get(int(label, 16), "unknown")
        except ValueError:
            kind = "not hexadecimal"
        return f"access type {label[:40]} is {kind}; {_KNOWN}"
    address = fields[1][:40] if len(fields) > 1 else ""
    if error == _WIDE_ADDRESS:
        return f"address {address} has more than 32 bits, which DineroIV's traces cannot hold; rebase the trace"
    found = f"{address!r} is not a hexadecimal address" if address else "the address is missing"
    return f"{found}; write `type address`, as in `0 1a2b40`"


def explain_record(address: int, size: int, label: int) -> str:
    """Return why a read of ``size`` bytes cannot be in a trace."""
    if label not in LABELS:
        return _explain(_BAD_LABEL, f"{label:x}") if label != 0xC else f"access type c is unknown; {_KNOWN}"
    if size == 0:
        return "a size of 0 B reads nothing"
    return (
        f"{size} B at {address:x} reach past 2^32, where DineroIV wraps to 0; rebase the trace, or split the record into two"
    )


@kernel
def first_bad_record(address, size, label):
    """Return the first record with an unknown type, no bytes, or bytes at 2^32 and beyond; the number of records if none."""
    for i in range(np.uint64(address.size)):
        of_label = label[i]
        known = of_label == 0 or of_label == 2 or of_label == 3 or of_label == 11
        if not known or size[i] == 0 or np.uint64(address[i]) + np.uint64(size[i]) > np.uint64(1 << 32):
            return i
    return np.uint64(address.size)


@kernel
def parse(text, digits, address, label):
    """Parse whole lines of ``type address``; return (accesses, lines before the first bad one, error code).

    ``digits`` maps a byte to its value as a hexadecimal digit, 255 for none.
    """
    n = n_lines = 0
    i = 0
    while i < text.size:
        while text[i] == 32 or text[i] == 9:
            i += 1
        if text[i] != 10:
            if text[i] == 48 and (text[i + 1] == 120 or text[i + 1] == 88):
                i += 2
            value, first = np.uint64(0), i
            while digits[text[i]] < 16 and i - first < 8:
                value = value * np.uint64(16) + np.uint64(digits[text[i]])
                i += 1
            is_end = text[i] == 32 or text[i] == 9 or text[i] == 10
            if i == first or not is_end or not (value == 0 or value == 2 or value == 3 or value == 11):
                return n, n_lines, _BAD_LABEL
            label[n] = value
            while text[i] == 32 or text[i] == 9:
                i += 1
            if text[i] == 48 and (text[i + 1] == 120 or text[i + 1] == 88):
                i += 2
            value, first = np.uint64(0), i
            while digits[text[i]] < 16:
                value = value * np.uint64(16) + np.uint64(digits[text[i]])
                if value >> np.uint64(32):
                    return n, n_lines, _WIDE_ADDRESS
                i += 1
            if i == first or not (text[i] == 32 or text[i] == 9 or text[i] == 10):
                return n, n_lines, _BAD_ADDRESS
            address[n] = value & np.uint64(0xFFFFFFFC)
            n += 1
            while text[i] != 10:
                i += 1
        i += 1
        n_lines += 1
    return n, n_lines, _OK


def export_din(
    run: Run,
    out: Path | str,
    *,
    fmt: str = "text",
    prefetch: str = "b",
    addresses: np.ndarray | None = None,
    warn: Callable[[str], None] = lambda text: None,
) -> int:
    """Write a run as a DineroIV trace, atomically; return the number of accesses written.

    Parameters
    ----------
    run : Run
    out : Path
    fmt : str
        ``"text"`` (for ``-informat d``) or ``"binary"`` (``-informat b``). Only binary keeps the size of a node: text
        accesses are 4 bytes to DineroIV, so a node that spans lines counts once.
    prefetch : str
        The access type of the prefetch requests: ``"b"``, ``"read"`` (0), ``"misc"`` (3), or ``"omit"``.
    addresses : (n_nodes,) integer array, optional
        Byte address of every node; as stored when None.
    warn : callable, optional
        Called with a sentence when DineroIV counts the trace differently: where a prefetch spans two lines.
    """
    if fmt not in ("text", "binary"):
        raise DinError(f"{fmt!r} is not a format of a DineroIV trace; choose text or binary")
    if prefetch not in PREFETCH_LABELS:
        raise DinError(f"{prefetch!r} is not an access type for prefetches; choose one of {', '.join(PREFETCH_LABELS)}")
    node_bytes = run.footer.tree.node_bytes
    if fmt == "binary" and node_bytes > np.iinfo(RECORD["size"]).max:
        raise DinError(f"nodes of {node_bytes} B do not fit a binary record, whose size has 16 bits; choose csv or parquet")
    addresses = node_addresses(run, addresses)
    if fmt == "binary" and prefetch == "b":
        is_aligned = node_bytes & (node_bytes - 1) == 0 and not (addresses % np.asarray(node_bytes, addresses.dtype)).any()
        lines = f"lines shorter than {node_bytes} B" if is_aligned else "lines of any size"
        warn(
            f"with {lines}, prefetches of {node_bytes} B span two, and DineroIV counts those wrongly, or stops with -uccc; "
            "use longer lines, --prefetch read, or npcache replay"
        )
    out = Path(out)
    written = 0
    with whole_file(out) as temporary, open(temporary, "wb") as file:
        for where, what in exported(run, addresses, prefetch):
            file.write(_records(where, what, node_bytes) if fmt == "binary" else _lines(where, what))
            written += where.size
    return written


def node_addresses(run: Run, addresses: np.ndarray | None = None) -> np.ndarray:
    """Return the address of every node, as stored if None is given; 0 for what is no node in memory."""
    if addresses is None:
        addresses = run.columns("nodes", ["address"])["address"]
    if not run.footer.tree.node_format.reads_leaves:
        axis = run.columns("nodes", ["axis"])["axis"]
        addresses = np.where(axis == LEAF_AXIS, 0, addresses)  # a leaf is no node in memory, so nothing reads it
    highest = int(addresses.max()) + run.footer.tree.node_bytes
    if highest > 1 << 32:
        raise DinError(f"{run.name} reaches address {highest:#x}; a DineroIV trace has 32 bits, so move the layout down")
    return addresses


def exported(run: Run, addresses: np.ndarray, prefetch: str) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield (address uint32, access type uint8) of a run's accesses, batch by batch; ``prefetch`` as in ``export_din``."""
    narrow = np.ascontiguousarray(addresses, np.uint32)
    mark = PREFETCH_LABELS[prefetch]
    left_out = [PREFETCH] * (mark is None) + [LEAF] * (not run.footer.tree.node_format.reads_leaves)
    labels = np.array([0, 0, 0, mark or 0], np.uint8)
    for nodes, kinds in run.batches():
        if left_out:
            keep = ~np.isin(kinds, left_out)
            nodes, kinds = nodes[keep], kinds[keep]
        yield narrow[nodes], labels[kinds]


def _records(address: np.ndarray, label: np.ndarray, size: int) -> bytes:
    records = np.zeros(address.size, RECORD)
    records["address"], records["size"], records["label"] = address, size, label
    return records.tobytes()


def _lines(address: np.ndarray, label: np.ndarray) -> bytes:
    text = np.empty(11 * address.size, np.uint8)  # type, blank, at most eight digits, newline
    return text[: format_lines(address, label, text)].tobytes()


@kernel
def format_lines(address, label, text):
    """Write ``type address`` lines in lower-case hexadecimal without leading zeros; return the number of bytes."""
    n = 0
    for i in range(address.size):
        digit = label[i]
        text[n] = 48 + digit if digit < 10 else 87 + digit
        text[n + 1] = 32
        n += 2
        shift = 28
        while shift > 0 and (address[i] >> np.uint32(shift)) == 0:
            shift -= 4
        while shift >= 0:
            digit = np.uint8((address[i] >> np.uint32(shift)) & np.uint32(15))
            text[n] = 48 + digit if digit < 10 else 87 + digit
            n += 1
            shift -= 4
        text[n] = 10
        n += 1
    return n
