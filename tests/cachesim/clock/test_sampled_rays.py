"""A sample of a run's rays for the clock: which rays they are, that all pieces are the run, and an interval by hand."""

import numpy as np
import pytest

from cachesim.clock.parameters import PRESETS
from cachesim.clock.sampled_rays import (
    NARROWEST,
    PIECES,
    Counted,
    count,
    figures,
    picked,
    read_cut_rows,
    reads_of,
    time_sample,
)
from cachesim.clock.timing import Workshop, time_run
from cachesim.config import CacheConfig
from cachesim.prefetch import parse_prefetch
from cachesim.source import RunSource
from nptrace_base.errors import NptraceError
from rtrace.render import Shooting, render
from rtrace.scenes.stand_ins import stand_in
from rtrace.trees.tree_cache import build_tree
from tests.bench.clock_error import FIELDS, SPREAD, STRETCH, Cell, measure, parts_of
from traces.reader import open_run


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    path, scene = tmp_path_factory.mktemp("runs") / "run", stand_in("blob", detail=0.2)
    render(scene, build_tree(scene.triangles, "bvh"), Shooting(96, 96), path, threads=1)
    return RunSource(open_run(path))


def test_pieces_are_cut_at_primary_rays_and_hold_every_ray(source):
    rows, cuts = read_cut_rows(source)
    assert len(cuts) == PIECES + 1 and (np.diff(cuts) > 0).all() and cuts[-1] == rows.waits_for.size
    assert (rows.types[cuts[:-1]] == 0).all()
    assert rows.first[-1] == rows.nodes.size


@pytest.mark.parametrize(("method", "n"), [(SPREAD, 8), (STRETCH, 4)])
def test_parts_share_no_piece_and_leave_none_out(method, n):
    assert sorted(piece for pieces in parts_of(method, n) for piece in pieces) == list(range(PIECES))
    assert {len(pieces) for pieces in parts_of(method, n)} == {PIECES // n}


def test_what_is_counted_are_the_pieces_and_before_them_stands_the_piece_before(source):
    stream = read_cut_rows(source)
    rows, cuts = stream
    warm, of_warm = picked(stream, [3, 4, 9], 2, is_warm=True)
    cold, of_cold = picked(stream, [3, 4, 9], 2, is_warm=False)
    for part, counted in ((warm, of_warm), (cold, of_cold)):
        for piece, (a, b) in zip([3, 4, 9], counted, strict=True):
            whole, own = slice(rows.first[cuts[piece]], rows.first[cuts[piece + 1]]), slice(part.first[a], part.first[b])
            assert np.array_equal(rows.nodes[whole], part.nodes[own]) and np.array_equal(rows.kinds[whole], part.kinds[own])
        assert part.waits_for.size - counted[-1][1] >= 5
    assert np.array_equal(warm.nodes[: warm.first[of_warm[0][0]]], rows.nodes[rows.first[cuts[2]] : rows.first[cuts[3]]])
    assert of_warm[1][0] == of_warm[0][1] and of_warm[2][0] - of_warm[1][1] == cuts[9] - cuts[8]
    assert of_cold[0][0] == 0 and of_cold[2][0] == of_cold[1][1]


@pytest.mark.parametrize("n_slots", [1, 8])
def test_all_pieces_together_are_the_run(source, n_slots):
    stream, workshop = read_cut_rows(source), Workshop(source, 1)
    cell = Cell(PRESETS["paper"].clock.with_numbers(rays=n_slots), CacheConfig(1024, 2, 32))
    job, other = (workshop.job(cell.config, cell.clock, parse_prefetch("push")) for _ in range(2))
    counts = count(other, *picked(stream, range(PIECES), n_slots))
    job.step(stream.rows)
    numbers = job.clock.numbers[0]
    cycles, reads = int(numbers.last_cycle), reads_of(numbers)
    assert 0.98 * reads < counts.reads.sum() <= reads
    assert counts.cycles.sum() / counts.reads.sum() == pytest.approx(cycles / reads, rel=0.005)


def test_an_interval_by_hand():
    """Six of 128 pieces; t of five degrees of freedom is 2.571; the rates are 20 and 10, and the pieces move them alike."""
    reads = np.full(6, 10)
    without, with_ = Counted(np.array([190, 200, 210] * 2), reads), Counted(np.array([95, 100, 105] * 2), reads)
    rate, speed_up, of_rate, of_speed_up = figures(without, with_)
    assert (rate, speed_up) == (10.0, 2.0)
    assert of_rate == pytest.approx(2.571 * np.sqrt(6 / 5 * (1 - 6 / 128) * 4 * (5 / 600) ** 2), rel=1e-3)
    assert of_speed_up == NARROWEST
    assert np.isinf(figures(*(Counted(*(column[:4] for column in each)) for each in (without, with_))).of_speed_up)


def test_a_part_tells_what_the_run_tells(source):
    """Every second piece of a smooth run; cycles per ray, speed-ups, and their order are those of ``time_run``."""
    configs, clocks = [CacheConfig(1024, 2, 32), CacheConfig(2048, 1, 32)], [PRESETS["paper"].clock]
    found = time_sample(source.run, configs, clocks, ("stack", "push"), 2, 1)
    for part, all_ in zip(found, time_run(source.run, configs, clocks, ("stack", "push"), threads=1), strict=True):
        assert (part.config, part.prefetch) == (all_.config, all_.prefetch)
        assert 0 < abs(part.speed_up / all_.speed_up - 1) < part.of_speed_up < 0.05
        assert part.cycles_per_ray_without == pytest.approx(all_.cycles_without / all_.n_rays, rel=0.03)
        shared = part.to_dict().keys() & all_.to_dict().keys() - {"speed_up", "cycles_per_ray_without"}
        assert {name: part.to_dict()[name] for name in shared} == {name: all_.to_dict()[name] for name in shared}


@pytest.mark.parametrize(
    ("prefetch", "sentence"),
    [("oracle", "oracle:unlimited goes through all rays twice"), ("predictor", "the predictor needs the rays of a whole run")],
)
def test_what_needs_all_rays_is_refused(source, prefetch, sentence):
    with pytest.raises(NptraceError, match=sentence):
        time_sample(source.run, [CacheConfig(1024, 2, 32)], [PRESETS["paper"].clock], (prefetch,), 8, 1)


@pytest.mark.parametrize(("pixels", "batch"), [(8, 1), (32, 0)])
def test_a_run_of_few_rays_or_in_batches_is_refused(pixels, batch, tmp_path):
    scene = stand_in("blob", detail=0.2)
    render(scene, build_tree(scene.triangles, "bvh"), Shooting(pixels, pixels, batch=batch), tmp_path / "run", threads=1)
    with pytest.raises(NptraceError, match="run cannot be timed by a sample: that takes 128 primary rays"):
        read_cut_rows(RunSource(open_run(tmp_path / "run")))


def test_the_fields_of_the_bench_are_those_of_its_rows(source):
    rows = list(measure(source.run, [Cell(PRESETS["paper"].clock, CacheConfig(1024, 2, 32))], 1, [(SPREAD, 8)]))
    assert [row["prefetch"] for row in rows] == ["stack", "push"] and {tuple(row) for row in rows} == {FIELDS}
