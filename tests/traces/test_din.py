"""DineroIV traces, text and binary: what is read, what is refused, and that an exported run replays as the run."""

import re
import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cachesim.config import CacheConfig
from cachesim.layout import addresses
from cachesim.replay import replay
from nptrace_base.errors import NptraceError
from tests.reference.traces import make_trace, write
from traces import din
from traces.din import DinError, DinTrace, export_din
from traces.identity import COLUMNS
from traces.stream import StreamError


def read(path):
    """Return (address, size, label) of every access of a trace."""
    return [
        (int(address), int(size), int(label))
        for addresses, sizes, labels in DinTrace(path).batches()
        for address, size, label in zip(addresses, np.broadcast_to(sizes, addresses.shape), labels, strict=True)
    ]


def text_of(tmp_path, text):
    path = tmp_path / "x.din"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


accesses = st.lists(st.tuples(st.integers(0, (1 << 32) - 1), st.sampled_from(din.LABELS)), min_size=1, max_size=50)


DRESSES = (
    "{1:x} {0:x}\n",
    "{1:X} {0:X}\n",
    "  {1:x}\t0x{0:x}  \r\n",
    "0{1:x} 0X{0:08x} # why\n",
    "0X{1:x} {0:x}\r",
    "0x{1:x} {0:x}\r\r\n",
    "\n{1:x} {0:x}\n \n",
)


@given(accesses, st.sampled_from(DRESSES), st.integers(1, 40))
def test_text_in_any_dress_and_any_chunks(tmp_path_factory, trace, dress, chunk):
    path = tmp_path_factory.mktemp("din") / "x.din"
    path.write_bytes("".join(dress.format(address, label) for address, label in trace).rstrip("\n").encode())
    before, din._CHUNK_BYTES = din._CHUNK_BYTES, chunk + 200
    try:
        assert read(path) == [(address & ~3, 4, label) for address, label in trace]
    finally:
        din._CHUNK_BYTES = before


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0 10\n1 14\n", "x.din, line 2: access type 1 is a write, and nodes are read-only; access types are 0 (read), 2"),
        ("0 10\n\n4 14\n", "line 3: access type 4 is a copy-back, and nodes are read-only"),
        ("8 10\n", "line 1: access type 8 is DineroIV's end mark"),
        ("0 10\n# comment\n", "line 2: access type # is not hexadecimal"),
        ("r 10 4\n", "line 1: access type r is of DineroIV's extended format (-informat D), which is not read"),
        ("c 10 4\n", "line 1: access type c is of DineroIV's extended format"),
        ("5 10\n", "line 1: access type 5 is an invalidation, and nothing invalidates nodes"),
        ("s 10\n", "line 1: access type s is not hexadecimal"),
        ("0x 10\n", "line 1: access type 0x is not hexadecimal"),
        ("0xc 10\n", "line 1: access type 0xc is unknown"),
        ("0\n", "line 1: the address is missing; write `type address`, as in `0 1a2b40`"),
        ("0 xyz\n", "line 1: 'xyz' is not a hexadecimal address"),
        ("0 12g4\n", "line 1: '12g4' is not a hexadecimal address"),
        ("0 0x\n", "line 1: '0x' is not a hexadecimal address"),
        ("0 1ffffffff\n", "line 1: address 1ffffffff has more than 32 bits"),
        ("b10 4\n", "line 1: access type b10 is unknown"),
        ("00000000b 4\n", "line 1: access type 00000000b is unknown"),
    ],
)
def test_what_text_is_refused(tmp_path, text, message):
    with pytest.raises(DinError) as error:
        read(text_of(tmp_path, text))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_the_line_number_counts_all_chunks(tmp_path, monkeypatch):
    monkeypatch.setattr(din, "_CHUNK_BYTES", 64)
    with pytest.raises(DinError, match="line 1001: access type 1 is a write"):
        read(text_of(tmp_path, "0 1234\n" * 1000 + "1 10\n"))


