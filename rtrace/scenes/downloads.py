"""Benchmark scenes over the network: an archive at its authors' site -> checked triangles in the user's cache.

An archive is accepted if its sha256 is a recorded one, or if its mesh has exactly the scene's known triangles. Nothing
incomplete stays: the archive is in a temporary folder, and the cached file is renamed into place.
"""

import tarfile
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING
from urllib.parse import urlsplit

import numpy as np

from nptrace_base.atomic import replacing
from nptrace_base.folders import private_folder
from rtrace.scenes.scene import Scene, SceneError, load_mesh, scene_from_triangles

if TYPE_CHECKING:
    from rtrace.scenes.catalog import Entry

Notify = Callable[[str], object]

TIMEOUT = 10  # seconds without an answer; a study must not hang because a server does
MAX_MEMBER_BYTES = 1 << 30  # the largest mesh is 27 MB; a longer member is not the mesh

#: Errors of opening an archive: truncated, damaged, encrypted, of an unknown method.
_BAD_ARCHIVE = (OSError, EOFError, RuntimeError, NotImplementedError, tarfile.TarError, zipfile.BadZipFile, zlib.error)

# Some servers refuse Python's default agent.
_HEADERS = {"User-Agent": "nptrace (scene downloader; https tools for node-cache studies)"}


def cached_file(name: str, folder: Path) -> Path | None:
    """Return the cached file of an earlier download of a scene, or None."""
    return next(iter(sorted(folder.glob(f"{name}-*.npy"))), None)


def load_cached(entry: "Entry", folder: Path, notify: Notify) -> Scene | None:
    """Return the scene that an earlier download left in ``folder``, or None; a damaged file is reported and deleted."""
    path = cached_file(entry.name, folder)
    if path is None:
        return None
    try:
        with open(path, "rb") as file:
            scene = scene_from_triangles(np.load(file, allow_pickle=False), entry.name, source=entry.name)
        if path.stem != f"{entry.name}-{scene.sha256}":
            raise SceneError("its checksum is wrong")
        return scene
    except (OSError, ValueError, EOFError) as error:
        notify(f"{path} is damaged ({error}) and was deleted")
        with suppress(OSError):
            path.unlink()
        return None


def download(entry: "Entry", folder: Path, notify: Notify, base_url: str | None = None) -> Scene | None:
    """Download a scene, keep its triangles in ``folder`` and return it; on failure, notify of the reason and return None.

    ``base_url`` (scheme and host) replaces that of the authors.
    """
    import pooch
    import requests

    assert entry.url is not None
    assert entry.member is not None
    url = entry.url if base_url is None else base_url.rstrip("/") + urlsplit(entry.url).path
    notify(f"downloading {entry.title} from {url}. Licence: {entry.licence}. Credit: {entry.credit}.")
    pooch.get_logger().setLevel("ERROR")  # it would repeat the notice
    try:
        with tempfile.TemporaryDirectory() as name:
            downloader = pooch.HTTPDownloader(headers=_HEADERS, timeout=TIMEOUT)
            archive = Path(pooch.retrieve(url, None, fname=Path(urlsplit(url).path).name, path=name, downloader=downloader))
            sha256 = pooch.file_hash(str(archive))
            mesh = _extract(archive, entry.member, Path(name))
            scene = load_mesh(mesh, fans=True)._replace(name=entry.name, source=entry.name)
    except (requests.RequestException, ValueError, *_BAD_ARCHIVE) as error:
        reason = str(error).split("\n")[0] or type(error).__name__
        notify(f"{entry.name} could not be downloaded: {reason[:200]}")
        return None
    if sha256 not in entry.archives and scene.sha256 != entry.sha256:
        notify(f"{entry.name} was not used: neither the archive (sha256 {sha256}) nor the mesh in it is known")
        return None
    try:
        _keep(scene, folder)
    except OSError as error:  # this costs a download next time, no more
        notify(f"{entry.name} could not be stored in {folder}: {error}")
    return scene


def load_archive(archive: Path, member: str, *, strict: bool = False) -> Scene:
    """Return the mesh in one of the user's archives. Raises SceneError."""
    with tempfile.TemporaryDirectory() as name:
        try:
            mesh = _extract(archive, member, Path(name))
        except _BAD_ARCHIVE as error:
            raise SceneError(f"{archive}: cannot be unpacked ({error}); put the mesh itself beside it") from error
        return load_mesh(mesh, strict=strict, fans=True)  # as in published counts of these scenes


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


def _keep(scene: Scene, folder: Path) -> None:
    private_folder(folder)
    with replacing(folder / f"{scene.name}-{scene.sha256}.npy") as temporary, open(temporary, "wb") as file:
        np.save(file, scene.triangles)
