"""A plot of a sweep: no curve joins points of two runs, prefetch policies, layouts, line sizes or numbers of ways."""

from itertools import pairwise

import pytest

from cachesim.config import CacheConfig
from cachesim.report.sweep_output import plot, tables
from cachesim.sweep import sweep
from tests.reference.traces import make_trace, write


@pytest.fixture
def rows(tmp_path):
    """Two runs of one name, under every setting."""
    configs = [CacheConfig(size, ways, line) for size in (512, 1024, 2048) for ways in (1, 2) for line in (16, 32)]
    found = []
    for i, folder in enumerate("ab"):
        run = write(make_trace("bvh", i, n_rays=40, max_level=8), tmp_path / folder / "bunny-bvh")
        for prefetch in ("none", "traced", "stack"):
            for layout in ("stored", "bfs"):
                found += sweep(run, configs, prefetch=prefetch, layout=layout, threads=1)
    return found


def test_every_curve_is_of_one_key(rows, tmp_path, monkeypatch):
    axes = pytest.importorskip("matplotlib.axes").Axes
    drawn, titles, real, title = [], [], axes.plot, axes.set_title
    monkeypatch.setattr(
        axes, "plot", lambda self, x, y, *a, **o: drawn.append((list(x), list(y))) or real(self, x, y, *a, **o)
    )
    monkeypatch.setattr(axes, "set_title", lambda self, text, **o: titles.append(text) or title(self, text, **o))
    plot(rows, tmp_path / "x.svg")
    assert len(titles) == len(set(titles)) == 2 * 3 * 2 * 2
    assert sum("a/bunny-bvh" in text for text in titles) == 12
    # Prefetching adds the curve without it.
    assert len(drawn) == 2 * 2 * 2 * 2 * (1 + 2 + 2)
    for sizes, _ in drawn:
        assert all(a < b for a, b in pairwise(sizes)), "two points of one size on a curve: it joins two keys"
    middles = [rates[1] for _, rates in drawn]
    for row in rows:
        if row.config.size_bytes == 1024:
            assert any(100 * row.to_dict()["demand_miss_rate"] == pytest.approx(rate) for rate in middles)


def test_the_table_has_a_key_column_for_what_varies(rows):
    [table], _ = tables(rows)
    assert table.header[: table.n_left] == ["run", "prefetch", "layout", "cache"]
    assert len({tuple(row[: table.n_left]) for row in table.rows}) == len(rows)
    [alone], _ = tables([row for row in rows if row.prefetch == "none" and row.layout == "bfs"])
    assert alone.header[: alone.n_left] == ["run", "cache"]
