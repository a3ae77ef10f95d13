"""Where kernels and trees are kept: nowhere that others may write, never those of other sources; failures stop nothing."""

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from nptrace_base import compiling, jit, source_files
from nptrace_base.folders import private_folder
from nptrace_base.jit import _Files
from rtrace.trees import tree_cache

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("nptrace", "nptrace_base", "rtrace", "cachesim", "traces")
SOURCES = [ROOT / "cli.py", *(path for package in PACKAGES for path in ROOT.glob(f"{package}/**/*.py"))]
DIN = "0 1000\n0 2000\nb 3000\n0 3000\n"


def kinds_of_folders(tmp_path):
    """Yield (folder, whether it may be used)."""
    for mode, is_good in ((0o700, True), (0o755, True), (0o775, False), (0o757, False), (0o1777, False)):
        folder = tmp_path / f"{mode:o}"
        folder.mkdir()
        folder.chmod(mode)
        yield folder, is_good
    (tmp_path / "link").symlink_to(tmp_path / "700")
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere")
    (tmp_path / "file").write_text("")
    yield tmp_path / "link", False
    yield tmp_path / "dangling", False
    yield tmp_path / "file", False
    yield tmp_path / "new" / "and" / "deep", True
    if os.geteuid() == 0:
        (tmp_path / "theirs").mkdir(mode=0o700)
        os.chown(tmp_path / "theirs", 65534, 65534)
        yield tmp_path / "theirs", False


def test_only_a_folder_of_ours_that_nobody_else_may_write_to_is_private(tmp_path, monkeypatch):
    for folder, is_good in kinds_of_folders(tmp_path):
        if is_good:
            private_folder(folder)
            assert folder.is_dir()
        else:
            with pytest.raises(OSError):
                private_folder(folder)
    assert not (tmp_path / "nowhere").exists()
    for made in ("new", "new/and", "new/and/deep"):
        assert (tmp_path / made).stat().st_mode & 0o777 == 0o700
    monkeypatch.setattr(os, "geteuid", lambda: 4711)
    with pytest.raises(OSError, match="another user"):
        private_folder(tmp_path / "700")


def test_kernels_are_kept_in_the_first_private_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(jit.tempfile, "tempdir", None)
    spare = tmp_path / f"nptrace-kernels-{os.geteuid()}"
    for folder, is_good in kinds_of_folders(tmp_path):
        monkeypatch.setenv("NUMBA_CACHE_DIR", str(folder))
        found = jit.cache_folder.__wrapped__()
        assert found.parent == (folder if is_good else spare)
        assert found.stat().st_mode & 0o777 == 0o700 == spare.stat().st_mode & 0o777 if spare.exists() else is_good
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/proc/none")
    spare.chmod(0o777)
    monkeypatch.setattr(compiling, "lost", {})
    said = []
    monkeypatch.setattr(compiling, "announce", said.append)
    assert jit.cache_folder.__wrapped__() is None
    assert said == [
        f"kernels could not be kept in /proc/none (No such file or directory) or {spare} "
        "(others may write to it, which `chmod go-w` forbids): they are made again each time"
    ]


def replay(tmp_path, *, limit=None, **environment):
    (tmp_path / "x.din").write_text(DIN)
    code = "import cli; cli.npcache()"
    if limit:
        code = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit})); {code}"
    command = [sys.executable, "-c", code, "replay", "x.din", "--format", "csv"]
    # Python 3.11 keeps the half of a compiled file that a limit of sizes leaves, and cannot import it later.
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1", **environment}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[1].startswith("x.din,x.din,,,,,,,,,,,,,,,,8192,1,32,lru,,traced,stored,own,never,3,2,")
    *lines, last = done.stderr.splitlines()
    assert "accesses read in" in last
    return lines


def test_a_full_folder_stops_nothing(tmp_path):
    lines = replay(tmp_path, limit=1000, NUMBA_CACHE_DIR=str(tmp_path / "full"))
    assert len(lines) == 2 and lines[0].startswith("compiling for this machine, once")
    assert lines[1].startswith(f"kernels could not be kept in {tmp_path}/full/") and "(File too large)" in lines[1]
    assert [p for p in (tmp_path / "full").rglob("*") if "tmp" in p.name] == []


@pytest.mark.slow
def test_a_damaged_kernel_is_compiled_again(tmp_path):
    kept = {"NUMBA_CACHE_DIR": str(tmp_path / "kept")}
    replay(tmp_path, **kept)
    files = [p for p in (tmp_path / "kept").rglob("*") if p.is_file()]
    assert len(files) > 4
    for i, path in enumerate(files):
        path.write_bytes(path.read_bytes()[:-20] if i % 2 else b"\x80\x05garbage")
    assert replay(tmp_path, **kept)[0].startswith("compiling for this machine")
    assert replay(tmp_path, **kept) == []


def test_signatures_have_files_of_their_own(tmp_path):
    """Two processes that compile them at a time do not meet, as they would in an index of one kernel's files."""
    one, other = (_Files(str(tmp_path), "kernel-1.py311", "source") for _ in range(2))
    keys = [(numba.typeof(value), ("cpu",), ("code",)) for value in (1, 1.5)]
    one.save(keys[0], "integers")
    other.save(keys[1], "floats")
    assert [one.load(key) for key in keys] == [other.load(key) for key in keys] == ["integers", "floats"]
    assert _Files(str(tmp_path), "kernel-1.py311", "other source").load(keys[0]) is None
    shutil.copy(one._path(keys[0]), one._path(keys[1]))
    assert other.load(keys[1]) is None  # what is in a file decides, not its name
    one.flush()
    assert list(tmp_path.iterdir()) == []


