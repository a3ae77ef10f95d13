"""The benchmark scenes by name: where each is found, how it is recognised, and its camera and light.

A scene comes from the folder $NPTRACE_SCENES, otherwise from the user's cache or a download; otherwise a built-in stand-in
takes its place. None of the four comes with this program: their licences are their authors'.

A downloaded archive is believed if its sha256 is one that was recorded, or if the mesh in it has exactly the triangles by
which the scene is known. Nothing half-done stays: the archive lives in a temporary folder, a cached file appears whole.
"""

import difflib
import os
import tempfile
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple
from urllib.parse import urlsplit

import numpy as np
from platformdirs import user_cache_path

from nptrace_base.atomic import replacing
from nptrace_base.folders import private_folder
from rtrace.camera import Camera, Point
from rtrace.scenes import downloads
from rtrace.scenes.mesh_file import READERS
from rtrace.scenes.scene import Scene, SceneError, load_mesh, scene_from_triangles, seen_from
from rtrace.scenes.stand_ins import STAND_INS, stand_in

Notify = Callable[[str], object]

_ARCHIVES = (".zip", ".tar.gz")


@dataclass(frozen=True)
class Entry:
    """A benchmark scene.

    Attributes
    ----------
    name, title : str
    n_triangles : int
    sha256 : str
        Of the triangles, as ``Scene.sha256``: it identifies the scene, whatever file it comes from.
    bounds : (2, 3) floats
        A mesh that fills about this box gets the catalogue's camera; any other gets a fitted one.
    camera, light : Camera and 3 floats
    camera_from : str
        Who published the camera.
    licence, credit : str
    stand_in : str
        Name of the built-in scene that takes its place.
    url, member : str or None
        An archive and the mesh in it; None for a scene that cannot be downloaded.
    archives : tuple of str
        sha256 of archives known to come from the authors, whatever their triangles.
    """

    name: str
    title: str
    n_triangles: int
    sha256: str
    bounds: tuple[Point, Point]
    camera: Camera
    light: Point
    camera_from: str
    licence: str
    credit: str
    stand_in: str
    url: str | None = None
    member: str | None = None
    archives: tuple[str, ...] = ()


_MCGUIRE = "https://casual-effects.com/g3d/data10/research/model"
_TAQU = "taqu/BoundingVolumeHierarchy, main.cpp"
_NON_COMMERCIAL = "CC BY-NC 3.0 (as the archive states): not for commercial use, name the authors"
_CONFERENCE_BOX = ((-1020.1307, -2.7924, -1055.6562), (1685.8113, 650.2925, 668.4894))
# The same view for both editions of Conference: published for this very file, and of the five sources the one that shows the
# whole table with the chairs on both sides of it. Light: below the ceiling over the middle of the room.
_CONFERENCE_CAMERA = Camera((1610.0, 356.0, -322.0), (1609.0, 356.0, -322.0), fov=60.0)
_CONFERENCE_LIGHT = (500.0, 500.0, 100.0)
_CONFERENCE_CREDIT = "Anat Grynberg and Greg Ward; Kenzie Lamar; M. McGuire, Computer Graphics Archive 2017"

