"""Numbers at the limits of their types, chunks and stacks: 8192 pixels, 2^32 rows and addresses, 2^24 misses, depth 64."""

import csv
import io
import json
import struct

import numpy as np
import pytest

from cachesim.config import CacheConfig
from cachesim.lines import AddressLines
from cachesim.prefetch import UnitReplay, parse_prefetch
from cachesim.replay import replay
from cachesim.report import replay_tables
from cachesim.result import Result
from cachesim.sweep import sweep
from nptrace_base.errors import NptraceError
from nptrace_base.records import to_csv, to_json
from nptrace_base.tables import to_markdown
from rtrace import render as rendering
from rtrace.camera import Camera
from rtrace.chunk import Chunk
from rtrace.rays import make_rays
from rtrace.render import CHUNK, Shooting, render
from rtrace.scenes.scene import scene_from_triangles
from rtrace.traverse import trace_recorded
from rtrace.trees.tree import node_table
from rtrace.trees.tree_cache import build_tree
from tests.reference.cache import Cache, pieces
from tests.reference.traces import make_trace, write
from tests.reference.traversal import events_of, traverse
from traces.identity import RunIdentity
from traces.node_formats import NODE_FORMATS
from traces.reader import open_run

TREES = ("kdtree", "bvh")


@pytest.mark.parametrize("batch", [1, 3, 5000, CHUNK, CHUNK + 1, 10_500, 0])
@pytest.mark.slow
def test_a_batch_is_never_cut(tmp_path, batch):
    """The rays of each batch follow one another, primary before shadow, wherever chunks of pixels end."""
    quad = np.float32([[[-9, -9, 0], [9, -9, 0], [9, 9, 0]], [[-9, -9, 0], [0, 0, 0], [-9, 9, 0]]])
    scene = scene_from_triangles(quad, "quad")._replace(camera=Camera((1, 2, 12), (0, 0, 0)), light=(3.0, 4.0, 5.0))
    width, height = 110, 100
    assert width * height > CHUNK
    render(scene, build_tree(quad, "bvh"), Shooting(width, height, "scanline", batch), tmp_path / "run")
    rays = open_run(tmp_path / "run").columns("rays")
    pixels = rays["y"].astype(int) * width + rays["x"]
    shadowed = set(pixels[rays["type"] == 1].tolist())
    want, step = [], batch or width * height
    assert 1000 < len(shadowed) < width * height
    for start in range(0, width * height, step):
        members = range(start, min(start + step, width * height))
        want += [(pixel, 0) for pixel in members] + [(pixel, 1) for pixel in members if pixel in shadowed]
    assert list(zip(pixels.tolist(), rays["type"].tolist(), strict=True)) == want


class Rows:
    """As many rows as a column could have, without the memory."""

    def __init__(self, n):
        self.n = n

    def __len__(self):
        return self.n

    def __iadd__(self, other):
        return self


