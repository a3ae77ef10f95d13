"""An open run: its footer, its columns and its accesses batch by batch, checked as they are read.

Readers see one run with one numbering of rays and rows, whether it is a directory of four files or of several parts.
"""

from base64 import b64encode
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from html import escape
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from nptrace_base.places import Place
from traces.arrow_arrays import as_array
from traces.footer import Footer
from traces.format import ACCESSES, BOX, NODES, PREFETCH, RAYS, ROW_GROUP, SPLIT, RunError, printable
from traces.identity import RunIdentity, identity_of
from traces.validation import check_accesses, check_nodes, check_ray_numbers, check_rays, kinds_allowed, plain

#: Each table's schema, and the fields that it may have by name.
SCHEMAS = {"accesses": ACCESSES, "rays": RAYS, "nodes": NODES}
FIELDS = {name: {field.name: field for field in schema} for name, schema in SCHEMAS.items()}
FIELDS["nodes"] |= {field.name: field for field in (*SPLIT, *BOX)}

#: Rows of a batch where the first ray from a row on is looked for.
_FEW = 1 << 14

#: The exceptions that a damaged Parquet file raises.
UNREADABLE = (OSError, ValueError, LookupError, TypeError, OverflowError, pa.ArrowException)


class PartFiles(NamedTuple):
    """A stretch of a run's rays, with files of its own, in which rays and rows are numbered from 0.

    Attributes
    ----------
    open : callable
        Returns the Parquet file of a table, ``rays`` or ``accesses``; of the first part also ``nodes``.
    files : mapping
        Table -> the file, for messages.
    footer : Footer
        With the part's numbers of rays and accesses.
    first_ray, first_access : int
        What is added to the numbers of its rays and rows.
    """

    open: Callable[[str], pq.ParquetFile]
    files: Mapping[str, Place]
    footer: Footer
    first_ray: int = 0
    first_access: int = 0

    def rows_of(self, rows: range) -> range:
        """Return which of its rows are among those of the run."""
        first, n = self.first_access, self.footer.n_accesses
        return range(min(max(rows.start - first, 0), n), min(max(rows.stop - first, 0), n))


class RunFiles(NamedTuple):
    """What a run is read from.

    Attributes
    ----------
    parts : sequence of PartFiles
        In the order of their rays.
    image : callable
        Returns the picture, a PNG file.
    n_bytes : int
        Of all files.
    digest : str
        As ``Run.digest``, of what was opened.
    reopen : callable
        Returns the run, with file handles of its own.
    """

    parts: Sequence[PartFiles]
    image: Callable[[], bytes]
    n_bytes: int
    digest: str
    reopen: Callable[[], "Run"]


