"""Results as files, from Python and from commands: the same bytes, the version of their columns, written atomically."""

import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

import cli
import nptrace as nt
from nptrace_base.records import SCHEMA_VERSION
from tests.nptrace.test_terminal import inputs

CALLS = {
    "replay traces/bunny-bvh --size 1K,2K": lambda: nt.replay("traces/bunny-bvh", size="1K,2K"),
    "replay traces/bunny-bvh --by level": lambda: nt.replay("traces/bunny-bvh", by="level"),
    "sweep traces/bunny-bvh --size 1K..2K": lambda: nt.sweep("traces/bunny-bvh", size="1K..2K"),
    "time traces/bunny-bvh --size 1K": lambda: nt.time("traces/bunny-bvh", size="1K"),
    "compare traces/bunny-bvh --prefetch push --no-baselines": lambda: nt.compare(
        "traces/bunny-bvh", prefetch="push", baselines=False
    ),
    "table1": lambda: nt.table1(),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results")
    inputs(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        yield folder


@pytest.mark.parametrize("command", CALLS)
def test_a_file_has_the_bytes_of_the_command(folder, command):
    results = CALLS[command]()
    for form, write in (("csv", results.to_csv), ("json", results.to_json), ("parquet", results.to_parquet)):
        done = CliRunner().invoke(cli.npcache, [*command.split(), "-o", f"theirs.{form}"], catch_exceptions=False)
        assert done.exit_code == 0, done.output
        assert write(Path(f"mine.{form}")) is None
        assert Path(f"mine.{form}").read_bytes() == Path(f"theirs.{form}").read_bytes()
    assert results.to_csv() == Path("mine.csv").read_text()
    assert results.to_json() == Path("mine.json").read_text()


def test_json_and_parquet_name_the_version_of_their_columns(folder):
    results = nt.replay("traces/bunny-bvh", size="1K")
    assert {row["schema_version"] for row in json.loads(results.to_json())} == {SCHEMA_VERSION}
    results.to_parquet("r.parquet")
    wanted = {b"schema_version": str(SCHEMA_VERSION).encode()}
    assert pq.read_schema("r.parquet").metadata == results.to_arrow().schema.metadata == wanted
    assert "schema_version" not in results.to_csv() and "schema_version" not in results.to_arrow().column_names


def test_an_estimate_is_a_table_of_its_caches(folder):
    results = nt.estimate("blob", accel="bvh", pixels="32x32", size=["1K", "2K"], exact_below=10**6)
    rows = results.to_arrow().to_pylist()
    assert len(results) == 1 and [row["size_bytes"] for row in rows] == [1024, 2048]
    assert [row["demand_miss_rate"] for row in rows] == [cell["demand_miss_rate"]["value"] for cell in results[0]["cells"]]
    assert repr(results).startswith("<Results of estimate: 1 row of 1 run, ")
    assert results.to_pandas()["size_bytes"].tolist() == [1024, 2048]
    results.to_parquet("e.parquet")
    args = "estimate blob --accel bvh --pixels 32x32 --size 1K,2K --exact-below 1000000 -o theirs.parquet"
    assert CliRunner().invoke(cli.npcache, args.split(), catch_exceptions=False).exit_code == 0
    assert pq.read_schema("e.parquet").equals(pq.read_schema("theirs.parquet"), check_metadata=True)


def test_what_cannot_be_written_is_one_sentence_and_keeps_what_was_there(folder, monkeypatch):
    results = nt.replay("traces/bunny-bvh", size="1K")
    for wrong, sentence in (
        ("nosuch/r.csv", "cannot write nosuch"), (".", "it is a folder"), (3, "path: 3 is not a path; write e.g."),
        ("x" * 5000, "File name too long"), ("a\0b", "is not a path"),
    ):  # fmt: skip
        for write in (results.to_csv, results.to_json, results.to_parquet):
            with pytest.raises(nt.NptraceError, match=sentence):
                write(wrong)
    with pytest.raises(nt.NptraceError, match="path: None is not a path"):
        results.to_parquet(None)
    Path("kept.csv").write_text("kept")

    def fail(*args):
        raise KeyboardInterrupt

    monkeypatch.setattr("nptrace_base.records.to_csv", fail)
    with pytest.raises(KeyboardInterrupt):
        results.to_csv("kept.csv")
    assert Path("kept.csv").read_text() == "kept"
