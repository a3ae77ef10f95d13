"""Unlikely inputs for everything that takes input: ``python -m tests.fuzz [WORD] [-n N] [-s SEED] [-o FILE]``.

A target takes one input. An accepted input must keep the target's properties; a refused one must raise a ValueError whose
message is one sentence. Anything else is a failure. ``tests/test_fuzz.py`` runs a seeded thousand; this command runs
many more and writes how many, for docs/correctness.md. With words, only targets that have one of them are tried, and only
their lines of FILE change.
"""

import argparse
import contextlib
import faulthandler
import importlib
import json
import math
import re
import resource
import struct
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from cachesim.config import CacheConfig, format_bytes, parse_bytes, parse_ways
from cachesim.grid import grid, parse_range, parse_ways_range
from cachesim.layout import addresses, parse_layout
from cachesim.prefetch import parse_prefetch
from cachesim.replay import replay
from cachesim.sweep import sweep
from nptrace.groups import BadInput
from nptrace.scene_options import parse_kd
from rtrace.camera import Camera, format_camera, parse_camera, parse_point, parse_size
from rtrace.scenes.mesh_file import SceneError
from rtrace.scenes.meshes.polygons import fan
from rtrace.scenes.scene import load_mesh, scene_from_triangles
from tests.reference.cache import Cache
from tests.reference.fuzz_gltf import changed_gltf, try_changed_gltf
from tests.reference.run_values import SCHEMAS, is_as_good, legal_events, mutate
from tests.reference.traces import make_trace, write
from tests.reference.tree_checks import SCENES, try_scene
from traces.din import DinTrace, export_din
from traces.format import FILES, METADATA_KEY
from traces.reader import open_run

REFUSED = (ValueError, BadInput)


class Target(NamedTuple):
    """``try_input`` returns what it made of an input, raises one of REFUSED, or fails."""

    what: str
    inputs: st.SearchStrategy
    try_input: Callable[[Any], object]
    least: int = 0  # inputs of the usual 100,000, if more than an equal share


@cache
def scratch() -> Path:
    """Return a folder for the files that are tried."""
    return Path(tempfile.mkdtemp(prefix="nptrace-fuzz-"))


def was_accepted(target: Target, value: Any) -> bool:
    """Try one input; return whether it was accepted. AssertionError if it was refused without a sentence."""
    try:
        target.try_input(value)
    except REFUSED as error:
        said = error.message if isinstance(error, BadInput) else str(error)
        assert said and "\n" not in said and "Traceback" not in said, said
        return False
    return True


# --- texts -----------------------------------------------------------------------------------------------------------


def damaged(*good: str) -> st.SearchStrategy[str]:
    """Texts near good ones: other numbers, or pieces cut out, doubled, or put in from a heap of numbers and signs."""
    junk = st.sampled_from(
        [*"0123456789.,:;=x*+-_ \t\nKMGBkeE/%", "nan", "inf", "-1", "1e400", "99999999999", "²", "٣", "..", ""]
    )
    piece = st.sampled_from(good) | junk | st.text(max_size=3) | st.integers(-3, 1 << 70).map(str) | st.floats().map(str)
    cuts = st.lists(st.tuples(st.integers(0, 60), st.integers(0, 4), piece), max_size=3)

    def change(base: str, numbers: list[int], cuts: list[tuple[int, int, str]]) -> str:
        others = iter(numbers)
        base = re.sub(r"\d+", lambda found: str(next(others, found[0])), base)
        for at, width, new in cuts:
            at %= len(base) + 1
            base = base[:at] + new + base[at + width :]
        return base

    number = st.integers(0, 9) | st.integers(0, 300) | st.integers(0, 17).map(lambda k: 1 << k)
    return st.builds(change, st.sampled_from(good), st.lists(number, max_size=4), st.just([]) | cuts)


def try_size(text: str) -> None:
    width, height = parse_size(text)
    assert 1 <= width <= 65536 and 1 <= height <= 65536 and width * height < 2**31


