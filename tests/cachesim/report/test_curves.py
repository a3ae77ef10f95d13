"""Miss-rate curves: no line joins points of two cases, every point is a row's, and layouts, policies and orders are lines."""

from itertools import pairwise

import pytest

from cachesim.config import CacheConfig
from cachesim.report.curves import channels_of, draw_curves, drawn_ways, lines_of, points_of, round_numbers
from cachesim.report.sweep_output import tables
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


def row(**changes):
    """Return a row of a sweep of nothing in particular."""
    facts = {
        "run": "bunny-bvh", "path": "x", "scene": "bunny", "stand_in": False, "tree": "bvh", "width": 8, "height": 8,
        "order": "scanline", "batch": 1, "size_bytes": 1024, "ways": 1, "line_bytes": 32, "policy": "lru",
        "prefetch": "none", "layout": "stored", "demand_accesses": 100, "demand_misses": 10, "prefetch_accesses": 0,
        "demand_misses_without": 10,
    }  # fmt: skip
    facts |= changes
    return facts | {
        "demand_miss_rate": facts["demand_misses"] / facts["demand_accesses"] if facts["demand_accesses"] else None
    }


def lines(rows):
    points = drawn_ways(points_of(rows))
    channels = channels_of(points)
    return lines_of(points, channels), channels


def test_every_line_is_of_one_case_and_has_its_rates(rows, tmp_path, monkeypatch):
    axes = pytest.importorskip("matplotlib.axes").Axes
    drawn, real = [], axes.plot

    def spy(self, x, y, **options):
        drawn.append((tuple(x), tuple(y), id(self), *map(options.get, STYLE)))
        return real(self, x, y, **options)

    monkeypatch.setattr(axes, "plot", spy)
    draw_curves([each.to_dict() for each in rows], tmp_path / "x.svg")
    assert len({(panel, *style) for _, _, panel, *style in drawn}) == len(drawn), "two lines of a panel look alike"
    assert len(drawn) == 2 * 2 * 2 * 2 * 3  # runs, lines, ways, layouts, policies; the rates without are none's
    for sizes, _, *_ in drawn:
        assert sizes == (512, 1024, 2048)
    rates = sorted(rate for _, rates, *_ in drawn for rate in rates)
    values = [each.to_dict() for each in rows]
    assert rates == pytest.approx(sorted(100 * each["demand_miss_rate"] for each in values))
    for each in values:
        assert any(100 * each["demand_miss_rate_without"] == pytest.approx(rate) for rate in rates)


STYLE = ("color", "linestyle", "marker")


def test_layouts_policies_and_orders_are_lines_of_one_panel():
    of_layout, channels = lines(
        [row(layout=layout, size_bytes=size) for layout in ("stored", "bfs", "veb") for size in (512, 1024)]
    )
    assert len(of_layout) == 3 and len({line.panel for line in of_layout}) == 1 and channels == {"layout": "colour"}
    of_policy, channels = lines([row(policy=policy) for policy in ("lru", "fifo", "random", "opt")])
    assert len(of_policy) == 4 and len({line.panel for line in of_policy}) == 1 and channels == {"policy": "colour"}
    orders = [row(run=f"bunny-bvh-{order}", order=order) for order in ("scanline", "morton", "hilbert")]
    of_order, channels = lines([*orders, row(run="room-bvh", scene="room")])
    assert channels == {"order": "colour"}
    assert [(line.panel, line.facts["order"]) for line in of_order] == [
        *((("bunny bvh",), order) for order in ("scanline", "morton", "hilbert")),
        (("room-bvh (scanline)",), "scanline"),
    ]


def test_what_a_visit_reads_and_emptied_caches_are_lines_of_their_own():
    """One of the three rows was kept."""
    rows = [row(), row(reads="own", flush="never", size_bytes=2048), row(reads="children", flush="never", demand_misses=20)]
    found, channels = lines([*rows, row(reads="own", flush="ray", demand_misses=30)])
    assert channels == {"reads": "colour", "flush": "marker"}
    assert [(line.facts["reads"], line.facts["flush"], line.rates) for line in found] == [
        ("reads own", "flush never", [0.1, 0.1]), ("reads children", "flush never", [0.2]),
        ("reads own", "flush ray", [0.3]),
    ]  # fmt: skip


