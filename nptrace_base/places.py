"""Where a run is: a local path, or an address in an object store -> files that can be read, written whole, listed, deleted.

``place`` alone decides which of the two a text means. ``Remote`` has the methods of a ``Path`` that readers of runs use; the
functions below write, list and delete in both. Keys and passwords are taken from the environment, never from an address: an
address is printed, stored in results and sent to workers.
"""

import math
import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import IO, Any
from urllib.parse import parse_qsl, unquote, urlencode, urlsplit

from nptrace_base.atomic import replacing
from nptrace_base.errors import NptraceError

#: The schemes of object stores, and the parameters that an address may have: none of them is a secret.
SCHEMES = {
    **dict.fromkeys(("s3",), ("region", "scheme", "endpoint_override")),
    **dict.fromkeys(("gs", "gcs"), ("scheme", "endpoint_override", "project_id", "retry_limit_seconds")),
    **dict.fromkeys(("abfs", "abfss"), (
        "enable_tls", "blob_storage_authority", "dfs_storage_authority", "blob_storage_scheme", "dfs_storage_scheme",
    )),
}  # fmt: skip
_FROM = {
    "s3": "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or a profile",
    "gs": "GOOGLE_APPLICATION_CREDENTIALS",
    "gcs": "GOOGLE_APPLICATION_CREDENTIALS",
    "abfs": "AZURE_CLIENT_ID and AZURE_CLIENT_SECRET, or a login",
    "abfss": "AZURE_CLIENT_ID and AZURE_CLIENT_SECRET, or a login",
}

_URI = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):/(/?)(.*)", re.DOTALL)

#: Characters of what a store answers that a message repeats.
_REASON = 300

#: Bytes of one request when a large file is copied.
_PIECE = 1 << 26


class PlaceError(NptraceError):
    """An address that cannot be used, or a store that does not answer; the message states the reason and the way out."""


@dataclass(frozen=True)
class Remote:
    """A file or folder in an object store; made by ``place``, and pickled as its four texts.

    Attributes
    ----------
    scheme, authority, path, query : str
        The parts of its address; ``path`` has no slash at its ends.
    """

    scheme: str
    authority: str
    path: str
    query: str = ""

    def __str__(self) -> str:
        path, query = (f"{mark}{text}" * bool(text) for mark, text in (("/", self.path), ("?", self.query)))
        return f"{self.scheme}://{self.authority}{path}{query}"

    def __truediv__(self, name: str) -> "Remote":
        return replace(self, path=f"{self.path}/{name}" if self.path else name)

    @property
    def name(self) -> str:
        """The last part of its path."""
        return self.path.rpartition("/")[2] or self.authority

    @property
    def parent(self) -> "Remote":
        """The folder that it is in."""
        return replace(self, path=self.path.rpartition("/")[0])

    def exists(self) -> bool:
        """Return whether there is a file, or a folder that holds one."""
        return self._info().type.name != "NotFound"

    def is_dir(self) -> bool:
        """Return whether it is a folder, which is where a file lies below it."""
        return self._info().type.name == "Directory"

    def is_file(self) -> bool:
        """Return whether it is a file."""
        return self._info().type.name == "File"

    def iterdir(self) -> Iterator["Remote"]:
        """Yield what lies in a folder, by name."""
        yield from (self / name for name in sorted(each.base_name for each in self.listed()))

    def folders(self) -> list["Remote"]:
        """Return the folders in a folder, by name; one request."""
        return [self / name for name in sorted(each.base_name for each in self.listed() if each.type.name == "Directory")]

    def read_bytes(self) -> bytes:
        """Return a file's content; two requests, for its size and its bytes. FileNotFoundError if there is none."""
        with _asked(self, "read"), self._filesystem().open_input_file(self._at()) as file:
            return file.read()

    def copy_to(self, sink: IO[bytes]) -> None:
        """Write a file's content to ``sink``."""
        with _asked(self, "read"), self._filesystem().open_input_file(self._at()) as file:
            while piece := file.read(_PIECE):
                sink.write(piece)

    def publish(self, pieces: Iterable[Any]) -> None:
        """Write a file: other programs see all of it, or what was there before.

        A stream that an exception ends is published all the same, with what it holds. So the content goes to another name
        first, and the store copies it to this one when all of it has arrived.
        """
        filesystem, path = self._filesystem(), self._at()
        upload, n_bytes = f"{path}.{os.urandom(4).hex()}.upload", 0
        with _asked(self, "write"):
            if filesystem.type_name not in ("s3", "gcs", "abfs"):  # where a folder is more than a part of a name
                filesystem.create_dir(path.rpartition("/")[0])
            try:
                with filesystem.open_output_stream(upload) as stream:
                    for piece in pieces:
                        n_bytes += stream.write(piece)
                if (arrived := filesystem.get_file_info(upload).size) != n_bytes:
                    raise OSError(f"{arrived} of {n_bytes} bytes arrived")
                filesystem.copy_file(upload, path)
            finally:
                with suppress(OSError):
                    filesystem.delete_file(upload)

    def unlink(self, missing_ok: bool = False) -> None:
        """Delete a file."""
        try:
            with _asked(self, "delete"):
                self._filesystem().delete_file(self._at())
        except FileNotFoundError:
            if not missing_ok:
                raise

    def _filesystem(self) -> Any:
        with _asked(self, "reach"):
            return filesystem_of(self.scheme, self.authority, self.query)[0]

    def _at(self) -> str:
        """Return the path in the filesystem."""
        base = filesystem_of(self.scheme, self.authority, self.query)[1]
        return "/".join(filter(None, (base, self.path)))

    def _info(self) -> Any:
        with _asked(self, "read"):
            return self._filesystem().get_file_info(self._at())

    def listed(self) -> list[Any]:
        """Return Arrow's facts of all that lies in a folder; one request for a thousand of them, nothing if there is none."""
        from pyarrow.fs import FileSelector

        with _asked(self, "list"):
            found: list[Any] = self._filesystem().get_file_info(FileSelector(self._at(), allow_not_found=True))
        return found


