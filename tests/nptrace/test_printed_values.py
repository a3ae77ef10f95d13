"""Every value that a command prints about a run, as table, JSON, CSV or file, recomputed from the run's files."""

import csv
import io
import json
import re
from pathlib import Path

import duckdb
import numpy as np
import pytest
from click.testing import CliRunner

import cli
from rtrace.camera import pixel_order
from rtrace.scenes.shapes import boxes, icosphere
from tests.nptrace.test_nptrace import write_obj
from tests.reference.recomputed import (
    NODE_BYTES,
    config_of,
    events,
    identity_of,
    number,
    query,
    replayed,
    share,
    table_rows,
    values_of,
)

TREES = ("kdtree", "bvh")
TRIANGLES = np.concatenate([boxes(), icosphere(2) + np.float32([0, 3, 0])])


def call(command, *args, code=0):
    result = CliRunner().invoke(command, [str(arg) for arg in args], catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result


def agree(got, want):
    """Assert that two rows have the same names in the same order, and the same values; rates to twelve digits."""
    assert list(got) == list(want)
    for name, value in want.items():
        if isinstance(value, float):
            value = pytest.approx(value, rel=1e-12)
        assert got[name] == value, name


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with runs of both trees of a small scene that calls itself bunny."""
    folder = tmp_path_factory.mktemp("printed")
    write_obj(folder / "bunny.obj", TRIANGLES)
    return folder


@pytest.fixture(scope="module")
def rendered(folder):
    """Return (summaries as JSON, the table) of the same render."""
    args = "render", folder / "bunny.obj", "--name", "bunny", "--pixels", "24x20", "--out", folder / "traces"
    return json.loads(call(cli.nptrace, *args, "--json").stdout), call(cli.nptrace, *args).stdout


@pytest.fixture(scope="module")
def traces(folder, rendered):
    return folder / "traces"


def facts_of(path):
    """Return what a run holds, counted in its files."""
    [rays] = query(path, "rays", """SELECT count(*), count(*) FILTER (type = 0 AND prim >= 0), count(*) FILTER (type = 1),
                                    count(*) FILTER (type = 1 AND prim >= 0) FROM it""")  # fmt: skip
    [accesses] = query(path, "accesses", "SELECT count(*) FILTER (kind < 3), count(*) FILTER (kind = 3) FROM it")
    return {
        "n_nodes": query(path, "nodes", "SELECT count(*) FROM it")[0][0],
        **dict(zip(("n_rays", "n_hits", "n_shadow_rays", "n_shadowed"), rays, strict=True)),
        "n_accesses": accesses[0], "n_prefetches": accesses[1],
        "n_bytes": sum(file.stat().st_size for file in path.iterdir()),
    }  # fmt: skip


def test_render(traces, rendered):
    summaries, table = rendered
    for tree, summary, words in zip(TREES, summaries, table_rows(table, r" \S*bunny-"), strict=True):
        path = traces / f"bunny-{tree}"
        facts = facts_of(path)
        wanted = {"schema_version": 1, **identity_of(path), "n_triangles": len(TRIANGLES), **facts}
        agree(summary, {name: wanted[name] for name in summary} | wanted)
        assert 0 < facts["n_shadowed"] < facts["n_shadow_rays"] < facts["n_hits"] < facts["n_rays"] - facts["n_shadow_rays"]
        hits = share(facts["n_hits"], facts["n_rays"] - facts["n_shadow_rays"])
        assert words == [
            str(path), number(len(TRIANGLES)), number(facts["n_nodes"]), number(facts["n_rays"]), number(hits, 1, 100),
            number(facts["n_shadow_rays"]), number(facts["n_shadowed"] / facts["n_shadow_rays"], 1, 100),
            number(facts["n_accesses"]), number(facts["n_accesses"] / facts["n_rays"], 1), number(facts["n_prefetches"]),
        ]  # fmt: skip
    assert rendered[0][0]["n_rays"] - rendered[0][0]["n_shadow_rays"] == 24 * 20


def test_a_random_order_is_that_of_its_seed(folder):
    for seed in (0, 9):
        args = "--pixels", "24x20", "--accel", "bvh", "--order", "random", "--seed", seed, "--out", folder / f"random{seed}"
        call(cli.nptrace, "render", folder / "bunny.obj", "--name", "bunny", *args)
        rows = query(folder / f"random{seed}" / "bunny-bvh", "rays", "SELECT y * 24 + x FROM it WHERE type = 0 ORDER BY ray")
        assert [pixel for (pixel,) in rows] == pixel_order("random", 24, 20, seed).tolist()


REPLAYS = [
    (tree, prefetch, base)
    for tree in TREES
    for prefetch, base in (("traced", 0), ("none", 0), ("stack:tris*2", 8), ("next-line:tagged", 0))
]


@pytest.mark.parametrize(("tree", "prefetch", "base"), REPLAYS)
def test_replay(traces, tree, prefetch, base):
    """JSON, CSV and table, with the three kinds of misses, of several caches at once."""
    configs = [config_of(size, ways, line) for line in (32, 64) for size in (512, 1024) for ways in (1, 2)]
    layout = f"stored+{base}" if base else "stored"
    args = ["replay", traces / f"bunny-{tree}", "--size", "512,1K", "--assoc", "1,2", "--line", "32,64", "--3c"]
    args += ["--prefetch", prefetch, "--layout", layout]
    wanted = [
        {**identity_of(traces / f"bunny-{tree}"), **values_of(traces / f"bunny-{tree}", tree, c, prefetch, base)}
        for c in configs
    ]
    printed = json.loads(call(cli.npcache, *args, "--json").stdout)
    assert len(printed) == len(wanted)
    for got, want in zip(printed, wanted, strict=True):
        agree(got, {"schema_version": 1, **want})
    read = list(csv.DictReader(io.StringIO(call(cli.npcache, *args, "--format", "csv").stdout)))
    for got, want in zip(read, printed, strict=True):
        del want["schema_version"]
        assert got == {name: "" if value is None else str(value) for name, value in want.items()}
    table = call(cli.npcache, *args).stdout
    n_requests = sum(want["prefetch_accesses"] for want in wanted)
    assert (n_requests > 0) == (prefetch != "none") == ("prefetches of" in table)
    lines = [words[5:] for words in table_rows(table, r" \d+K? +\d-way ")]
    for want, words in zip(wanted, lines, strict=False):
        kb = number(want["bytes_from_memory"] / 1024)
        more = [number(want["coverage"], 2, 100), number(want["traffic_ratio"], 3)] if n_requests else []
        assert words == [
            *(number(want[name]) for name in ("demand_accesses", "demand_misses")),
            *(number(want[name], 2, 100) for name in ("demand_miss_rate", "paper_miss_rate")),
            *(number(want[name]) for name in ("compulsory", "capacity", "conflict")), kb, *more,
        ]  # fmt: skip
    assert len(lines) == len(wanted) * (2 if n_requests else 1)
    for want, words in zip(wanted, lines[len(wanted) :], strict=bool(n_requests)):
        names = ("prefetch_accesses", "redundant", "filled", "useful", "useless", "resident")
        counts = [number(want[name]) for name in names]
        assert words == [*counts, number(want["accuracy"], 2, 100), number(want["pollution"])]


def test_the_random_policy_has_a_seed(traces):
    run, found = traces / "bunny-bvh", []
    for seed in (0, 7):
        args = "--size", "512", "--assoc", "4", "--policy", "random", "--seed", seed, "--json"
        [value] = json.loads(call(cli.npcache, "replay", run, *args).stdout)
        want = values_of(run, "bvh", config_of(512, 4, policy="random", seed=seed), "traced")
        want |= {"schema_version": 1, **identity_of(run)}
        agree(value, {name: want[name] for name in value})
        found.append(value["demand_misses"])
    assert found[0] != found[1]


def test_a_dinero_block(folder):
    """All rows and columns, of a trace with every type of access."""
    rng = np.random.default_rng(4)
    records = np.zeros(3000, [("address", "<u4"), ("size", "<u2"), ("label", "u1"), ("pad", "u1")])
    records["address"], records["size"] = 4 * rng.integers(0, 300, 3000), rng.choice([4, 8, 40], 3000)
    records["label"] = rng.choice([0, 0, 2, 3, 11], 3000)
    accesses = [(address, size, label) for address, size, label, _ in records.tolist()]
    (folder / "x.din").write_bytes(records.tobytes())
    args = folder / "x.din", "--size", "512", "--assoc", "2", "--line", "16", "--3c", "--format", "dinero"
    lines = call(cli.npcache, "replay", *args).stdout.splitlines()
    cache = replayed(accesses, config_of(512, 2, 16))
    printed = {}
    for line in lines[3:]:
        name, values = re.match(r"^\s*(.*?)\s*((?:\s+\d[\d.]*)*)$", line).groups()
        printed.setdefault(name, []).append(values.split())

    def columns(counts, mark):
        read, fetch, misc = (counts[mark | label] for label in (0, 2, 3))
        return np.array([read + fetch + misc, fetch, read + misc, read, 0, misc])

    def whole(name, values):
        assert printed[name] == [[str(value) for value in values]], name

    def rate(name, values, of, row=0):
        rates = np.divide(values, of, out=values.astype(float), where=of != 0)
        assert printed[name][row] == [f"{value:.4f}" for value in rates], name

    demand, requests = columns(cache.counts["accesses"], 0), columns(cache.counts["accesses"], 8)
    misses, fills = columns(cache.counts["misses"], 0), columns(cache.counts["misses"], 8)
    whole("Demand Fetches", demand)
    rate("Fraction of total", demand, demand[:1].repeat(6))
    whole("Prefetch Fetches", requests)
    rate("Fraction", requests, requests[:1].repeat(6), 0)
    whole("Total Fetches", demand + requests)
    rate("Fraction", demand + requests, (demand + requests)[:1].repeat(6), 1)
    whole("Demand Misses", misses)
    rate("Demand miss rate", misses, demand)
    whole("Prefetch Misses", fills)
    rate("PF miss rate", fills, requests)
    whole("Total Misses", misses + fills)
    rate("Total miss rate", misses + fills, demand + requests)
    for kind in ("compulsory", "capacity", "conflict"):
        own, its = columns(cache.counts[kind], 0), columns(cache.counts[kind], 8)
        whole(f"{kind.capitalize()} misses", own)
        rate(f"{kind.capitalize()} fraction", own, misses)
        whole(f"PF {kind} misses", its)
        rate(f"PF {kind} fract", its, fills)
    filled = 16 * int(misses[0] + fills[0])
    n_splits = sum(cache.counts["accesses"]) - len(accesses)
    assert printed["Multi-block refs"] == [[str(n_splits)]]
    assert printed["Bytes From Memory"] == printed["Total Bytes r/w Mem"] == [[str(filled)]]
    assert printed["( / Demand Fetches)"] == 2 * [[f"{filled / demand[0]:.4f}"]]
    assert printed["Bytes To Memory"] == [["0"]] and printed["( / Demand Writes)"] == [["0.0000"]]
    assert n_splits > 100 and min(demand[[1, 3, 5]]) > 100


@pytest.mark.parametrize("tree", TREES)
def test_sweep(traces, tmp_path, tree):
    """JSON, CSV and Parquet."""
    run = traces / f"bunny-{tree}"
    args = ["sweep", run, "--size", "512..1K", "--ways", "1..3,full", "--line", "32,64", "--prefetch", "traced,none"]
    rows = json.loads(call(cli.npcache, *args, "--json").stdout)
    shapes = {(row["size_bytes"], row["ways"], row["line_bytes"]) for row in rows}
    assert len(rows) == 2 * len(shapes) and {ways for _, ways, _ in shapes} == {1, 2, 3, 8, 16, 32}
    for row in rows:
        want = values_of(run, tree, config_of(row["size_bytes"], row["ways"], row["line_bytes"]), row["prefetch"])
        want |= {"schema_version": 1, **identity_of(run)}
        want["sets"] = row["size_bytes"] // row["ways"] // row["line_bytes"]
        want["total_misses"] = want["demand_misses"] + want["prefetch_misses"]
        want["demand_miss_rate_without"] = want["demand_misses_without"] / want["demand_accesses"]
        agree(row, {name: want[name] for name in row})
    read = list(csv.DictReader(io.StringIO(call(cli.npcache, *args).stdout)))
    for row in rows:
        del row["schema_version"]
    assert read == [{name: "" if value is None else str(value) for name, value in row.items()} for row in rows]
    for name in ("x.csv", "x.parquet"):
        call(cli.npcache, *args, "-o", tmp_path / name)
    assert (tmp_path / "x.csv").read_text() == call(cli.npcache, *args).stdout
    table = duckdb.sql(f"FROM read_parquet('{tmp_path / 'x.parquet'}')")
    assert [dict(zip(table.columns, row, strict=True)) for row in table.fetchall()] == rows


def test_a_plot_draws_the_rates(traces, tmp_path, monkeypatch):
    """Over the sizes, for every number of ways: solid with prefetching, dashed without."""
    axes = pytest.importorskip("matplotlib.axes").Axes
    drawn, real = [], axes.plot
    spy = lambda self, x, y, **o: drawn.append((x, y, o["linestyle"])) or real(self, x, y, **o)
    monkeypatch.setattr(axes, "plot", spy)
    run, sizes = traces / "bunny-bvh", (512, 1024, 2048)
    call(cli.npcache, "sweep", run, "--size", "512..2K", "--ways", "1,2,full", "--plot", tmp_path / "x.svg")
    wanted = []
    for ways in (1, 2, "full"):
        values = [values_of(run, "bvh", config_of(size, size // 32 if ways == "full" else ways), "traced") for size in sizes]
        wanted.append((sizes, [100 * value["demand_miss_rate"] for value in values], "-"))
        without = [100 * value["demand_misses_without"] / value["demand_accesses"] for value in values]
        wanted.append((sizes, without, "--"))
    for (x, y, style), (sizes, rates, dashes) in zip(drawn, wanted, strict=True):
        assert (tuple(x), y, style) == (sizes, pytest.approx(rates), dashes)


PAPER_N = {"kdtree": 15.77, "bvh": 27.0}
IDENTITY = (
    "run", "path", "scene", "stand_in", "tree", "width", "height", "order", "batch", "packet", "shadow", "shadow_order",
    "shadow_end", "camera", "light",
)  # fmt: skip
#: The columns of a record of Table I, each with what divides per cent and KB to give fractions and bytes.
RECORD = {
    "miss_a": ("demand_miss_rate_without", 100), "miss_b": ("paper_miss_rate", 100), "miss_ratio": ("paper_ratio", 100),
    "kb_a": ("bytes_from_memory_without", 1 / 1024), "kb_b": ("bytes_from_memory", 1 / 1024),
    "kb_ratio": ("traffic_ratio", 100), "acpr_a": ("acpr_without", 1), "acpr_b": ("acpr", 1),
    "acpr_ratio": ("acpr_ratio", 100), "demand_accesses": ("demand_accesses", 1), "prefetches": ("prefetch_accesses", 1),
    "demand_miss_b": ("demand_miss_rate", 100), "demand_ratio": ("demand_ratio", 100), "coverage": ("coverage", 100),
    "accuracy": ("accuracy", 100), "acpr_a_measured_n": ("acpr_without_measured_n", 1),
    "acpr_b_measured_n": ("acpr_measured_n", 1), "nodes_per_ray": ("accesses_per_ray", 1),
}  # fmt: skip
NAMES = ("miss_a", "miss_b", "miss_ratio", "kb_a", "kb_b", "kb_ratio", "acpr_a", "acpr_b", "acpr_ratio")


def table1_of(run, tree, config):
    """Return our values of a row of Table I by the paper's definitions."""
    want = values_of(run, tree, config, "traced")
    demand, n = want["demand_accesses"], PAPER_N[tree]
    rate_a, rate_b = want["demand_misses_without"] / demand, want["paper_miss_rate"]
    a, b = 1 - rate_a + 100 * rate_a, 1 - rate_b + 100 * rate_b
    kb_a, kb_b = want["demand_misses_without"] * 32 / 1024, want["bytes_from_memory"] / 1024
    return {
        **identity_of(run), "miss_a": 100 * rate_a, "miss_b": 100 * rate_b, "miss_ratio": 100 * rate_b / rate_a,
        "kb_a": kb_a, "kb_b": kb_b, "kb_ratio": 100 * kb_b / kb_a,
        "acpr_a": n * a, "acpr_b": n * b, "acpr_ratio": 100 * b / a,
        "demand_accesses": demand, "prefetches": want["prefetch_accesses"], "demand_miss_a": 100 * rate_a,
        "demand_miss_b": 100 * want["demand_misses"] / demand,
        "demand_ratio": 100 * want["demand_misses"] / want["demand_misses_without"],
        "coverage": 100 * want["coverage"], "accuracy": 100 * want["accuracy"],
        "acpr_a_measured_n": demand / facts_of(run)["n_rays"] * a, "acpr_b_measured_n": demand / facts_of(run)["n_rays"] * b,
        "nodes_per_ray": demand / facts_of(run)["n_rays"],
    }  # fmt: skip


def paper_rows():
    """Return the paper's numbers, read apart from the program."""
    with open(Path(cli.__file__).parent / "cachesim" / "report" / "table1_paper.csv") as file:
        rows = list(csv.DictReader(line for line in file if line[0] != "#"))
    return {(row["tree"], int(row["size_bytes"]), int(row["ways"])): row for row in rows if row["scene"] == "bunny"}


#: What Table I has of the clock.
CYCLES = ("cycles_per_ray_without", "cycles_per_ray", "speed_up")


def test_table1(traces):
    """JSON, CSV and every cell of the tables."""
    paper = paper_rows()
    keys = [(tree, size, ways) for tree in TREES for size in (8192, 16384) for ways in (1, 2)]
    ours = {key: table1_of(traces / f"bunny-{key[0]}", key[0], config_of(*key[1:])) for key in keys}
    rows = json.loads(call(cli.npcache, "table1", "--traces", traces, "--json").stdout)
    assert [(row["tree"], row["size_bytes"], row["ways"]) for row in rows] == keys
    for row, key in zip(rows, keys, strict=True):
        assert {name: row[name] for name in IDENTITY} == {name: ours[key][name] for name in IDENTITY}
        for name, (column, by) in RECORD.items():
            assert row[column] == pytest.approx(ours[key][name] / by, rel=1e-11), name
            if name in NAMES:
                assert row[f"{column}_paper"] == pytest.approx(float(paper[key][name]) / by, rel=1e-11), name
    read = csv.DictReader(io.StringIO(call(cli.npcache, "table1", "--traces", traces, "--format", "csv").stdout))
    for got, row in zip(read, rows, strict=True):
        assert got == {name: "" if value is None else str(value) for name, value in row.items() if name != "schema_version"}
    text = call(cli.npcache, "table1", "--traces", traces).stdout
    lines = table_rows(text, r" .*(ours|paper|diff) ")
    decimals = [0 if name in ("kb_a", "kb_b") else 1 for name in NAMES]
    for i, key in enumerate(keys):
        mine, theirs, gap = ([*line[-14:]] if "ours" in line else line[-9:] for line in lines[3 * i : 3 * i + 3])
        names = ("demand_miss_a", "demand_miss_b", "demand_ratio", "coverage", "accuracy")
        assert mine == [f"{ours[key][name]:.{d}f}" for name, d in zip(NAMES, decimals, strict=True)] + [
            f"{ours[key][name]:.{d}f}" for name, d in zip(names, (2, 2, 1, 2, 1), strict=True)
        ]
        numbers = [float(paper[key][name]) for name in NAMES]
        assert [float(word) for word in theirs] == numbers
        differences = [ours[key][name] - value for name, value in zip(NAMES, numbers, strict=True)]
        assert [float(word) for word in gap] == [float(f"{x:.{d}f}") for x, d in zip(differences, decimals, strict=True)]
        assert f"{key[1] // 1024}K({key[2]})" in lines[3 * i]
    text, _, of_clock = text.partition("In time: ")
    for line, tree in zip(table_rows(text, r" (kd-tree|BVH) +Bunny"), TREES, strict=True):
        mine = [ours[key] for key in keys if key[0] == tree]
        cells = [f"{one[name]:.1f}" for one in mine for name in ("acpr_a_measured_n", "acpr_b_measured_n")]
        assert line[2:] == [f"{mine[0]['nodes_per_ray']:.2f}", *cells]
    caches = ("--size", "8K,16K", "--assoc", "1,2")
    timed = [call(cli.npcache, "time", traces / f"bunny-{tree}", *caches, "--json").stdout for tree in TREES]
    timed = [row for printed in timed for row in json.loads(printed)]
    for line, row, one in zip(table_rows(of_clock, r" (kd-tree|BVH) +Bunny"), rows, timed, strict=True):
        assert [one[name] for name in ("size_bytes", "ways")] == [row[name] for name in ("size_bytes", "ways")]
        assert [one[name] for name in CYCLES] == [row[name] for name in CYCLES]
        cells = [f"{row[name]:.{d}f}" for name, d in zip(CYCLES, (1, 1, 3), strict=True)]
        assert [word.replace(",", "") for word in line[-3:]] == cells


@pytest.mark.parametrize("tree", TREES)
@pytest.mark.parametrize("prefetch", ["b", "read", "misc", "omit"])
def test_export(traces, tmp_path, tree, prefetch):
    """The number printed, and both files access by access."""
    label = {"b": 11, "read": 0, "misc": 3, "omit": None}[prefetch]
    run = traces / f"bunny-{tree}"
    wanted = [(address, label if kind else 0) for address, _, kind in events(run, tree, "traced")]
    wanted = [access for access in wanted if access[1] is not None]
    args = "export", run, "--prefetch-as", prefetch, "-o"
    said = call(cli.nptrace, *args, tmp_path / "x.din").stderr
    assert said.startswith(f"{tmp_path / 'x.din'}: {len(wanted):,} accesses in ")
    assert (tmp_path / "x.din").read_text() == "".join(f"{label:x} {address:x}\n" for address, label in wanted)
    call(cli.nptrace, *args, tmp_path / "x.bin", "--binary")
    records = np.fromfile(tmp_path / "x.bin", [("address", "<u4"), ("size", "<u2"), ("label", "u1"), ("pad", "u1")])
    assert records.tolist() == [(address, NODE_BYTES[tree], label, 0) for address, label in wanted]
