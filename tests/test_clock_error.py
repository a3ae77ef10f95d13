"""Parts of a run for the clock: which rays they are, that all pieces together are the run, and an interval by hand."""

import numpy as np
import pytest

from cachesim.clock.parameters import PRESETS
from cachesim.clock.timing import Workshop
from cachesim.config import CacheConfig
from cachesim.prefetch import parse_prefetch
from cachesim.source import RunSource
from rtrace.render import Shooting, render
from rtrace.scenes.stand_ins import stand_in
from rtrace.trees.tree_cache import build_tree
from tests.bench import clock_error
from tests.bench.clock_error import PIECES, SPREAD, STRETCH, Cell, Counted, count, figures, parts_of, picked, read_stream
from traces.reader import open_run


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    path, scene = tmp_path_factory.mktemp("runs") / "run", stand_in("blob", detail=0.2)
    render(scene, build_tree(scene.triangles, "bvh"), Shooting(40, 40), path, threads=1)
    return RunSource(open_run(path))


def test_pieces_are_cut_at_primary_rays_and_hold_every_ray(source):
    rows, cuts = read_stream(source)
    assert len(cuts) == PIECES + 1 and (np.diff(cuts) > 0).all() and cuts[-1] == rows.waits_for.size
    assert (rows.types[cuts[:-1]] == 0).all()
    assert rows.first[-1] == rows.nodes.size


@pytest.mark.parametrize(("method", "n"), [(SPREAD, 8), (STRETCH, 4)])
def test_parts_share_no_piece_and_leave_none_out(method, n):
    assert sorted(piece for pieces in parts_of(method, n) for piece in pieces) == list(range(PIECES))
    assert {len(pieces) for pieces in parts_of(method, n)} == {PIECES // n}


def test_what_is_counted_are_the_pieces_and_before_them_stands_the_piece_before(source):
    stream = read_stream(source)
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
    stream, workshop = read_stream(source), Workshop(source, 1)
    cell = Cell(PRESETS["paper"].clock.with_numbers(rays=n_slots), CacheConfig(1024, 2, 32))
    counts = count(workshop, cell, parse_prefetch("push"), *picked(stream, range(PIECES), n_slots, is_warm=True))
    job = workshop.job(cell.config, cell.clock, parse_prefetch("push"))
    job.step(stream.rows)
    n = stream.rows.waits_for.size
    assert n - 2 * n_slots <= counts.rays.sum() <= n
    assert counts.cycles.sum() / counts.rays.sum() == pytest.approx(int(job.clock.numbers[0].last_cycle) / n, rel=0.01)


def test_an_interval_by_hand():
    """Six of twelve pieces; t of five degrees of freedom is 2.571; the rates are 20 and 10, and the pieces move them alike."""
    rays = np.full(6, 10)
    without, with_ = Counted(np.array([190, 200, 210] * 2), rays), Counted(np.array([95, 100, 105] * 2), rays)
    rate, speed_up, of_rate, of_speed_up = figures(without, with_, 2)
    assert (rate, speed_up) == (10.0, 2.0)
    assert of_rate == pytest.approx(2.571 * np.sqrt(6 / 5 * (1 - 1 / 2) * 4 * (5 / 600) ** 2), rel=1e-3)
    assert of_speed_up == pytest.approx(0.0, abs=1e-12)
    assert np.isnan(figures(*(Counted(*(column[:1] for column in each)) for each in (without, with_)), 2)[2])


def test_the_fields_are_those_of_the_rows(source):
    cell = Cell(PRESETS["paper"].clock, CacheConfig(1024, 2, 32))
    rows = list(clock_error.measure(source.run, [cell], 1, [(SPREAD, 8)]))
    assert [row["prefetch"] for row in rows] == ["stack", "push"] and {tuple(row) for row in rows} == {clock_error.FIELDS}