Place = Path | Remote


def place(given: "Place | str | os.PathLike[str]") -> Place:
    """Return where a text points: an address of an object store, or a local path, also written file:///....

    Raises
    ------
    PlaceError
        An address of another kind, or with a user, a password or a key in it.
    """
    if isinstance(given, Remote):
        return given
    text = os.fspath(given)
    found = _URI.fullmatch(text)
    scheme = found[1].lower() if found else ""
    if found is None or not (found[2] or (isinstance(given, Path) and scheme in (*SCHEMES, "file"))):
        return Path(given)
    rest = found[3]  # a Path has lost one of the slashes
    if scheme == "file":
        if found[2] and not rest.startswith("/"):
            raise PlaceError(f"{text} names the host {rest.partition('/')[0]!r}; write file:/// and an absolute path")
        return Path(unquote(f"/{rest.lstrip('/')}"))
    if scheme not in SCHEMES:
        raise PlaceError(f"{scheme}:// is not a store of runs; give a path, or an address of {', '.join(SCHEMES)} or file")
    before, _, query = rest.partition("?")
    authority, _, path = before.partition("/")
    return _checked(Remote(scheme, authority, path.strip("/"), query))


def _checked(remote: Remote) -> Remote:
    """Return an address without secrets; PlaceError otherwise, which does not repeat them."""
    user, _, host = remote.authority.rpartition("@")
    shown = f"{remote.scheme}://{host}/{remote.path}".rstrip("/")
    harmless = user in (("", "anonymous") if remote.scheme in ("gs", "gcs") else ("",))
    if not (harmless or (remote.scheme in ("abfs", "abfss") and ":" not in user)):  # there it is the container
        raise PlaceError(
            f"{shown} was given with a user or a password before its @; leave them out: keys come from the environment "
            f"({_FROM[remote.scheme]})"
        )
    if not host:
        raise PlaceError(f"{remote.scheme}:// names no bucket; write e.g. {remote.scheme}://bucket/folder")
    for name, value in parse_qsl(remote.query, keep_blank_values=True):
        if name not in SCHEMES[remote.scheme] or "@" in value:
            raise PlaceError(
                f"{shown} was given with the parameter {name[:40]!r}; an address takes {', '.join(SCHEMES[remote.scheme])}, "
                f"and keys come from the environment ({_FROM[remote.scheme]})"
            )
    return remote


