"""A run on disk: schema, writer and reader. Ray and node columns in, record batches out; imports neither stage.

A run is one directory with four files (``traces/README.md`` describes every column):

    accesses.parquet   one row per node access, in the order the hardware would issue them
    rays.parquet       one row per ray, in the order they were shot
    nodes.parquet      one row per tree node
    image.png          the picture that was traced

Node *numbers* are stored, not addresses: the address is chosen at replay. The footer of each Parquet file has the same
metadata under the key ``nptrace``, without a time stamp, so the same command gives the same bytes.
"""

import ctypes
import errno
import hashlib
import json
import os
import secrets
import shutil
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from traces.whole import is_alive

FORMAT_VERSION = 1
ROW_GROUP = 1 << 18  # rows: a page, which is one column of them, is 2 MB at most
METADATA_KEY = b"nptrace"

#: The kinds of an access. 0-2 are the demand stream (the paper's configuration A); with 3 it is configuration B.
READ, PUSH, LEAF, PREFETCH = range(4)

#: The types of a ray.
PRIMARY, SHADOW = range(2)


def _field(name: str, type_: pa.DataType, meaning: str) -> pa.Field:
    return pa.field(name, type_, nullable=False, metadata={"meaning": meaning})


ACCESSES = pa.schema(
    [
        _field("ray", pa.uint32(), "number of the ray, ascending"),
        _field("node", pa.uint32(), "number of the node read or requested"),
        _field("kind", pa.uint8(), "0 read; 1 read, one child pushed; 2 leaf entered; 3 pre-fetch request"),
    ]
)
RAYS = pa.schema(
    [
        _field("ray", pa.uint32(), "number of the ray: its row"),
        _field("x", pa.uint16(), "pixel column, 0 at the left"),
        _field("y", pa.uint16(), "pixel row, 0 at the top"),
        _field("type", pa.uint8(), "0 primary; 1 shadow"),
        _field("first", pa.uint64(), "row of its first access in accesses.parquet"),
        _field("count", pa.uint32(), "number of its accesses, pre-fetches included"),
        _field("prim", pa.int32(), "triangle hit (shadow: the occluder found), -1 for none"),
        _field("t", pa.float32(), "ray parameter of the hit, infinity for none"),
    ]
)
NODES = pa.schema(
    [
        _field("node", pa.uint32(), "number of the node: its row"),
        _field("parent", pa.int32(), "number of its parent, -1 for the root"),
        _field("level", pa.uint16(), "steps from the root"),
        _field("axis", pa.uint8(), "split axis 0, 1, 2; 3 for a leaf"),
        _field("n_prims", pa.uint32(), "triangles in the leaf; 0 for an inner node or an empty leaf"),
        _field("address", pa.uint64(), "byte address as stored: node number x node size"),
    ]
)
SPLIT = [_field("split", pa.float32(), "kd-tree: position of the split plane; NaN for a leaf")]
BOX = [_field(f"{end}_{axis}", pa.float32(), "BVH: the node's box") for axis in "xyz" for end in ("min", "max")]

FILES = ("accesses.parquet", "rays.parquet", "nodes.parquet", "image.png")

# Measured: neighbouring rays repeat whole paths, which zstd finds in plain numbers if a page is long enough, and which a
# dictionary or a delta would hide from it; the usual 20,000 rows a page took twice the bytes. All other columns are
# written faster than plain with their bytes split, and most are smaller; differences took longer.
ENCODING: dict[str, Any] = {
    "compression": "zstd",
    "compression_level": 1,
    "use_dictionary": False,
    "data_page_size": 1 << 22,
    "max_rows_per_page": ROW_GROUP,
    "write_batch_size": 1 << 16,
    "write_page_checksum": True,
}


def column_encoding(schema: pa.Schema) -> dict[str, str]:
    """Return the columns whose bytes are split: all but the two that zstd has to see as they are."""
    return {name: "BYTE_STREAM_SPLIT" for name in schema.names if schema is not ACCESSES or name == "kind"}


def empty_column(n: int, dtype: type[np.generic]) -> np.ndarray:
    """Return n values not set yet, for columns that are handed over by the million.

    They lie in Arrow's memory, which is used again once a row group is written. NumPy's would come fresh from the system, and
    zeroing that took as long as filling it.
    """
    return np.frombuffer(pa.allocate_buffer(n * np.dtype(dtype).itemsize), dtype)