def test_runs_of_one_name_are_two_lines():
    found, _ = lines([row(path="a/x", run="x", scene="bunny"), row(path="b/x", run="x", scene="room", demand_misses=20)])
    assert [(line.panel, line.rates) for line in found] == [(("a/x (bunny)",), [0.1]), (("b/x (room)",), [0.2])]


def test_the_rate_without_prefetches_is_a_line_once():
    found, channels = lines([row(prefetch=each, prefetch_accesses=5, demand_misses=6) for each in ("traced", "stack")])
    assert channels == {"prefetch": "dash"}
    assert {line.facts["prefetch"]: line.rates for line in found} == {"traced": [0.06], "none": [0.1], "stack": [0.06]}


def test_ways_have_panels_of_their_own_where_there_are_too_many_lines():
    layouts = ("stored", "bfs", "veb", "dfs")
    found, channels = lines([row(layout=layout, ways=ways) for layout in layouts for ways in (1, 2, 4, 8, 16)])
    assert channels == {"ways": "panel", "layout": "colour"} and len({line.panel for line in found}) == 5


def test_of_many_ways_the_powers_of_two_are_drawn():
    found, channels = lines([row(ways=ways, size_bytes=4096) for ways in range(1, 17)])
    assert [line.facts["ways"] for line in found] == ["1-way", "2-way", "4-way", "8-way", "16-way"]
    assert channels == {"ways": "colour"}
    found, _ = lines([row(ways=ways, size_bytes=ways * 64) for ways in (3, 5, 6, 7, 9, 10, 11, 12)])
    assert [line.facts["ways"] for line in found] == ["3-way", "5-way", "6-way", "7-way", "9-way", "10-way"]


@pytest.mark.parametrize("rates", [[10], [0, 10], [0], [1, 90]])
def test_an_axis_has_numbers(rates, tmp_path):
    """A single cache, no misses, and rates far apart."""
    figure = pytest.importorskip("matplotlib.figure")
    kept, save = [], figure.Figure.savefig
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(figure.Figure, "savefig", lambda self, *args, **o: kept.append(self) or save(self, *args, **o))
        draw_curves([row(demand_misses=rate, layout=str(i)) for i, rate in enumerate(rates)], tmp_path / "x.png")
    [axes] = kept[0].axes
    low, high = axes.get_ylim()
    assert sum(low <= tick <= high for tick in axes.get_yticks()) >= 2
    assert [text.get_text() for text in axes.get_xticklabels()] == ["1K"]
    assert all(text.get_text() for text in axes.get_yticklabels())


@pytest.mark.parametrize("limits", [(10, 90), (11, 70), (0.001, 100), (5, 36)])
def test_round_numbers_lie_within_an_axis(limits):
    found = round_numbers(*limits)
    assert len(found) >= 1 and all(limits[0] <= value <= limits[1] for value in found)
    assert all(a < b for a, b in pairwise(found)) and len(found) <= 16


def test_no_accesses_are_a_plot_too(tmp_path):
    draw_curves([row(demand_accesses=0, demand_misses=0)], tmp_path / "x.png")
    assert (tmp_path / "x.png").read_bytes().startswith(b"\x89PNG")


def test_the_same_rows_give_the_same_bytes(tmp_path):
    for ending in ("png", "svg", "pdf"):
        for name in "ab":
            draw_curves([row(), row(ways=2)], tmp_path / f"{name}.{ending}")
        assert (tmp_path / f"a.{ending}").read_bytes() == (tmp_path / f"b.{ending}").read_bytes()


def test_the_table_has_a_key_column_for_what_varies(rows):
    [table], _ = tables(rows)
    assert table.header[: table.n_left] == ["run", "prefetch", "layout", "cache"]
    assert len({tuple(row[: table.n_left]) for row in table.rows}) == len(rows)
    [alone], _ = tables([row for row in rows if row.prefetch == "none" and row.layout == "bfs"])
    assert alone.header[: alone.n_left] == ["run", "cache"]