def try_camera(text: str) -> None:
    camera = parse_camera(text)
    assert parse_camera(format_camera(camera)) == camera
    frame = camera.frame(3, 2)
    assert np.isfinite(frame[0]).all() and frame.shape == (4, 3)


def try_point(text: str) -> None:
    assert len(parse_point(text)) == 3 and all(map(math.isfinite, parse_point(text)))


def try_kd(text: str) -> None:
    assert set(parse_kd(text)) <= {"c_trav", "c_isect", "empty_bonus", "max_level", "min_leaf", "max_leaf"}


def try_bytes(text: str) -> None:
    n = parse_bytes(text)
    assert n >= 0 and parse_bytes(format_bytes(n)) == n


def try_cache(texts: tuple[str, str, str, str]) -> None:
    size, ways, line, policy = texts
    size_bytes, line_bytes = parse_bytes(size), parse_bytes(line)
    config = CacheConfig(size_bytes, parse_ways(ways, size_bytes, line_bytes), line_bytes, policy)
    assert config.n_sets * config.ways * config.line_bytes == config.size_bytes > 0
    assert 1 <= config.n_sets < 1 << 31 and str(config)


def try_ranges(texts: tuple[str, str]) -> None:
    low, high = parse_range(texts[0])
    names = parse_ways_range(texts[1])
    if len(names) > 64:  # more ways than that are many caches, but no other code
        return
    for config in grid([(low, high)], names, [32]):
        assert low <= config.size_bytes <= high and config.n_sets & (config.n_sets - 1) == 0


def try_prefetch(text: str) -> None:
    policy = parse_prefetch(text)
    assert parse_prefetch(str(policy)) == policy


def try_layout(text: str) -> None:
    layout = parse_layout(text)
    assert parse_layout(str(layout)) == layout
    placed = addresses({"parent": np.array([-1, 0, 0, 1, 1]), "level": np.array([0, 1, 1, 2, 2])}, 32, layout)
    assert len(set(placed.tolist())) == 5 and placed.min() >= 0


# --- meshes ----------------------------------------------------------------------------------------------------------

numbers = st.sampled_from([0.0, -0.0, 1.0, -2.5, 3e38, 1e39, -1e300, 1e-45, math.nan, math.inf, -math.inf]) | st.floats()
vertex_ids = st.integers(0, 5) | st.sampled_from([-1, -2, 6, 7, 99, 2**31, 2**40, -(2**31)])


def write_mesh(name: str, vertices: list, faces: list) -> Path:
    """Write an OBJ, OFF or PLY file with these vertices and polygons, whose numbers count from 0."""
    path = scratch() / f"mesh{name}"
    rows = [" ".join(map(repr, vertex)) for vertex in vertices]
    if name == ".obj":  # 0 and below would count from 1 or backwards: left out by making them 0, which is no vertex
        lines = [f"v {row}" for row in rows]
        lines += ["f " + " ".join(str(max(i + 1, 0)) for i in face) for face in faces]
    elif name == ".off":
        lines = ["OFF", f"{len(vertices)} {len(faces)} 0", *rows, *(f"{len(f)} " + " ".join(map(str, f)) for f in faces)]
    else:
        lines = [
            "ply", "format ascii 1.0", f"element vertex {len(vertices)}", *(f"property double {k}" for k in "xyz"),
            f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header",
            *rows, *(f"{len(f)} " + " ".join(map(str, f)) for f in faces),
        ]  # fmt: skip
    path.write_text("\n".join(lines) + "\n")
    return path