#: What reading a damaged Parquet file raises.
_UNREADABLE = (OSError, ValueError, LookupError, TypeError, OverflowError, pa.ArrowException)


#: Pieces handed over and not yet taken, per file: a chunk of accesses is some MB.
_AHEAD = 2

#: One array per column of a table, all of one length.
Columns = Mapping[str, np.ndarray]


class RunError(ValueError):
    """A directory that is not a readable run; the message says what is wrong and what to do."""


class _Table:
    """One Parquet file that is filled in exact row groups, whatever the sizes of the pieces handed over.

    A thread of its own compresses what is appended, so that the three files of a run are written at the same time
    and the caller goes on; the arrays must not change until the run is whole.
    """

    def __init__(self, path: Path, schema: pa.Schema) -> None:
        self.schema = schema
        self.n_rows = 0
        self._pieces: deque[pa.Table] = deque()  # taken and not yet written: less than a row group
        self._n_pending = 0
        self._thread = ThreadPoolExecutor(1)
        self._waiting: deque[Future[None]] = deque()
        self._writer = pq.ParquetWriter(
            path, schema, column_encoding=column_encoding(schema), write_statistics=schema.names[:1], **ENCODING
        )

    def append(self, columns: Columns | Callable[[], Columns]) -> None:
        self._waiting.append(self._thread.submit(self._take, columns))
        self.wait(_AHEAD)

    def wait(self, n_left: int = 0) -> None:
        """Wait until at most ``n_left`` pieces are not taken yet; raise what went wrong."""
        while len(self._waiting) > n_left:
            self._waiting.popleft().result()

    def _take(self, columns: Columns | Callable[[], Columns]) -> None:
        if not isinstance(columns, Mapping):
            columns = columns()
        piece = pa.Table.from_arrays([pa.array(columns[name]) for name in self.schema.names], schema=self.schema)
        self._pieces.append(piece)
        self.n_rows += len(piece)
        self._n_pending += len(piece)
        self._write(ROW_GROUP)

    def _write(self, least: int) -> None:
        """Write row groups while at least so many rows wait; the pieces are joined without copying them."""
        while self._n_pending >= least:
            group, n = [], min(self._n_pending, ROW_GROUP)
            self._n_pending -= n
            while n:
                piece = self._pieces.popleft()
                if len(piece) > n:
                    self._pieces.appendleft(piece.slice(n))
                group.append(piece.slice(0, n))
                n -= len(group[-1])
            self._writer.write_table(pa.concat_tables(group), row_group_size=ROW_GROUP)

    def complete(self) -> None:
        """Have what is left written; nothing more is appended."""
        self._waiting.append(self._thread.submit(self._write, 1))

    def close(self, metadata: bytes) -> None:
        """Write the footer, when all rows are written."""
        self._thread.shutdown()
        self._writer.add_key_value_metadata({METADATA_KEY: metadata})
        self._writer.close()

    def abandon(self) -> None:
        """Close the file handle and ignore what it says: the file is about to be deleted."""
        self._thread.shutdown(cancel_futures=True)
        with suppress(OSError, pa.ArrowException):
            self._writer.close()


