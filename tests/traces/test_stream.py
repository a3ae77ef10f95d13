"""Traces from practice: from pipes and stdin, compressed, in other encodings; opened once; names that are not text."""

import bz2
import gzip
import io
import json
import lzma
import os
import subprocess
import sys
import threading
from types import SimpleNamespace

import pyarrow as pa
import pytest
from click.testing import CliRunner

import cli
from cachesim.config import CacheConfig
from cachesim.replay import replay
from cachesim.sweep import sweep
from tests.reference.traces import make_footer, make_trace, write
from traces import din
from traces.din import DinTrace, export_din
from traces.format import SPLIT
from traces.reader import open_run
from traces.stream import StreamError
from traces.writer import RunWriter

TEXT = b"0 1000\n0 2000\nb 3000\n0 3000\n"
CONFIGS = [CacheConfig(8192, 1, 32), CacheConfig(8192, 2, 32)]


def counts(path, **options):
    [result, _] = replay(path, CONFIGS, threads=1, **options)
    return result.demand_accesses, result.prefetch_accesses, result.demand_misses


def packed(data, codec):
    sink = pa.BufferOutputStream()
    with pa.CompressedOutputStream(sink, codec) as file:
        file.write(data)
    return sink.getvalue().to_pybytes()


DRESSED = {
    "plain": TEXT,
    "gzip": gzip.compress(TEXT),
    "gzip in two parts": gzip.compress(TEXT[:14]) + gzip.compress(TEXT[14:]),
    "zstd": packed(TEXT, "zstd"),
    "lz4": packed(TEXT, "lz4"),
    "xz": lzma.compress(TEXT),
    "bzip2": bz2.compress(TEXT),
    "utf-8 mark": b"\xef\xbb\xbf" + TEXT,
    "utf-16": TEXT.decode().encode("utf-16"),
    "utf-16 the other way": b"\xfe\xff" + TEXT.decode().encode("utf-16-be"),
    "utf-16 without a mark": TEXT.decode().encode("utf-16-le"),
    "packed utf-16": gzip.compress(TEXT.decode().encode("utf-16")),
    "CR": TEXT.replace(b"\n", b"\r"),
    "CR LF": TEXT.replace(b"\n", b"\r\n"),
    "blank lines first": b"\n" * 5000 + b" \r\n" * 5000 + TEXT,
    "0x": TEXT.replace(b"0 ", b"0x0 0X").replace(b"b ", b"0XB 0x"),
}


@pytest.mark.parametrize("dress", DRESSED)
def test_a_trace_is_known_by_its_bytes(tmp_path, dress):
    (tmp_path / "any.name").write_bytes(DRESSED[dress])
    assert counts(tmp_path / "any.name") == (3, 1, 2)
    assert counts(tmp_path / "any.name", prefetch="none") == (3, 0, 3)


def through_a_pipe(path, data):
    os.mkfifo(path)
    writer = threading.Thread(target=lambda: path.write_bytes(data), daemon=True)
    writer.start()
    return writer


@pytest.mark.parametrize("dress", ["plain", "gzip", "zstd", "xz", "utf-16"])
def test_a_fifo_is_read_once(tmp_path, dress):
    writer = through_a_pipe(tmp_path / "in.din", DRESSED[dress])
    assert counts(tmp_path / "in.din") == (3, 1, 2)
    writer.join(10)
    assert not writer.is_alive()


class Dripping(io.RawIOBase):
    """A pipe that gives a byte at a time."""

    def __init__(self, data):
        self._file = io.BytesIO(data)

    def readable(self):
        return True

    def readinto(self, buffer):
        return self._file.readinto(memoryview(buffer)[:1])


@pytest.mark.parametrize("dress", ["plain", "gzip", "zstd", "utf-16", "packed utf-16"])
def test_what_comes_byte_by_byte_is_known_all_the_same(monkeypatch, dress):
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=Dripping(DRESSED[dress])))
    assert counts("-") == (3, 1, 2)


