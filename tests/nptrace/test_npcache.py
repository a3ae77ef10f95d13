"""The npcache command: data on stdout, the rest on stderr, exit 2 with one sentence on a bad input."""

import csv
import io
import json
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

import cli
from cachesim.config import CacheConfig
from cachesim.replay import replay
from cachesim.report.dinero import dinero_block
from tests.reference.traces import make_trace, write
from traces.din import export_din
from traces.identity import COLUMNS
from traces.reader import find_runs, open_run

FIELDS = [
    *COLUMNS, "size_bytes", "ways", "line_bytes", "policy", "policy_seed", "prefetch", "layout", "reads", "flush",
    "demand_accesses", "demand_misses",
    "prefetch_accesses", "prefetch_misses", "compulsory", "capacity", "conflict", "redundant", "filled", "useful", "useless",
    "resident", "pollution", "demand_misses_without", "bytes_from_memory", "demand_miss_rate", "paper_miss_rate", "accuracy",
    "coverage", "traffic_ratio",
]  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two runs, one of a stand-in, and a DineroIV trace of the first."""
    folder = tmp_path_factory.mktemp("traces")
    for kind in ("bvh", "kdtree"):
        run = write(make_trace(kind, 4, n_rays=40), folder / f"bunny-{kind}", stand_in=kind == "kdtree")
        if kind == "bvh":
            export_din(run, folder / "x.din", fmt="binary")
    return folder


def npcache(*args):
    return CliRunner().invoke(cli.npcache, [str(arg) for arg in args])


def replayed(*args):
    result = npcache("replay", *args)
    assert result.exit_code == 0, result.output
    return result.stdout


def test_json_has_every_field_of_every_run_and_configuration(folder):
    values = json.loads(replayed("--traces", folder, "--size", "1K,2K", "--assoc", "1", "--assoc", "2,full", "--3c", "--json"))
    assert [(value["run"], value["stand_in"], value["size_bytes"], value["ways"]) for value in values] == [
        (run, run == "bunny-kdtree", size, ways or size // 32)
        for run in ("bunny-bvh", "bunny-kdtree")
        for size in (1024, 2048)
        for ways in (1, 2, 0)
    ]
    assert all(list(value) == ["schema_version", *FIELDS] for value in values)
    [wanted] = replay(open_run(folder / "bunny-bvh"), [CacheConfig(2048, 2, 32)], three_c=True)
    assert values[4] == {"schema_version": 1, **wanted.to_dict()}


def test_csv_and_table(folder):
    args = ("--traces", folder, "--size", "1K", "--prefetch", "none,stack:tris*2,next-line:tagged", "--layout", "stored,veb+8")
    rows = list(csv.DictReader(io.StringIO(replayed(*args, "--format", "csv"))))
    assert list(rows[0]) == [name for name in FIELDS if name not in ("compulsory", "capacity", "conflict")]
    assert [(row["layout"], row["prefetch"]) for row in rows[:6]] == [
        (layout, prefetch) for layout in ("stored", "veb+8") for prefetch in ("none", "stack:tris*2", "next-line:tagged")
    ]
    table = replayed(*args)
    assert table.isascii()
    assert "bunny-kdtree (stand-in), prefetch stack:tris*2, layout veb+8" in table
    assert "demand miss rate = demand misses / demand accesses" in " ".join(table.split())
    for row in rows:
        assert f"{int(row['demand_misses']):,}" in table


def test_dinero_report(folder):
    [result] = replay(folder / "x.din", [CacheConfig(1024, 2, 32)])
    block = dinero_block(result)
    assert replayed(folder / "x.din", "--size", "1K", "--assoc", "2", "--format", "dinero") == block
    assert "Prefetch Fetches" in block
    both = replayed(folder / "x.din", "--size", "1K", "--assoc", "2,4", "--format", "dinero")
    assert f"x.din, prefetch traced, 1K 2-way 32 B lru\n{block}" in both
    assert "Prefetch Fetches" not in replayed(folder / "x.din", "--prefetch", "none", "--format", "dinero")


def test_table1(folder, tmp_path):
    result = npcache("table1", "--traces", folder)
    assert result.exit_code == 0
    assert result.stdout.isascii()
    assert max(len(line) for line in result.stdout.splitlines()) <= 120
    assert "no run of sponza as a BVH: nptrace render sponza --accel bvh" in result.stderr
    assert result.stderr.count("no run of") == 6
    assert "..." not in result.stdout
    for form in ("csv", "json", "markdown", "latex", "table"):
        printed = npcache("table1", "--traces", folder, "--format", form).stdout
        assert ("True" if form == "csv" else "true" if form == "json" else "(stand-in)") in printed
        assert npcache("table1", "--traces", folder, "--format", form, "-o", tmp_path / form).stdout == ""
        assert (tmp_path / form).read_text() == printed
    first = json.loads(npcache("table1", "--traces", folder, "--json").stdout)[0]
    assert (first["scene"], first["tree"], first["stand_in"]) == ("bunny", "kdtree", True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["csv", "json", "latex", "markdown", "table"]


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["replay", "--size", "8X"], "Error: --size: '8X' is not a size; write e.g. 512, 8K or 64KiB (K = 1024)"),
        (["replay", "--assoc", "0"], "Error: 0 ways: a cache has at least 1; write 1 for direct mapped"),
        (["replay", "--assoc", "two"], "Error: 'two' is not a number of ways"),
        (
            ["replay", "--assoc", "3"],
            "Error: a size of 8192 B is not a whole number of sets of 3 x 32 B = 96 B; write",
        ),
        (["replay", "--line", "48"], "Error: a line of 48 B is not a power of two"),
        (["replay", "--policy", "mru"], "Error: --policy: 'mru' is not a replacement policy; choose lru, fifo, random or opt"),
        (["replay", "--prefetch", "magic"], "Error: --prefetch: there is no prefetch policy 'magic'; write one of next-line"),
        (["replay", "--layout", "zigzag"], "Error: --layout: 'zigzag' is not a layout; choose one of stored, bfs"),
        (["replay", "no-such-run"], "Error: there is no no-such-run"),
        (["replay", "no-such.din"], "Error: there is no no-such.din"),
        (["replay", "--traces", "nowhere"], "Error: there is no folder nowhere; make a run with nptrace render SCENE"),
        (["table1", "--traces", "nowhere"], "Error: there is no folder nowhere"),
        (["table1", "--traces", "HERE", "-o", "no/where.csv"], "Error: cannot write no/where.csv: there is no folder no"),
        (["replay", "BAD"], "line 3: access type 1 is a write, and nodes are read-only"),
        (["replay", "DAMAGED"], "is not a complete run: nodes.parquet missing; render it again"),
    ],
)
def test_bad_input_is_one_sentence(folder, tmp_path, monkeypatch, args, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.din").write_text("0 10\n0 14\n1 18\n")
    (tmp_path / "damaged").mkdir()
    for name in ("accesses.parquet", "rays.parquet", "image.png"):
        (tmp_path / "damaged" / name).write_bytes((folder / "bunny-bvh" / name).read_bytes())
    names = {"HERE": folder, "BAD": "bad.din", "DAMAGED": "damaged"}
    args = [str(names.get(arg, arg)) for arg in args]
    if args[0] == "replay" and args[-2].startswith("--") and args[-1] != "nowhere":
        args += ["--traces", str(folder)]
    result = npcache(*args)
    assert result.exit_code == 2
    assert result.stdout == ""
    errors = [line for line in result.stderr.splitlines() if not line.startswith("no run of")]
    assert len(errors) == 1
    assert message in errors[0]


def test_no_scene_of_the_table(tmp_path):
    write(make_trace("bvh", 1, n_rays=2), tmp_path / "teapot-bvh", scene="teapot")
    result = npcache("table1", "--traces", tmp_path)
    assert result.exit_code == 2
    assert "no run in" in result.stderr
    assert "is of a scene of Table I (bunny, conference, sibenik, sponza)" in result.stderr


def test_damage_inside_a_row_group(folder, tmp_path):
    [path] = [path for path in find_runs(folder) if path.name == "bunny-bvh"]
    copy = tmp_path / "bunny-bvh"
    copy.mkdir()
    for file in path.iterdir():
        data = bytearray(file.read_bytes())
        if file.name == "accesses.parquet":
            data[200:260] = b"\xff" * 60
        (copy / file.name).write_bytes(data)
    result = npcache("replay", copy)
    assert result.exit_code == 2
    assert "is damaged" in result.stderr
    assert len(result.stderr.splitlines()) == 1


@pytest.mark.parametrize("command", [[], ["replay"], ["table1"]])
def test_help_is_quick_and_has_no_heavy_import(command):
    code = (
        "import sys, cli\n"
        f"try: cli.npcache({[*command, '--help']!r})\n"
        "except SystemExit as e: assert not e.code\n"
        "heavy = {'numpy', 'numba', 'pyarrow', 'rich', 'trimesh'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(cli.__file__).parent, stdout=subprocess.DEVNULL)


def test_a_closed_pipe_is_quiet(folder):
    code = f"import cli; cli.npcache(['replay', '--traces', {str(folder)!r}, '--size', '256,512,1K,2K', '--3c', '--json'])"
    process = subprocess.Popen(
        [sys.executable, "-c", code], cwd=Path(cli.__file__).parent, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )  # fmt: skip
    process.stdout.close()
    _, error = process.communicate(timeout=120)
    assert error == b""


def test_a_sweep_counts_what_replays_count(folder, tmp_path):
    rows = json.loads(npcache("sweep", folder / "bunny-bvh", "--size", "1K..4K", "--ways", "1,2", "--json").stdout)
    assert len(rows) == 6
    for row in rows:
        [want] = json.loads(replayed(folder / "bunny-bvh", "--size", row["size_bytes"], "--assoc", row["ways"], "--json"))
        assert {name: row[name] for name in want if name in row} == {name: want[name] for name in want if name in row}
    files = "-o", tmp_path / "x.csv", "--plot", tmp_path / "x.svg"
    result = npcache("sweep", folder / "bunny-bvh", "--size", "1K..4K", "--ways", "1,2", *files)
    assert (result.exit_code, result.stdout) == (0, "")
    assert len(list(csv.DictReader(io.StringIO((tmp_path / "x.csv").read_text())))) == 6
    assert (tmp_path / "x.svg").read_text().startswith("<?xml")


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (("--size", "8K..4K"), "8K..4K"),
        (("--ways", "0"), "0"),
        (("--prefetch", "next-line:miss"), "next-line"),
    ],
)
def test_a_bad_sweep_is_one_sentence(folder, tmp_path, monkeypatch, args, words):
    monkeypatch.chdir(tmp_path)
    result = npcache("sweep", folder / "bunny-bvh", *args)
    assert result.exit_code == 2
    assert words in result.stderr
    assert list(tmp_path.iterdir()) == []
