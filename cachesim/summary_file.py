"""Summary files: the summary of a part of a run on disk, and the files of all parts -> the results of the whole run.

A file is Arrow IPC, compressed with zstd: a row for each array of the summary (``cachesim.summary``), with its name, NumPy
type and bytes. The metadata of its schema is JSON: the version of the format, the run with its digest, the rows of the part,
what was asked, digests of the code that counted, and a checksum of the arrays; beside it stands the checksum of that text.
"""

import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from cachesim.config import CacheConfig
from cachesim.parts import code_of
from cachesim.replay import Replay
from cachesim.result import Result
from cachesim.summary import About, of_prefix, prefixed
from nptrace_base.atomic import whole_file
from nptrace_base.errors import NptraceError
from traces.identity import RunIdentity
from traces.reader import Run

#: Raised when what the file holds changes.
FORMAT_VERSION = 3

_KEY, _KEY_SUM = b"nptrace summary", b"nptrace summary sha256"
_SCHEMA = pa.schema([("name", pa.string()), ("type", pa.string()), ("data", pa.large_binary())])
_UNREADABLE = (OSError, ValueError, LookupError, TypeError, pa.ArrowException)


@dataclass(frozen=True)
class Asked:
    """A question and the layout under which it is asked."""

    layout: str
    question: Replay


class _Part(NamedTuple):
    """The metadata of a file."""

    path: Path
    run: dict[str, Any]
    rows: range
    asked: list[dict[str, Any]]
    code: list[str]
    sha256: str


def write_part(path: Path, part: Run, asked: Sequence[Asked], summaries: Sequence[Any]) -> int:
    """Write the summaries of a part of a run, one for each question; return the bytes of the file."""
    arrays = {
        name: array for i, summary in enumerate(summaries) for name, array in prefixed(str(i), summary.arrays()).items()
    }  # fmt: skip
    rows = [(name, array.dtype.str, array.tobytes()) for name, array in arrays.items()]
    of = {"identity": asdict(part.identity), "digest": part.digest, "n_rays": part.footer.n_rays}
    metadata = {
        "format_version": FORMAT_VERSION,
        "run": of | {"n_accesses": part.footer.n_accesses},
        "rows": [part.rows.start, part.rows.stop],
        "asked": [asdict(each) for each in asked],
        "code": [code_of(each.question) for each in asked],
        "sha256": _checksum(rows),
    }
    text = json.dumps(metadata).encode()
    schema = _SCHEMA.with_metadata({_KEY: text, _KEY_SUM: hashlib.sha256(text).hexdigest().encode()})
    with whole_file(path) as temporary:
        options = pa.ipc.IpcWriteOptions(compression="zstd")
        with temporary.open("wb") as file, pa.ipc.new_file(file, schema, options=options) as writer:
            writer.write_table(pa.table([*map(list, zip(*rows, strict=True))], schema=schema))
        return temporary.stat().st_size


def combine(paths: Iterable[Path]) -> list[Result]:
    """Return the results of a run from the files of all its parts, in any order, as the replay of the run has them.

    Raises
    ------
    NptraceError
        A file is damaged, of another format version, run or question, or counted by other sources of this program; accesses
        are missing or in two files.
    """
    parts = sorted((_metadata(path) for path in paths), key=lambda part: (part.rows.start, part.rows.stop))
    if not parts:
        raise NptraceError("there are no summaries to combine; name the files that npcache summarise wrote")
    first = parts[0]
    _check(parts)
    asked = [_asked(first, each) for each in first.asked]
    code = [code_of(each.question) for each in asked]
    whole: list[Any] = []
    for part in parts:
        if part.code != code:
            raise NptraceError(
                f"{part.path} was counted by other sources of nptrace than those of this command; combine it with the version "
                "that made it, or make it again with npcache summarise"
            )
        arrays = _arrays(part)
        summaries = [each.question.begin(None) for each in asked]
        try:
            for i, summary in enumerate(summaries):
                summary.load(of_prefix(str(i), arrays))
        except _UNREADABLE as e:
            raise _damaged(part.path, e) from e
        whole = [one.then(other) for one, other in zip(whole, summaries, strict=True)] if whole else summaries
    identity, n_rays = RunIdentity(**first.run["identity"]), first.run["n_rays"]
    return [
        result
        for each, summary in zip(asked, whole, strict=True)
        for result in each.question.finished(summary, About(identity, each.layout, n_rays))
    ]  # fmt: skip


