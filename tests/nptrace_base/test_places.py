"""Where runs are: local paths and addresses of object stores, which hold no secrets and no halves of files."""

import os
import pickle
from pathlib import Path

import pyarrow as pa
import pytest

import nptrace_base.places as places
from nptrace_base.places import PlaceError, Remote, older, opened, place, publish, sizes


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("traces/x", Path("traces/x")),
        ("-", Path("-")),
        ("C:/x", Path("C:/x")),
        (Path("a"), Path("a")),
        ("file:///tmp/a%20b", Path("/tmp/a b")),
        ("s3://bucket/a/b/", Remote("s3", "bucket", "a/b")),
        ("S3://bucket", Remote("s3", "bucket", "")),
        (Path("s3://bucket/a"), Remote("s3", "bucket", "a")),  # of which pathlib has dropped a slash
        ("s3://bucket/a?region=eu-west-1", Remote("s3", "bucket", "a", "region=eu-west-1")),
        ("gs://anonymous@bucket/a", Remote("gs", "anonymous@bucket", "a")),
        ("abfs://container@account.dfs.core.windows.net/a", Remote("abfs", "container@account.dfs.core.windows.net", "a")),
    ],
)
def test_a_text_is_a_path_or_an_address(text, found):
    assert place(text) == found
    assert place(place(text)) == found


def test_an_address_is_text_again():
    for text in ("s3://bucket/a/b", "s3://bucket", "s3://bucket/a?region=x&scheme=http", "gs://b/c"):
        assert str(place(text)) == text
        assert pickle.loads(pickle.dumps(place(text))) == place(text)
    inner = place("s3://bucket/a?region=x") / "b.parquet"
    assert (str(inner), inner.name, str(inner.parent)) == (
        "s3://bucket/a/b.parquet?region=x",
        "b.parquet",
        "s3://bucket/a?region=x",
    )


@pytest.mark.parametrize(
    "text",
    [
        "s3://AKIAUSER:hunter2@bucket/a",
        "s3://hunter2@bucket/a",
        "gs://user:hunter2@bucket/a",
        "abfs://:hunter2@account.blob.core.windows.net/a",
        "abfs://user:hunter2@account.blob.core.windows.net/a",
        "s3://bucket/a?secret_key=hunter2",
        "s3://bucket/a?access_key=AKIAUSER&secret_key=hunter2&region=x",
        "s3://bucket/a?endpoint_override=user:hunter2@127.0.0.1",
        "abfs://account.blob.core.windows.net/a?client_secret=hunter2",
        "abfs://account.blob.core.windows.net/a?sig=hunter2",
    ],
)
@pytest.mark.parametrize("make", [str, Path])
def test_a_secret_in_an_address_is_refused_and_not_repeated(text, make):
    with pytest.raises(PlaceError, match=r"^(s3|gs|abfs)://.* was given with .* environment") as found:
        place(make(text))
    assert "hunter2" not in str(found.value) and "AKIAUSER" not in str(found.value)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (
            "https://host/run",
            "https:// is not a store of runs; give a path, or an address of s3, gs, gcs, abfs, abfss or file",
        ),
        ("s3://", "s3:// names no bucket; write e.g. s3://bucket/folder"),
        ("file://tmp/x", "file://tmp/x names the host 'tmp'; write file:/// and an absolute path"),
    ],
)
def test_another_address_is_one_sentence(text, sentence):
    with pytest.raises(PlaceError) as found:
        place(text)
    assert str(found.value) == sentence


def test_files_are_written_listed_read_and_deleted(bucket, tmp_path):
    for folder in (bucket / "a", tmp_path / "local"):
        assert sizes(folder) == {}
        publish(folder / "x.bin", b"12", memoryview(b"345"))
        publish(folder / "sub" / "y", b"")
        assert sizes(folder) == {"x.bin": 5}
        assert (folder / "x.bin").read_bytes() == b"12345"
        publish(folder / "x.bin", b"1")
        assert (folder / "x.bin").read_bytes() == b"1"
        with opened(folder / "x.bin") as file:
            assert file.read() == b"1"
        assert [each.name for each in sorted(folder.iterdir(), key=str)] == ["sub", "x.bin"]
        assert (folder.is_dir(), (folder / "x.bin").is_file(), (folder / "x.bin").is_dir()) == (True, True, False)
        (folder / "x.bin").unlink()
        (folder / "x.bin").unlink(missing_ok=True)
        assert not (folder / "x.bin").exists()
        with pytest.raises(FileNotFoundError):
            (folder / "x.bin").unlink()
        with pytest.raises(FileNotFoundError):
            (folder / "x.bin").read_bytes()
    assert [each.name for each in (bucket / "a").folders()] == ["sub"]


