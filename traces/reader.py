"""A run on disk -> its footer and columns, or one sentence that says what is wrong with it."""

import hashlib
import os
import weakref
from base64 import b64encode
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from html import escape
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from traces.footer import Footer, parse_footer
from traces.format import (
    ACCESSES,
    BOX,
    FILES,
    METADATA_KEY,
    NODES,
    PREFETCH,
    RAYS,
    ROW_GROUP,
    SPLIT,
    RunError,
    printable,
)
from traces.identity import RunIdentity, identity_of
from traces.validation import (
    check_accesses,
    check_nodes,
    check_ray_numbers,
    check_rays,
    is_convertible,
    kinds_allowed,
    plain,
)

_SCHEMAS = {"accesses": ACCESSES, "rays": RAYS, "nodes": NODES}
_FIELDS = {name: {field.name: field for field in schema} for name, schema in _SCHEMAS.items()}
_FIELDS["nodes"] |= {field.name: field for field in (*SPLIT, *BOX)}

#: Bytes at the end of a Parquet file, after its footer: the length of the footer, and PAR1.
_TAIL = 8

#: The exceptions that a damaged Parquet file raises.
_UNREADABLE = (OSError, ValueError, LookupError, TypeError, OverflowError, pa.ArrowException)


class Run:
    """A complete run, opened for reading: a ``Footer``, and arrays that are read, and checked, when asked for."""

    def __init__(self, path: Path, files: dict[str, pq.ParquetFile], footer: Footer) -> None:
        self.path = path
        self.footer = footer
        self._files = files
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
        picture = b64encode((self.path / "image.png").read_bytes()).decode()
        return f'<table>{lines}</table><img alt="the picture of {escape(self.name)}" src="data:image/png;base64,{picture}">'

    @property
    def name(self) -> str:
        """The directory's name, ``<scene>-<tree>``."""
        return printable(self.path.name)

    @property
    def identity(self) -> RunIdentity:
        """What tells this run from others, for the rows of results."""
        return identity_of(self.footer, self.name, printable(str(self.path)))

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
        """A hash of what the Parquet files say of themselves: the facts of the run, and the place and range of all columns."""
        digest = hashlib.sha256()
        for name in _SCHEMAS:
            with (self.path / f"{name}.parquet").open("rb") as file:
                file.seek(-_TAIL, os.SEEK_END)
                n_bytes = int.from_bytes(file.read(4), "little")
                file.seek(-_TAIL - n_bytes, os.SEEK_END)
                digest.update(file.read(n_bytes))
        return digest.hexdigest()

    def part(self, number: int, n: int) -> "Run":
        """Return part ``number``, from 1 on, of ``n`` parts with about as many accesses each.

        It is a run with its own files, whose ``batches`` are those of the part. A part begins with the first access of a ray,
        the read of the root, and goes on to where the next part begins: some may be empty.
        """
        part = open_run(self.path)
        if part.footer != self.footer:
            raise RunError(f"{self.path} has changed while it was read; start again")
        first, end = (part._ray_at(i * self.footer.n_accesses // n) for i in (number - 1, number))
        part.rows = range(first, end)
        return part

    def _ray_at(self, row: int) -> int:
        """Return the first row from ``row`` on with which a ray begins, or the number of rows."""
        if row == 0:
            return 0
        rows = range(row, self.footer.n_accesses)
        for read in _batches(self._files["accesses"], ["kind", "node"], self.path / "accesses.parquet", rows):
            begins = (read.column("node").to_numpy() == 0) & (read.column("kind").to_numpy() != PREFETCH)
            if begins.any():
                return row + int(begins.argmax())
            row += read.num_rows
        return row

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
            names = [name for name in self._files[table].schema_arrow.names if name in _FIELDS[table]]
        columns = self._plain(table, {*_SCHEMAS[table].names, *names} - ({"address"} - {*names}))
        if table == "rays":
            check_rays(columns, self.path / "rays.parquet", self.footer)
        else:
            check_nodes(columns, self.path / "nodes.parquet", self.footer.tree)
            self._axis = columns["axis"]
        return {name: columns[name] for name in names}

    def _plain(self, table: str, names: Iterable[str]) -> dict[str, np.ndarray]:
        """Return whole columns, each of whose values is one of the contract's type."""
        file, path = self._files[table], self.path / f"{table}.parquet"
        try:
            read = file.read(columns=sorted(names))
            if read.num_rows != file.metadata.num_rows:  # Parquet readers stop silently at a misplaced page
                raise OSError(f"{read.num_rows} of {file.metadata.num_rows} rows can be read")
        except _UNREADABLE as e:
            raise _damaged(path, e) from e
        return {name: plain(read.column(name), _FIELDS[table][name], path) for name in read.column_names}

    def batches(self, names: tuple[str, ...] = ("node", "kind")) -> Iterator[tuple[np.ndarray, ...]]:
        """Yield the named columns of ``accesses``, checked, up to a row group at a time; the next batch is read meanwhile."""
        reading = self._checked(names)
        with ThreadPoolExecutor(1) as pool:
            ahead = pool.submit(next, reading, None)
            while (batch := ahead.result()) is not None:
                ahead = pool.submit(next, reading, None)
                yield batch

    def _checked(self, names: tuple[str, ...]) -> Iterator[tuple[np.ndarray, ...]]:
        path, row = self.path / "accesses.parquet", self.rows.start
        ends = np.cumsum(self.columns("rays", ["count"])["count"], dtype=np.uint64) if "ray" in names else None
        # Not in a thread of its own beside the accesses: the two share a cache, which costs processor time.
        axis = self.columns("nodes", ["axis"])["axis"] if self._axis is None else self._axis
        allowed = kinds_allowed(axis, self.footer.tree.node_format)
        for read in _batches(self._files["accesses"], sorted({*names, "node", "kind"}), path, self.rows):
            columns = {name: plain(read.column(name), ACCESSES.field(name), path, row) for name in read.schema.names}
            check_accesses(columns["node"], columns["kind"], allowed, path, row)
            if ends is not None:
                check_ray_numbers(columns["ray"], ends, path, row)
            row += read.num_rows
            yield tuple(columns[name] for name in names)


def _batches(file: pq.ParquetFile, names: list[str], path: Path, rows: range) -> Iterator[pa.RecordBatch]:
    """Yield some rows of a file, of one row group after the other, ``ROW_GROUP`` rows or fewer at a time."""
    start = n_read = n_passed = 0
    try:
        for group in range(file.num_row_groups):
            n_here = file.metadata.row_group(group).num_rows
            if start + n_here <= rows.start or start >= rows.stop:
                start, n_passed = start + n_here, n_passed + n_here
                continue
            for batch in file.iter_batches(ROW_GROUP, row_groups=[group], columns=names, use_threads=False):
                n_read += batch.num_rows
                first, end = max(rows.start - start, 0), min(rows.stop - start, batch.num_rows)
                if first < end:
                    yield batch.slice(first, end - first)
                start += batch.num_rows
        if n_read + n_passed != file.metadata.num_rows:  # Parquet readers stop silently at a misplaced page
            raise OSError(f"{n_read + n_passed} of {file.metadata.num_rows} rows can be read")
    except _UNREADABLE as e:
        raise _damaged(path, e) from e


def open_run(path: Path | str) -> Run:
    """Open a run and check that it is whole: all files, one format version, one footer, the stated row counts.

    Raises
    ------
    RunError
        The directory is missing, half-written, damaged, or of another format version.
    """
    path = Path(path)
    if not path.is_dir():
        raise RunError(f"{path} is not a run directory; make one with `nptrace render`, or list them with `ls traces`")
    missing = [name for name in FILES if not (path / name).is_file()]
    if missing:
        raise RunError(f"{path} is not a complete run: {', '.join(missing)} missing; render it again")
    with ExitStack() as handles:
        files, footer = _open_files(path, handles)
        try:
            image = hashlib.sha256((path / "image.png").read_bytes()).hexdigest()
        except OSError as e:
            raise _damaged(path / "image.png", e) from e
        if footer.image_sha256 not in (image, None):  # earlier versions have no checksum
            raise RunError(f"{path / 'image.png'} is damaged (its checksum is wrong); render it again")
        run = Run(path, files, footer)
        weakref.finalize(run, handles.pop_all().close)
    return run


def _open_files(path: Path, handles: ExitStack) -> tuple[dict[str, pq.ParquetFile], Footer]:
    """Return the Parquet files of a run and their footer; ``handles`` closes them."""
    files: dict[str, pq.ParquetFile] = {}
    schemas: dict[str, pa.Schema] = {}
    texts: set[bytes | None] = set()
    for name in _SCHEMAS:
        file = path / f"{name}.parquet"
        try:
            handle = handles.enter_context(file.open("rb"))  # by Python: Arrow opens only names that are UTF-8
            files[name] = pq.ParquetFile(handle, page_checksum_verification=True)
            schemas[name] = files[name].schema_arrow
            texts.add((files[name].metadata.metadata or {}).get(METADATA_KEY))
        except _UNREADABLE as e:
            raise _damaged(file, e) from e
    if None in texts:
        raise RunError(f"{path} was not written by nptrace: a Parquet footer has no '{METADATA_KEY.decode()}' entry")
    if len(texts) > 1:
        raise RunError(f"{path} mixes the files of different runs; render it again")
    footer = parse_footer(texts.pop() or b"", path)
    for name, file in files.items():
        _check_schema(path / f"{name}.parquet", schemas[name], name)
        promised = getattr(footer, f"n_{name}")
        if file.metadata.num_rows != promised:
            raise RunError(
                f"{path / name}.parquet has {file.metadata.num_rows} rows, its footer says {promised}; render it again"
            )
    return files, footer


def _check_schema(file: Path, found: pa.Schema, table: str) -> None:
    for name, field in _FIELDS[table].items():
        columns = found.get_all_field_indices(name)
        if not columns and name not in _SCHEMAS[table].names:
            continue  # of the other kind of tree
        if len(columns) != 1:
            raise RunError(f"{file} has {len(columns) or 'no'} columns '{name}', and a run has one; render it again")
        type_ = found.field(columns[0]).type
        if not is_convertible(type_, field.type):
            raise RunError(f"{file}, column '{name}' is of type {type_}, and not {field.type}; render the run again")


def find_runs(folder: Path | str) -> list[Path]:
    """Return the run directories directly under ``folder``, by name."""
    folder = Path(folder)
    if not folder.is_dir():
        return []
    found = (p for p in folder.iterdir() if p.is_dir() and not p.name.startswith("."))
    return sorted(p for p in found if any((p / name).exists() for name in FILES))


def _damaged(path: Path, error: Exception) -> RunError:
    reason = (str(error) or type(error).__name__).splitlines()[0]
    return RunError(f"{path} is damaged ({reason}); render it again")