def _asked(part: _Part, values: dict[str, Any]) -> Asked:
    try:
        question = values["question"]
        configs = tuple(CacheConfig(**config) for config in question["configs"])
        return Asked(values["layout"], Replay(**(question | {"configs": configs})))
    except _UNREADABLE as e:
        raise _damaged(part.path, e) from e


def _check(parts: Sequence[_Part]) -> None:
    """Raise NptraceError unless parts in order are one run, answer one question, and leave no row out and none twice."""
    first, row, before = parts[0], 0, parts[0]
    for part in parts:
        if part.run["digest"] != first.run["digest"]:
            raise NptraceError(
                f"{part.path} is a part of the run {part.run['identity']['run']} and {first.path} one of "
                f"{first.run['identity']['run']}, and these are different runs; combine the parts of one run"
            )
        if part.asked != first.asked:
            raise NptraceError(
                f"{part.path} and {first.path} answer different questions; give every npcache summarise the same options"
            )
        if not part.rows:  # with more parts than rays
            continue
        if part.rows.start < row:
            raise NptraceError(f"{before.path} and {part.path} both have access {part.rows.start}; name each part once")
        if part.rows.start > row:
            raise NptraceError(f"accesses {row} to {part.rows.start - 1} are in no file; name the summary of every part")
        row, before = part.rows.stop, part
    if row != first.run["n_accesses"]:
        raise NptraceError(
            f"accesses {row} to {first.run['n_accesses'] - 1} are in no file; name the summary of every part"
        )  # fmt: skip


def _metadata(path: Path) -> _Part:
    try:
        with path.open("rb") as file:
            found = pa.ipc.open_file(file).schema.metadata or {}
        text = found[_KEY]
        values = json.loads(text)
        version = values["format_version"]
        if version != FORMAT_VERSION:
            raise NptraceError(f"{path} has format version {version}, and this program reads {FORMAT_VERSION}; make it again")
        if hashlib.sha256(text).hexdigest().encode() != found[_KEY_SUM]:
            raise ValueError("the checksum of its metadata is wrong")
        return _Part(path, values["run"], range(*values["rows"]), values["asked"], values["code"], values["sha256"])
    except NptraceError:
        raise
    except _UNREADABLE as e:
        raise _damaged(path, e) from e


def _arrays(part: _Part) -> dict[str, np.ndarray]:
    try:
        with part.path.open("rb") as file:
            table = pa.ipc.open_file(file).read_all()
        table.validate(full=True)  # Arrow takes the places of texts in a file as they are
        rows = list(zip(*(table.column(name).to_pylist() for name in _SCHEMA.names), strict=True))
        if _checksum(rows) != part.sha256:
            raise ValueError("its checksum is wrong")
        return {name: np.frombuffer(data, type_) for name, type_, data in rows}
    except _UNREADABLE as e:
        raise _damaged(part.path, e) from e


def _checksum(rows: Iterable[tuple[str, str, bytes]]) -> str:
    """Return the sha256 of the rows of a file, in hexadecimal: names, types and contents of arrays."""
    digest = hashlib.sha256()
    for name, type_, data in rows:
        digest.update(f"{name} {type_} {len(data)}\n".encode() + data)
    return digest.hexdigest()


def _damaged(path: Path, error: Exception) -> NptraceError:
    reason = getattr(error, "strerror", None) or (str(error) or type(error).__name__).splitlines()[0]
    return NptraceError(f"{path} is not a readable summary ({reason}); make it again with npcache summarise")
