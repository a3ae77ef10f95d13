"""Columns of rays, accesses and nodes -> a run on disk, written atomically by separate threads."""

import ctypes
import errno
import glob
import hashlib
import os
import shutil
import stat
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from nptrace_base.atomic import is_left, new_mark
from nptrace_base.places import Place
from traces.footer import Footer, parse_footer
from traces.format import (
    ACCESSES,
    ENCODING,
    FILES,
    INNER_ADDRESS,
    METADATA_KEY,
    NODES,
    RAYS,
    ROW_GROUP,
    RunError,
    column_encoding,
)
from traces.manifest import MANIFEST, is_of_run, parse_manifest

#: Pieces waiting for the thread of a file: a chunk of accesses has some MB.
_AHEAD = 2

#: One array per column of a table, all of one length.
Columns = Mapping[str, np.ndarray]
#: Columns, or a function that makes pieces of them.
RowPieces = Columns | Callable[[], Iterable[Columns]]


def empty_column(n: int, dtype: type[np.generic]) -> np.ndarray:
    """Return n uninitialized values, for columns with millions of rows.

    They lie in Arrow's memory pool, which is reused once a row group is written. NumPy's memory would come fresh from the
    system, and zeroing that took as long as filling it.
    """
    return np.frombuffer(pa.allocate_buffer(n * np.dtype(dtype).itemsize), dtype)


class TableWriter:
    """One Parquet file, written to ``file``, that is filled in exact row groups, whatever the sizes of the pieces.

    A separate thread compresses the appended rows, so that the three files of a run are written at the same time and the
    caller continues; the arrays must not change until the run is complete.
    """

    def __init__(self, file: pa.NativeFile, schema: pa.Schema) -> None:
        self.schema = schema
        self.n_rows = 0
        self._pieces: deque[pa.Table] = deque()  # not yet written: less than a row group
        self._n_pending = 0
        self._thread = ThreadPoolExecutor(1)
        self._waiting: deque[Future[None]] = deque()
        self._file = file
        self._writer = pq.ParquetWriter(
            self._file, schema, column_encoding=column_encoding(schema), write_statistics=schema.names[:1], **ENCODING
        )

    def append(self, columns: RowPieces) -> None:
        """Append rows; a function that yields them is called by the thread."""
        self._waiting.append(self._thread.submit(self._take, columns))
        self.wait(_AHEAD)

    def wait(self, n_left: int = 0) -> None:
        """Wait until at most ``n_left`` pieces wait; raise the thread's exception."""
        while len(self._waiting) > n_left:
            self._waiting.popleft().result()

    def _take(self, columns: RowPieces) -> None:
        for each in [columns] if isinstance(columns, Mapping) else columns():
            self._add(each)

    def _add(self, columns: Columns) -> None:
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
        """Start writing the remaining rows; nothing more is appended."""
        self._waiting.append(self._thread.submit(self._write, 1))

    def close(self, footer: bytes) -> None:
        """Write the footer, when all rows are written."""
        self._thread.shutdown()
        self._writer.add_key_value_metadata({METADATA_KEY: footer})
        self._writer.close()
        self._file.close()

    def abandon(self, is_hasty: bool) -> None:
        """Close the file handle and ignore its errors: the file is about to be deleted.

        In haste the thread and its handle are abandoned; the end of the program closes them.
        """
        self._thread.shutdown(wait=not is_hasty, cancel_futures=True)
        if is_hasty:
            return
        with suppress(OSError, pa.ArrowException):
            self._writer.close()
        with suppress(OSError, pa.ArrowException):
            self._file.close()


def node_schema(footer: Footer, node_fields: list[pa.Field]) -> pa.Schema:
    """Return the schema of the table of nodes; ``node_fields`` as ``RunWriter`` takes them."""
    nodes = pa.schema([*NODES, *node_fields])
    if not footer.tree.node_format.reads_leaves:
        nodes = nodes.set(nodes.get_field_index("address"), INNER_ADDRESS)
    return nodes


