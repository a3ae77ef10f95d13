"""A run -> its footer and columns, or one sentence that says what is wrong with it.

A run is a directory of four files, or of several parts and the manifest that makes them one (``manifest``), on disk or in an
object store. Readers see one run with one numbering of rays and rows.
"""

import hashlib
import weakref
from base64 import b64encode
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from functools import lru_cache, partial
from html import escape
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from nptrace_base.places import Place, Remote, opened, place, sizes
from traces.footer import Footer, parse_footer
from traces.format import (
    ACCESSES,
    BOX,
    FILES,
    METADATA_KEY,
    NODES,
    RAYS,
    ROW_GROUP,
    SPLIT,
    RunError,
    printable,
)
from traces.identity import RunIdentity, identity_of
from traces.manifest import MANIFEST, FileFacts, Manifest, check_there, parse_manifest, verified
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

#: The exceptions that a damaged Parquet file raises.
_UNREADABLE = (OSError, ValueError, LookupError, TypeError, OverflowError, pa.ArrowException)


class Part(NamedTuple):
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


class Run:
    """A complete run, opened for reading: a ``Footer``, and arrays that are read, and checked, when asked for."""

    def __init__(self, path: Place, parts: Sequence[Part], footer: Footer, image: Callable[[], bytes], n_bytes: int) -> None:
        self.path = path
        self.footer = footer
        self.n_bytes = n_bytes
        self._parts, self._image = parts, image
        self._axis: np.ndarray | None = None  # of nodes that have been checked

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
        return self._image()

    @property
    def n_nodes(self) -> int:
        """Rows of ``nodes.parquet``."""
        return self.footer.n_nodes

    @property
    def n_accesses(self) -> int:
        """Rows of ``accesses.parquet``, prefetches included."""
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
            names = [name for name in self._parts[0].open(table).schema_arrow.names if name in _FIELDS[table]]
        wanted = {*_SCHEMAS[table].names, *names} - ({"address"} - {*names})
        if table == "rays":
            found = [self._rays(part, wanted) for part in self._parts]
            columns = found[0] if len(found) == 1 else {name: np.concatenate([each[name] for each in found]) for name in names}
        else:
            columns = self._plain(self._parts[0], table, wanted)
            check_nodes(columns, self._parts[0].files["nodes"], self.footer.tree)
            self._axis = columns["axis"]
        return {name: columns[name] for name in names}

    def _rays(self, part: Part, names: Iterable[str]) -> dict[str, np.ndarray]:
        """Return the checked columns of the rays of a part, numbered as in the run."""
        columns = self._plain(part, "rays", {*names, *RAYS.names})
        check_rays(columns, part.files["rays"], part.footer)
        for name, first in (("ray", part.first_ray), ("first", part.first_access)):
            columns[name] = _moved(columns[name], first)
        return columns

    def _plain(self, part: Part, table: str, names: Iterable[str]) -> dict[str, np.ndarray]:
        """Return whole columns, each of whose values is one of the contract's type."""
        file, path = part.open(table), part.files[table]
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
        # Not in a thread of its own beside the accesses: the two share a cache, which costs processor time.
        axis = self.columns("nodes", ["axis"])["axis"] if self._axis is None else self._axis
        allowed = kinds_allowed(axis, self.footer.tree.node_format)
        with ThreadPoolExecutor(1) as pool:
            fetched = pool.submit(self._parts[0].open, "accesses")
            for i, part in enumerate(self._parts):
                file = fetched.result()
                if i + 1 < len(self._parts):
                    fetched = pool.submit(self._parts[i + 1].open, "accesses")  # it may come from far
                yield from self._checked_part(part, file, names, allowed)

    def _checked_part(
        self, part: Part, file: pq.ParquetFile, names: tuple[str, ...], allowed: np.ndarray
    ) -> Iterator[tuple[np.ndarray, ...]]:
        path, row = part.files["accesses"], 0
        counts = self._rays(part, ["count"])["count"] if "ray" in names else None
        ends = None if counts is None else np.cumsum(counts, dtype=np.uint64)
        for read in _batches(file, sorted({*names, "node", "kind"}), path):
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


def _batches(file: pq.ParquetFile, names: list[str], path: Place) -> Iterator[pa.RecordBatch]:
    """Yield the rows of a file, of one row group after the other, ``ROW_GROUP`` rows or fewer at a time."""
    n_read = 0
    try:
        for group in range(file.num_row_groups):
            for batch in file.iter_batches(ROW_GROUP, row_groups=[group], columns=names, use_threads=False):
                n_read += batch.num_rows
                yield batch
        if n_read != file.metadata.num_rows:  # Parquet readers stop silently at a misplaced page
            raise OSError(f"{n_read} of {file.metadata.num_rows} rows can be read")
    except _UNREADABLE as e:
        raise _damaged(path, e) from e


