"""A run cut into stretches: where batches end changes nothing, and shadow rays wait for their primary rays."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cachesim.clock import timing
from cachesim.clock.parameters import PRESETS
from cachesim.clock.stretches import NOTHING, THE_RAY_BEFORE, shadows_wait
from cachesim.clock.timing import time_run
from cachesim.config import CacheConfig
from cachesim.source import RunSource
from tests.reference.traces import make_trace, write
from traces.reader import Run


@pytest.mark.parametrize("kind", ["kdtree", "bvh64"])
def test_where_batches_end_changes_nothing(kind, tmp_path, monkeypatch):
    run = write(make_trace(kind, 21, n_rays=60, max_level=7), tmp_path / "run")
    clocks = [PRESETS["paper"].clock.with_numbers(rays=rays, miss=30) for rays in (1, 4, 16)]
    config = [CacheConfig(512, 2, 64)]
    whole = [each.to_dict() for each in time_run(run, config, clocks, ["stack", "oracle"])]
    batches = Run.batches
    for n in (1, 5, 64):

        def cut(self, names=("node", "kind"), n=n):
            for columns in batches(self, names):
                for start in range(0, columns[0].size, n):
                    yield tuple(column[start : start + n] for column in columns)

        monkeypatch.setattr(Run, "batches", cut)
        assert [each.to_dict() for each in time_run(run, config, clocks, ["stack", "oracle"])] == whole, n


def test_machines_that_do_not_fit_into_memory_are_timed_in_several_passes(tmp_path, monkeypatch):
    run = write(make_trace("bvh", 21, n_rays=30, max_level=7), tmp_path / "run")
    clocks = [PRESETS["paper"].clock.with_numbers(rays=rays, miss=30) for rays in (1, 4, 16)]
    configs, together = [CacheConfig(512, 2, 32), CacheConfig(256, 1, 32)], []
    passes = timing._time_together
    monkeypatch.setattr(timing, "_time_together", lambda *args: together.append(len(args[2])) or passes(*args))
    whole = [each.to_dict() for each in time_run(run, configs, clocks, ["stack", "oracle"])]
    monkeypatch.setattr(timing, "_MOST_BYTES", timing._LINE_BYTES * RunSource(run).lines(32, 0).n_ids * 3 * 4)
    assert [each.to_dict() for each in time_run(run, configs, clocks, ["stack", "oracle"])] == whole
    assert together == [6, 4, 2]


@given(st.lists(st.tuples(st.integers(0, 5), st.booleans()), max_size=20))
def test_whom_a_shadow_ray_waits_for(rays):
    wanted, latest = [], {}
    for number, (pixel, is_primary) in enumerate(rays):
        if is_primary:
            latest[pixel] = number
            wanted.append(NOTHING)
        else:
            primary = latest.get(pixel, NOTHING)
            wanted.append(THE_RAY_BEFORE if primary >= 0 and primary == number - 1 else primary)
    pixels, is_primary = np.array([pixel for pixel, _ in rays], np.int64), np.array([each for _, each in rays], np.bool_)
    assert shadows_wait(pixels, is_primary).tolist() == wanted