def test_a_control_character_is_no_label(tmp_path):
    (tmp_path / "x.din").write_bytes(b"0 10\n\x1c\n")
    with pytest.raises(DinError, match="line 2: access type '.x1c' is not hexadecimal"):
        list(din.DinTrace(tmp_path / "x.din").batches())


@pytest.mark.parametrize("text", ["", " \n\n\t\n"])
def test_an_empty_trace(tmp_path, text):
    with pytest.raises(DinError, match="holds no access"):
        read(text_of(tmp_path, text))


def test_no_such_file(tmp_path):
    with pytest.raises(StreamError, match=r"cannot read .*no\.din: No such file"):
        DinTrace(tmp_path / "no.din")


def test_a_file_without_lines(tmp_path, monkeypatch):
    monkeypatch.setattr(din, "_CHUNK_BYTES", 64)
    with pytest.raises(DinError, match="has no end within 64 B; this is not a trace"):
        read(text_of(tmp_path, "a" * 1000))


@given(st.lists(st.tuples(st.integers(0, (1 << 32) - 1), st.integers(1, 65535), st.sampled_from(din.LABELS)), min_size=1))
def test_binary(tmp_path_factory, records):
    records = [(min(address, (1 << 32) - size), size, label) for address, size, label in records]
    path = tmp_path_factory.mktemp("din") / "x.bin"
    path.write_bytes(b"".join(struct.pack("<IHBB", *record, 0) for record in records))
    assert read(path) == records


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (struct.pack("<IHBB", 16, 4, 0, 0) * 2 + b"\0\0\0", "is truncated: its size is not a whole number of 8-byte records"),
        (struct.pack("<IHBB", 16, 4, 0, 0) + struct.pack("<IHBB", 16, 4, 1, 0), "record 2: access type 1 is a write"),
        (struct.pack("<IHBB", 16, 0, 0, 0), "record 1: a size of 0 B reads nothing"),
        (
            struct.pack("<IHBB", 16, 4, 0, 0) + struct.pack("<IHBB", 0xFFFFFFFC, 5, 0, 0),
            "record 2: 5 B at fffffffc reach past 2^32, where DineroIV wraps to 0; rebase the trace, or split",
        ),
        (struct.pack("<IHBB", 16, 4, 4, 0), "record 1: access type 4 is a copy-back, and nodes are read-only"),
        (struct.pack("<IHBB", 16, 4, 12, 0), "record 1: access type c is unknown"),
    ],
)
def test_what_binary_is_refused(tmp_path, data, message):
    with pytest.raises(DinError, match=re.escape(message)):
        read(text_of(tmp_path, data))


GRID = [CacheConfig(512, 2, 32), CacheConfig(1024, 1, 64), CacheConfig(96, 3, 32, "fifo")]


@pytest.mark.parametrize("kind", ["kdtree", "bvh"])
@pytest.mark.parametrize("fmt", ["text", "binary"])
@pytest.mark.parametrize("layout", ["stored", "veb", "bfs+24"])
def test_an_exported_run_replays_as_the_run(tmp_path, kind, fmt, layout):
    """Counts, account and 3C; the kd-nodes of ``bfs+24`` and all BVH nodes lie in one line each only in the lines of GRID."""
    if layout == "bfs+24" and kind == "bvh" and fmt == "text":
        layout = "bfs+64"  # text does not keep the size of a node that spans lines
    trace = make_trace(kind, 13, n_rays=100)
    run = write(trace, tmp_path / f"bunny-{kind}")
    tree = run.columns("nodes", ["parent", "level"])
    out = tmp_path / "x.din"
    written = export_din(run, out, fmt=fmt, addresses=addresses(tree, trace.node_bytes, layout))
    assert written == len(trace.rows) == len(read(out))
    for ours, exported in zip(
        replay(run, GRID, layout=layout, three_c=True), replay(out, GRID, three_c=True), strict=True
    ):  # fmt: skip
        same = dict.fromkeys([*COLUMNS, "layout"])
        assert ours.to_dict() | same == exported.to_dict() | same
        assert ours.n_splits == exported.n_splits


