"""Traces of addresses in CSV and Parquet: replayed as DineroIV's are, with the same checks, and written from runs."""

import gzip
import json
import os
import subprocess
import sys
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

import cli
from cachesim.config import CacheConfig
from cachesim.replay import replay
from cachesim.sweep import sweep
from nptrace_base.errors import NptraceError
from tests.reference.traces import make_trace, write
from traces.address_files import AddressFile, export_addresses
from traces.stream import Stream

PATH = {"PYTHONPATH": str(Path(cli.__file__).parent)}
CONFIGS = [CacheConfig(1024, 2), CacheConfig(2048, 64)]
DIN = "0 1000\n0 1020\nb 1040\n3 1040\n2 1004\n0 1000\n"
CSV = "address,note,type,size\n4096,x,0,4\n0x1020,y,read,4\n4160,,b,4\n0x1040,z,misc,4\n 0x1004 , ,fetch,4\n4096,,0,4\n"


def counts(path, **options):
    return [(r.demand_accesses, r.demand_misses, r.prefetch_accesses, r.useful) for r in replay(path, CONFIGS, **options)]


def rows_of(path):
    return [list(map(int, row)) for address, size, types in AddressFile(Stream(path)).batches()
            for row in zip(address, [size] * len(address) if isinstance(size, int) else size, types, strict=True)]  # fmt: skip


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "x.din").write_text(DIN)
    (tmp_path / "x.csv").write_text(CSV)
    (tmp_path / "x.csv.gz").write_bytes(gzip.compress(CSV.replace("\n", "\r\n").encode()))
    addresses = [0x1000, 0x1020, 0x1040, 0x1040, 0x1004, 0x1000]
    table = pa.table(
        {"type": pa.array([0, 0, 11, 3, 2, 0], pa.int8()), "address": pa.array(addresses, pa.int64()), "size": [4] * 6}
    )
    pq.write_table(table, tmp_path / "x.parquet")
    return tmp_path


@pytest.mark.parametrize("name", ["x.csv", "x.csv.gz", "x.parquet"])
def test_they_replay_and_sweep_as_din_does(folder, name):
    for prefetch in ("traced", "none", "next-line:miss"):
        assert counts(name, prefetch=prefetch) == counts("x.din", prefetch=prefetch)
    swept = [[(row.demand_misses, row.prefetch_misses) for row in sweep(each, CONFIGS)] for each in (name, "x.din")]
    assert swept[0] == swept[1]
    assert replay(name, CONFIGS)[0].identity.run == name


@pytest.mark.parametrize("name", ["x.csv", "x.csv.gz", "x.parquet", "x.din"])
def test_they_come_through_a_pipe(folder, name):
    """Which form it is shows in the first bytes: a pipe has no name."""
    for prefetch in ("traced", "none"):
        arguments = [sys.executable, "-m", "nptrace", "cache", "replay", "-", "--prefetch", prefetch, "--size", "1K", "--json"]
        with subprocess.Popen(["cat", name], stdout=subprocess.PIPE) as source:
            done = subprocess.run(arguments, stdin=source.stdout, capture_output=True, check=True, env=os.environ | PATH)
        [row] = json.loads(done.stdout)
        assert (row["demand_accesses"], row["demand_misses"]) == counts("x.din", prefetch=prefetch)[0][:2], name
        assert row["run"] == "stdin"


@pytest.mark.parametrize("name", ["x.csv", "x.csv.gz", "x.parquet"])
def test_a_file_without_an_ending_is_known_by_its_first_bytes(folder, name):
    (folder / "plain").write_bytes((folder / name).read_bytes())
    assert counts("plain", prefetch="traced") == counts("x.din", prefetch="traced")
    assert counts("plain", prefetch="next-line:miss") == counts("x.din", prefetch="next-line:miss")


def test_what_is_left_out_is_a_read_of_one_byte(folder):
    (folder / "y.csv").write_text("Address\n31\n4294967295\n")
    assert rows_of("y.csv") == [[31, 1, 0], [2**32 - 1, 1, 0]]
    (folder / "y.csv").write_text("size,address\n3,30\n")
    assert rows_of("y.csv") == [[30, 3, 0]]
    [result] = replay("y.csv", [CacheConfig(1024, 1)])
    assert result.demand_accesses == 2  # across a line boundary


def test_addresses_of_64_bits_may_have_zeros_in_front(folder):
    """As many tools write them; where the number is too large, that is what is said."""
    (folder / "y.csv").write_text("address\n0x0000000012345678\n0X00000000FFFFFFFF\n0000000000000000031\n")
    assert [row[0] for row in rows_of("y.csv")] == [0x12345678, 2**32 - 1, 31]
    for text, digits in (("0x00007ffe12345678", "7ffe12345678"), ("0xffffffffffffffff", "f" * 16)):
        (folder / "y.csv").write_text(f"address\n{text}\n")
        with pytest.raises(NptraceError, match=f"row 1: 1 B at {digits} reach past 2\\^32"):
            rows_of("y.csv")