def test_files_that_were_written_before_a_moment(bucket, tmp_path):
    publish(bucket / "a", b"12")
    publish(bucket / "b", b"3")
    (tmp_path / "bucket" / "folder").mkdir()
    os.utime(tmp_path / "bucket" / "a", (1000, 1000))
    for folder in (bucket, tmp_path / "bucket"):
        assert older(folder, 1000.5) == {"a"} and older(folder, 1000) == set()
        assert older(folder, 1e11) == {"a", "b"} and older(folder / "none", 1e11) == set()


def test_a_file_that_vanishes_while_a_folder_is_listed_hides_no_other(tmp_path, monkeypatch):
    """As beside a render that is about to finish, which deletes what its workers needed."""
    for name in "abc":
        publish(tmp_path / name, b"12")
    listed = places.os.scandir

    class Listed(list):
        def __enter__(self):
            return self

        def __exit__(self, *error):
            return None

    def scandir(folder):
        with listed(folder) as entries:
            found = Listed(entries)
        (tmp_path / "b").unlink()
        return found

    monkeypatch.setattr(places.os, "scandir", scandir)
    assert sizes(tmp_path) == {"a": 2, "c": 2}


@pytest.mark.parametrize("where", ["remote", "local"])
@pytest.mark.parametrize("before", [None, b"before"])
def test_an_exception_while_writing_publishes_nothing(bucket, tmp_path, where, before):
    """Neither in the middle nor under another name; a stream that is closed by an exception publishes what it holds."""
    file = (bucket if where == "remote" else tmp_path / "bucket") / "run" / "manifest.json"
    if before is not None:
        publish(file, before)

    class Broken:
        def __len__(self):
            raise RuntimeError("stop")

    with pytest.raises((RuntimeError, TypeError)):
        publish(file, b"half", Broken())
    assert sizes(file.parent) == ({} if before is None else {"manifest.json": len(before)})


@pytest.mark.parametrize("error", [OSError, pa.ArrowException, pa.ArrowInvalid, pa.ArrowNotImplementedError])
def test_what_a_store_answers_is_one_sentence(bucket, monkeypatch, error):
    """Azure's errors are Arrow's own, and Google's have a thousand characters."""

    class Down:
        type_name = "s3"

        def __getattr__(self, name):
            raise error(f"AWS Error NETWORK_CONNECTION during HeadObject operation{'.' * 900}\nand more")

    monkeypatch.setattr(places, "filesystem_of", lambda scheme, authority, query: (Down(), authority))
    for what, ask in (("read", bucket.exists), ("list", bucket.folders), ("read", bucket.read_bytes),
                      ("write", lambda: bucket.publish([b""])), ("delete", bucket.unlink)):  # fmt: skip
        with pytest.raises(PlaceError) as found:
            ask()
        assert str(found.value) == (
            f"cannot {what} s3://bucket: AWS Error NETWORK_CONNECTION during HeadObject operation{'.' * 244} ...; check the "
            "address, and the keys in the environment"
        )


def test_endpoint_and_region_come_from_the_environment_unless_they_are_given(monkeypatch):
    """Amazon is not asked for the region of a store of one's own."""
    asked = []

    class FileSystem:
        @staticmethod
        def from_uri(uri):
            asked.append(uri)
            return None, "bucket/"

    monkeypatch.setattr("pyarrow.fs.FileSystem", FileSystem)
    for name in ("AWS_REGION", "AWS_DEFAULT_REGION", "AWS_ENDPOINT_URL", "AWS_ENDPOINT_URL_S3"):
        monkeypatch.delenv(name, raising=False)
    of = places.filesystem_of.__wrapped__
    assert of("s3", "bucket", "") == (None, "bucket")
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:1")
    of("s3", "bucket", "scheme=https")
    monkeypatch.setenv("AWS_DEFAULT_REGION", "eu-west-1")
    of("s3", "bucket", "")
    monkeypatch.delenv("AWS_ENDPOINT_URL")
    of("s3", "bucket", "")
    of("s3", "bucket", "region=x")
    of("gs", "bucket", "")
    assert asked == [
        "s3://bucket/",
        "s3://bucket/?endpoint_override=127.0.0.1%3A1&scheme=https&region=us-east-1",
        "s3://bucket/?endpoint_override=127.0.0.1%3A1&scheme=http&region=eu-west-1",
        "s3://bucket/?region=eu-west-1",
        "s3://bucket/?region=x",
        "gs://bucket/",
    ]
