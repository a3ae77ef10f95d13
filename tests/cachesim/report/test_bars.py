"""Bars: their lengths are the numbers of the rows, and every case has a text of its own."""

import pytest

from cachesim.by_group import GroupedRecords, replay_by
from cachesim.clock.parameters import PRESETS
from cachesim.clock.timing import time_run
from cachesim.config import CacheConfig
from cachesim.replay import replay
from cachesim.report import tally_tables
from cachesim.report.bars import account_of, draw_account, draw_levels, draw_speed_ups, short_number
from cachesim.report.cases import facts_of, shared_text, texts_of
from cachesim.report.table1_plot import draw_table1
from nptrace_base.errors import NptraceError
from tests.cachesim.report.test_curves import row
from tests.reference.traces import make_trace, write

CACHES = [CacheConfig(512, ways, 32) for ways in (1, 2)]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return write(make_trace("bvh", 5, n_rays=40, max_level=8), tmp_path_factory.mktemp("run") / "bunny-bvh", stand_in=True)


@pytest.fixture
def figures(monkeypatch):
    """Return the figures that are written."""
    figure = pytest.importorskip("matplotlib.figure").Figure
    kept, save = [], figure.savefig
    monkeypatch.setattr(figure, "savefig", lambda self, *args, **o: kept.append(self) or save(self, *args, **o))
    return kept


def test_the_account_is_that_of_the_replay(run, figures, tmp_path):
    rows = [each.to_dict() for prefetch in ("traced", "stack:1") for each in replay(run, CACHES, prefetch=prefetch)]
    draw_account(rows, tmp_path / "x.png")
    [axes] = figures[0].axes
    assert [text.get_text() for text in axes.get_yticklabels()] == texts_of(rows)
    shares = {
        (container.get_label(), i): bar.get_width() for container in axes.containers for i, bar in enumerate(container.patches)
    }
    for i, each in enumerate(rows):
        assert sum(account_of(each).values()) == each["prefetch_accesses"]
        for name, n in account_of(each).items():
            assert shares.get((name, i), 0) == pytest.approx(100 * n / each["prefetch_accesses"])
    numbers = {text.get_text() for text in axes.texts}
    assert {f"{each['prefetch_accesses']:,}" for each in rows} <= numbers


def test_the_account_of_the_clock_adds_up_to_its_requests(run, tmp_path):
    clocks = [PRESETS["paper"].clock.with_numbers(rays=rays) for rays in (1, 4)]
    rows = [each.to_dict() for each in time_run(run, CACHES, clocks, ["none", "stack"], threads=1)]
    for each in rows:
        assert sum(account_of(each).values()) == each["requests"]
    draw_account(rows, tmp_path / "x.svg")
    text = (tmp_path / "x.svg").read_text()
    assert "late" in text and "2-way, rays 4" in text and "(stand-in)" in text
    with pytest.raises(NptraceError, match="no prefetch requests"):
        draw_account([each for each in rows if each["prefetch"] == "none"], tmp_path / "x.svg")


def test_the_bars_of_levels_are_their_counts(run, figures, tmp_path):
    rows = list(GroupedRecords(replay_by(run, CACHES, "level")))
    draw_levels(rows, tmp_path / "x.png")
    panels = [axes for axes in figures[0].axes if axes.containers and axes.containers[0].get_label() == "demand accesses"]
    assert len(panels) == 2
    for axes, config in zip(panels, CACHES, strict=True):
        of = [each for each in rows if each["ways"] == config.ways]
        for container, name in zip(axes.containers, ("demand_accesses", "demand_misses"), strict=True):
            assert [bar.get_height() for bar in container] == [each[name] for each in of]
            assert [bar.get_x() + bar.get_width() / 2 for bar in container] == pytest.approx([each["level"] for each in of])
    rates = [axes for axes in figures[0].axes if axes not in panels]
    for axes in rates:
        assert max(bar.get_height() for bar in axes.containers[0]) < axes.get_ylim()[1]


def test_ray_types_and_what_the_clock_counts_are_drawn_too(run, figures, tmp_path):
    draw_levels(list(GroupedRecords(replay_by(run, CACHES[:1], "ray-type"))), tmp_path / "x.png")
    assert [text.get_text() for text in figures[0].axes[1].get_xticklabels()] == ["primary", "shadow"]
    timed = time_run(run, CACHES[:1], [PRESETS["paper"].clock], ["stack"], by="level", threads=1)
    draw_levels(tally_tables.records(timed, "level"), tmp_path / "x.png")
    with pytest.raises(NptraceError, match="results by node cannot be drawn as bars"):
        draw_levels(list(GroupedRecords(replay_by(run, CACHES[:1], "node"))), tmp_path / "x.png")


def test_speed_ups_without_the_bound(run, figures, tmp_path):
    timed = time_run(run, CACHES[:1], [PRESETS["paper"].clock], ["stack", "perfect", "push"], threads=1)
    rows = [each.to_dict() for each in timed]
    draw_speed_ups(rows, tmp_path / "x.png")
    [axes] = figures[0].axes
    real = sorted((each for each in rows if each["prefetch"] != "perfect"), key=lambda each: each["speed_up"])
    assert [bar.get_width() for bar in axes.containers[0]] == [each["speed_up"] for each in real]
    assert [text.get_text() for text in axes.get_yticklabels()] == [each["prefetch"] for each in real]
    assert axes.get_title() == f"bunny-bvh (stand-in) (bound {rows[1]['speed_up']:.2f})"