def try_mesh(mesh: tuple[str, list, list]) -> None:
    """What is kept are the triangles with good vertices and numbers, in the order of the file; the others are counted."""
    name, vertices, faces = mesh
    with np.errstate(over="ignore"):
        corners = np.array(vertices, np.float64).astype(np.float32).reshape(-1, 3)
    wanted, n_bad = [], 0
    for face in faces:
        for k in range(1, len(face) - 1):
            three = [face[0], face[k], face[k + 1]]
            good = all(0 <= i < len(corners) and np.isfinite(corners[i]).all() for i in three)
            wanted += [corners[three]] if good else []
            n_bad += not good
    try:
        path = write_mesh(name, vertices, faces)
        scene = load_mesh(path, fans=True)
    except SceneError:
        assert not wanted, "a mesh with good triangles was refused"
        raise
    np.testing.assert_array_equal(scene.triangles, np.array(wanted))
    assert sum(dropped.n for dropped in scene.dropped) == n_bad
    with contextlib.suppress(SceneError):  # polygons whose ears are cut may give no triangle
        cut = load_mesh(path)
        assert len(cut.triangles) <= len(wanted) and sum(dropped.n for dropped in cut.dropped) == n_bad


def try_bits(bits: bytes) -> None:
    """Triangles of any bit pattern: those that are numbers stay, and can be looked at."""
    triangles = np.frombuffer(bits[: len(bits) // 36 * 36], np.float32).reshape(-1, 3, 3)
    finite = np.isfinite(triangles).all(axis=(1, 2))
    scene = scene_from_triangles(triangles, "bits")
    np.testing.assert_array_equal(scene.triangles, triangles[finite])
    assert isinstance(scene.camera, Camera) and np.isfinite(scene.camera.frame(4, 4)[0]).all()
    assert all(map(math.isfinite, scene.light))


@cache
def good_meshes() -> dict[str, bytes]:
    """Return a small good file of each kind, by suffix."""
    import trimesh

    corners, faces = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)], [[0, 1, 2], [0, 1, 3, 2]]
    made = {name: write_mesh(name, corners, faces).read_bytes() for name in (".obj", ".off", ".ply")}
    solid = trimesh.Trimesh(corners, fan(np.array([3, 4]), np.concatenate(faces)), process=False)
    made |= {f".{kind}": solid.export(file_type=kind) for kind in ("stl", "glb")}
    made["-text.stl"] = solid.export(file_type="stl_ascii").encode()
    return made


def try_mesh_bytes(value: tuple[str, bytes, list]) -> None:
    name, data, cuts = value
    path = scratch() / f"bytes{name}"
    path.write_bytes(spliced(good_meshes()[name], data, cuts))
    scene = load_mesh(path)
    assert len(scene.triangles) and np.isfinite(scene.triangles).all()


def spliced(base: bytes, data: bytes, cuts: list[tuple[int, int, int]]) -> bytes:
    """Return bytes with pieces of ``data`` put in: each cut is (where, how much to leave out, how much to put in)."""
    for at, out, put in cuts:
        at %= len(base) + 1
        base = base[:at] + data[:put] + base[at + out :]
    return base


words = st.integers(0, (1 << 32) - 1) | st.sampled_from([0, 0x7F7FFFFF, 0x80000001, 0x3F800000, 0x7F800000, 0xFFC00000])
bit_patterns = st.lists(words, min_size=9, max_size=45).map(lambda each: struct.pack(f"<{len(each)}I", *each))
cuts = st.lists(st.tuples(st.integers(0, 1 << 16), st.integers(0, 8), st.integers(0, 8)), max_size=4)
mesh_bytes = st.tuples(st.sampled_from([".obj", ".off", ".ply", ".stl", "-text.stl", ".glb"]), st.binary(max_size=64), cuts)
meshes = st.tuples(
    st.sampled_from([".obj", ".off", ".ply"]),
    st.lists(st.tuples(numbers, numbers, numbers), min_size=1, max_size=6),
    st.lists(st.lists(vertex_ids, min_size=3, max_size=5), min_size=1, max_size=5),
)


# --- traces ----------------------------------------------------------------------------------------------------------


@cache
def good_run() -> dict[str, bytes]:
    """Return the files of a small run."""
    path = scratch() / "good-bvh"
    write(make_trace("bvh", 5, n_rays=12), path)
    return {name: (path / name).read_bytes() for name in FILES}