def test_a_long_file_is_read_in_pieces(folder, monkeypatch):
    import traces.address_files as files

    monkeypatch.setattr(files, "_CHUNK_BYTES", 10)
    (folder / "y.csv").write_text("address\n" + "".join(f"{i}\n" for i in range(999)).rstrip("\n"))
    assert [row[0] for row in rows_of("y.csv")] == list(range(999))
    (folder / "y.csv").write_text("address\n" + "".join(f"{i}\n" for i in range(99)) + "x\n")
    with pytest.raises(
        NptraceError, match=r"y.csv, row 100: address 'x' is no whole number of up to 19 digits; write e.g. 4096"
    ):
        rows_of("y.csv")


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "has no column 'address'"), ("a,b\n1,2\n", "has no column 'address' (it has a, b); name it so in the header"),
        ("address\n", "holds no access"), ("address,address\n1,2\n", "has several columns 'address'"),
        ("address\n1\n-3\n", "row 2: address '-3' is no whole number"),
        ("address\n18446744073709551615\n", "row 1: address '18446744073709551615' is no whole number of up to 19 digits"),
        ("address\n9223372036854775808\n", "row 1: 1 B at 8000000000000000 reach past 2^32"),
        ("address\n0xffffffffffffffff\n", "row 1: 1 B at ffffffffffffffff reach past 2^32"),
        ("address\n0x\n", "row 1: address '0x'"),
        ("address\n4294967296\n", "row 1: 1 B at 100000000 reach past 2^32"),
        ("address,size\n4294967295,2\n", "row 1: 2 B at ffffffff reach past 2^32"),
        ("address,size\n1,0\n", "row 1: a size of 0 B reads nothing"), ("address,size\n1,\n", "row 1: size ''"),
        ("address,type\n1,0\n1,1\n", "row 2: access type 1 is a write, and nodes are read-only"),
        ("address,type\n1,write\n", "row 1: access type 1 is a write"),
        ("address,type\n1,z\n", "row 1: type 'z' is no access type"),
        ("address,type\n1\n", "cannot be read as CSV"),
        ("address\r1\r2\r", "has lines that end with a carriage return alone; end them with a line feed"),
        ("a\0d\0d\0r\0e\0s\0s\0\n\0001\0\n\0", "is not in UTF-8; save it as UTF-8"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_one_sentence(folder, text, sentence):
    (folder / "y.csv").write_text(text, newline="")
    with pytest.raises(NptraceError) as caught:
        rows_of("y.csv")
    assert sentence in str(caught.value) and str(caught.value).startswith("y.csv") and "\n" not in str(caught.value)


def test_the_case_of_a_heading_does_not_count(folder):
    (folder / "y.csv").write_text("Note, Address ,TYPE\na,16,b\n")
    pq.write_table(pa.table({"Type": ["b"], "note": ["a"], " Address ": [16]}), "y.parquet")
    assert rows_of("y.csv") == rows_of("y.parquet") == [[16, 1, 11]]


@pytest.mark.parametrize(
    ("columns", "sentence"),
    [
        ({"address": [1.5]}, "column 'address' is of type double; write whole numbers"),
        ({"address": pa.array([1, None], pa.int64())}, "row 2: address None is no whole number from 0"),
        ({"address": [1, -1]}, "row 2: address -1 is no whole number from 0"),
        ({"address": pa.array([1, 2**63], pa.uint64())}, "row 2: 1 B at 8000000000000000 reach past 2^32"),
        ({"address": pa.array([2**64 - 1], pa.uint64())}, "row 1: 1 B at ffffffffffffffff reach past 2^32"),
        ({"address": pa.array([1, None], pa.uint32())}, "row 2: address None is no whole number from 0"),
        ({"address": [16], "size": pa.array([2**64 - 16], pa.uint64())}, "row 1: 18446744073709551600 B at 10 reach past"),
        ({"address": [0], "size": [2**32]}, "row 1: 4294967296 B at 0 reach past 2^32"),
        ({"address": [1], "type": [7]}, "row 1: type 7 is no access type"), ({"x": [1]}, "has no column 'address'"),
    ],
)  # fmt: skip
def test_parquet_is_checked_too(folder, columns, sentence):
    pq.write_table(pa.table(columns), "y.parquet")
    with pytest.raises(NptraceError) as caught:
        rows_of("y.parquet")
    assert sentence in str(caught.value)
    (folder / "y.parquet").write_bytes(b"PAR1")
    with pytest.raises(NptraceError, match="y.parquet cannot be read as Parquet"):
        rows_of("y.parquet")


def test_what_needs_nodes_is_refused_by_name(folder):
    def said(*args):
        result = CliRunner().invoke(cli.npcache, args)
        assert result.exit_code == 2, result.output
        return result.stderr

    assert "x.csv has addresses, not pushes, so no stack can be rebuilt for stack" in said(
        "replay", "x.csv", "--prefetch", "stack"
    )
    assert "x.csv has addresses, not nodes, so it cannot use the layout veb" in said("replay", "x.csv", "--layout", "veb")
    assert "x.csv has addresses alone, and the clock needs leaves and rays" in said("time", "x.csv")
    assert "x.csv is not a run directory" in said("compare", "x.csv")


@pytest.mark.parametrize("kind", ["kdtree", "bvh", "bvh64"])
def test_an_exported_run_replays_as_the_run_does(folder, kind):
    run = write(make_trace(kind, 1, n_rays=100, max_level=9), folder / "run")
    written = [export_addresses(run, f"out.{form}", form=form) for form in ("csv", "parquet")]
    assert written[0] == written[1] == pq.read_metadata("out.parquet").num_rows
    assert counts("out.csv") == counts("out.parquet") == counts("run")
    export_addresses(run, "out.csv", form="csv", prefetch="omit")
    assert counts("out.csv") == counts("run", prefetch="none")


def test_export_is_a_command(folder):
    write(make_trace("bvh", 1, n_rays=20), folder / "run")
    for form in ("csv", "parquet"):
        result = CliRunner().invoke(cli.nptrace, ["export", "run", "--format", form], catch_exceptions=False)
        assert result.exit_code == 0 and result.stderr.rstrip().endswith(f"next: npcache replay run.{form}")
        assert counts(f"run.{form}") == counts("run")
    result = CliRunner().invoke(cli.nptrace, ["export", "run", "--format", "csv", "--binary"])
    assert result.exit_code == 2 and "--binary is a form of DineroIV's traces, and csv has none" in result.stderr