def test_two_passes_over_a_pipe_are_refused_before_reading(tmp_path):
    writer = through_a_pipe(tmp_path / "in.din", TEXT)
    result = CliRunner().invoke(cli.npcache, ["replay", str(tmp_path / "in.din"), "--prefetch", "none,traced"])
    assert (
        result.exit_code == 2
        and "in.din is a pipe, and this command reads it 2 times; write it to a file first" in result.stderr
    )
    writer.join(10)
    trace = DinTrace(pipe_of(TEXT))
    assert sum(batch[0].size for batch in trace.batches()) == 4
    with pytest.raises(StreamError, match="is a pipe, and this command reads it 2 times"):
        next(trace.batches())
    with pytest.raises(StreamError, match="is a pipe, and this command reads it 2 times"):
        replay(pipe_of(TEXT), [CacheConfig(512, 2, 32, "opt")], threads=1)


def pipe_of(data):
    """Return the name of a pipe that holds some bytes, as a shell's ``<(...)`` gives it."""
    reading, writing = os.pipe()
    os.write(writing, data)
    os.close(writing)
    return f"/dev/fd/{reading}"


def test_commands_read_pipes_and_stdin(tmp_path):
    (tmp_path / "x.din").write_bytes(TEXT)
    code = "import sys, cli; sys.argv[0] = 'npcache'; cli.npcache()"

    def run(*args, **stdin):
        done = subprocess.run([sys.executable, "-c", code, *args], capture_output=True, check=True, timeout=120, **stdin)
        [row] = json.loads(done.stdout)
        return row["run"], row["demand_accesses"], row["prefetch_accesses"], row["demand_misses"]

    assert run("replay", "-", "--json", input=TEXT) == ("stdin", 3, 1, 2)
    assert run("replay", "/dev/stdin", "--json", input=gzip.compress(TEXT)) == ("stdin", 3, 1, 2)
    with open(tmp_path / "x.din", "rb") as file:  # a file on stdin can be read twice
        assert run("replay", "-", "--policy", "opt", "--json", stdin=file) == ("stdin", 3, 1, 2)
    assert run("sweep", "-", "--size", "8K", "--ways", "1", "--threads", "1", "--json", input=TEXT) == ("stdin", 3, 1, 2)
    [row] = sweep(pipe_of(TEXT), CONFIGS[:1], threads=1)
    assert (row.demand_accesses, row.prefetch_accesses, row.demand_misses) == (3, 1, 2)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (gzip.compress(TEXT, mtime=0)[:-9], r"x is gzip that cannot be unpacked \(.*\); pack it again"),
        (gzip.compress(TEXT, mtime=0)[:-8] + b"12345678", r"x is gzip that cannot be unpacked \(CRC check failed"),
        (packed(TEXT * 99, "zstd")[:-9], r"x is zstd that cannot be unpacked"),
        (lzma.compress(TEXT)[:-9], r"x is xz that cannot be unpacked"),
        (b"PAR1" + bytes(40), "x cannot be read as Parquet"),
        (b"PK\x03\x04" + bytes(40), "x is not a trace but a zip archive; unpack it"),
        (b"", "x holds no access"),
        (b"\n" * 9000, "x holds no access"),
        (gzip.compress(b"", mtime=0), "x holds no access"),
        (b"\r" * 5000 + b"0 10\r4 10\r", "x, line 5002: access type 4 is a copy-back"),
        (b"0 10\r\n\n\r\r\n4 10\r", "x, line 5: access type 4"),
    ],
)
def test_what_is_refused(tmp_path, data, said):
    (tmp_path / "x").write_bytes(data)
    with pytest.raises(StreamError, match=said) as error:
        counts(tmp_path / "x")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("chunk", range(1, 24))
def test_line_ends_that_chunks_cut(tmp_path, monkeypatch, chunk):
    monkeypatch.setattr(din, "_CHUNK_BYTES", chunk + 200)
    text = b"".join(b"0 %x" % (4 * k) + (b"\r\n", b"\r", b"\n", b"\r\r\n")[k % 4] for k in range(200))
    (tmp_path / "x").write_bytes(text + b"4 10")
    addresses = []
    with pytest.raises(StreamError, match="line 251: access type 4"):
        addresses += [int(a) for batch in DinTrace(tmp_path / "x").batches() for a in batch[0]]


def test_records_that_begin_as_packed_files_do(tmp_path):
    """Addresses whose bytes are those of gzip's and UTF-16's marks: whole good records are records."""
    for first in (0x00088B1F, 0xFD2FB528, 0x0000FEFF, 0xBFBBEF):
        records = b"".join(address.to_bytes(4, "little") + b"\x04\0\0\0" for address in (first, 16, 32))
        (tmp_path / "x").write_bytes(records)
        assert [int(a) for batch in DinTrace(tmp_path / "x").batches() for a in batch[0]] == [first, 16, 32]