class Run:
    """A complete run, opened for reading: a ``Footer``, and arrays that are read, and checked, when asked for."""

    def __init__(self, path: Place, footer: Footer, files: RunFiles) -> None:
        self.path, self.footer, self.n_bytes = path, footer, files.n_bytes
        self._files, self._parts = files, files.parts
        self._axis: np.ndarray | None = None  # of nodes that have been checked
        self.rows = range(footer.n_accesses)

    def __repr__(self) -> str:
        of = self.identity
        scene = f"{of.scene} (stand-in)" if of.stand_in else of.scene
        return f"<Run {of.path}: {scene}, {of.tree}, {of.pixels}, {self.footer.n_rays:,} rays, {self.n_accesses:,} accesses>"

    def _repr_html_(self) -> str:
        """Return the facts and the picture, for notebooks."""
        facts = {name: value for name, value in self.identity.to_dict().items() if value is not None}
        facts |= {"rays": f"{self.footer.n_rays:,}", "accesses": f"{self.n_accesses:,}", "nodes": f"{self.n_nodes:,}"}
        lines = "".join(f"<tr><th>{escape(name)}</th><td>{escape(str(value))}</td></tr>" for name, value in facts.items())
        picture = b64encode(self.image()).decode()
        return f'<table>{lines}</table><img alt="the picture of {escape(self.name)}" src="data:image/png;base64,{picture}">'

    @property
    def name(self) -> str:
        """The directory's name, ``<scene>-<tree>``."""
        return printable(self.path.name)

    @property
    def identity(self) -> RunIdentity:
        """What tells this run from others, for the rows of results."""
        return identity_of(self.footer, self.name, printable(str(self.path)))

    def image(self) -> bytes:
        """Return the picture, a PNG file."""
        return self._files.image()

    @property
    def n_nodes(self) -> int:
        """Rows of ``nodes.parquet``."""
        return self.footer.n_nodes

    @property
    def n_accesses(self) -> int:
        """Rows of ``accesses.parquet``, prefetches included; of a part, those of the part, which are ``rows``."""
        return len(self.rows)

    @property
    def digest(self) -> str:
        """A hash of what the files say of themselves: the facts of the run, and the place and range of all columns."""
        return self._files.digest

    def part(self, number: int, n: int) -> "Run":
        """Return part ``number``, from 1 on, of ``n`` parts with about as many accesses each.

        It is a run with its own files, whose ``batches`` are those of the part. A part begins with the first access of a ray,
        the read of the root, and goes on to where the next part begins: some may be empty.
        """
        part = self._files.reopen()
        if (part.footer, part.digest) != (self.footer, self.digest):
            raise RunError(f"{self.path} has changed while it was read; start again")
        part._axis = self._axis  # of the same nodes
        first, end = (part._ray_at(i * self.footer.n_accesses // n) for i in (number - 1, number))
        part.rows = range(first, end)
        return part

    def _ray_at(self, row: int) -> int:
        """Return the first row from ``row`` on with which a ray begins, or the number of rows."""
        for part in self._parts:
            first, n = part.first_access, part.footer.n_accesses
            if row <= first:
                return first  # as a part does
            if row >= first + n:
                continue
            rows = range(row - first, n)
            for read in _batches(part.open("accesses"), ["kind", "node"], part.files["accesses"], rows, _FEW):
                begins = (as_array(read.column("node")) == 0) & (as_array(read.column("kind")) != PREFETCH)
                if begins.any():
                    return row + int(begins.argmax())
                row += read.num_rows
        return self.footer.n_accesses

    def columns(self, table: str, names: list[str] | None = None) -> dict[str, np.ndarray]:
        """Read whole columns of ``rays`` or ``nodes`` (or of a small ``accesses``) as NumPy arrays.

        The other columns of the contract are read and checked too: some errors show only in several columns together.
        """
        if table == "accesses":
            names = names or ACCESSES.names
            batches = list(self.batches(tuple(names)))
            empty = {name: np.empty(0, ACCESSES.field(name).type.to_pandas_dtype()) for name in names}
            return {name: np.concatenate([empty[name], *(batch[i] for batch in batches)]) for i, name in enumerate(names)}
        if names is None:
            names = [name for name in self._parts[0].open(table).schema_arrow.names if name in FIELDS[table]]
        wanted = {*SCHEMAS[table].names, *names} - ({"address"} - {*names})
        if table == "rays":
            found = [self._rays(part, wanted) for part in self._parts]
            columns = found[0] if len(found) == 1 else {name: np.concatenate([each[name] for each in found]) for name in names}
        else:
            columns = self._plain(self._parts[0], table, wanted)
            check_nodes(columns, self._parts[0].files["nodes"], self.footer.tree)
            self._axis = columns["axis"]
        return {name: columns[name] for name in names}

    def _rays(self, part: PartFiles, names: Iterable[str]) -> dict[str, np.ndarray]:
        """Return the checked columns of the rays of a part, numbered as in the run."""
        columns = self._plain(part, "rays", {*names, *RAYS.names})
        check_rays(columns, part.files["rays"], part.footer)
        for name, first in (("ray", part.first_ray), ("first", part.first_access)):
            columns[name] = _moved(columns[name], first)
        return columns

    def _plain(self, part: PartFiles, table: str, names: Iterable[str]) -> dict[str, np.ndarray]:
        """Return whole columns, each of whose values is one of the contract's type."""
        file, path = part.open(table), part.files[table]
        try:
            read = file.read(columns=sorted(names))
            if read.num_rows != file.metadata.num_rows:  # Parquet readers stop silently at a misplaced page
                raise OSError(f"{read.num_rows} of {file.metadata.num_rows} rows can be read")
        except UNREADABLE as e:
            raise damaged(path, e) from e
        return {name: plain(read.column(name), FIELDS[table][name], path) for name in read.column_names}

    def batches(self, names: tuple[str, ...] = ("node", "kind")) -> Iterator[tuple[np.ndarray, ...]]:
        """Yield the named columns of ``accesses``, checked, up to a row group at a time; the next batch is read meanwhile."""
        reading = self._checked(names)
        with ThreadPoolExecutor(1) as pool:
            ahead = pool.submit(next, reading, None)
            while (batch := ahead.result()) is not None:
                ahead = pool.submit(next, reading, None)
                yield batch

    def _checked(self, names: tuple[str, ...]) -> Iterator[tuple[np.ndarray, ...]]:
        # Not in a thread of its own beside the accesses: the two share a cache, which costs processor time.
        axis = self.columns("nodes", ["axis"])["axis"] if self._axis is None else self._axis
        allowed = kinds_allowed(axis, self.footer.tree.node_format)
        stretches = [(part, rows) for part in self._parts if len(rows := part.rows_of(self.rows))]
        with ThreadPoolExecutor(1) as pool:
            fetched = [pool.submit(part.open, "accesses") for part, _ in stretches[:1]]
            for i, (part, rows) in enumerate(stretches):
                file = fetched.pop().result()
                fetched = [pool.submit(later.open, "accesses") for later, _ in stretches[i + 1 : i + 2]]  # maybe from far
                yield from self._checked_part(part, rows, file, names, allowed)

    def _checked_part(
        self, part: PartFiles, rows: range, file: pq.ParquetFile, names: tuple[str, ...], allowed: np.ndarray
    ) -> Iterator[tuple[np.ndarray, ...]]:
        path, row = part.files["accesses"], rows.start
        counts = self._rays(part, ["count"])["count"] if "ray" in names else None
        ends = None if counts is None else np.cumsum(counts, dtype=np.uint64)
        for read in _batches(file, sorted({*names, "node", "kind"}), path, rows):
            columns = {name: plain(read.column(name), ACCESSES.field(name), path, row) for name in read.schema.names}
            check_accesses(columns["node"], columns["kind"], allowed, path, row)
            if ends is not None:
                check_ray_numbers(columns["ray"], ends, path, row)
                columns["ray"] = _moved(columns["ray"], part.first_ray)
            row += read.num_rows
            yield tuple(columns[name] for name in names)


def _moved(numbers: np.ndarray, first: int) -> np.ndarray:
    """Return numbers of a part as those of the run."""
    if not first:
        return numbers
    moved = numbers + numbers.dtype.type(first)
    moved.flags.writeable = False  # as Arrow's arrays: Numba would compile separate code for others
    return moved


def _batches(
    file: pq.ParquetFile, names: list[str], path: Place, rows: range, at_a_time: int = ROW_GROUP
) -> Iterator[pa.RecordBatch]:  # fmt: skip
    """Yield some rows of a file, of one row group after the other, ``at_a_time`` or fewer; what follows is not decoded."""
    start = n_read = n_passed = 0
    try:
        for group in range(file.num_row_groups):
            n_here = file.metadata.row_group(group).num_rows
            if start + n_here <= rows.start or start >= rows.stop:
                start, n_passed = start + n_here, n_passed + n_here
                continue
            of_group, n_wanted = start, min(n_here, rows.stop - start)
            for batch in file.iter_batches(
                min(at_a_time, n_wanted), row_groups=[group], columns=names, use_threads=False
            ):  # fmt: skip
                n_read += batch.num_rows
                first, end = max(rows.start - start, 0), min(rows.stop - start, batch.num_rows)
                if first < end:
                    yield batch.slice(first, end - first)
                start += batch.num_rows
                if start >= of_group + n_wanted:
                    n_passed += of_group + n_here - start
                    start = of_group + n_here
                    break
        if n_read + n_passed != file.metadata.num_rows:  # Parquet readers stop silently at a misplaced page
            raise OSError(f"{n_read + n_passed} of {file.metadata.num_rows} rows can be read")
    except UNREADABLE as e:
        raise damaged(path, e) from e


def damaged(path: Place, error: Exception) -> RunError:
    """Return the error of a file that cannot be read."""
    reason = (str(error) or type(error).__name__).splitlines()[0]
    return RunError(f"{path} is damaged ({reason}); render it again")