def test_a_bound_is_named_only_where_all_bars_share_it(figures, tmp_path):
    """The largest of several machines stood in the title."""
    of_one = [row(prefetch=each, speed_up=s, group="policy") for each, s in (("none", 1.0), ("push", 1.2), ("perfect", 3.0))]
    baseline = row(prefetch="none", speed_up=1.1, group="baseline", line_bytes=64, layout="veb")
    cases = [{}, {"ways": 2}, {"clock": "paper", "rays": 4}, {"layout": "veb"}]
    for i, changes in enumerate(cases):
        others = [each | changes | ({"speed_up": 9.4} if each["prefetch"] == "perfect" else {}) for each in of_one]
        draw_speed_ups([*of_one, baseline, *(others if changes else [])], tmp_path / "x.png")
        [axes] = figures[i].axes
        assert axes.get_title() == ("bunny-bvh" if changes else "bunny-bvh (bound 3.00)")


def test_table_1_has_both_numbers(figures, tmp_path):
    names = ("demand_miss_rate_without", "paper_ratio", "demand_ratio", "traffic_ratio")
    values = dict.fromkeys(names, 0.25) | {f"{name}_paper": 0.5 for name in names}
    rows = [row(tree=tree, scene=scene, ways=ways) | values for tree in ("kdtree", "bvh") for scene in "ab" for ways in (1, 2)]
    rows[0]["paper_ratio"] = None
    draw_table1(rows, tmp_path / "x.png")
    assert len(figures[0].axes) == 4
    for i, axes in enumerate(figures[0].axes):
        drawn = {line.get_label(): list(line.get_ydata()) for line in axes.lines if not line.get_label().startswith("_")}
        series = {"paper": 50, "ours": 25} if i % 2 == 0 else {"paper: miss rate": 50, "ours: the paper's miss rate": 25}
        for name, value in series.items():
            assert set(drawn[name]) == {value}
    assert len(figures[0].axes[1].lines[1].get_ydata()) == 3  # a rate without a value has no point


def test_two_tables_1_are_told_apart(figures, tmp_path):
    """They stood side by side as equal caches."""
    names = ("demand_miss_rate_without", "paper_ratio", "demand_ratio", "traffic_ratio")
    values = dict.fromkeys(names, 0.25) | {f"{name}_paper": 0.5 for name in names}
    tables = [
        {"policy": "lru"},
        {"policy": "fifo"},
        {"policy": "lru", "run": "bunny-bvh-512x512", "width": 512, "height": 512},
    ]
    rows = [
        row(run=f"{scene}-bvh", scene=scene, ways=ways) | values | (of if scene == "bunny" else {"policy": of["policy"]})
        for of in tables for scene in ("bunny", "room") for ways in (1, 2)
    ]  # fmt: skip
    draw_table1(rows[:8], tmp_path / "x.png")
    draw_table1(rows, tmp_path / "x.png")
    ticks = [[text.get_text() for text in figure.axes[0].get_xticklabels()] for figure in figures]
    assert ticks[0] == [f"1K({ways}) {policy}" for _ in "ab" for policy in ("lru", "fifo") for ways in (1, 2)]
    assert ticks[1][:6:2] == ["1K(1) bunny-bvh (8x8), lru", "1K(1) bunny-bvh (8x8), fifo", "1K(1) bunny-bvh-512x512, lru"]
    draw_table1(rows[:4], tmp_path / "x.png")
    assert [text.get_text() for text in figures[2].axes[0].get_xticklabels()] == ["1K(1)", "1K(2)"] * 2


def test_texts_tell_all_cases_apart_and_nothing_else():
    rows = [row(prefetch=prefetch, layout=layout, policy="random", policy_seed=seed) for prefetch in ("none", "stack")
            for layout in ("stored", "bfs") for seed in (0, 1)]  # fmt: skip
    assert len(set(texts_of(rows))) == len(rows)
    assert texts_of(rows)[1] == "random seed 1, stored, none" and texts_of(rows[:1]) == [""]
    assert shared_text(rows) == "bunny-bvh, 1K 1-way, 32 B lines"
    of_reads = [row(), row(reads="children", flush="never"), row(reads="own", flush="ray")]
    assert texts_of(of_reads) == ["reads own, flush never", "reads children, flush never", "reads own, flush ray"]
    assert shared_text(of_reads[1:2]) == "bunny-bvh, 1K 1-way, 32 B lines, lru, layout stored, reads children, prefetch none"
    assert facts_of(row(ways=32, line_bytes=32))["cache"] == "1K full"


def test_numbers_of_an_axis():
    assert [short_number(n) for n in (0, 999, 1000, 250_000, 1_500_000, 2e9)] == ["0", "999", "1k", "250k", "1.5M", "2G"]
