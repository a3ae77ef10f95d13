"""Traces of addresses in CSV or Parquet, from other programs: a file -> (address, size, type) in batches; a run -> a file.

A file has a column ``address``, and may have ``type`` and ``size``; other columns are ignored. CSV has a header and may be
compressed (``traces.stream``); an address is decimal, or hexadecimal with 0x. Types are DineroIV's: 0, 2, 3 and b (11 as a
number), or the words read, fetch, misc and prefetch; without the column every access is a read. Without sizes an access is one
byte, so it touches one line. As in DineroIV's traces, bytes at 2^32 and beyond are an error.
"""

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as csv
import pyarrow.parquet as pq

from nptrace_base.atomic import whole_file
from traces.arrow_arrays import as_array
from traces.din import LABELS, PREFETCH_LABELS, DinError, explain_record, exported, node_addresses
from traces.reader import Run
from traces.stream import Stream

#: Ends of the names of such files; a CSV file may be compressed.
ENDINGS = (".csv", ".csv.gz", ".csv.zst", ".csv.xz", ".csv.bz2", ".parquet")
COLUMNS = ("address", "type", "size")
#: Access types by what a file may call them; of the last ones a message tells why not.
_TYPES = {
    "read": 0x0, "fetch": 0x2, "misc": 0x3, "prefetch": 0xB, "b": 0xB, "11": 0xB, "0": 0x0, "2": 0x2, "3": 0x3,
    "1": 0x1, "write": 0x1, "4": 0x4, "5": 0x5, "8": 0x8,
}  # fmt: skip
_PARQUET = b"PAR1"  # how a Parquet file begins
_CHUNK_BYTES = 1 << 20
_ROWS = 1 << 18
_INTEGER = r"^\s*(0[xX][0-9a-fA-F]{1,16}|0*[0-9]{1,19})\s*$"


def is_address_file(stream: Stream) -> bool:
    """Return whether a file is such a trace: by the end of its name, else by its header, which a pipe has too."""
    if stream.name.lower().endswith(ENDINGS):
        return True
    head = stream.head()
    return head.startswith(_PARQUET) or "address" in _names(head.removeprefix(b"\xef\xbb\xbf").partition(b"\n")[0])