def open_and_replay(path: Path) -> None:
    run = open_run(path)
    for name in ("rays", "nodes"):
        for column in run.columns(name).values():
            assert len(column) == getattr(run.footer, f"n_{name}")
    assert sum(len(nodes) for nodes, _ in run.batches()) == run.n_accesses
    for prefetch in ("traced", "stack:budget=2"):
        replay(run, [CacheConfig(256, 2, 32)], prefetch=prefetch, threads=1)


def try_run_bytes(value: tuple[str, bytes, list]) -> None:
    """A run with bytes changed in one file opens and replays, or is refused."""
    name, data, cuts = value
    path = scratch() / "bytes-bvh"
    path.mkdir(exist_ok=True)
    for each, whole in good_run().items():
        (path / each).write_bytes(spliced(whole, data, cuts) if each == name else whole)
    open_and_replay(path)


json_values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-2, 1 << 70)
    | st.floats()
    | st.text(max_size=4)
    | st.sampled_from(["kdtree", "bvh"]),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["kind", "node_bytes", "name", "stand_in"]), inner)
    ),
    max_leaves=6,
)
footer_names = st.sampled_from(["format_version", "n_accesses", "n_rays", "n_nodes", "tree", "scene", "image_sha256", "order"])


@cache
def good_tables() -> dict[str, Any]:
    """Return the tables of a small run with what their footers say."""
    import io

    import pyarrow.parquet as pq

    files = {name: pq.ParquetFile(io.BytesIO(data)) for name, data in good_run().items() if name.endswith("parquet")}
    return {name: (file.read(), json.loads(file.metadata.metadata[METADATA_KEY])) for name, file in files.items()}


def try_footer(value: tuple[dict[str, Any], list[str], object]) -> None:
    """A run whose footers all say the same, but anything."""
    import pyarrow.parquet as pq

    changes, missing, instead = value
    path = scratch() / "footer-bvh"
    path.mkdir(exist_ok=True)
    for name, (table, good) in good_tables().items():
        metadata = good | changes
        for each in missing:
            metadata.pop(each, None)
        text = json.dumps(metadata if instead is None else instead).encode()
        pq.write_table(table.replace_schema_metadata({METADATA_KEY: text}), path / name)
    (path / "image.png").write_bytes(good_run()["image.png"])
    open_and_replay(path)