def open_run(path: Place | str) -> Run:
    """Open a run and check that it is whole: all files, one format version, one footer, the stated row counts.

    Parameters
    ----------
    path : str, Path or Remote
        A directory, or the address of one in an object store (``nptrace_base.places``).

    Raises
    ------
    NptraceError
        The directory is missing, half-written, damaged, or of another format version; the store does not answer.
    """
    path = place(path)
    if not path.is_dir():
        raise RunError(f"{path} is not a run directory; make one with `nptrace render`, or list them with `ls traces`")
    try:
        text = (path / MANIFEST).read_bytes()
    except FileNotFoundError:
        return _open_directory(path)
    except OSError as e:
        raise _damaged(path / MANIFEST, e) from e
    manifest = parse_manifest(text, path)
    check_there(manifest, path, sizes(path))
    return Run(
        path, list(_parts(manifest, path)), manifest.footer, partial(_content, path, manifest.image),
        len(text) + sum(file.bytes for file in manifest.files),
    )  # fmt: skip


def _parts(manifest: Manifest, path: Place) -> Iterator[Part]:
    """Yield the parts that a manifest names; a file is read when it is opened, the nodes once."""
    open_nodes = lru_cache(1)(partial(_open_file, path, "nodes", manifest.nodes))
    for part, ray, access in zip(manifest.parts, manifest.first_rays, manifest.first_accesses, strict=True):
        facts = {"rays": part.rays, "accesses": part.accesses, "nodes": manifest.nodes}
        footer = replace(manifest.footer, n_rays=part.rays.rows, n_accesses=part.accesses.rows)
        openers = {table: partial(_open_file, path, table, file) for table, file in facts.items()} | {"nodes": open_nodes}
        files = {table: path / file.name for table, file in facts.items()}
        yield Part(partial(_open_table, openers), files, footer, ray, access)


def _open_table(openers: Mapping[str, Callable[[], pq.ParquetFile]], table: str) -> pq.ParquetFile:
    return openers[table]()


def _content(path: Place, file: FileFacts) -> bytes:
    """Return what a file of a run of parts holds; RunError if that is not what was written."""
    where = path / file.name
    try:
        return verified(where.read_bytes(), file, where)
    except FileNotFoundError:
        raise RunError(f"{where} is missing, and the run is made of it; render it again") from None
    except OSError as e:
        raise _damaged(where, e) from e


def _open_file(path: Place, table: str, file: FileFacts) -> pq.ParquetFile:
    where = path / file.name
    try:
        found = pq.ParquetFile(pa.BufferReader(_content(path, file)))
        schema = found.schema_arrow
    except _UNREADABLE as e:
        if isinstance(e, RunError):
            raise
        raise _damaged(where, e) from e
    _check_schema(where, schema, table)
    if found.metadata.num_rows != file.rows:
        n = found.metadata.num_rows
        raise RunError(f"{where} has {n} rows, and the run was written with {file.rows}; render it again")
    return found


def _open_directory(path: Place) -> Run:
    """Open a run of four files."""
    if isinstance(path, Remote):
        found = path.sizes()
    else:
        found = {name: (path / name).stat().st_size for name in FILES if (path / name).is_file()}
    missing = [name for name in FILES if name not in found]
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
        part = Part(files.__getitem__, {table: path / f"{table}.parquet" for table in files}, footer)
        run = Run(path, [part], footer, (path / "image.png").read_bytes, sum(found[name] for name in FILES))
        weakref.finalize(run, handles.pop_all().close)
    return run


def _open_files(path: Place, handles: ExitStack) -> tuple[dict[str, pq.ParquetFile], Footer]:
    """Return the Parquet files of a run and their footer; ``handles`` closes them."""
    files: dict[str, pq.ParquetFile] = {}
    schemas: dict[str, pa.Schema] = {}
    texts: set[bytes | None] = set()
    for name in _SCHEMAS:
        file = path / f"{name}.parquet"
        try:
            handle = handles.enter_context(opened(file))
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


def _check_schema(file: Place, found: pa.Schema, table: str) -> None:
    for name, field in _FIELDS[table].items():
        columns = found.get_all_field_indices(name)
        if not columns and name not in _SCHEMAS[table].names:
            continue  # of the other kind of tree
        if len(columns) != 1:
            raise RunError(f"{file} has {len(columns) or 'no'} columns '{name}', and a run has one; render it again")
        type_ = found.field(columns[0]).type
        if not is_convertible(type_, field.type):
            raise RunError(f"{file}, column '{name}' is of type {type_}, and not {field.type}; render the run again")


def find_runs(folder: Place | str) -> list[Place]:
    """Return the run directories directly under ``folder``, by name."""
    folder = place(folder)
    if isinstance(folder, Remote):
        return [each for each in folder.folders() if holds_run(each)]
    if not folder.is_dir():
        return []
    found = (p for p in folder.iterdir() if p.is_dir() and not p.name.startswith("."))
    return [*sorted(p for p in found if holds_run(p))]


def holds_run(folder: Place) -> bool:
    """Return whether a folder is that of a run, whole or damaged, and not one that holds runs."""
    names = (MANIFEST, *FILES)
    if isinstance(folder, Remote):
        return not folder.sizes().keys().isdisjoint(names)
    return any((folder / name).exists() for name in names)


def _damaged(path: Place, error: Exception) -> RunError:
    reason = (str(error) or type(error).__name__).splitlines()[0]
    return RunError(f"{path} is damaged ({reason}); render it again")
