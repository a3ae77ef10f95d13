"""Where a benchmark scene comes from: the user's folder, the cache, a download (from a server on this machine), a stand-in."""

import dataclasses
import hashlib
import io
import os
import tarfile
import threading
import zipfile
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest

from rtrace.scenes import catalog, downloads
from rtrace.scenes.catalog import CATALOG, find_scene, list_scenes, load_scene
from rtrace.scenes.scene import SceneError, scene_from_triangles
from rtrace.scenes.shapes import icosphere, soup

BALL = icosphere(2)


def obj(triangles):
    lines = ["v {} {} {}".format(*map(repr, map(float, corner))) for corner in triangles.reshape(-1, 3)]
    return "\n".join(lines + [f"f {3 * i + 1} {3 * i + 2} {3 * i + 3}" for i in range(len(triangles))]).encode()


def zipped(members):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return buffer.getvalue()


def tarred(members):
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w:gz") as archive:
        for name, data in members.items():
            info = tarfile.TarInfo(name)
            info.size = len(data)
            archive.addfile(info, io.BytesIO(data))
    return buffer.getvalue()


@pytest.fixture
def server():
    """A server on this machine: ``pages`` maps a path to bytes or a status; ``agents`` are the user agents that asked."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            self.server.agents.append(self.headers["User-Agent"])
            page = self.server.pages.get(self.path, 404)
            if isinstance(page, int):
                self.send_error(page)
                return
            length = len(page) + (100 if self.path in self.server.cut else 0)
            self.send_response(200)
            self.send_header("Content-Length", str(length))
            self.end_headers()
            self.wfile.write(page)

        def log_message(self, *args):
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as served:
        served.pages, served.agents, served.cut = {}, [], set()
        thread = threading.Thread(target=served.serve_forever)
        thread.start()
        served.url = f"http://127.0.0.1:{served.server_port}"
        yield served
        served.shutdown()
        thread.join()


@pytest.fixture
def ball(monkeypatch):
    """Sponza's entry, but known by the triangles of a ball."""
    entry = dataclasses.replace(
        CATALOG["sponza"],
        n_triangles=len(BALL),
        sha256=scene_from_triangles(BALL, "ball").sha256,
        bounds=((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)),
        archives=(),
    )
    monkeypatch.setitem(CATALOG, "sponza", entry)
    monkeypatch.delenv("NPTRACE_SCENES", raising=False)
    return entry


def find(tmp_path, server=None):
    said = []
    scene = find_scene(
        "sponza", notify=said.append, cache=tmp_path / "cache", download=server is not None, base_url=server and server.url
    )
    return scene, " | ".join(said)


def path_of(entry):
    return "/" + entry.url.split("/", 3)[3]


def test_a_download_is_announced_checked_kept_and_not_repeated(tmp_path, server, ball):
    server.pages[path_of(ball)] = zipped({"readme.txt": b"hello", "sub/sponza.obj": obj(BALL)})
    scene, said = find(tmp_path, server)
    np.testing.assert_array_equal(scene.triangles, BALL)
    assert (scene.name, scene.source, scene.stand_in) == ("sponza", "sponza", False)
    assert scene.camera == ball.camera
    assert scene.light == ball.light
    assert ball.licence in said
    assert ball.credit in said
    assert len(server.agents) == 1
    assert "python" not in server.agents[0].lower()
    assert [p.suffix for p in (tmp_path / "cache").iterdir()] == [".npy"]
    again, said = find(tmp_path, server)
    assert (len(server.agents), said) == (1, "")
    np.testing.assert_array_equal(again.triangles, BALL)
    assert (again.camera, again.name) == (ball.camera, "sponza")
    row = next(row for row in list_scenes(tmp_path / "cache") if row.name == "sponza")
    assert row.where.endswith(".npy")


def test_a_tar_archive_is_opened_too(tmp_path, server, ball, monkeypatch):
    entry = dataclasses.replace(ball, url="http://example.org/pub/sponza.tar.gz", member="deep/in/it/sponza.obj")
    monkeypatch.setitem(CATALOG, "sponza", entry)
    server.pages["/pub/sponza.tar.gz"] = tarred({"deep/in/it/sponza.obj": obj(BALL)})
    np.testing.assert_array_equal(find(tmp_path, server)[0].triangles, BALL)


def test_a_known_archive_is_believed_whatever_is_in_it_and_an_unknown_one_is_not(tmp_path, server, ball, monkeypatch):
    other = zipped({"sponza.obj": obj(soup(100, seed=1))})
    server.pages[path_of(ball)] = other
    scene, said = find(tmp_path, server)
    assert scene.stand_in
    assert "neither the archive" in said
    assert not (tmp_path / "cache").exists()
    known = dataclasses.replace(ball, archives=(hashlib.sha256(other).hexdigest(),))
    monkeypatch.setitem(CATALOG, "sponza", known)
    scene, _ = find(tmp_path, server)
    assert not scene.stand_in
    assert "differs from the known Sponza atrium" in scene.notes[-1]


EVIL = "../../../evil.obj"