_ENTRIES = (
    Entry(
        name="bunny",
        title="Stanford Bunny",
        n_triangles=69_451,
        sha256="6b43d979b823ec6dd9f5dd48145b25e16d91abb7258299bae209513474f7c536",
        bounds=((-0.09469, 0.032987, -0.061874), (0.061009, 0.187321, 0.0588)),
        # The only published camera found for this mesh; all of the bunny is in the picture. Light: above its head.
        camera=Camera((-0.12, 0.29, 0.28), (0.142497, -0.237678, -0.527869), (0.0945048, 0.847262, -0.522701), 31.417),
        light=(-0.2, 0.45, 0.1),
        camera_from="RichardBruce/RAPTor, ply_tests.cc",
        licence="Stanford 3D Scanning Repository: free for research with acknowledgement, not for commercial use",
        credit="Stanford University Computer Graphics Laboratory",
        stand_in="blob",
        url="https://graphics.stanford.edu/pub/3Dscanrep/bunny.tar.gz",
        member="bunny/reconstruction/bun_zipper.ply",
        archives=("a5720bd96d158df403d153381b8411a727a1d73cff2f33dc9b212d6f75455b84",),
    ),
    Entry(
        name="conference",
        title="Conference room",
        n_triangles=331_179,
        sha256="360f2a3348002156db16dd6f99aa624230e5d02467b19f5a3c097b76aecd88cc",
        bounds=_CONFERENCE_BOX,
        camera=_CONFERENCE_CAMERA,
        light=_CONFERENCE_LIGHT,
        camera_from=_TAQU,
        licence="public domain (as the archive states); the authors ask for credit",
        credit=_CONFERENCE_CREDIT,
        stand_in="room",
        url=f"{_MCGUIRE}/conference/conference.zip",
        member="conference.obj",
        archives=(
            "d16161ebc1ce568bacc3c34a67e9a45be3ab277bd8817173e4b6f7958f63b721",
            "3dfd86325416ec344bfb2d19290b2e3305cc862ee504a06a52ce0a0e895453f0",
        ),
    ),
    Entry(
        name="conference_repaired",
        title="Conference room, its shrunken chairs brought back to size",
        n_triangles=259_499,
        sha256="b54b8f9a54e5024e0eabe5c9e3b2cddaea605568963f4b65e92395dced36cb93",
        bounds=_CONFERENCE_BOX,
        camera=_CONFERENCE_CAMERA,
        light=_CONFERENCE_LIGHT,
        camera_from=_TAQU,
        licence="public domain; derived from conference",
        credit=_CONFERENCE_CREDIT,
        stand_in="room",
    ),
    Entry(
        name="sibenik",
        title="Sibenik cathedral",
        n_triangles=75_284,
        sha256="a42b34d2e37dfb86a4a9f1d2d06b50ba49818ea4dd275743b4b8a2f0fd861fad",
        bounds=((-20.1411, -15.3123, -8.4968), (20.1411, 15.3, 8.4968)),
        # Published for this file, and the one that shows the nave as a whole up to the altar. Light: in the crossing, so
        # that columns and arches throw shadows towards the eye; above y = 4 the vault would hide it.
        camera=Camera((-15.0, -5.0, 0.0), (-14.0, -5.2, 0.0), fov=60.0),
        light=(2.0, -4.0, -1.0),
        camera_from=_TAQU,
        licence=_NON_COMMERCIAL,
        credit="Marko Dabrovic 2002; Kenzie Lamar; M. McGuire, Computer Graphics Archive 2017",
        stand_in="nave",
        url=f"{_MCGUIRE}/sibenik/sibenik.zip",
        member="sibenik.obj",
        archives=(
            "8cd074b577b0511eae5a1d670a763cba519a17630b3df9b55ca5cfd997bf84b1",
            "b7980306d30d4cc93deb3596082cfa63831b3902e51892e386f5e3721ed06e5c",
        ),
    ),
    Entry(
        name="sponza",
        title="Sponza atrium (Dabrovic)",
        n_triangles=66_450,
        sha256="5d0a8bc0e7b0d7c8567e192f540a33635841c7c8fe45e36d427586692bb9de05",
        bounds=((-17.4028, -0.9067, -7.7985), (17.4172, 15.6533, 7.8015)),
        # The view down the length of the court from its floor, arcades on both sides. Light: in the open roof.
        camera=Camera((-11.135, 2.227, 0.558), (-10.135, 2.227, 0.558), fov=45.0),
        light=(0.0, 14.0, 0.0),
        camera_from="meistdan/hippie, test/Comparison/env.py (JCGT 2022), view 1",
        licence=_NON_COMMERCIAL,
        credit="Marko Dabrovic 2002; Kenzie Lamar; M. McGuire, Computer Graphics Archive 2017",
        stand_in="court",
        url=f"{_MCGUIRE}/dabrovic_sponza/sponza.zip",
        member="sponza.obj",
        archives=("cf2a45b1d99eb8613db88c343537ec5643d54e4a89d047ff46de635e29953248",),
    ),
)

