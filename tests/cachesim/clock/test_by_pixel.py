"""The cycles of each pixel: those that a run takes longer with its rays than without, and their sums are the clock's."""

import pytest

from cachesim.clock import by_pixel
from cachesim.clock.by_pixel import cycles_by_pixel
from cachesim.clock.parameters import PRESETS
from cachesim.clock.timing import time_run
from cachesim.config import CacheConfig
from cachesim.source import RunSource
from nptrace_base.errors import NptraceError
from tests.reference.traces import make_trace, write

CLOCK = PRESETS["paper"].clock
CONFIG = CacheConfig(256, 2, 16)


def spent(run, clock, prefetch):
    [timing] = time_run(run, [CONFIG], [clock], [prefetch], threads=1)
    return timing.spent


@pytest.mark.parametrize("kind", ["kdtree", "bvh64"])
def test_a_pixel_has_what_its_ray_adds(kind, tmp_path):
    """With one ray in flight the rays before it do not notice it: the runs of the first n rays say what each took."""
    trace = make_trace(kind, 3, n_rays=9)
    rows, n_rays, before = trace.rows, trace.n_rays, dict.fromkeys(CLOCK.to_dict(), 0)
    found = cycles_by_pixel(RunSource(write(trace, tmp_path / "whole")), CONFIG, CLOCK, "stack")
    assert found["late prefetch"].any() and found["demand miss"].any()
    before = dict.fromkeys(found, 0)
    for n in range(1, n_rays + 1):
        trace.rows, trace.n_rays = [row for row in rows if row[0] < n], n
        after = spent(write(trace, tmp_path / str(n)), CLOCK, "stack")
        assert {name: int(counts[n - 1]) for name, counts in found.items()} == {
            name: after[name] - before[name] for name in found
        }
        before = after


@pytest.mark.parametrize("limits", [(1 << 14, 1 << 17), (50, 300), (1, 1)])
@pytest.mark.parametrize("prefetch", ["traced", "stack:2"])
def test_the_pixels_add_up_to_the_cycles_of_the_run(tmp_path, monkeypatch, limits, prefetch):
    """However often the log is emptied, and if it has to be made longer."""
    monkeypatch.setattr(by_pixel, "ROWS", limits[0])
    monkeypatch.setattr(by_pixel, "ENTRIES", limits[1])
    clock = CLOCK.with_numbers(rays=4, mshrs=3)
    run = write(make_trace("bvh", 1, n_rays=60), tmp_path / "run")
    found, want = cycles_by_pixel(RunSource(run), CONFIG, clock, prefetch), spent(run, clock, prefetch)
    assert {name: int(counts.sum()) for name, counts in found.items()} == {name: want[name] for name in found}
    assert all(len(counts) == 60 and counts.min() >= 0 for counts in found.values())


def test_a_machine_that_does_not_fit_is_refused(tmp_path):
    run = write(make_trace("bvh", 1, n_rays=3), tmp_path / "run")
    with pytest.raises(NptraceError, match="rays=5000 cannot be in flight"):
        cycles_by_pixel(RunSource(run), CONFIG, CLOCK.with_numbers(rays=5000))