@pytest.mark.parametrize(
    ("page", "words"),
    [
        (404, "404"),
        (503, "503"),
        (b"not an archive", "not a zip"),
        (zipped({"other.obj": obj(BALL)}), "has no sponza.obj"),
        (zipped({"sponza.obj": b"no mesh"}), "no triangle"),
        (zipped({"sponza.obj": obj(BALL)})[:-300], "zip"),
    ],
)
def test_trouble_ends_in_the_stand_in_with_a_reason_and_nothing_kept(tmp_path, server, ball, page, words):
    server.pages[path_of(ball)] = page
    scene, said = find(tmp_path, server)
    assert scene.stand_in
    assert scene.label == "sponza (stand-in)"
    assert words in said
    assert "takes its place" in said
    assert not (tmp_path / "cache").exists()


def test_a_cut_off_answer_and_no_server_are_no_crash(tmp_path, server, ball):
    server.pages[path_of(ball)] = zipped({"sponza.obj": obj(BALL)})
    server.cut.add(path_of(ball))
    scene, said = find(tmp_path, server)
    assert scene.stand_in
    assert "could not be downloaded" in said
    server.url = "http://127.0.0.1:9"
    assert find(tmp_path, server)[0].stand_in
    assert not (tmp_path / "cache").exists()


def test_paths_in_an_archive_are_never_used(tmp_path, server, ball):
    server.pages[path_of(ball)] = zipped({"../../../../sponza.obj": obj(BALL), EVIL: b"x"})
    scene, _ = find(tmp_path, server)
    np.testing.assert_array_equal(scene.triangles, BALL)
    assert sorted(os.listdir(tmp_path)) == ["cache"]


def test_huge_members_are_refused(tmp_path, server, ball, monkeypatch):
    monkeypatch.setattr(downloads, "MAX_MEMBER_BYTES", 1000)
    server.pages[path_of(ball)] = zipped({"sponza.obj": obj(BALL)})
    scene, said = find(tmp_path, server)
    assert scene.stand_in
    assert "more than 1,000" in said


def test_a_damaged_cache_is_reported_and_downloaded_again(tmp_path, server, ball):
    server.pages[path_of(ball)] = zipped({"sponza.obj": obj(BALL)})
    find(tmp_path, server)
    (file,) = (tmp_path / "cache").iterdir()
    for broken in (file.read_bytes()[:-4] + b"abcd", b"", file.read_bytes()[:100]):
        file.write_bytes(broken)
        scene, said = find(tmp_path, server)
        assert "is damaged" in said
        np.testing.assert_array_equal(scene.triangles, BALL)


def test_the_users_folder_comes_first(tmp_path, ball, monkeypatch):
    folder = tmp_path / "mine"
    folder.mkdir()
    monkeypatch.setenv("NPTRACE_SCENES", str(folder))
    assert find(tmp_path)[0].stand_in
    (folder / "sponza.zip").write_bytes(zipped({"sponza.obj": obj(BALL)}))
    np.testing.assert_array_equal(find(tmp_path)[0].triangles, BALL)
    for at in (40, 60, 200):  # a damaged archive, wherever the damage is, is said or does no harm
        broken = bytearray(zipped({"sponza.obj": obj(BALL)}))
        broken[at] ^= 0xFF
        (folder / "sponza.zip").write_bytes(broken)
        with pytest.raises(SceneError, match=r"sponza\.zip|mesh\.obj"):
            find(tmp_path)
    (folder / "sponza.obj").write_bytes(obj(soup(50, seed=3) * np.float32(100)))
    scene, _ = find(tmp_path)
    assert len(scene.triangles) == 50
    assert "not comparable" in scene.notes[-1]
    assert scene.camera != ball.camera  # another mesh in another place
    (folder / "sponza.obj").write_bytes(b"no mesh")
    with pytest.raises(SceneError, match=r"sponza\.obj"):
        find(tmp_path)
    monkeypatch.setenv("NPTRACE_SCENES", str(tmp_path / "nowhere"))
    assert "not a folder" in find(tmp_path)[1]


def test_names_files_and_neither(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bunny").write_text("a file of that name")
    (tmp_path / "ball.obj").write_bytes(obj(BALL))
    assert load_scene("ball.obj").name == "ball"
    assert load_scene("nave").name == "nave"
    for name, words in (
        ("sponzza", "did you mean sponza"),
        ("thing", "known scene"),
        ("./bunny", "unknown kind"),
        ("x.ply", "no such"),
    ):
        with pytest.raises(SceneError, match=words):
            load_scene(name)


@pytest.mark.skipif("NPTRACE_SCENES" not in os.environ, reason="compares the real meshes; NPTRACE_SCENES is not set")
@pytest.mark.parametrize("name", ["bunny", "conference", "sibenik", "sponza"])
def test_the_real_meshes_are_recognised(name):
    scene = load_scene(name)
    assert (scene.sha256, len(scene.triangles)) == (CATALOG[name].sha256, CATALOG[name].n_triangles)
    assert scene.camera == CATALOG[name].camera
    assert scene.notes == ()


def test_the_catalogue_is_consistent():
    for entry in CATALOG.values():
        assert entry.stand_in in catalog.STAND_INS
        assert (entry.url is None) == (entry.member is None)
        assert all(len(sha256) == 64 for sha256 in (entry.sha256, *entry.archives))