class RunWriter:
    """Write one run; as a context manager the run appears whole at the end, or not at all.

    Parameters
    ----------
    path : Path
        The run's directory. An earlier run there is replaced at the end; any other directory is refused.
    metadata : dict
        JSON values for the footers: scene, camera, tree, order, command. The counts and the format version are added here.
    node_fields : list of pyarrow.Field
        ``SPLIT`` or ``BOX``: the columns of ``nodes.parquet`` that depend on the tree.
    """

    def __init__(self, path: Path, metadata: Mapping[str, Any], node_fields: list[pa.Field]) -> None:
        self.path = Path(path)
        self._metadata = dict(metadata)
        self._node_fields = node_fields

    def __enter__(self) -> "RunWriter":
        if self.path.exists() and not _looks_like_run(self.path):
            raise RunError(f"{self.path} exists and is not a run; choose another --out or remove it")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            _sweep(self.path)
            self._temp = self.path.parent / f".{self.path.name}.{os.getpid()}-{secrets.token_hex(4)}.tmp"
            self._temp.mkdir()
        except OSError as e:
            raise RunError(f"cannot write {self.path}: {e.strerror}; choose another --out") from e
        self._tables: dict[str, _Table] = {}
        for name, schema in (("accesses", ACCESSES), ("rays", RAYS)):
            self._tables[name] = _Table(self._temp / f"{name}.parquet", schema)
        nodes = pa.schema([*NODES, *self._node_fields])
        self._tables["nodes"] = _Table(self._temp / "nodes.parquet", nodes)
        return self

    def append(self, table: str, columns: Columns | Callable[[], Columns]) -> None:
        """Append rows to ``accesses``, ``rays`` or ``nodes``; a function that makes them is called by the file's thread."""
        self._tables[table].append(columns)

    def complete(self) -> None:
        """Have what is left of all rows written, while the caller goes on; for a caller with something else to do."""
        for table in self._tables.values():
            table.complete()

    def image(self, png: bytes) -> None:
        """Store the picture, and its sha256 in the footers: PNG readers tend to show what is left of a damaged one."""
        (self._temp / "image.png").write_bytes(png)
        self._metadata["image_sha256"] = hashlib.sha256(png).hexdigest()

    def __exit__(self, exc_type: type[BaseException] | None, exc: BaseException | None, tb: object) -> None:
        if exc_type is None:
            try:
                self._commit()
                return
            except BaseException as e:
                self._discard()
                if isinstance(e, OSError):
                    raise RunError(f"cannot write {self.path}: {e}; nothing was kept") from e
                raise
        self._discard()
        if isinstance(exc, OSError) and not isinstance(exc, RunError):
            raise RunError(f"cannot write {self.path}: {exc}; nothing was kept") from exc

    def _commit(self) -> None:
        self.complete()
        for table in self._tables.values():
            table.wait()
        counts = {f"n_{name}": table.n_rows for name, table in self._tables.items()}
        metadata = {"format_version": FORMAT_VERSION, **self._metadata, **counts}
        text = json.dumps(metadata, sort_keys=True).encode()
        for table in self._tables.values():
            table.close(text)
        for _ in range(100):  # another render may put its run there, or take it away, between any two of these calls
            try:
                if not self.path.exists():
                    self._temp.rename(self.path)
                    return
                if _exchange(self._temp, self.path):
                    shutil.rmtree(self._temp, ignore_errors=True)  # now the earlier run
                    return
                old = self._temp.with_suffix(".old")
                self.path.rename(old)
                shutil.rmtree(old, ignore_errors=True)
            except OSError as e:
                if e.errno not in (errno.EEXIST, errno.ENOTEMPTY, errno.ENOENT) or not self._temp.exists():
                    raise
        raise RunError(f"cannot replace {self.path}: other programs keep writing it; choose another --out")

    def _discard(self) -> None:
        for table in self._tables.values():
            table.abandon()
        shutil.rmtree(self._temp, ignore_errors=True)


def _exchange(a: Path, b: Path) -> bool:
    """Swap two directories in one step, so that there is a run at every moment; return False where that cannot be done."""
    renameat2 = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None) if os.name == "posix" else None
    at_cwd, exchange = -100, 2
    return renameat2 is not None and renameat2(at_cwd, os.fsencode(a), at_cwd, os.fsencode(b), exchange) == 0


def _looks_like_run(path: Path) -> bool:
    if not path.is_dir():
        return False
    names = {p.name for p in path.iterdir()}
    return names <= set(FILES) and (not names or "accesses.parquet" in names)


def _sweep(path: Path) -> None:
    """Delete what killed processes left beside ``path``; put back a run that was moved aside when its writer was killed."""
    for left in path.parent.glob(f".{path.name}.*-*"):
        pid = left.name[len(path.name) + 2 :].partition("-")[0]
        if left.suffix not in (".tmp", ".old") or not pid.isdigit() or is_alive(int(pid)):
            continue
        if left.suffix == ".old" and not path.exists():
            left.rename(path)
        else:
            shutil.rmtree(left, ignore_errors=True)


