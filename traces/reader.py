"""A run on disk -> its metadata and columns, or one sentence that says what is wrong with it."""

import hashlib
import json
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from traces.format import ACCESSES, FILES, FORMAT_VERSION, METADATA_KEY, NODES, RAYS, RunError

#: What reading a damaged Parquet file raises.
_UNREADABLE = (OSError, ValueError, LookupError, TypeError, OverflowError, pa.ArrowException)


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
    found = (p for p in folder.iterdir() if p.is_dir() and not p.name.startswith("."))
    return sorted(p for p in found if any((p / name).exists() for name in FILES))


def _all_rows(table: pa.Table, promised: int) -> pa.Table:
    """Return the table; an OSError if rows are missing. Parquet readers end quietly where a page is not where it should be."""
    if table.num_rows != promised:
        raise OSError(f"{table.num_rows} of {promised} rows can be read")
    return table


def _damaged(path: Path, error: Exception) -> RunError:
    reason = (str(error) or type(error).__name__).splitlines()[0]
    return RunError(f"{path} is damaged ({reason}); render it again")