#: The benchmark scenes, by name.
CATALOG = {entry.name: entry for entry in _ENTRIES}


class SceneRow(NamedTuple):
    """A line of ``nptrace scenes``; ``where`` is the file found on this machine, "" if there is none."""

    name: str
    title: str
    n_triangles: int
    where: str
    licence: str
    credit: str
    url: str
    stand_in: str


def list_scenes(cache: Path | None = None) -> list[SceneRow]:
    """Return each benchmark scene and where it is found; reads no mesh and downloads nothing."""
    rows = []
    for e in CATALOG.values():
        where = _in_folder(e) or _cached_file(e, cache or cache_folder()) or ""
        rows.append(SceneRow(e.name, e.title, e.n_triangles, str(where), e.licence, e.credit, e.url or "", e.stand_in))
    return rows


def load_scene(
    name: str, *, strict: bool = False, download: bool = False, notify: Notify = warnings.warn, cache: Path | None = None
) -> Scene:
    """Return the scene called ``name``: a benchmark scene, a built-in stand-in (blob, room, nave, court), or a mesh file.

    Write ./name for a file with the name of a scene. Options as for ``find_scene`` and ``load_mesh``; SceneError.
    """
    if name in CATALOG:
        return find_scene(name, strict=strict, download=download, notify=notify, cache=cache)
    if name in STAND_INS:
        return stand_in(name)
    path = Path(name)
    if path.suffix.lower() in READERS or os.path.exists(name) or os.sep in name:
        return load_mesh(path, strict=strict)._replace(source=str(path))
    known = [*CATALOG, *STAND_INS]
    near = difflib.get_close_matches(name, known, 1)
    meant = f"did you mean {near[0]}?" if near else "give one of those or a mesh file"
    raise SceneError(f"{name!r} is neither a file nor a known scene ({', '.join(known)}); {meant}")


def find_scene(
    name: str,
    *,
    strict: bool = False,
    download: bool = False,
    notify: Notify = warnings.warn,
    cache: Path | None = None,
    base_url: str | None = None,
) -> Scene:
    """Return a benchmark scene from $NPTRACE_SCENES, the cache or, with ``download``, its authors; else its stand-in.

    Parameters
    ----------
    name : str
        One of ``CATALOG``.
    notify : callable
        Called with each sentence a user should see: the licence before a download, and why a scene is missing.
    cache : Path, optional
        Folder in place of the user's cache.
    base_url : str, optional
        Server to use instead of the authors', with the same paths.

    Raises
    ------
    SceneError
        A file in $NPTRACE_SCENES cannot be used. A failing cache or download never stops a run.
    """
    entry = CATALOG[name]
    folder = os.environ.get("NPTRACE_SCENES")
    if folder and not Path(folder).is_dir():
        notify(f"NPTRACE_SCENES is {folder!r}, which is not a folder; looking elsewhere for {name}")
    own = _in_folder(entry)
    if own is not None:
        if own.suffix.lower() in READERS:
            scene = load_mesh(own, strict=strict, fans=True)
        else:
            scene = load_archive(own, entry.member or f"{name}.obj", strict=strict)
        return _present(entry, scene, str(own), notify)
    cache = cache or cache_folder()
    cached = _load_cached(entry, cache, notify)
    if cached is None and download and entry.url:
        cached = _download(entry, cache, notify, base_url)
    if cached is not None:
        return _present(entry, cached, "the downloaded mesh", notify)
    notify(
        f"{name} was not found; the built-in {entry.stand_in!r} takes its place; its numbers are not those of {entry.title}"
    )
    return stand_in(entry.stand_in)._replace(name=name, source=name, stand_in=True)


