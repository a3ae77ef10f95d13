"""A place -> the run there, whole and of one version, or one sentence that says what is wrong with it.

A run is a directory of four files, or of several parts and the manifest that makes them one (``manifest``), on disk or in an
object store.
"""

import hashlib
import os
import weakref
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from functools import lru_cache, partial
from typing import IO, Any

import pyarrow as pa
import pyarrow.parquet as pq

from nptrace_base.places import Place, Remote, opened, place, sizes
from traces.footer import Footer, parse_footer
from traces.format import FILES, METADATA_KEY, RunError
from traces.manifest import MANIFEST, FileFacts, Manifest, check_there, is_of_run, parse_manifest, verified
from traces.run import FIELDS, SCHEMAS, UNREADABLE, PartFiles, RunFiles, damaged
from traces.run import Run as Run
from traces.validation import is_convertible

#: Bytes at the end of a Parquet file, after its footer: the length of the footer, and PAR1.
_TAIL = 8


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
        raise damaged(path / MANIFEST, e) from e
    manifest = parse_manifest(text, path)
    check_there(manifest, path, sizes(path))
    n_bytes = len(text) + sum(file.bytes for file in manifest.files)
    digest = hashlib.sha256(text).hexdigest()

    def opened() -> Run:  # again without a request: whatever is read later has to have the manifest's checksums
        image = partial(_content, path, manifest.image)
        return Run(path, manifest.footer, RunFiles(list(_parts(manifest, path)), image, n_bytes, digest, opened))

    return opened()


def _parts(manifest: Manifest, path: Place) -> Iterator[PartFiles]:
    """Yield the parts that a manifest names; a file is read when it is opened, the nodes once.

    Of the accesses the last two stay: a part of a run looks for its first ray in one of them, and for its end in the other.
    """
    open_nodes = lru_cache(1)(partial(_open_file, path, "nodes", manifest.nodes))
    open_accesses = lru_cache(2)(partial(_open_file, path, "accesses"))
    for part, ray, access in zip(manifest.parts, manifest.first_rays, manifest.first_accesses, strict=True):
        facts = {"rays": part.rays, "accesses": part.accesses, "nodes": manifest.nodes}
        footer = replace(manifest.footer, n_rays=part.rays.rows, n_accesses=part.accesses.rows)
        openers: dict[str, Callable[[], Any]] = {
            "rays": partial(_open_file, path, "rays", part.rays), "accesses": partial(open_accesses, part.accesses),
            "nodes": open_nodes,
        }  # fmt: skip
        files = {table: path / file.name for table, file in facts.items()}
        yield PartFiles(partial(_open_table, openers), files, footer, ray, access)


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
        raise damaged(where, e) from e


def _open_file(path: Place, table: str, file: FileFacts) -> pq.ParquetFile:
    where = path / file.name
    try:
        found = pq.ParquetFile(pa.BufferReader(_content(path, file)))
        schema = found.schema_arrow
    except UNREADABLE as e:
        if isinstance(e, RunError):
            raise
        raise damaged(where, e) from e
    _check_schema(where, schema, table)
    if found.metadata.num_rows != file.rows:
        n = found.metadata.num_rows
        raise RunError(f"{where} has {n} rows, and the run was written with {file.rows}; render it again")
    return found


def _open_directory(path: Place) -> Run:
    """Open a run of four files."""
    if isinstance(path, Remote):
        found = sizes(path)
    else:
        found = {name: (path / name).stat().st_size for name in FILES if (path / name).is_file()}
    missing = [name for name in FILES if name not in found]
    if missing:
        raise RunError(f"{path} is not a complete run: {', '.join(missing)} missing; render it again")
    with ExitStack() as handles:
        files, footer, digest = _open_files(path, handles)
        try:
            image = hashlib.sha256((path / "image.png").read_bytes()).hexdigest()
        except OSError as e:
            raise damaged(path / "image.png", e) from e
        if footer.image_sha256 not in (image, None):  # earlier versions have no checksum
            raise RunError(f"{path / 'image.png'} is damaged (its checksum is wrong); render it again")
        part = PartFiles(files.__getitem__, {table: path / f"{table}.parquet" for table in files}, footer)
        n_bytes = sum(found[name] for name in FILES)
        image_of, reopen = (path / "image.png").read_bytes, partial(open_run, path)
        run = Run(path, footer, RunFiles([part], image_of, n_bytes, digest, reopen))
        weakref.finalize(run, handles.pop_all().close)
    return run


def _metadata_of(file: IO[bytes]) -> bytes:
    """Return the footer of a Parquet file."""
    file.seek(-_TAIL, os.SEEK_END)
    n_bytes = int.from_bytes(file.read(4), "little")
    file.seek(-_TAIL - n_bytes, os.SEEK_END)
    return file.read(n_bytes)


def _open_files(path: Place, handles: ExitStack) -> tuple[dict[str, pq.ParquetFile], Footer, str]:
    """Return the Parquet files of a run, their footer and a hash of their metadata; ``handles`` closes them."""
    files: dict[str, pq.ParquetFile] = {}
    schemas: dict[str, pa.Schema] = {}
    texts: set[bytes | None] = set()
    digest = hashlib.sha256()
    for name in SCHEMAS:
        file = path / f"{name}.parquet"
        try:
            handle = handles.enter_context(opened(file))
            files[name] = pq.ParquetFile(handle, page_checksum_verification=True)
            schemas[name] = files[name].schema_arrow
            texts.add((files[name].metadata.metadata or {}).get(METADATA_KEY))
            digest.update(_metadata_of(handle))  # now, as another run may take the place of these files
        except UNREADABLE as e:
            raise damaged(file, e) from e
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
    return files, footer, digest.hexdigest()


def _check_schema(file: Place, found: pa.Schema, table: str) -> None:
    for name, field in FIELDS[table].items():
        columns = found.get_all_field_indices(name)
        if not columns and name not in SCHEMAS[table].names:
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
    names = sizes(folder).keys()
    tables = {name for name in names if name.endswith(".parquet") and is_of_run(name)}  # a picture proves nothing
    return not tables.isdisjoint(FILES) or (MANIFEST in names and bool(tables))
