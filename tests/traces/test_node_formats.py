"""The table of node formats: what it says of each, and runs of 64-byte BVH nodes, read, checked and exported."""

import numpy as np
import pyarrow.parquet as pq
import pytest

from nptrace.scene_options import BVH_NODES
from rtrace.traverse import KERNELS, PACKET_KERNELS
from tests.reference import traversal
from tests.reference.traces import make_trace, write
from tests.traces.test_run_values import rewrite, with_value
from traces.din import DinTrace, export_din
from traces.format import LEAF, PREFETCH, PUSH, READ, RunError
from traces.node_formats import NO_ADDRESS, NODE_FORMATS, formats_of, stored_addresses
from traces.reader import open_run
from traces.validation import INNER_KINDS, leaf_kinds


def test_every_format_is_known_everywhere():
    assert list(NODE_FORMATS) == list(KERNELS) == list(traversal.WALKS)
    assert [name for name, each in NODE_FORMATS.items() if each.takes_packets] == list(PACKET_KERNELS)
    assert list(formats_of("bvh")) == list(map(int, BVH_NODES))
    assert [each.node_bytes for each in NODE_FORMATS.values()] == [8, 32, 64]
    assert [each.reads_leaves for each in NODE_FORMATS.values()] == [True, True, False]
    assert [leaf_kinds(each) for each in NODE_FORMATS.values()] == [(LEAF, PREFETCH), (READ, LEAF, PREFETCH), (LEAF,)]
    assert INNER_KINDS == (READ, PUSH, PREFETCH)


def test_inner_nodes_lie_side_by_side_and_leaves_nowhere():
    """The worked tree of the run format: 0 splits into 1 and 2, 1 into 3 and 4, 2 into 5 and 6."""
    parent = np.array([-1, 0, 0, 1, 1, 2, 2], np.int32)
    absent = int(NO_ADDRESS)
    assert stored_addresses(parent, NODE_FORMATS["bvh64"], 64).tolist() == [0, 64, 128, absent, absent, absent, absent]
    assert stored_addresses(parent, NODE_FORMATS["bvh"], 32).tolist() == [32 * node for node in range(7)]
    assert stored_addresses(parent[:1], NODE_FORMATS["bvh64"], 64).tolist() == [absent]


@pytest.fixture
def run(tmp_path):
    trace = make_trace("bvh64", 7, n_rays=60)
    return trace, write(trace, tmp_path / "x-bvh64")


def changed(run, table, column, row, value):
    rewrite(run.path, table, with_value(column, row, value))
    return open_run(run.path)


def test_the_columns_of_a_run_are_checked_by_its_format(run):
    trace, opened = run
    assert opened.columns("nodes", ["address"])["address"].astype(np.int64).tolist() == trace.addresses
    leaf = next(node for node, child in enumerate(trace.child) if not child)
    rule = "the number of its pair of children, from 0, x node size, and a leaf's is 2\\^64 - 1"
    with pytest.raises(RunError, match=f"column 'address', row {leaf}: 64 breaks the rule that an inner node's .* {rule}"):
        changed(opened, "nodes", "address", leaf, 64).columns("nodes")


@pytest.mark.parametrize("kind", [READ, PUSH, PREFETCH])
def test_a_leaf_is_entered_only(run, kind):
    trace, opened = run
    row = next(row for row, (node, _) in enumerate(trace.node_kinds) if not trace.child[node])
    with pytest.raises(RunError, match=f"row {row}: {kind} breaks the rule that a leaf, .* is accessed with kind 2"):
        changed(opened, "accesses", "kind", row, kind).columns("accesses")


def test_a_file_says_what_its_addresses_are(run):
    field = pq.read_schema(run[1].path / "nodes.parquet").field("address")
    assert field.metadata == {b"meaning": b"byte address of an inner node as stored; 2^64 - 1 for a leaf"}


@pytest.mark.parametrize("prefetch", ["b", "omit"])
def test_an_export_has_the_nodes_in_memory(run, tmp_path, prefetch):
    trace, opened = run
    path = tmp_path / "x.bin"
    written = export_din(opened, path, fmt="binary", prefetch=prefetch)
    wanted = [(trace.addresses[node], 64, 11 if is_request else 0) for node, is_request in trace.accesses]
    wanted = [access for access in wanted if prefetch == "b" or access[2] == 0]
    assert written == len(wanted) and any(label for _, _, label in wanted) == (prefetch == "b")
    assert [
        row for a, s, b in DinTrace(path).batches() for row in zip(a.tolist(), s.tolist(), b.tolist(), strict=True)
    ] == wanted