def load_archive(archive: Path, member: str, *, strict: bool = False) -> Scene:
    """Return the mesh in an archive of the user's own. Raises SceneError."""
    with tempfile.TemporaryDirectory() as folder:
        mesh = downloads.unpack(archive, member, Path(folder))
        return load_mesh(mesh, strict=strict, fans=True)  # as everybody's counts of these scenes are made


def cache_folder() -> Path:
    """Return the folder of the user's cache in which downloaded scenes are kept."""
    return Path(user_cache_path("nptrace")) / "scenes"


def _in_folder(entry: Entry) -> Path | None:
    """Return the scene's file in $NPTRACE_SCENES: a mesh or archive with its name."""
    folder = os.environ.get("NPTRACE_SCENES")
    if not folder:
        return None
    candidates = [Path(folder) / (entry.name + suffix) for suffix in (*READERS, *_ARCHIVES)]
    return next((path for path in candidates if path.is_file()), None)


def _cached_file(entry: Entry, folder: Path) -> Path | None:
    """Return the file in which an earlier download of a scene was kept, or None."""
    return next(iter(sorted(folder.glob(f"{entry.name}-*.npy"))), None)


def _load_cached(entry: Entry, folder: Path, notify: Notify) -> Scene | None:
    """Return the scene that an earlier download left in ``folder``, or None; a damaged file is reported and deleted."""
    path = _cached_file(entry, folder)
    if path is None:
        return None
    try:
        with open(path, "rb") as file:
            scene = scene_from_triangles(np.load(file, allow_pickle=False), entry.name, source=entry.name)
        if path.stem != f"{entry.name}-{scene.sha256}":
            raise SceneError("its checksum is wrong")
        return scene
    except (OSError, ValueError, EOFError) as error:
        notify(f"{path} is damaged ({error}); it is deleted")
        with suppress(OSError):
            path.unlink()
        return None


def _download(entry: Entry, folder: Path, notify: Notify, base_url: str | None) -> Scene | None:
    """Download a scene, keep its triangles in ``folder`` and return it; None, after giving the reason, if that cannot be done.

    ``base_url`` (scheme and host) replaces that of the authors.
    """
    assert entry.url is not None
    assert entry.member is not None
    url = entry.url if base_url is None else base_url.rstrip("/") + urlsplit(entry.url).path
    notify(f"downloading {entry.title} from {url}. Licence: {entry.licence}. Credit: {entry.credit}.")
    try:
        with tempfile.TemporaryDirectory() as name:
            mesh, sha256 = downloads.download(url, entry.member, Path(name))
            scene = load_mesh(mesh, fans=True)
    except (SceneError, OSError) as error:
        notify(f"{entry.name} could not be downloaded: {str(error)[:200]}")
        return None
    if sha256 not in entry.archives and scene.sha256 != entry.sha256:
        notify(f"{entry.name} was not used: neither the archive (sha256 {sha256}) nor the mesh in it is one that is known")
        return None
    try:
        private_folder(folder)
        path = folder / f"{entry.name}-{scene.sha256}.npy"
        with replacing(path) as temporary, open(temporary, "wb") as file:
            np.save(file, scene.triangles)
    except OSError as error:  # this costs a download next time, no more
        notify(f"{entry.name} could not be kept in {folder}: {error}")
    return scene


def _present(entry: Entry, scene: Scene, where: str, notify: Notify) -> Scene:
    """Return the scene under its name, seen with the catalogue's camera; a note warns if its mesh is not that."""
    notes = scene.notes
    if scene.sha256 != entry.sha256:
        notes += (
            f"{where} differs from the known {entry.title} ({len(scene.triangles):,} triangles, not {entry.n_triangles:,}, "
            "or other coordinates); results are not comparable with published ones",
        )
    scene = scene._replace(name=entry.name, source=entry.name, notes=notes)
    bounds = np.array(entry.bounds)
    if np.abs(scene.bounds - bounds).max() <= 0.05 * (bounds[1] - bounds[0]).max():
        scene = seen_from(scene, entry.camera, entry.light)
    return scene