def test_the_first_access_of_a_ray_goes_beyond_32_bits(tmp_path, monkeypatch):
    written = []

    class Writer:
        def __init__(self, *args):
            tmp_path.joinpath("image.png").write_bytes(b"")

        __enter__ = lambda self: self
        __exit__ = lambda self, *args: None
        complete = image = lambda self, *args: None

        def append(self, table, columns):
            if table == "rays":
                written.extend(zip(columns["ray"].tolist(), columns["first"].tolist(), strict=True))

    def chunks(*args):
        for _ in range(3):
            rays = {"ray": np.arange(2, dtype=np.uint32), "first": np.array([0, 1 << 31], np.uint64)}
            accesses = {"ray": Rows((1 << 31) + 5), "node": None, "kind": None}
            yield Chunk(rays, accesses, np.arange(2), np.zeros((2, 3), np.uint8), 5, 0, 2, 0, 0, True)

    monkeypatch.setattr(rendering, "RunWriter", Writer)
    monkeypatch.setattr(rendering, "chunks", chunks)
    triangles = np.float32([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    summary = render(scene_from_triangles(triangles, "x"), build_tree(triangles, "bvh"), Shooting(2, 3), tmp_path)
    size = (1 << 31) + 5
    assert written == [(2 * i + j, i * size + j * (1 << 31)) for i in range(3) for j in range(2)]
    assert written[-1][1] > 1 << 32
    assert (summary.n_accesses, summary.n_prefetches) == (3 * size - 15, 15)


GRID = [CacheConfig(512, 2, 32), CacheConfig(96, 3, 32, "fifo"), CacheConfig(64, 1, 16)]


@pytest.mark.parametrize("kind", TREES)
@pytest.mark.parametrize("base", [(1 << 32) - 64, (1 << 32) - 8, (1 << 32) + 8, (1 << 33) - 24])
def test_nodes_on_both_sides_of_address_2_32(tmp_path, kind, base):
    trace = make_trace(kind, 5, n_rays=30)
    run = write(trace, tmp_path / f"x-{kind}")
    accesses = [(base + trace.node_bytes * node, trace.node_bytes, 11 if kind == 3 else 0) for node, kind in trace.node_kinds]
    for result in replay(run, GRID, layout=f"stored+{base}"):
        model = Cache(result.config).replay(pieces(accesses, result.config.line_bytes))
        assert result.misses.tolist() == model.counts["misses"]
        assert result.accesses.tolist() == model.counts["accesses"]


def test_the_last_addresses_of_a_din_trace(tmp_path):
    """The last byte is an address like any other; an access that would go beyond it is refused."""
    last = (1 << 32) - 1
    records = [
        (last, 1, 0),
        (last - 3, 4, 0),
        (0, 1, 0),
        (last - 63, 64, 0),
        (1 << 31, 4, 11),
        (0x7FFFFFFF, 4, 0),
    ]
    (tmp_path / "x.din").write_bytes(b"".join(struct.pack("<IHBB", *record, 0) for record in records))
    accesses = pieces(records, 16)
    [result] = replay(tmp_path / "x.din", [CacheConfig(32, 1, 16)])
    model = Cache(result.config).replay(accesses)
    assert result.accesses.tolist() == model.counts["accesses"]
    assert result.misses.tolist() == model.counts["misses"]
    (tmp_path / "far.din").write_bytes(struct.pack("<IHBB", last, 40, 0, 0))
    with pytest.raises(NptraceError, match=r"record 1: 40 B at ffffffff reach past 2\^32"):
        replay(tmp_path / "far.din", [CacheConfig(32, 1, 16)])
    (tmp_path / "text.din").write_text("0 ffffffff\n0 fffffffc\n0 0\n0 80000000\n0 7fffffff\n")
    [result] = replay(tmp_path / "text.din", [CacheConfig(16, 4, 4)])
    assert (result.demand_accesses, result.demand_misses) == (5, 4)


MANY = (1 << 24) + 3


class Alternating:
    """Two lines of one set in turn, ``MANY`` times: a direct-mapped cache always misses."""

    identity, n_rays, n_events, layout = RunIdentity("alternating"), None, None, "stored"

    def events(self, prefetch):
        for start in range(0, MANY, 1 << 21):
            n = min(1 << 21, MANY - start)
            address = np.zeros(n, np.uint32)
            address[1::2] = 1 << 20
            yield (address, 4), np.zeros(n, np.uint8)

    def lines(self, line_bytes, ahead):
        return AddressLines(line_bytes, ahead)


def test_more_misses_than_float32_counts():
    config = CacheConfig(1024, 1, 32)
    [counted], [result] = (
        replay(Alternating(), [config], prefetch=policy, is_filtered=False) for policy in ("none", "traced")
    )
    assert counted.demand_misses == counted.demand_accesses == MANY  # by the kernel that counts nothing else
    assert result.demand_misses == result.demand_accesses == result.demand_misses_without == MANY
    [row] = sweep(Alternating(), [config])
    assert row.to_dict()["demand_misses"] == row.to_dict()["total_misses"] == MANY
    for values in (
        json.loads(to_json([result.to_dict()]))[0],
        *csv.DictReader(io.StringIO(to_csv([result.to_dict()]))),
    ):
        assert int(values["demand_misses"]) == int(values["demand_accesses"]) == MANY
        assert int(values["bytes_from_memory"]) == 32 * MANY
    [values] = csv.DictReader(io.StringIO(to_csv([row.to_dict()])))
    assert (int(values["demand_misses"]), int(values["bytes_from_memory"])) == (MANY, 32 * MANY)


def test_large_counts_are_printed_whole():
    """In every column of the table and of DineroIV's block."""
    counts = {name: np.zeros(16, np.int64) for name in ("accesses", "misses", "compulsory", "capacity", "conflict")}
    for i, column in enumerate(counts.values()):
        column[[0, 2, 3, 11]] = [(1 << 40) + i, (1 << 24) + 1 + i, (1 << 31) + i, (1 << 33) + 1 + i]
    result = Result(RunIdentity("x"), CacheConfig(1024), "traced", "stored", True, n_splits=MANY, useful=MANY + 1,
                    useless=MANY + 2, resident=MANY + 3, pollution=MANY + 4, demand_misses_without=MANY, **counts)  # fmt: skip
    demand = (1 << 40) + (1 << 24) + 1 + (1 << 31)
    text = to_markdown(*replay_tables.tables([result]))
    for i in range(5):
        assert f" {demand + 3 * i:,} " in text
    for value in ((1 << 33) + 1, (1 << 33) + 2, -1, MANY + 1, MANY + 2, MANY + 3, MANY + 4):
        assert f" {value:,} " in text
    assert f" {(demand + 3 + (1 << 33) + 2) * 32 / 1024:,.0f} " in text
    rows = {
        line.rsplit("\t", 6)[0].strip(): line.split()[-6:] for line in replay_tables.to_dinero([result]).splitlines() if line
    }
    for i, name in enumerate(("Demand Fetches", "Demand Misses", "Compulsory misses", "Capacity misses", "Conflict misses")):
        parts = [demand + 3 * i, (1 << 24) + 1 + i, demand + 2 * i - (1 << 24) - 1, (1 << 40) + i, 0, (1 << 31) + i]
        assert rows[name] == [str(value) for value in parts]
    assert f" Multi-block refs      {MANY:12}\n" in replay_tables.to_dinero([result])


def powers_of_two():
    """Triangles at every power of two that float32 holds, in three axes' turns: the deepest trees that are legal."""
    size = np.exp2(np.arange(-126, 127, dtype=np.float64)).astype(np.float32)[:, None, None]
    return size * np.float32([[1, 0.25, 0.25], [1, 0.75, 0.25], [1, 0.25, 0.75]])


def deepest(events, tree):
    """Return the most entries that the stack of a traversal holds; a BVH pops one at each visit that pushes nothing."""
    depth, most = 0, 0
    for _, kind in events:
        depth += 1 if kind == 1 else -1 if tree.kind == "bvh" and kind != 3 else 0
        most = max(most, depth)
    return most


@pytest.mark.parametrize("kind", TREES)
@pytest.mark.slow
def test_a_stack_deeper_than_64(kind):
    """Visits and requests as the slow traverser has them; the requests derived from the visits are those traced."""
    triangles = powers_of_two()
    tree = build_tree(triangles, kind)
    assert tree.max_level > 64
    directions = np.float32([[1, 0.5, 0.5], [1, 0.25, 0.25], [1, 0.3, 0.4], [1, 0.9, 0.9], [1, 0.1, 0.1], [1, 0.45, 0.3]])
    rays = make_rays(np.zeros((6, 3)), directions)
    hits, count, packed = trace_recorded(tree, rays)
    events, start, most = [], 0, 0
    for i in range(6):
        mine = events_of(packed[start : start + count[i]])
        prim, t, want = traverse(tree, rays.origin[i], rays.direction[i])
        assert (int(hits.prim[i]), float(hits.t[i])) == (prim, t)
        assert mine == want
        events += mine
        most = max(most, deepest(mine, tree))
        start += count[i]
    assert most > 64
    table = node_table(tree)
    unit = UnitReplay(parse_prefetch("stack"), NODE_FORMATS[kind], *(table[name] for name in ("n_prims", "level", "parent")))
    nodes, kinds = (np.array(column) for column in zip(*events, strict=True))
    derived, labels = unit.events(nodes.astype(np.uint32), kinds.astype(np.uint8))
    assert derived.tolist() == nodes.tolist()
    assert (labels >= 8).tolist() == (kinds == 3).tolist()