@pytest.mark.parametrize("data", [TEXT * 400_000, b"\x10\0\0\0\x04\0\0\0" * 2_000_000])
def test_what_is_packed_well_is_unpacked_piece_by_piece(tmp_path, data):
    (tmp_path / "x").write_bytes(gzip.compress(data, 1))
    sizes = [batch[0].size for batch in DinTrace(tmp_path / "x").batches()]
    assert sum(sizes) in (1_600_000, 2_000_000) and max(sizes) < 700_000


# --- names and forms ----------------------------------------------------------------------------------------------------


def test_a_name_that_stdout_cannot_write_appears_with_escapes(tmp_path):
    (tmp_path / "caf\xe9.din").write_bytes(TEXT)
    result = CliRunner(charset="ascii").invoke(cli.npcache, ["replay", str(tmp_path / "caf\xe9.din"), "--threads", "1"])
    assert result.exit_code == 0 and result.stdout.startswith("caf\\xe9.din, prefetch traced\n")


@pytest.mark.slow
def test_names_that_are_no_text(tmp_path):
    folder = tmp_path / os.fsdecode(b"t\xe9")
    made = write(make_trace("kdtree", 2, n_rays=4), folder / os.fsdecode(b"bunn\xff-kdtree"))
    assert made.name == "bunn\\xff-kdtree"
    assert made.columns("rays")["count"].sum() == made.n_accesses
    with RunWriter(folder / os.fsdecode(b"\xfe"), make_footer(), SPLIT) as run:
        run.append("nodes", {name: column for name, column in made.columns("nodes").items()})
        run.image(b"")
    assert open_run(folder / os.fsdecode(b"\xfe")).n_nodes == made.n_nodes
    environment = os.environ | {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0", "PYTHONIOENCODING": ""}
    for env in (os.environ, environment):
        for command in (
            ["npcache", "replay", "--traces", str(folder)],
            ["npcache", "sweep", str(made.path), "--ways", "1", "--threads", "1"],
            ["npcache", "sweep", str(made.path), "--ways", "1", "--threads", "1", "-o", os.fsdecode(b"o\xe9.parquet")],
            ["nptrace", "export", str(made.path), "-o", os.fsdecode(b"bunn\xff.din")],
        ):
            code = f"import sys, cli; cli.{command[0]}()"
            done = subprocess.run(
                [sys.executable, "-c", code, *command[1:]], cwd=folder, env={**env, "PYTHONPATH": os.getcwd()},
                capture_output=True, check=False, timeout=120,
            )  # fmt: skip
            assert done.returncode == 0, done.stderr
            assert b"damaged" not in done.stderr and b"Traceback" not in done.stderr
    assert (folder / os.fsdecode(b"bunn\xff.din")).exists() and (folder / os.fsdecode(b"o\xe9.parquet")).exists()


@pytest.mark.parametrize(
    "command", [["replay", "--format", "dinero"], ["replay", "--format", "table"], ["table1", "--format", "csv"]]
)
def test_two_forms_at_once_are_refused(command, tmp_path):
    (tmp_path / "x.din").write_bytes(TEXT)
    source = [str(tmp_path / "x.din")] if command[0] == "replay" else []
    result = CliRunner().invoke(cli.npcache, [command[0], *source, *command[1:], "--json"])
    assert (
        result.exit_code == 2
        and result.stderr == f"Error: {command[1]} {command[2]} and --json ask for two formats; leave one out\n"
    )


def test_an_export_warns_where_dinero_counts_wrongly(tmp_path):
    run = write(make_trace("bvh", 2, n_rays=4), tmp_path / "a-bvh")
    for fmt, prefetch, said in (
        ("binary", "b", "with lines shorter than 32 B, prefetches of 32 B span two"), ("binary", "read", ""),
        ("text", "b", ""),
    ):  # fmt: skip
        heard = []
        export_din(run, tmp_path / "x.din", fmt=fmt, prefetch=prefetch, warn=heard.append)
        assert len(heard) == bool(said) and said in "".join(heard)
    heard = []
    export_din(run, tmp_path / "x.din", fmt="binary", addresses=run.columns("nodes")["address"] + 8, warn=heard.append)
    assert "with lines of any size" in heard[0]