class Run:
    """A complete run, opened for reading. ``metadata`` is the footer's JSON; the arrays are read when asked for."""

    def __init__(self, path: Path, files: dict[str, pq.ParquetFile], metadata: dict[str, Any]) -> None:
        self.path = path
        self.metadata = metadata
        self._files = files

    @property
    def name(self) -> str:
        """The directory's name, ``<scene>-<tree>``."""
        return self.path.name

    @property
    def n_accesses(self) -> int:
        """Rows of ``accesses.parquet``, pre-fetches included."""
        return int(self.metadata["n_accesses"])

    def columns(self, table: str, names: list[str] | None = None) -> dict[str, np.ndarray]:
        """Read whole columns of ``rays`` or ``nodes`` (or of a small ``accesses``) as NumPy arrays."""
        try:
            read = _all_rows(self._files[table].read(columns=names), self._files[table].metadata.num_rows)
        except _UNREADABLE as e:
            raise _damaged(self.path / f"{table}.parquet", e) from e
        return {name: read.column(name).to_numpy() for name in read.column_names}

    def batches(self, names: tuple[str, ...] = ("node", "kind")) -> Iterator[tuple[np.ndarray, ...]]:
        """Yield the named columns of ``accesses`` row group by row group; the next group is decoded meanwhile."""
        file = self._files["accesses"]
        n_groups = file.num_row_groups

        def read(group: int) -> tuple[np.ndarray, ...]:
            table = file.read_row_group(group, columns=list(names), use_threads=False)
            _all_rows(table, file.metadata.row_group(group).num_rows)
            return tuple(table.column(name).to_numpy() for name in names)

        with ThreadPoolExecutor(1) as pool:
            ahead = pool.submit(read, 0) if n_groups else None
            for group in range(n_groups):
                assert ahead is not None
                try:
                    batch = ahead.result()
                except _UNREADABLE as e:
                    raise _damaged(self.path / "accesses.parquet", e) from e
                ahead = pool.submit(read, group + 1) if group + 1 < n_groups else None
                yield batch


def open_run(path: Path | str) -> Run:
    """Open a run and check that it is whole: all files, one format version, one metadata, the stated row counts.

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
    files: dict[str, pq.ParquetFile] = {}
    schemas: dict[str, pa.Schema] = {}
    texts: set[bytes | None] = set()
    for name in ("accesses", "rays", "nodes"):
        file = path / f"{name}.parquet"
        try:
            files[name] = pq.ParquetFile(file, page_checksum_verification=True)
            schemas[name] = files[name].schema_arrow
            texts.add((files[name].metadata.metadata or {}).get(METADATA_KEY))
        except _UNREADABLE as e:
            raise _damaged(file, e) from e
    if None in texts:
        raise RunError(f"{path} was not written by nptrace: a Parquet footer has no '{METADATA_KEY.decode()}' entry")
    if len(texts) > 1:
        raise RunError(f"{path} mixes the files of different runs; render it again")
    try:
        metadata = json.loads(texts.pop() or b"")
        version = metadata["format_version"]
        promised = {name: int(metadata[f"n_{name}"]) for name in files}
    except (ValueError, TypeError, KeyError, RecursionError) as e:
        raise _damaged(path, e) from e
    if version != FORMAT_VERSION:
        raise RunError(f"{path} has format version {version}, this program reads {FORMAT_VERSION}; render it again")
    for name, file in files.items():
        found = dict(zip(schemas[name].names, schemas[name].types, strict=True))
        for field in {"accesses": ACCESSES, "rays": RAYS, "nodes": NODES}[name]:
            if found.get(field.name) != field.type:
                raise RunError(f"{path / name}.parquet has no {field.type} column '{field.name}'; render it again")
        if file.metadata.num_rows != promised[name]:
            raise RunError(
                f"{path / name}.parquet has {file.metadata.num_rows} rows, its footer says {promised[name]}; render it again"
            )
    try:
        image = hashlib.sha256((path / "image.png").read_bytes()).hexdigest()
    except OSError as e:
        raise _damaged(path / "image.png", e) from e
    if metadata.get("image_sha256", image) != image:  # runs of earlier versions do not say
        raise RunError(f"{path / 'image.png'} is damaged (its checksum is wrong); render it again")
    return Run(path, files, metadata)


def find_runs(folder: Path | str) -> list[Path]:
    """Return the run directories directly under ``folder``, by name."""
    folder = Path(folder)
    if not folder.is_dir():
        return []
    found = (p for p in folder.iterdir() if p.is_dir() and not p.name.startswith((".", "_")))
    return sorted(p for p in found if any((p / name).exists() for name in FILES))


def _all_rows(table: pa.Table, promised: int) -> pa.Table:
    """Return the table; an OSError if rows are missing. Parquet readers end quietly where a page is not where it should be."""
    if table.num_rows != promised:
        raise OSError(f"{table.num_rows} of {promised} rows can be read")
    return table


def _damaged(path: Path, error: Exception) -> RunError:
    reason = (str(error) or type(error).__name__).splitlines()[0]
    return RunError(f"{path} is damaged ({reason}); render it again")
