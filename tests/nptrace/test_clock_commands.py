"""npcache time, npcache compare and nptrace map: their outputs agree with each other, and no work is done in vain."""

import importlib
import json
from itertools import pairwise
from xml.etree import ElementTree

import pytest
from click.testing import CliRunner

import cli
import nptrace.break_even
import nptrace_base.tables
from cachesim.clock import compare, state, timing
from nptrace.commands.time import BY
from tests.nptrace.test_terminal import inputs
from traces.reader import open_run

RUN = ["traces/bunny-bvh", "--size", "1K", "--assoc", "1"]
TIME = ["time", *RUN, "--rays", "4", "--prefetch", "stack,push"]
MAP = ["map", "ball.obj", "--quick", "--pixels", "16x16", "--threads", "1"]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    inputs(tmp_path)
    return tmp_path


def run(program, *args, code=0):
    result = CliRunner().invoke(program, [*map(str, args)], catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result


def rows_of(program, *args):
    return json.loads(run(program, *args, "--json").stdout)


def printed(monkeypatch, *args):
    """Return the tables of a command of npcache: a dict of cells for each line."""
    found = []
    with monkeypatch.context() as patch:
        patch.setattr(nptrace_base.tables, "print_tables", lambda tables, notes, file, **options: found.extend(tables))
        run(cli.npcache, *args)
    return [[dict(zip([name.replace("\n", " ") for name in t.header], line, strict=True)) for line in t.rows] for t in found]


def number(text):
    return float(text.replace(",", ""))


def test_the_tables_of_time_have_the_numbers_of_its_json(monkeypatch):
    rows = rows_of(cli.npcache, *TIME)
    cycles, fates = printed(monkeypatch, *TIME)
    assert [row["prefetch"] for row in rows] == [line["prefetch"] for line in cycles] == ["stack:unlimited", "push"]
    for row, line, fate in zip(rows, cycles, fates, strict=True):
        assert number(line["cycles /ray"]) == pytest.approx(row["cycles"] / 200, abs=0.06)
        assert number(line["without"]) == pytest.approx(row["cycles_without"] / 200, abs=0.06)
        assert number(line["speed-up"]) == pytest.approx(row["cycles_without"] / row["cycles"], abs=6e-4)
        for title, name in (("hit", "hit"), ("miss", "demand_miss"), ("late", "late_prefetch"), ("idle", "idle")):
            share = 100 * row[f"spent_{name}"] / (row["cycles"] * row["rays"])
            assert number(line[f"{title} %"]) == pytest.approx(share, abs=0.06)
        whole = {"offered": "candidates_offered", "port busy": "candidates_port_busy", "evicted early": "evicted_before_use"}
        same = ("redundant", "joined", "filled", "timely", "late", "resident")
        for title, name in {**whole, **{name: name for name in same}}.items():
            assert number(fate[title]) == row[name]


def test_a_row_of_the_json_adds_up():
    for row in rows_of(cli.npcache, *TIME):
        assert sum(n for name, n in row.items() if name.startswith("spent_")) == row["cycles"] * row["rays"]
        assert row["requests"] == row["redundant"] + row["joined"] + row["filled"]
        fates = ("timely", "late", "evicted_before_use", "never_used", "resident")
        assert row["filled"] == sum(row[name] for name in fates)
        reads = ("demand_hits", "demand_misses", "demand_joined", "demand_late")
        assert row["demand_reads"] == sum(row[name] for name in reads)


@pytest.mark.parametrize("by", BY)
def test_the_classes_of_a_tally_add_up_to_the_row(monkeypatch, by):
    assert state.BY[1:] == BY
    total, rows = rows_of(cli.npcache, *TIME)[0], rows_of(cli.npcache, *TIME, "--by", by)
    of_stack = [row for row in rows if row["prefetch"] == "stack:unlimited"]
    assert len({row["class"] for row in of_stack}) == len(of_stack) > 1
    for name in ("requests", "redundant", "joined", "filled", "timely", "late"):
        assert sum(row[name] for row in of_stack) == total[name]
    assert sum(row["evicted_unused"] for row in of_stack) == total["evicted_before_use"] + total["never_used"]
    if by in ("level", "ray"):
        assert sum(row["demand_reads"] for row in of_stack) == total["demand_reads"]
        assert sum(row["demand_missed"] for row in of_stack) == total["demand_misses"] + total["demand_joined"]
    else:
        assert {row["demand_reads"] for row in of_stack} == {None}
    tables = printed(monkeypatch, *TIME, "--by", by)
    lines = [line for table in tables for line in table]
    assert len(tables) == 2 and len(lines) == len(rows)
    for row, line in zip(rows, lines, strict=True):
        assert next(iter(line.values())) == row["class"]
        assert (number(line["requests"]), number(line["filled"])) == (row["requests"], row["filled"])
        if row["filled"]:
            assert number(line["accuracy %"]) == pytest.approx(100 * (row["timely"] + row["late"]) / row["filled"], abs=0.06)


def test_a_timeline_lies_within_the_run(folder):
    one = ["time", *RUN, "--rays", "4", "--timeline"]
    (row,) = rows_of(cli.npcache, *one, "t.json")
    events = json.loads((folder / "t.json").read_text())["traceEvents"]
    shown = [event for event in events if event["ph"] == "X"]
    assert {event["ph"] for event in events} == {"M", "X"} and len(shown) > 1000
    for event in shown:
        assert event["ts"] >= 0 and event["dur"] >= 1 and event["ts"] + event["dur"] <= row["cycles"]
        assert event["tid"] in range(4) and event["pid"] in (0, 1)
    for slot in range(4):  # a ray does one thing after the other
        of_rays = sorted((event["ts"], event["dur"]) for event in shown if event["pid"] == 0 and event["tid"] == slot)
        assert all(start + length <= after for (start, length), (after, _) in pairwise(of_rays))
    assert {"prefetch", "box test", "triangle test", "hit", "demand miss"} <= {event["name"] for event in shown}
    assert json.loads(run(cli.npcache, *one, "-").stdout)["traceEvents"] == events  # and no table


def test_traced_requests_are_timed_as_those_of_the_unit(folder):
    """The timeline, and the map of a part, ended in an AssertionError after all the timing."""
    one = ["time", *RUN, "--timeline"]
    assert rows_of(cli.npcache, *one, "a.json", "--prefetch", "traced") == rows_of(cli.npcache, *one, "b.json")
    assert (folder / "a.json").read_bytes() == (folder / "b.json").read_bytes()
    assert [str(timing.timed_policy(each)) for each in ("traced", "push")] == ["stack:unlimited", "push"]


def test_an_option_that_means_nothing_on_the_clock_is_refused():
    """A leaf without triangles takes no time there: stack:empty was timed as stack."""
    for command in ("time", "compare"):
        said = run(cli.npcache, command, *RUN, "--prefetch", "stack:empty", code=2).stderr
        assert said.splitlines()[-1] == (
            "Error: stack:unlimited:empty: on the clock a leaf without triangles takes no time in which the unit could "
            "request; leave empty out, or use npcache replay"
        )
    assert run(cli.npcache, "replay", *RUN, "--prefetch", "stack:empty")


def test_a_comparison_is_drawn(folder):
    args = ["compare", *RUN, "--no-baselines", "--prefetch", "stack,push", "--plot"]
    run(cli.npcache, *args, "c.png")
    assert (folder / "c.png").read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    run(cli.npcache, *args, "c.svg")
    texts = [element.text for element in ElementTree.parse(folder / "c.svg").iter() if element.tag.endswith("text")]
    assert {"none", "stack:unlimited", "push"} <= set(texts)
    assert "perfect" not in texts and any("(bound " in (text or "") for text in texts)  # its bar would dwarf the others


def test_the_bound_is_perfect_wherever_it_stands():
    """The bound was the last policy of the list."""
    for policies in ("perfect,stack", "stack", "none,stack,perfect"):
        rows = rows_of(cli.npcache, "compare", *RUN, "--no-baselines", "--prefetch", policies)
        assert [row["prefetch"] for row in rows] == ["none", "stack:unlimited", "perfect"]
        assert [row["share_of_bound"] for row in rows][::2] == [0, 1]
        assert {row["cycles_bound"] for row in rows} == {rows[-1]["cycles"]}


def test_a_map_goes_on_where_it_stopped(folder, monkeypatch):
    rows = rows_of(cli.nptrace, *MAP)
    parts = sorted((folder / "traces" / "map").glob("map-*.parquet"))
    assert len(parts) == 6 and len(rows) == 24
    timed = []
    real = nptrace.break_even.time_run
    spy = lambda run, *args, **options: timed.append(run.name) or real(run, *args, **options)
    monkeypatch.setattr(nptrace.break_even, "time_run", spy)
    assert rows_of(cli.nptrace, *MAP) == rows and timed == []
    parts[0].unlink()
    assert rows_of(cli.nptrace, *MAP) == rows and len(timed) == 1
    parts[1].write_bytes(b"PAR1")
    said = run(cli.nptrace, *MAP, code=2).stderr.splitlines()[-1]
    part = parts[1].relative_to(folder)
    assert said == f"Error: {part} cannot be read as a part of a map; delete it, and its run is timed again"


def test_a_map_of_another_program_is_timed_again(folder, monkeypatch):
    """A map resumed after an upgrade returned the figures of the old program."""
    assert {path.name for path in nptrace.break_even._CODE} == {"break_even.py", "timing.py", "sampled_rays.py"}
    rows_of(cli.nptrace, *MAP)
    [first, *_] = (folder / "traces" / "map").glob("*/accesses.parquet")
    assert open_run(str(first.parent)).footer.tool_version == nptrace.__version__
    monkeypatch.setattr(nptrace.break_even, "digest_of", lambda paths: "another")
    rows_of(cli.nptrace, *MAP)
    assert len(list((folder / "traces" / "map").glob("map-*.parquet"))) == 12


def test_a_map_from_part_of_the_rays(folder):
    """Its rows are those of the map, with intervals that hold most of its speed-ups, and without what a part does not tell."""
    larger = [*MAP[:3], "--pixels", "160x160", "--threads", "1"]
    rows, parts = rows_of(cli.nptrace, *larger), rows_of(cli.nptrace, *larger, "--one-in", "4")
    known = [name for name in rows[0] if parts[0][name] is not None]
    assert [name for name in rows[0] if name not in known] == [
        "cycles", "cycles_without", "demand_reads", "requests", "filled", "bytes_from_memory", "traffic_ratio", "accuracy",
        "demand_miss_rate", "spent_port",
    ]  # fmt: skip
    held = 0
    for row, part in zip(rows, parts, strict=True):
        assert (row["one_in"], row["speed_up_half_width"], part["one_in"]) == (1, None, 4)
        for name in set(known) - {"one_in", "speed_up", "speed_up_half_width", "cycles_per_ray_without"}:
            assert row[name] == part[name]
        held += abs(row["speed_up"] - part["speed_up"]) <= part["speed_up_half_width"] < 0.2
    assert held >= 0.9 * len(rows)
    said = run(cli.nptrace, *larger, "--one-in", "4").stdout
    assert "from one in 4 of the 128 pieces of the rays: a speed-up is within its half-width" in said.replace("\n", " ")


@pytest.mark.parametrize("command", [(cli.npcache, "compare", *RUN), (cli.nptrace, *MAP)])
def test_a_missing_matplotlib_is_known_before_any_work(folder, monkeypatch, command):
    def absent(name, *args):
        raise ImportError(name)

    before = sorted(folder.rglob("*"))
    for module in (timing, compare, nptrace.break_even):
        monkeypatch.setattr(module, "time_run", None)
    monkeypatch.setattr("cachesim.report.pictures.importlib", type("Imports", (), {"import_module": staticmethod(absent)}))
    result = run(*command, "--plot", "x.png", code=2)
    assert result.stderr.startswith("Error: a plot needs matplotlib, which is not installed; run: pip install matplotlib")
    assert sorted(folder.rglob("*")) == before
    assert importlib.import_module("matplotlib")