class AddressFile:
    """A trace of addresses in CSV or Parquet, with the methods of ``DinTrace``.

    It is read in pieces, except Parquet from a pipe, whose end has to be known first.
    """

    def __init__(self, stream: Stream) -> None:
        self.stream = stream

    def batches(self) -> Iterator[tuple[np.ndarray, np.ndarray | int, np.ndarray]]:
        """Yield (address uint32, size in bytes, access type uint8); the size is 1 where the file has none."""
        n = 0
        is_parquet = self.stream.name.lower().endswith(".parquet") or self.stream.head().startswith(_PARQUET)
        tables = self._parquet() if is_parquet else self._csv()
        for table in tables:
            if table.num_rows:
                yield self._checked(table, n)
                n += table.num_rows
        if not n:
            raise DinError(f"{self.stream.where} holds no access; give a file with addresses below its header")

    def _parquet(self) -> Iterator[Any]:
        try:
            with self.stream.opened() as file:
                found = pq.ParquetFile(file)
                given = found.schema_arrow.names
                names = [name.strip().lower() for name in given]
                ours = {given[names.index(name)]: name for name in self._columns(names)}
                for batch in found.iter_batches(_ROWS, columns=[*ours]):
                    yield pa.table(batch).select([*ours]).rename_columns([*ours.values()])
        except (pa.ArrowException, OSError) as e:
            reason = (str(e) or type(e).__name__).splitlines()[0]
            raise DinError(f"{self.stream.where} cannot be read as Parquet ({reason}); write it again") from e

    def _csv(self) -> Iterator[Any]:
        rest, header = b"", b""
        for chunk in self.stream.chunks(_CHUNK_BYTES, lambda head: False):
            text, _, rest = (rest + chunk).rpartition(b"\n")
            if not header and text:
                header, _, text = text.removeprefix(b"\xef\xbb\xbf").partition(b"\n")
            if text.strip():
                yield self._parsed(header, text)
        if not header:
            header, rest = rest, b""
        self._columns(self._header(header))
        if rest.strip():
            yield self._parsed(header, rest)

    def _parsed(self, header: bytes, text: bytes) -> Any:
        names = self._header(header)
        convert = csv.ConvertOptions(
            column_types=dict.fromkeys(names, pa.string()), include_columns=self._columns(names), strings_can_be_null=False
        )  # fmt: skip
        try:
            return csv.read_csv(io.BytesIO(text), csv.ReadOptions(column_names=names), convert_options=convert)
        except pa.ArrowException as e:
            raise DinError(f"{self.stream.where} cannot be read as CSV ({str(e).splitlines()[0]}); write it again") from e

    def _header(self, header: bytes) -> list[str]:
        """Return the names of all columns of a CSV file."""
        if b"\0" in header:
            raise DinError(f"{self.stream.where} is not in UTF-8; save it as UTF-8")
        if b"\r" in header.strip():
            raise DinError(f"{self.stream.where} has lines that end with a carriage return alone; end them with a line feed")
        return _names(header)

    def _columns(self, names: list[str]) -> list[str]:
        """Return those of our columns that a file has; each once, and ``address`` at least."""
        if "address" not in names:
            found = ", ".join(names)[:80]
            raise DinError(f"{self.stream.where} has no column 'address' (it has {found}); name it so in the header")
        twice = next((name for name in COLUMNS if names.count(name) > 1), None)
        if twice:
            raise DinError(f"{self.stream.where} has several columns {twice!r}; leave one")
        return [name for name in COLUMNS if name in names]

    def _checked(self, table: Any, before: int) -> tuple[np.ndarray, np.ndarray | int, np.ndarray]:
        """Return the arrays of some rows; DinError names the first row that cannot be, from 1."""
        columns = {name: table.column(name).combine_chunks() for name in table.column_names}
        address = self._numbers("address", columns["address"], before)
        size = self._numbers("size", columns["size"], before) if "size" in columns else np.ones(address.size, np.uint64)
        types = self._types(columns["type"], before) if "type" in columns else np.zeros(address.size, np.uint8)
        bad = np.flatnonzero((size >= 1 << 32) | (address > (1 << 32) - size) | (size == 0) | ~np.isin(types, LABELS))
        if bad.size:
            at = int(bad[0])
            reason = explain_record(int(address[at]), int(size[at]), int(types[at]))
            raise DinError(f"{self.stream.where}, row {before + at + 1}: {reason}")
        return address.astype(np.uint32), size.astype(np.uint32) if "size" in columns else 1, types

    def _numbers(self, name: str, values: Any, before: int) -> np.ndarray:
        import pyarrow.compute as pc  # a fifth of a warm start, and few commands read such a file

        if pa.types.is_string(values.type) or pa.types.is_large_string(values.type):
            good = pc.fill_null(pc.match_substring_regex(values, _INTEGER), False)
            if not pc.all(good).as_py():
                raise self._bad(name, values, good, before, "no whole number of up to 19 digits; write e.g. 4096 or 0x1000")
            return as_array(pc.cast(pc.utf8_trim_whitespace(values), pa.uint64()))
        if not pa.types.is_integer(values.type):
            raise DinError(f"{self.stream.where}, column {name!r} is of type {values.type}; write whole numbers")
        is_unsigned = pa.types.is_unsigned_integer(values.type)  # Arrow compares these with 0 as int64, which is too narrow
        good = pc.is_valid(values) if is_unsigned else pc.fill_null(pc.greater_equal(values, 0), False)
        if not pc.all(good).as_py():
            raise self._bad(name, values, good, before, "no whole number from 0")
        return as_array(pc.cast(values, pa.uint64()))

    def _types(self, values: Any, before: int) -> np.ndarray:
        """Return access types; those that DineroIV knows and a trace of reads cannot have are left to the check of rows."""
        import pyarrow.compute as pc

        words = pc.utf8_lower(pc.utf8_trim_whitespace(pc.cast(values, pa.string())))
        good = pc.fill_null(pc.is_in(words, pa.array([*_TYPES], pa.string())), False)
        if not pc.all(good).as_py():
            rule = "no access type; write 0 (read), 2 (fetch), 3 (misc) or b (prefetch)"
            raise self._bad("type", values, good, before, rule)
        numbers = words.dictionary_encode()
        table = np.array([_TYPES[word] for word in numbers.dictionary.to_pylist()], np.uint8)
        return table[as_array(numbers.indices)]

    def _bad(self, name: str, values: Any, good: Any, before: int, rule: str) -> DinError:
        at = good.index(False).as_py()
        return DinError(f"{self.stream.where}, row {before + at + 1}: {name} {values[at].as_py()!r} is {rule}")


def _names(header: bytes) -> list[str]:
    return [name.strip().strip('"') for name in header.decode("utf-8", "replace").strip().lower().split(",")]


def export_addresses(run: Run, out: Path | str, *, form: str, prefetch: str = "b") -> int:
    """Write a run as a trace of addresses, atomically; return the number of accesses written.

    Parameters
    ----------
    form : str
        ``"csv"`` (address in hexadecimal) or ``"parquet"`` (address uint32, type uint8, size uint32).
    prefetch : str
        As in ``traces.din.export_din``.
    """
    if prefetch not in PREFETCH_LABELS:
        raise DinError(f"{prefetch!r} is not an access type for prefetches; choose one of {', '.join(PREFETCH_LABELS)}")
    addresses, node_bytes, written = node_addresses(run), run.footer.tree.node_bytes, 0
    schema = pa.schema([("address", pa.uint32()), ("type", pa.uint8()), ("size", pa.uint32())])
    with whole_file(Path(out)) as temporary, open(temporary, "wb") as file:
        if form == "csv":
            file.write(b"address,type,size\n")
            for where, what in exported(run, addresses, prefetch):
                lines = zip(where.tolist(), what.tolist(), strict=True)
                file.write("".join(f"0x{address:x},{kind:x},{node_bytes}\n" for address, kind in lines).encode())
                written += where.size
            return written
        with pq.ParquetWriter(file, schema, compression="zstd") as writer:
            for where, what in exported(run, addresses, prefetch):
                sizes = np.full(where.size, node_bytes, np.uint32)
                writer.write_table(pa.table([where, what, sizes], schema=schema))
                written += where.size
    return written
