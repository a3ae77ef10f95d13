"""--resume: files that are damaged, truncated, foreign or in no folder are reported before anything is traced."""

import io
import pickle
import zipfile

import numpy as np
import pytest
from click.testing import CliRunner

import cli
from cachesim.config import CacheConfig
from cachesim.sampling.estimate import estimate
from cachesim.sampling.target import Target
from nptrace_base.errors import NptraceError
from tests.reference.unit_sources import ArraySource

CONFIGS = [CacheConfig(2048, 1)]


def source(name="array"):
    rng = np.random.default_rng(3)
    return ArraySource(rng.integers(2048, size=150_000), name=name)


def run(path, of=None, **options):
    return estimate(of or source(), CONFIGS, Target(0.2, 0.01), exact_below=0, resume=path, **options)


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    path = tmp_path_factory.mktemp("kept") / "good.npz"
    assert run(path).method == "sampled"
    return path.read_bytes()


def archive(arrays, **options):
    file = io.BytesIO()
    np.savez(file, **arrays, **options)
    return file.getvalue()


def changed(good, name, value):
    """Return the file with another array, or another entry (place, number), of this name."""
    with np.load(io.BytesIO(good)) as arrays:
        found = dict(arrays)
    if isinstance(value, tuple):
        at, number = value
        found[name] = found[name].copy()
        found[name].flat[at] = number
    elif value is None:
        del found[name]
    else:
        found[name] = value
    return archive(found)


def beyond(good):
    """Let a unit that was counted once only lie behind the end of the run."""
    with np.load(io.BytesIO(good)) as arrays:
        once = np.flatnonzero(~np.isin(arrays["units"], arrays["long_"][:, 0]))
    return changed(good, "units", (once[-1], 10_000))


def compressed(good):
    file = io.BytesIO()
    with np.load(io.BytesIO(good)) as arrays:
        np.savez_compressed(file, **arrays)
    return file.getvalue()


def array_file(values, **options):
    file = io.BytesIO()
    np.save(file, values, **options)
    return file.getvalue()


def flipped(good):
    """Change one byte in the middle of an array: the checksum of the archive does not fit."""
    at = good.index(b"counts.npy") + 400
    return good[:at] + bytes([good[at] ^ 0xFF]) + good[at + 1 :]


def endless(good):
    """An array of 10^15 numbers, by its header."""
    file = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(good)) as old, zipfile.ZipFile(file, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            if name == "looked.npy":
                header = b"{'descr': '<i8', 'fortran_order': False, 'shape': (1000000000000000,), }"
                data = b"\x93NUMPY\x01\x00\x76\x00" + header.ljust(117) + b"\n"
            new.writestr(name, data)
    return file.getvalue()


DAMAGED = {
    "cut": lambda good: good[: len(good) // 2],
    "a byte less": lambda good: good[:-1],
    "a byte changed": flipped,
    "empty": lambda good: b"",
    "text": lambda good: b"eye=0,0,5\n" * 40,
    "an array": lambda good: array_file(np.arange(5)),
    "a pickle": lambda good: pickle.dumps({"key": 1}),
    "an array of objects": lambda good: array_file(np.array([{}, 1], object), allow_pickle=True),
    "objects inside": lambda good: changed(good, "units", np.array([{}], object)),
    "compressed": compressed,
    "endless": endless,
    "another archive": lambda good: archive({"a": np.arange(3)}),
    "no spans": lambda good: changed(good, "spans", None),
    "a unit beyond the run": beyond,
    "a unit before the run": lambda good: changed(good, "units", (0, -1)),
    "long counts of a unit that is not there": lambda good: changed(good, "long_", (0, 585)),
    "a rate of work that is none": lambda good: changed(good, "work", (0, np.nan)),
    "counts below 0": lambda good: changed(good, "known", (0, -5)),
    "fewer rows": lambda good: changed(good, "counts", np.zeros((3, 3))),
    "other numbers": lambda good: changed(good, "settled", np.zeros((24, 3), np.float32)),
    "a stretch beyond the run": lambda good: changed(good, "spans", (1, 1 << 40)),
    "a stretch that ends before it starts": lambda good: changed(good, "spans", (0, 149_999)),
    "a position beyond the run": lambda good: changed(good, "looked", (0, 150_000)),
}


@pytest.mark.parametrize("how", DAMAGED)
def test_what_is_no_whole_file_of_counts(how, good, tmp_path):
    path, of = tmp_path / "kept.npz", source()
    path.write_bytes(DAMAGED[how](good))
    before = path.read_bytes()
    with pytest.raises(
        NptraceError, match="cannot be resumed from: it is damaged, or not a file of counts; name another file"
    ):
        run(path, of)
    assert of.n_traced == 0 and path.read_bytes() == before


def test_a_file_of_another_run(good, tmp_path):
    path, of = tmp_path / "kept.npz", source("another")
    path.write_bytes(good)
    with pytest.raises(NptraceError, match="belongs to another scene"):
        run(path, of)
    assert of.n_traced == 0


def test_a_whole_file_is_continued(good, tmp_path):
    path, of = tmp_path / "kept.npz", source()
    path.write_bytes(good)
    again = run(path, of)
    assert again.method == "sampled" and of.n_traced < 0.05 * of.n_positions  # the scout
    assert again.cells == run(tmp_path / "fresh.npz").cells
    assert not list(tmp_path.glob(".*"))  # no temporary file is left


def test_a_place_where_nothing_can_be_kept(tmp_path):
    of = source()
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "missing" / "x.npz", tmp_path / "file" / "x.npz"):
        with pytest.raises(NptraceError, match="cannot store the counts: there is no folder"):
            run(path, of)
    assert of.n_traced == 0


def test_the_command_gives_one_sentence(tmp_path):
    scene = tmp_path / "one.obj"
    scene.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "cut.npz").write_bytes(b"PK\x03\x04 cut")
    for path, sentence in ((tmp_path / "cut.npz", "cannot be resumed from"), (tmp_path / "no" / "x.npz", "no folder")):
        args = ["estimate", str(scene), "--accel", "bvh", "--pixels", "64x64", "--resume", str(path)]
        result = CliRunner().invoke(cli.npcache, args)
        assert result.exit_code == 2 and result.stderr.count("\n") == 1 and sentence in result.stderr
        assert result.stderr.startswith("Error: ") and "Traceback" not in result.output
