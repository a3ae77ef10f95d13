"""Runs of packets: which rays go together, whose their accesses are, and that all that reads a run works or says why not."""

import math

import numpy as np
import pytest
from click.testing import CliRunner

import cli
from cachesim.by_group import replay_by
from cachesim.config import CacheConfig
from cachesim.replay import replay
from nptrace_base.errors import NptraceError
from rtrace import chunk
from rtrace import render as render_module
from rtrace.camera import ORDERS, pixel_order
from rtrace.packets import shot_pixels
from rtrace.ray_source import RayUnits
from rtrace.render import render
from rtrace.scenes.scene import scene_from_triangles
from rtrace.scenes.shapes import boxes, icosphere
from rtrace.shooting import Shooting
from rtrace.traverse import Together, trace_recorded
from rtrace.trees.tree_cache import build_tree
from tests.reference.packets import traverse_packets
from traces.format import FILES, PREFETCH
from traces.reader import open_run

TREES = ("kdtree", "bvh")
PACKETS = (4, 16, 64)
WIDTH, HEIGHT = 70, 37


@pytest.fixture(scope="module")
def scene():
    return scene_from_triangles(np.concatenate([boxes(), icosphere(3) + np.float32([0, 3, 0])]), "things")


@pytest.fixture(scope="module")
def single(scene, tmp_path_factory):
    """The rays of the usual run of each tree, by (pixel, type)."""
    found = {}
    for kind in TREES:
        path = tmp_path_factory.mktemp("single") / kind
        render(scene, build_tree(scene.triangles, kind), Shooting(WIDTH, HEIGHT), path)
        found[kind] = open_run(path)
    return found


