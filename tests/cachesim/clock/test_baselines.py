"""What needs no unit, in npcache compare: caches of the same capacity, however small that is."""

import pytest

from cachesim.clock.compare import baselines
from cachesim.config import CacheConfig
from cachesim.layout import parse_layout
from tests.reference.traces import make_trace, write
from traces.reader import open_run


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    path = tmp_path_factory.mktemp("runs") / "small-bvh"
    write(make_trace("bvh", 5, n_rays=12), path)
    return open_run(path)


@pytest.mark.parametrize(
    ("size", "ways", "lines"), [(64, 2, [32, 64]), (32, 1, [32]), (128, 2, [32, 64]), (96, 3, [32]), (4096, 2, [32, 64, 128])]
)
def test_lines_up_to_four_times_as_long_that_fit(run, size, ways, lines):
    found = baselines(run, CacheConfig(size, ways, 32), parse_layout("stored"))
    assert sorted({cache.line_bytes for cache, _ in found}) == lines
    assert all(cache.n_sets * cache.ways * cache.line_bytes == size for cache, _ in found)