def try_run_values(seed_of: int) -> None:
    """A run with other values, types, columns, rows or row groups is counted as a slow reading counts it, or refused."""
    path = scratch() / "values"
    run = mutate(seed_of, path, scratch())
    node_bytes, config = 8 if run.kind == "kdtree" else 32, CacheConfig(256, 2, 32)
    accepted = False
    for prefetch in ("traced", "stack:budget=2"):
        wanted = legal_events(run, prefetch)
        try:
            [result] = replay(path, [config], prefetch=prefetch, threads=1)
        except REFUSED:
            assert not (wanted is not None and is_as_good(run)), f"a good run was refused: {run.what}"
            if prefetch == "traced":
                raise
            continue
        assert wanted is not None, f"a bad run was counted: {run.what}"
        accepted = True
        model = Cache(config).replay([(node * node_bytes // 32, 11 if is_request else 0) for node, is_request in wanted])
        assert result.accesses.tolist() == model.counts["accesses"] and result.misses.tolist() == model.counts["misses"]
    assert accepted
    if seed_of % 4:
        return
    wanted = legal_events(run, "traced")
    assert wanted is not None
    for layout in ("bfs", "dfs", "veb", "treelet:64"):
        [result] = replay(path, [config], layout=layout, threads=1)
        assert result.demand_accesses + result.prefetch_accesses == len(wanted)
    [row] = sweep(path, [config], threads=1)
    assert row.demand_accesses + row.prefetch_accesses == len(wanted)
    with contextlib.suppress(*REFUSED):  # it reads the addresses too, and they may be wrong
        export_din(open_run(path), scratch() / "values.din")
        text = "".join(f"{'b' if is_request else '0'} {node_bytes * node:x}\n" for node, is_request in wanted)
        assert (scratch() / "values.din").read_text() == text
    for table in SCHEMAS:
        with contextlib.suppress(*REFUSED):
            open_run(path).columns(table)


def try_din(data: bytes) -> None:
    path = scratch() / "x.din"
    path.write_bytes(data)
    n = sum(len(address) for address, _, _ in DinTrace(path).batches())
    [result] = replay(path, [CacheConfig(256, 2, 32)], threads=1)
    assert result.demand_accesses + result.prefetch_accesses == n + result.n_splits


def try_disguised_din(value: tuple[bytes, str, list[tuple[int, int, int]], bytes]) -> None:
    """A trace that is packed, or in another encoding, reads as the plain one; damaged, it is refused or reads as a part."""
    data, dress, cuts, junk = value
    plain, path = scratch() / "plain.din", scratch() / "dressed.din"
    plain.write_bytes(data)
    path.write_bytes(spliced(dressed(data, dress), junk, cuts))
    assert cuts or listed(plain) == listed(path)
    listed(path)


def listed(path: Path) -> list[tuple[int, int, int]]:
    """Return (address, size, label) of every access of a trace."""
    batches = DinTrace(path).batches()
    return [
        row for a, s, b in batches for row in zip(a.tolist(), np.broadcast_to(s, a.shape).tolist(), b.tolist(), strict=True)
    ]


def dressed(data: bytes, dress: str) -> bytes:
    """Return a trace in another form."""
    if dress in ("zstd", "lz4"):
        sink = pa.BufferOutputStream()
        with pa.CompressedOutputStream(sink, dress) as packed:
            packed.write(data)
        return sink.getvalue().to_pybytes()
    if dress in ("gzip", "bz2", "lzma"):
        return importlib.import_module(dress).compress(data)
    if dress == "cr":
        return data.replace(b"\r\n", b"\n").replace(b"\n", b"\r")
    return data.decode("latin-1").encode(dress)


din_texts = damaged("0 1a2b40\n2 0x10 rest\n", "b ffffffff\r\n", "3 0\n\n").map(lambda text: text.encode("utf-8", "replace"))
din_records = st.lists(st.tuples(st.integers(0, (1 << 32) - 1), st.integers(0, 80), st.sampled_from([0, 0, 2, 3, 11, 1, 8])))
din_binary = din_records.map(lambda records: b"".join(struct.pack("<IHBB", *record, 0) for record in records))

seeds = st.integers(0, 2**48)  # of random triangles; tests/reference/tree_checks.py makes and checks their trees
din_plain = din_texts.map(lambda text: text.decode("ascii", "ignore").encode()) | din_texts.map(lambda _: b"0 1a2b40\nb 20\n")
dresses = st.sampled_from(["gzip", "bz2", "lzma", "zstd", "lz4", "cr", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])

policies = st.sampled_from(["lru", "fifo", "random", "opt", "mru", ""])
sizes = ("8K", "512", "64KiB", "1M", "0", "3G")
ways = ("1", "2", "full", "16", "3")

TARGETS = [
    Target("picture sizes", damaged("512x512", "1X65536", " 9 x 9 "), try_size),
    Target("cameras", damaged("eye=1,2,3 at=0,0,0", "eye=1,2,3; dir=0,0,-1 up=0,1,0 fov=60"), try_camera),
    Target("lights", damaged("1,2,3", "-1e30, 0, .5"), try_point),
    Target("kd-tree parameters", damaged("c_trav=1.5,c_isect=2", "coarse", "max_level=16,empty_bonus=.8"), try_kd),
    Target("byte sizes", damaged(*sizes), try_bytes),
    Target("caches", st.tuples(damaged(*sizes), damaged(*ways), damaged("32", "64", "1"), policies), try_cache),
    Target("ranges of a sweep", st.tuples(damaged("4K..64K", "8K", "1..2"), damaged("1..16", "full", "4")), try_ranges),
    Target(
        "prefetch policies",
        damaged("none", "traced", "stack:budget=3:once", "stack:tris*2:empty", "next-line:tagged:2"),
        try_prefetch,
    ),
    Target("layouts", damaged("stored", "bfs+64", "dfs", "veb", "treelet:256+4G"), try_layout),
    Target("meshes with bad numbers", meshes, try_mesh),
    Target("triangles of any bits", bit_patterns, try_bits),
    Target("mesh files of any bytes", mesh_bytes, try_mesh_bytes),
    Target("glTF files of any values", changed_gltf, try_changed_gltf),
    Target("runs with changed bytes", st.tuples(st.sampled_from(FILES), st.binary(max_size=16), cuts), try_run_bytes),
    Target(
        "runs with other footers",
        st.tuples(
            st.dictionaries(footer_names, json_values, max_size=3),
            st.lists(footer_names, max_size=1),
            st.none() | st.none() | json_values,
        ),
        try_footer,
    ),
    *(Target(f"trees of {kind}", seeds, partial(try_scene, kind), least=17_000) for kind in SCENES),
    Target("runs with other values", st.integers(0, 1 << 48), try_run_values, least=20_000),
    Target("DineroIV traces", din_texts | din_binary | st.binary(max_size=60), try_din),
    Target(
        "DineroIV traces in disguise",
        st.tuples(din_plain, dresses, st.just([]) | cuts, st.binary(max_size=8)),
        try_disguised_din,
    ),
]


def run(target: Target, n: int, seed_of: int) -> Counter[bool]:
    """Try about ``n`` different inputs (fewer where there are not so many); return how many were accepted and refused."""
    tried: Counter[bool] = Counter()
    quick = settings(
        max_examples=n, deadline=None, database=None, derandomize=False, suppress_health_check=list(HealthCheck),
        phases=[Phase.generate, Phase.shrink],
    )  # fmt: skip

    @seed(seed_of)
    @quick
    @given(target.inputs)
    def attempt(value: Any) -> None:
        tried[was_accepted(target, value)] += 1

    attempt()
    return tried


def main() -> None:
    """Try inputs on every target until there were as many as asked for; exit 1 if any failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("words", nargs="*", metavar="WORD")
    parser.add_argument("-n", type=int, default=100_000, help="inputs in all, were all targets tried")
    parser.add_argument("-s", "--seed", type=int, default=0)
    parser.add_argument("-o", type=Path, help="write the counts as JSON")
    args = parser.parse_args()
    warnings.simplefilter("error")  # nobody who reads a file wants to see them
    faulthandler.enable()  # a crash of the process is a failure too, and says where
    resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))  # an input that asks for more is a failure, not the end of all
    rows: dict[str, dict[str, Any]] = {}
    if args.words and args.o is not None and args.o.exists():
        rows = {row["inputs"]: row for row in json.loads(args.o.read_text(encoding="utf-8"))["rows"]}
    n_failed = 0
    for target in TARGETS:
        if args.words and not any(word in target.what for word in args.words):
            continue
        began, tried = time.perf_counter(), Counter[bool]()
        try:
            for turn in range(100):  # a run of hypothesis ends early where inputs begin to repeat
                share = max(math.ceil(args.n / len(TARGETS)), args.n * target.least // 100_000)
                missing = share - tried.total()
                if missing > 0:
                    tried += run(target, missing, args.seed + 1000 * turn)
        except Exception:
            n_failed += 1
            traceback.print_exc()
            continue
        rows[target.what] = {
            "inputs": target.what, "seed": args.seed, "tried": tried.total(), "accepted": tried[True], "refused": tried[False]
        }  # fmt: skip
        print(f"{rows[target.what]} {time.perf_counter() - began:.0f} s", file=sys.stderr, flush=True)
        if args.o is not None:
            write_counts(args.o, rows)
    print(f"{sum(row['tried'] for row in rows.values())} inputs, {n_failed} targets failed")
    raise SystemExit(1 if n_failed else 0)


def write_counts(path: Path, rows: dict[str, dict[str, Any]]) -> None:
    """Write one target a line, in their order."""
    lines = [json.dumps(rows[target.what]) for target in TARGETS if target.what in rows]
    path.write_text('{"rows": [\n' + ",\n".join(lines) + "\n]}\n", encoding="utf-8")


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        main()