class RunWriter:
    """Write one run, as a context manager: the run appears complete at the end, or not at all.

    Parameters
    ----------
    path : Path
        The run's directory. An earlier run there is replaced at the end; any other directory is refused.
    footer : Footer
        Without the counts and the picture's checksum, which are added here.
    node_fields : list of pyarrow.Field
        ``SPLIT`` or ``BOX``: the columns of ``nodes.parquet`` that depend on the tree.
    """

    def __init__(self, path: Path, footer: Footer, node_fields: list[pa.Field]) -> None:
        self.path = Path(path)
        self._real = Path(os.path.realpath(path))  # a run may be moved to another disk and linked back
        self._footer = footer
        self._node_fields = node_fields

    def __enter__(self) -> "RunWriter":
        try:
            if self._real.exists() and not looks_like_run(self._real):
                raise RunError(f"{self.path} exists and is not a run; choose another --out or remove it")
            if self._real.exists() and not os.access(self._real, os.W_OK):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
            if self.path.is_symlink() and not self._real.parent.is_dir():
                raise RunError(f"{self.path} is a link to {self._real}, whose folder is missing; choose another --out")
            self._real.parent.mkdir(parents=True, exist_ok=True)
            for path in {self.path, self._real}:
                _delete_left(path)
            self._temp = self._real.with_name(f".{self._real.name}.{new_mark()}.tmp")
            self._temp.mkdir()
        except (FileExistsError, NotADirectoryError) as e:
            raise RunError(f"cannot write {self.path}: {self.path.parent} is not a folder; choose another --out") from e
        except OSError as e:
            raise RunError(f"cannot write {self.path}: {e.strerror}; choose another --out") from e
        schemas = {"accesses": ACCESSES, "rays": RAYS, "nodes": node_schema(self._footer, self._node_fields)}
        self._tables: dict[str, TableWriter] = {}
        try:
            for name, schema in schemas.items():
                path = self._temp / f"{name}.parquet"
                file = pa.OSFile(os.fsencode(path), "wb")  # it takes no str that is not UTF-8
                self._tables[name] = TableWriter(file, schema)
        except BaseException as e:  # too many open files, no space
            self.__exit__(type(e), e, e.__traceback__)
            raise
        return self

    def append(self, table: str, columns: RowPieces) -> None:
        """Append rows to ``accesses``, ``rays`` or ``nodes``; a function that yields them is called by the file's thread."""
        self._tables[table].append(columns)

    def complete(self) -> None:
        """Start writing the remaining rows in the background."""
        for table in self._tables.values():
            table.complete()

    def image(self, png: bytes) -> None:
        """Store the picture, and its sha256 in the footers: PNG readers tend to show a damaged picture without an error."""
        (self._temp / "image.png").write_bytes(png)
        self._footer = replace(self._footer, image_sha256=hashlib.sha256(png).hexdigest())

    def __exit__(self, exc_type: type[BaseException] | None, exc: BaseException | None, tb: object) -> None:
        if exc_type is None:
            try:
                self._commit()
                return
            except BaseException as e:
                self._discard(not isinstance(e, Exception))
                if isinstance(e, OSError):
                    raise RunError(f"cannot write {self.path}: {e}; nothing was kept") from e
                raise
        self._discard(not isinstance(exc, Exception))
        if isinstance(exc, OSError) and not isinstance(exc, RunError):
            raise RunError(f"cannot write {self.path}: {exc}; nothing was kept") from exc

    def _commit(self) -> None:
        self.complete()
        for table in self._tables.values():
            table.wait()
        n_accesses, n_rays, n_nodes = (self._tables[name].n_rows for name in ("accesses", "rays", "nodes"))
        text = replace(self._footer, n_accesses=n_accesses, n_rays=n_rays, n_nodes=n_nodes).to_json()
        for table in self._tables.values():
            table.close(text)
        for _ in range(100):  # another render may put its run there, or take it away, between any two of these calls
            try:
                if not self._real.exists():
                    self._temp.rename(self._real)
                    return
                self._temp.chmod(stat.S_IMODE(self._real.stat().st_mode))
                if _exchange(self._temp, self._real):
                    _remove(self._temp)  # now the previous run
                    return
                old = self._temp.with_suffix(".old")
                self._real.rename(old)
                _remove(old)
            except OSError as e:
                if e.errno not in (errno.EEXIST, errno.ENOTEMPTY, errno.ENOENT) or not self._temp.exists():
                    raise
        raise RunError(f"cannot replace {self.path}: other programs keep writing it; choose another --out")

    def _discard(self, is_hasty: bool) -> None:
        for table in self._tables.values():
            table.abandon(is_hasty)
        shutil.rmtree(self._temp, ignore_errors=True)


def refuse_other(path: Place, footer: Footer) -> None:
    """Raise RunError if a run of other content is at ``path``: of another mesh, picture or tree than ``footer`` tells of.

    A run whose footers cannot be read is no loss; one whose footers lack something may be of another version of the program.
    """
    text, manifest = None, _manifest_text(path)
    for name in ("accesses", "rays", "nodes"):
        if manifest is None and isinstance(path, Path):
            with suppress(OSError, pa.ArrowException), pa.OSFile(os.fsencode(path / f"{name}.parquet")) as file:
                text = (pq.read_metadata(file).metadata or {}).get(METADATA_KEY)
    try:
        if manifest is not None:
            unlike = parse_manifest(manifest, path).footer.differences(footer)
        elif text is not None:
            unlike = parse_footer(text, path).differences(footer)
        else:
            return
    except RunError as e:
        raise RunError(f"{e}, with --overwrite") from e
    if unlike:
        raise RunError(
            f"{path} holds another run (of another {', '.join(unlike)}); replace it with --overwrite, "
            "or keep it with --name or another --out"
        )


def _exchange(a: Path, b: Path) -> bool:
    """Swap two directories in one step, so that a run exists at every moment; return False where the system cannot."""
    renameat2 = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None) if os.name == "posix" else None
    at_cwd, exchange = -100, 2
    return renameat2 is not None and renameat2(at_cwd, os.fsencode(a), at_cwd, os.fsencode(b), exchange) == 0


def _manifest_text(path: Place) -> bytes | None:
    try:
        return (path / MANIFEST).read_bytes()
    except OSError:
        return None


def looks_like_run(path: Place) -> bool:
    """Return whether a folder holds a run, finished or not, or nothing, and so may be replaced."""
    if not path.is_dir():
        return False
    names = {p.name for p in path.iterdir()}
    return all(map(is_of_run, names)) and (not names or not names <= {*FILES} - {"accesses.parquet"})


def _delete_left(path: Path) -> None:
    """Delete what writers that are gone have left beside ``path``; restore a run that one of them had moved aside."""
    for left in path.parent.glob(f".{glob.escape(path.name)}.*-*"):
        if left.suffix not in (".tmp", ".old") or not is_left(left, left.stem[len(path.name) + 2 :]):
            continue
        if left.suffix == ".old" and not path.exists():
            left.rename(path)
        else:
            _remove(left)


def _remove(path: Path) -> None:
    """Delete a folder and its contents, or a link but not its target."""
    if path.is_symlink():
        path.unlink(missing_ok=True)
    else:
        shutil.rmtree(path, ignore_errors=True)