@pytest.mark.parametrize("fmt", ["text", "binary"])
@pytest.mark.parametrize(("name", "label"), [("b", 11), ("read", 0), ("misc", 3), ("omit", None)])
def test_labels_of_prefetches(tmp_path, fmt, name, label):
    trace = make_trace("bvh", 2, n_rays=30)
    run = write(trace, tmp_path / "bunny-bvh")
    export_din(run, tmp_path / "x.din", fmt=fmt, prefetch=name)
    size = 32 if fmt == "binary" else 4
    wanted = [
        (32 * node, size, label if kind == 3 else 0) for node, kind in trace.node_kinds if kind != 3 or label is not None
    ]
    assert read(tmp_path / "x.din") == wanted
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []


def test_text_is_what_dinero_reads(tmp_path):
    """Lower-case hexadecimal without leading zeros, one blank, one newline."""
    trace = make_trace("kdtree", 2, n_rays=2)
    run = write(trace, tmp_path / "bunny-kdtree")
    export_din(run, tmp_path / "x.din")
    wanted = "".join(f"{'b' if kind == 3 else '0'} {8 * node:x}\n" for node, kind in trace.node_kinds)
    assert (tmp_path / "x.din").read_text() == wanted


def test_an_export_that_does_not_fit_or_cannot_be_written(tmp_path):
    trace = make_trace("kdtree", 2, n_rays=2)
    run = write(trace, tmp_path / "bunny-kdtree")
    high = np.arange(len(trace.parent), dtype=np.int64) * 8 + (1 << 32) - 16
    with pytest.raises(DinError, match="a DineroIV trace has 32 bits, so move the layout down"):
        export_din(run, tmp_path / "x.din", addresses=high)
    with pytest.raises(NptraceError, match=r"cannot write .*no/x\.din: there is no folder .*; name another file"):
        export_din(run, tmp_path / "no" / "x.din")
    with pytest.raises(DinError, match="'xml' is not a format"):
        export_din(run, tmp_path / "x.din", fmt="xml")
    with pytest.raises(DinError, match="'write' is not an access type for prefetches; choose one of b, read, misc, omit"):
        export_din(run, tmp_path / "x.din", prefetch="write")
    assert [path.name for path in tmp_path.iterdir()] == ["bunny-kdtree"]


def test_a_trace_has_no_nodes(tmp_path):
    path = text_of(tmp_path, "0 10\n")
    with pytest.raises(ValueError, match="no stack can be rebuilt for stack:unlimited; use traced, none or next-line"):
        replay(path, GRID, prefetch="stack")
    with pytest.raises(ValueError, match="has addresses, not nodes, so it cannot use the layout veb"):
        replay(path, GRID, layout="veb")


def test_prefetch_options_of_a_trace(tmp_path):
    path = text_of(tmp_path, "0 0\nb 40\n0 40\n3 80\n2 c0\n")
    traced, none, tagged = (
        replay(path, [CacheConfig(1024, 1, 32)], prefetch=prefetch)[0] for prefetch in ("traced", "none", "next-line:always")
    )
    assert (traced.demand_accesses, traced.prefetch_accesses, traced.demand_misses) == (4, 1, 3)
    assert (none.demand_accesses, none.prefetch_accesses, none.demand_misses) == (4, 0, 4)
    assert tagged.accesses.tolist()[8:12] == [2, 0, 1, 0]  # misc triggers nothing, and the explicit request is left out


def test_a_node_that_no_binary_record_holds(tmp_path):
    trace = make_trace("bvh", 2)
    run = write(trace, tmp_path / "bunny-bvh")
    run.footer = replace(run.footer, tree=replace(run.footer.tree, node_bytes=1 << 16))
    with pytest.raises(DinError, match="nodes of 65536 B do not fit a binary record, whose size has 16 bits; choose csv"):
        export_din(run, tmp_path / "x.din", fmt="binary", prefetch="read")