def by_pixel(run, names):
    rays = run.columns("rays")
    order = np.lexsort((rays["x"], rays["y"], rays["type"]))
    return [rays[name][order] for name in ("x", "y", "type", *names)]


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("packet", PACKETS)
def test_a_packet_is_an_aligned_square_where_its_first_pixel_was(order, packet):
    shooting, side = Shooting(WIDTH, HEIGHT, order, seed=3, packet=packet), math.isqrt(packet)
    squares = {}
    for pixel in pixel_order(order, WIDTH, HEIGHT, 3).tolist():
        squares.setdefault((pixel // WIDTH // side, pixel % WIDTH // side), []).append(pixel)
    assert shot_pixels(shooting).tolist() == [pixel for square in squares.values() for pixel in square]
    if order == "tile" and packet == 64:
        np.testing.assert_array_equal(shot_pixels(shooting), pixel_order(order, WIDTH, HEIGHT))


@pytest.mark.parametrize("kind", TREES)
@pytest.mark.parametrize("packet", PACKETS)
@pytest.mark.parametrize(("order", "batch"), [("tile", 1), ("scanline", 1), ("random", 130), ("morton", 0)])
def test_the_rows_of_a_run_of_packets(tmp_path, scene, single, kind, packet, order, batch):
    shooting = Shooting(WIDTH, HEIGHT, order, batch, seed=3, packet=packet)
    render(scene, build_tree(scene.triangles, kind), shooting, tmp_path / "run")
    run, side = open_run(tmp_path / "run"), math.isqrt(packet)
    # Hits and picture are those of single rays; the occluder of a shadow ray may be another.
    for got, wanted in zip(by_pixel(run, ["prim", "t"]), by_pixel(single[kind], ["prim", "t"]), strict=True):
        primary = WIDTH * HEIGHT
        np.testing.assert_array_equal(got[:primary], wanted[:primary])
        np.testing.assert_array_equal(got[primary:] < np.inf, wanted[primary:] < np.inf)
    assert (run.path / "image.png").read_bytes() == (single[kind].path / "image.png").read_bytes()

    rays, n_accesses = run.columns("rays"), run.n_accesses
    assert rays["count"].sum() == n_accesses < single[kind].n_accesses
    square = rays["y"] // side * 100 + rays["x"] // side
    cuts = np.flatnonzero((np.diff(square) != 0) | (np.diff(rays["type"]) != 0)) + 1
    packets = np.split(np.arange(len(square)), cuts)
    types = [rays["type"][each[0]] for each in packets]
    assert all(len(each) <= packet for each in packets) and max(map(len, packets)) == packet
    if batch == 1:  # a packet of primary rays, and after it at most one of its shadow rays
        assert sum(t == 0 for t in types) == -(-WIDTH // side) * -(-HEIGHT // side)
        assert all(types[i - 1] == 0 and square[packets[i][0]] == square[packets[i - 1][0]]
                   for i, t in enumerate(types) if t == 1)  # fmt: skip
    if batch == 130:
        at_once = [len(part) for part in "".join("ps"[t] for t in types).replace("s", " ").split()]
        assert not any(n % -(-130 // packet) for n in at_once[:-1]) and len(at_once) > 3
    if batch == 0:
        assert types == sorted(types)
    if kind == "bvh":  # every packet reads the root, and its first ray has all of its accesses
        assert all(rays["count"][each[0]] > 0 and not rays["count"][each[1:]].any() for each in packets)


@pytest.mark.parametrize("kind", TREES)
def test_the_rows_are_those_of_the_slow_recursion(tmp_path, scene, kind):
    """The primary rays of the first squares, from the picture to the file."""
    tree = build_tree(scene.triangles, kind)
    render(scene, tree, Shooting(24, 16, "tile", 0, packet=64), tmp_path / "run")
    run = open_run(tmp_path / "run")
    frame = scene.camera.frame(24, 16)
    pixels = np.concatenate([(np.arange(8)[:, None] * 24 + np.arange(x, x + 8)).ravel() for x in (0, 8, 16)])
    rays = chunk.primary_rays(frame, pixels.astype(np.uint32), 24)
    _, wanted = traverse_packets(tree, rays, np.repeat([0, 1, 2], 64))
    wanted = [event for each in wanted for event in each]
    node, kinds = (column[: len(wanted)].tolist() for column in next(run.batches(("node", "kind"))))
    assert list(zip(node, kinds, strict=True)) == wanted and len(wanted) > 100


@pytest.mark.parametrize("kind", TREES)
@pytest.mark.parametrize("shooting", [Shooting(90, 70, packet=16), Shooting(65, 66, "hilbert", 0, packet=64)])
def test_bytes_do_not_depend_on_threads_or_chunks(tmp_path, scene, kind, shooting, monkeypatch):
    tree = build_tree(scene.triangles, kind)
    render(scene, tree, shooting, tmp_path / "0", threads=1)
    render(scene, tree, shooting, tmp_path / "1", threads=3)
    monkeypatch.setattr(render_module, "CHUNK", 200)
    render(scene, tree, shooting, tmp_path / "2", threads=2)
    monkeypatch.setattr(render_module, "MOST_EVENTS", 600)
    render(scene, tree, shooting, tmp_path / "3", threads=2)
    for name in FILES:
        assert len({(tmp_path / str(i) / name).read_bytes() for i in range(4)}) == 1


@pytest.mark.parametrize("kind", TREES)
def test_a_replay_rebuilds_the_stack_of_a_packet(tmp_path, scene, kind):
    render(scene, build_tree(scene.triangles, kind), Shooting(40, 40, packet=64), tmp_path / "run")
    cache = [CacheConfig(1024, 2, 32)]
    traced, rebuilt, none = (replay(str(tmp_path / "run"), cache, prefetch=text) for text in ("traced", "stack", "none"))
    assert traced[0].prefetch_accesses > 100
    for name in ("prefetch_accesses", "prefetch_misses", "demand_misses"):
        assert getattr(traced[0], name) == getattr(rebuilt[0], name)
    assert none[0].demand_accesses == traced[0].demand_accesses
    by_type = replay_by(str(tmp_path / "run"), cache, "ray-type", prefetch="stack")[0].counts["demand_accesses"]
    rays, kinds = (open_run(tmp_path / "run").columns(*what) for what in (("rays",), ("accesses", ["ray", "kind"])))
    is_shadow = rays["type"][kinds["ray"][kinds["kind"] != PREFETCH]] == 1
    assert by_type.tolist() == [(~is_shadow).sum(), is_shadow.sum()] and by_type.min() > 0


COMMANDS = {
    "npcache replay {run} --size 1K": 0, "npcache sweep {run} --size 1K,2K --ways 1,2": 0, "nptrace info {run}": 0,
    "npcache replay {run} --size 1K --by level": 0, "nptrace export {run} -o {out}": 0, "npcache plot {run} -o {out}.png": 0,
    "nptrace view {run} -o {out}.png": 0,
    "npcache replay {run} --size 1K --by pixel": "keep counts by level, node or ray-type, or render with --packet 1",
    "nptrace view {run} --heat accesses -o {out}.png": "keep counts by level, node or ray-type, or render with --packet 1",
    "npcache time {run}": "on the clock every ray reads for itself; time a run of --packet 1",
    "npcache compare {run}": "on the clock every ray reads for itself; time a run of --packet 1",
    "nptrace view {run} --heat miss-cycles -o {out}.png": "on the clock every ray reads for itself; time a run of --packet 1",
}  # fmt: skip


@pytest.mark.parametrize("command", COMMANDS)
def test_what_reads_a_run_works_or_says_why_not(tmp_path, scene, command, monkeypatch):
    monkeypatch.chdir(tmp_path)
    render(scene, build_tree(scene.triangles, "bvh"), Shooting(24, 24, packet=16), tmp_path / "run")
    program, *args = command.format(run="run", out="out").split()
    result = CliRunner().invoke(getattr(cli, program), args)
    assert result.exit_code == (0 if COMMANDS[command] == 0 else 2), result.output
    if COMMANDS[command]:
        assert result.stderr.splitlines()[-1].startswith("Error: run has packets of 16 rays, ")
        assert result.stderr.rstrip().endswith(COMMANDS[command])


def test_an_estimate_samples_single_rays(scene):
    with pytest.raises(NptraceError, match="and not packets of 4; render the run"):
        RayUnits(scene, build_tree(scene.triangles, "bvh"), Shooting(64, 64, packet=4))


@pytest.mark.parametrize("knob", [{"packet": 4}, {"shadow_order": "cheaper"}, {"shadow_end": "drain"}])
def test_other_nodes_than_mantas_are_refused(tmp_path, scene, knob):
    [(name, value)] = knob.items()
    with pytest.raises(NptraceError, match=f"^{name} {value} is for nodes as Manta has them.*not for bvh64; leave out"):
        list(render_module.render_all([scene], {"bvh64": {}}, Shooting(8, 8, **knob), tmp_path))
    assert not list(tmp_path.iterdir())


def test_a_single_square_that_is_too_long_gets_its_room(scene, monkeypatch):
    tree = build_tree(scene.triangles, "bvh")
    rays = chunk.primary_rays(scene.camera.frame(8, 8), np.arange(64, dtype=np.uint32), 8)
    room = chunk.Room(most=1)
    _, count, _ = trace_recorded(tree, rays, room=room, together=Together(np.zeros(64, np.uint32)))
    assert count[0] > 0