@cache
def filesystem_of(scheme: str, authority: str, query: str) -> tuple[Any, str]:
    """Return the pyarrow filesystem of an address, made once, and the path in it where the address's own begins."""
    from pyarrow.fs import FileSystem

    given = dict(parse_qsl(query))
    if scheme == "s3":
        given = _from_environment() | given
    filesystem, base = FileSystem.from_uri(f"{scheme}://{authority}/" + (f"?{urlencode(given)}" if given else ""))
    return filesystem, base.strip("/")


def _from_environment() -> dict[str, str]:
    """Return the parameters of an S3 address that are set in the environment, as Amazon's own programs read them."""
    found = {}
    if own := os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL"):
        url = urlsplit(own if "://" in own else f"https://{own}")
        # Without a region Arrow asks Amazon for the one of the bucket, whatever the endpoint.
        found = {"endpoint_override": url.netloc.rpartition("@")[2], "scheme": url.scheme, "region": "us-east-1"}
    if region := os.environ.get("AWS_REGION") or os.environ.get("AWS_DEFAULT_REGION"):
        found["region"] = region
    return found


@contextmanager
def _asked(remote: Remote, what: str) -> Iterator[None]:
    """Turn what a store answers into one sentence; that there is no such file is an exception of its own."""
    try:
        yield
    except (FileNotFoundError, NptraceError):
        raise
    except Exception as e:
        from pyarrow import ArrowException

        if not isinstance(e, (OSError, ArrowException)):
            raise
        reason = (str(e) or type(e).__name__).splitlines()[0]
        if len(reason) > _REASON:
            reason = f"{reason[:_REASON]} ..."
        raise PlaceError(f"cannot {what} {remote}: {reason}; check the address, and the keys in the environment") from e


def publish(where: Place, *pieces: Any) -> None:
    """Write a file whole or not at all; a local one is renamed at the end, and its folder is made."""
    if isinstance(where, Remote):
        where.publish(pieces)
        return
    where.parent.mkdir(parents=True, exist_ok=True)
    with replacing(where) as temporary, open(temporary, "wb") as file:
        for piece in pieces:
            file.write(piece)


def sizes(folder: Place) -> dict[str, int]:
    """Return the bytes of each file in a folder; nothing if there is no folder."""
    return {name: size for name, size, _ in _files(folder)}


def older(folder: Place, moment: float) -> set[str]:
    """Return the names of the files in a folder that were last written before a moment, in seconds since 1970."""
    return {name for name, _, written in _files(folder) if written < moment}


def _files(folder: Place) -> Iterator[tuple[str, int, float]]:
    """Yield the name of each file in a folder, its bytes, and when it was last written."""
    if isinstance(folder, Remote):
        for each in folder.listed():
            if each.type.name == "File":
                yield each.base_name, each.size, math.inf if each.mtime_ns is None else each.mtime_ns / 1e9
        return
    with suppress(FileNotFoundError, NotADirectoryError), os.scandir(folder) as entries:
        for entry in entries:
            with suppress(FileNotFoundError):  # another process has just deleted this one
                if entry.is_file():
                    facts = entry.stat()
                    yield entry.name, facts.st_size, facts.st_mtime


@contextmanager
def opened(where: Place) -> Iterator[IO[bytes]]:
    """Open a file for reading: a local one by Python, as Arrow opens only names that are UTF-8; of a remote one a copy."""
    if isinstance(where, Path):
        with where.open("rb") as file:
            yield file
        return
    import tempfile

    with tempfile.TemporaryFile() as copy:
        where.copy_to(copy)
        copy.seek(0)
        yield copy