def test_importing_touches_no_folder(tmp_path):
    code = "import rtrace.render, cachesim.replay, cachesim.sampling.estimate, numba; print(numba.config.CACHE_DIR)"
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(tmp_path / "kept"), "TMPDIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout == f"{tmp_path}/kept\n"
    assert os.listdir(tmp_path) == []


DIGESTS = """
from nptrace_base.jit import kernel_digest, _stamp
from rtrace.trees.tree_cache import _builder_digest
from nptrace_base.source_files import ROOT
print(kernel_digest(), _builder_digest(), _stamp(ROOT / "cachesim/source.py"), _stamp(ROOT / "cachesim/replacement.py"))
"""


@pytest.fixture(scope="module")
def digests(tmp_path_factory):
    """Return a function: a file, a text and another -> the digests of the project with that replaced."""
    folder = tmp_path_factory.mktemp("project")
    for path in SOURCES:
        copy = folder / path.relative_to(ROOT)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, copy)

    def found(file=None, old="", new=""):
        path = folder / file if file else folder / "cli.py"
        before = path.read_text(encoding="utf-8")
        assert old in before
        path.write_text(before.replace(old, new, 1) if old else before + new, encoding="utf-8")
        try:
            command = [sys.executable, "-c", DIGESTS]
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
        finally:
            path.write_text(before, encoding="utf-8")
        return done.stdout.split()

    return found


SWAPPED = ("traces/format.py", "READ, PUSH, LEAF, PREFETCH = range(4)", "PUSH, READ, LEAF, PREFETCH = range(4)")


def test_swapped_kinds_are_another_folder(digests):
    """Their file has no kernel: those that write and count kinds are in others."""
    kernels = digests()[0]
    assert digests(*SWAPPED)[0] != kernels
    assert digests("nptrace_base/jit.py", "nogil=True, ", "")[0] != kernels
    assert digests("cachesim/policies/push.py", new="# more\n")[0] != kernels
    assert digests("cli.py", new="# more\n")[0] == kernels


def test_trees_and_kernels_change_with_what_they_stand_on_and_with_nothing_else(digests):
    _, trees, replayed, lists = digests()
    _, *swapped = digests(*SWAPPED)
    assert swapped[0] == trees and swapped[1] != replayed and swapped[2] == lists
    assert digests("cachesim/stack_distance.py", new="# more\n")[1] == trees
    for file in ("rtrace/trees/merge_sort.py", "rtrace/trees/tree_cache.py", "nptrace_base/jit.py"):
        assert digests(file, new="# more\n")[1] != trees


def test_a_policy_is_found_by_a_listing_and_counts_as_imported(digests):
    """Its hooks are pasted into the kernels of the clock and of the replay, which import no policy by name."""
    _, trees, replayed, lists = digests()
    _, *changed = digests("cachesim/policies/push.py", new="# more\n")
    assert changed[1] != replayed and [changed[0], changed[2]] == [trees, lists]


@pytest.mark.parametrize("name", ["numba", "llvmlite", "np"])
def test_another_version_is_another_folder(name, monkeypatch):
    before = jit.kernel_digest()
    monkeypatch.setattr(getattr(jit, name), "__version__", "0.0")
    assert jit.kernel_digest() != before


def test_what_a_file_imports_is_found_as_python_finds_it():
    """The statements of ours are picked out by their form; here whole files are parsed."""
    assert len(SOURCES) > 60
    for path in SOURCES:
        names = set()
        for node in ast.walk(ast.parse(path.read_bytes())):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0
                names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        ours = {name for name in names if name.partition(".")[0] in source_files.OURS}
        assert set(source_files._names(path.read_text(encoding="utf-8"))) == ours, path


def test_a_tree_is_not_taken_from_a_folder_of_others(tmp_path, monkeypatch):
    from rtrace.scenes.scene import scene_from_triangles
    from rtrace.scenes.shapes import soup

    scene = scene_from_triangles(soup(50, seed=1), "soup")
    want = tree_cache.cached_tree(scene, "bvh", tmp_path / "trees")
    (tmp_path / "trees").chmod(0o777)
    monkeypatch.setattr(tree_cache, "_load", None)
    said = []
    monkeypatch.setattr(compiling, "lost", {})
    monkeypatch.setattr(compiling, "announce", said.append)
    for _ in range(2):
        assert tree_cache.cached_tree(scene, "bvh", tmp_path / "trees").nodes.tobytes() == want.nodes.tobytes()
    assert len(said) == 1 and said[0].startswith(f"trees could not be kept in {tmp_path}/trees (others may write to it")


@pytest.fixture
def root(tmp_path, monkeypatch):
    """An empty folder instead of that of our packages."""
    monkeypatch.setattr(source_files, "ROOT", tmp_path)
    source_files._files.cache_clear()
    yield tmp_path
    source_files._files.cache_clear()


def test_what_an_import_imports_counts(root):
    (root / "rtrace").mkdir()
    for name, text in (("one", "import rtrace.two\n"), ("two", "from rtrace import three\n"), ("three", ""), ("four", "")):
        (root / f"rtrace/{name}.py").write_text(text)
    found = source_files.closure([root / "rtrace/one.py"])
    assert found == {root / f"rtrace/{name}.py" for name in ("one", "two", "three")}


def test_in_a_folder_of_everybodys_packages_only_ours_count(root):
    """Where a wheel is installed; with NumPy's sources, kernels were compiled again after each change of NumPy."""
    for name in ("rtrace", "somebody_elses"):
        (root / name).mkdir()
        (root / name / "__init__.py").write_text("")
    (root / "rtrace/one.py").write_text("import somebody_elses\nfrom rtrace import two\n")
    (root / "rtrace/two.py").write_text("")
    found = source_files.closure([root / "rtrace/one.py"])
    assert found == {root / f"rtrace/{name}.py" for name in ("__init__", "one", "two")}
