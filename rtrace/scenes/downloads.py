"""Archives with a mesh, at their authors' sites or on this machine -> the mesh in a folder of the caller's."""

import tarfile
import zipfile
import zlib
from pathlib import Path
from typing import IO
from urllib.parse import urlsplit

from rtrace.scenes.mesh_file import SceneError

TIMEOUT = 10  # seconds without an answer; a study must not hang because a server does
MAX_MEMBER_BYTES = 1 << 30  # the largest mesh is 27 MB; a longer member is not the mesh

#: Errors of opening an archive: truncated, damaged, encrypted, of an unknown method.
_BAD_ARCHIVE = (OSError, EOFError, RuntimeError, NotImplementedError, tarfile.TarError, zipfile.BadZipFile, zlib.error)

# Some servers refuse Python's default agent.
_HEADERS = {"User-Agent": "nptrace (scene downloader; https tools for node-cache studies)"}


def download(url: str, member: str, folder: Path) -> tuple[Path, str]:
    """Download an archive into ``folder`` and unpack one mesh there; return its file and the archive's sha256.

    Raises SceneError, with the reason, if that cannot be done.
    """
    import pooch
    import requests

    pooch.get_logger().setLevel("ERROR")  # it would repeat the notice
    downloader = pooch.HTTPDownloader(headers=_HEADERS, timeout=TIMEOUT)
    try:
        name = Path(urlsplit(url).path).name
        archive = Path(pooch.retrieve(url, None, fname=name, path=folder, downloader=downloader))
        return _extract(archive, member, folder), pooch.file_hash(str(archive))
    except (requests.RequestException, ValueError, *_BAD_ARCHIVE) as error:
        raise SceneError(str(error).split("\n")[0] or type(error).__name__) from error


def unpack(archive: Path, member: str, folder: Path) -> Path:
    """Unpack the mesh in an archive of the user's own into ``folder``; return its file. Raises SceneError."""
    try:
        return _extract(archive, member, folder)
    except _BAD_ARCHIVE as error:
        raise SceneError(f"{archive}: cannot be unpacked ({error}); put the mesh itself beside it") from error


def _extract(archive: Path, member: str, folder: Path) -> Path:
    """Copy the wanted member to ``folder`` under a fixed name; archive paths are never used."""
    target = folder / f"mesh{Path(member).suffix}"
    wanted = Path(member).name
    if archive.name.endswith(".zip"):
        with zipfile.ZipFile(archive) as zipped:
            found = [m for m in zipped.infolist() if Path(m.filename).name == wanted and not m.is_dir()]
            _check(archive, wanted, [m.file_size for m in found])
            with zipped.open(found[0]) as source:
                _copy(source, target)
    else:
        with tarfile.open(archive) as tarred:
            members = [m for m in tarred.getmembers() if Path(m.name).name == wanted and m.isfile()]
            _check(archive, wanted, [m.size for m in members])
            opened = tarred.extractfile(members[0])
            assert opened is not None
            with opened:
                _copy(opened, target)
    return target


def _check(archive: Path, wanted: str, sizes: list[int]) -> None:
    if not sizes:
        raise SceneError(f"{archive.name} has no {wanted}")
    if sizes[0] > MAX_MEMBER_BYTES:
        raise SceneError(f"{wanted} in {archive.name} has {sizes[0]:,} bytes, more than {MAX_MEMBER_BYTES:,}")


def _copy(source: IO[bytes], target: Path) -> None:
    left = MAX_MEMBER_BYTES  # the size in the archive's directory may be a lie
    with open(target, "wb") as out:
        while piece := source.read(1 << 20):
            left -= len(piece)
            if left < 0:
                raise SceneError(f"{target.name} is longer than the archive says")
            out.write(piece)
