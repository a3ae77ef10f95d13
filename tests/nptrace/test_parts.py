"""Parts of a run: job arrays through files, processes, executors; always the counts of the plain replay, or one sentence."""

import json
import os
import re
import signal
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import pyarrow as pa
import pytest
from click.testing import CliRunner

import cli
import nptrace as nt
from cachesim import parts
from cachesim.config import CacheConfig
from cachesim.replay import replay
from cachesim.sweep import sweep
from nptrace_base.engines import Engine, engine_of, processes
from nptrace_base.errors import NptraceError
from rtrace.render import Shooting, render
from rtrace.scenes.stand_ins import stand_in
from rtrace.trees.tree_cache import build_tree
from traces.reader import open_run

ROOT = Path(cli.__file__).resolve().parent
POLICIES = ("none", "traced", "stack:tris*2:once", "stack:live", "push", "ttp", "next-line:always:2")
CACHES = [
    CacheConfig(sets * ways * line, ways, line) for line in (32, 64) for sets, ways in ((64, 1), (48, 2), (8, 4), (1, 40))
]


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A built-in scene with every kind of tree, some hundred thousand accesses each."""
    folder, scene = tmp_path_factory.mktemp("parts"), stand_in("blob", detail=0.3)
    found = {}
    for kind in ("kdtree", "bvh", "bvh64"):
        render(scene, build_tree(scene.triangles, kind), Shooting(40, 30), folder / f"blob-{kind}", threads=1)
        found[kind] = open_run(folder / f"blob-{kind}")
    return found


@pytest.fixture
def small_parts(monkeypatch):
    """Cut also short runs."""
    monkeypatch.setattr(parts, "LEAST_PART", 2_000)
    monkeypatch.setattr(parts, "PART", 2_000)


def dicts(rows):
    return [row.to_dict() for row in rows]


def whole(run, *args, **kwargs):
    """Replay in one piece."""
    assert run.n_accesses < parts.LEAST_PART
    return dicts(replay(run, CACHES, *args, threads=2, **kwargs))


@pytest.mark.parametrize("kind", ["kdtree", "bvh", "bvh64"])
@pytest.mark.parametrize("three_c", [False, True])
def test_threads_share_a_run(runs, monkeypatch, kind, three_c):
    run = runs[kind]
    for prefetch in POLICIES:
        expected = whole(run, prefetch=prefetch, three_c=three_c)
        seen = []
        with monkeypatch.context() as patch:
            patch.setattr(parts, "LEAST_PART", 2_000)
            found = replay(run, CACHES, prefetch=prefetch, three_c=three_c, threads=7, progress=seen.append)
        assert dicts(found) == expected
        assert len(seen) >= 7


@pytest.mark.parametrize("kind", ["kdtree", "bvh64"])
@pytest.mark.parametrize("layout", ["stored", "veb+8"])
def test_threads_share_a_sweep(runs, monkeypatch, kind, layout):
    configs = [
        CacheConfig(sets * ways * line, ways, line) for line in (32, 64) for sets in (1, 2, 16, 64) for ways in (1, 3, 20)
    ]
    for prefetch in ("none", "stack"):
        expected = sweep(runs[kind], configs, prefetch=prefetch, layout=layout, threads=1)
        with monkeypatch.context() as patch:
            patch.setattr(parts, "LEAST_PART", 2_000)
            assert sweep(runs[kind], configs, prefetch=prefetch, layout=layout, threads=5) == expected


@pytest.mark.parametrize("kind", ["kdtree", "bvh"])
def test_parts_of_a_run_begin_with_a_ray_and_are_the_run(runs, kind):
    run = runs[kind]
    nodes, kinds = (run.columns("accesses")[name] for name in ("node", "kind"))
    for n in (1, 2, 7, 1000, 5000):
        rows = [run.part(number, n).rows for number in range(1, n + 1)] if n < 1000 else []
        rows = rows or [run.part(number, n).rows for number in (1, 2, n // 2, n // 2 + 1, n)]
        for each in rows:
            assert len(each) == 0 or (nodes[each.start] == 0 and kinds[each.start] != 3)
        if n < 1000:
            assert [each.start for each in rows] == [0, *(each.stop for each in rows[:-1])]
            assert rows[-1].stop == run.n_accesses
    part = run.part(2, 3)
    assert part.columns("accesses")["node"].tolist() == nodes[part.rows.start : part.rows.stop].tolist()
    with pytest.raises(ValueError, match=r"has changed while it was read|is not a run directory"):
        changed = open_run(run.path)
        changed.footer = runs["bvh64"].footer
        changed.part(1, 2)


@pytest.mark.parametrize("pool", [ProcessPoolExecutor, ThreadPoolExecutor])
def test_any_executor(runs, monkeypatch, small_parts, pool):
    if pool is ProcessPoolExecutor:
        monkeypatch.setenv("PYTHONPATH", str(ROOT))
    run = runs["bvh"]
    with pool(2) as executor, engine_of(executor) as engine:
        found = dicts(replay(run, CACHES, prefetch="stack:tris*2", three_c=True, engine=engine))
        swept = sweep(run, [CacheConfig(4096, 4), CacheConfig(4096, 128)], engine=engine)
    monkeypatch.undo()
    assert found == whole(run, prefetch="stack:tris*2", three_c=True)
    assert swept == sweep(run, [CacheConfig(4096, 4), CacheConfig(4096, 128)])


class Mortal:
    """``count_part``, whose process is killed when it counts the third part, ``n_deaths`` times."""

    def __init__(self, deaths, n_deaths):
        self.deaths, self.n_deaths = deaths, n_deaths

    def __call__(self, *args):
        n = len(self.deaths.read_bytes())
        if args[-2] == 3 and n < self.n_deaths:
            with self.deaths.open("ab") as file:  # whole even where the pool ends this process meanwhile
                file.write(b".")
            os.kill(os.getpid(), signal.SIGKILL)
        return COUNT_PART(*args)


COUNT_PART = parts.count_part


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="kills a process with a signal")
@pytest.mark.parametrize("n_deaths", [1, 99])
def test_a_killed_worker(runs, tmp_path, monkeypatch, small_parts, n_deaths):
    deaths = tmp_path / "deaths"
    deaths.touch()
    monkeypatch.setattr(parts, "count_part", Mortal(deaths, n_deaths))
    if n_deaths == 1:
        assert dicts(replay(runs["bvh"], CACHES, engine=processes(2))) == dicts(replay(runs["bvh"], CACHES, threads=1))
        assert deaths.read_bytes() == b"."
        return
    with pytest.raises(NptraceError, match=r"a worker process was lost \(BrokenProcessPool\) with [1-7] of 8 tasks left"):
        replay(runs["bvh"], CACHES, engine=processes(2))


@pytest.mark.parametrize(
    ("args", "message"),
    [
        ("--policy fifo", "under fifo replacement, one hit or miss changes what 8K 1-way 32 B fifo does with all that follow"),
        ("--policy random", "under random replacement"),
        ("--policy opt", "under opt replacement"),
        ("--prefetch next-line:miss", "what next-line:miss requests depends on hits and misses"),
        ("--prefetch next-line:tagged", "what next-line:tagged requests depends on hits"),
    ],
)
def test_what_is_no_fold_is_refused_with_the_reason(runs, tmp_path, args, message):
    run = str(runs["bvh"].path)
    for words in (f"replay {run} --workers 2 {args}", f"summarise {run} --part 1/2 -o {tmp_path / 'x.sum'} {args}"):
        result = CliRunner().invoke(cli.npcache, words.split())
        assert result.exit_code == 2
        assert message in result.stderr
        assert "Traceback" not in result.stderr
    assert CliRunner().invoke(cli.npcache, f"replay {run} {args}".split()).exit_code == 0


def test_a_worker_of_another_version_counts_nothing(runs, monkeypatch):
    class Older(Engine):
        n_workers = 2

        def __init__(self):
            pass

        def results(self, function, tasks):
            with monkeypatch.context() as patch:
                patch.setattr(parts, "code_of", lambda question: "older", raising=False)
                yield from ((i, function(*task)) for i, task in enumerate(tasks))

    with pytest.raises(NptraceError, match="a worker has other sources of nptrace than the command; install the same version"):
        replay(runs["bvh"], CACHES, engine=Older())


# Files


def npcache(*words):
    result = CliRunner().invoke(cli.npcache, [str(word) for word in words])
    assert result.exit_code == 0, result.output
    return result.stdout


def refused(*words):
    result = CliRunner().invoke(cli.npcache, [str(word) for word in words])
    assert result.exit_code == 2, result.output
    return result.stderr


OPTIONS = ["--size", "1K,4K", "--assoc", "2,full", "--prefetch", "none,stack:tris*2", "--layout", "stored,dfs", "--3c"]


def summaries(run, folder, n, options=OPTIONS):
    for i in range(1, n + 1):
        npcache("summarise", run.path, "--part", f"{i}/{n}", *options, "-o", folder / f"{i}.sum")
    return [folder / f"{i}.sum" for i in range(1, n + 1)]


@pytest.mark.parametrize("form", ["json", "table", "csv", "dinero"])
def test_combine_prints_what_replay_prints(runs, tmp_path, form):
    options = OPTIONS if form != "dinero" else ["--size", "1K", "--assoc", "2"]
    files = summaries(runs["kdtree"], tmp_path, 3, options)
    found = npcache("combine", *reversed(files), "--format", form)
    assert found == npcache("replay", runs["kdtree"].path, *options, "--format", form)
    assert found == npcache("combine", *files, "--format", form) == npcache("combine", *files, "--format", form)


def test_from_python_too(runs, tmp_path):
    run, options = runs["kdtree"], {"size": "1K,4K", "ways": "2,full", "prefetch": "none,stack", "layout": "stored,dfs"}
    files = [nt.summarise(run, tmp_path / f"{i}.sum", part=(i, 3), **options) for i in (1, 2)]
    files.append(nt.summarise(run.path, str(tmp_path / "3.sum"), part="3/3", **options, threads=1))
    found, expected = nt.combine(map(str, reversed(files))), nt.replay(run, **options)
    assert list(found) == list(expected)
    assert str(found) == str(expected)
    with pytest.raises(nt.NptraceError, match="'4/3' is not a part of a run"):
        nt.summarise(run, tmp_path / "4.sum", part=(4, 3))


def test_more_parts_than_rays(runs, tmp_path):
    """Some parts are empty, and there is nothing that they could overlap."""
    run, options = runs["bvh"], ["--size", "1K"]
    n = run.n_accesses
    empty = next(number for number in range(n // 2, n) if not run.part(number, n).rows)
    npcache("summarise", run.path, "--part", f"{empty}/{n}", *options, "-o", tmp_path / "empty.sum")
    assert f"accesses 0 to {n - 1} are in no file" in refused("combine", tmp_path / "empty.sum")
    files = [*summaries(run, tmp_path, 2, options), tmp_path / "empty.sum"]
    assert npcache("combine", *files) == npcache("replay", run.path, *options)


def test_gaps_overlaps_other_runs_and_other_questions(runs, tmp_path):
    folders = [tmp_path / name for name in "abc"]
    for folder in folders:
        folder.mkdir()
    options = ["--size", "1K"]
    files = summaries(runs["bvh"], folders[0], 3, options)
    other = summaries(runs["kdtree"], folders[1], 3, options)
    asked = summaries(runs["bvh"], folders[2], 3, [*options, "--prefetch", "none"])
    start = runs["bvh"].part(2, 3).rows
    assert f"accesses {start.start} to {start.stop - 1} are in no file" in refused("combine", files[0], files[2])
    assert "accesses 0 to" in refused("combine", *files[1:])
    assert "name the summary of every part" in refused("combine", *files[:2])
    assert f"both have access {start.start}" in refused("combine", *files, files[1])
    npcache("summarise", runs["bvh"].path, "--part", "2/2", *options, "-o", tmp_path / "half.sum")
    assert "both have access" in refused("combine", files[0], tmp_path / "half.sum", files[1])
    assert "these are different runs" in refused("combine", files[0], other[1], files[2])
    assert "answer different questions" in refused("combine", files[0], asked[1], files[2])


def test_parts_that_other_sources_counted_are_not_joined(runs, tmp_path, monkeypatch):
    """As on the nodes of a job array with another version."""
    options = ["--size", "1K", "--prefetch", "none,traced"]
    files = summaries(runs["bvh"], tmp_path, 2, options)
    read, source = Path.read_bytes, ROOT / "cachesim" / "fast_lru.py"
    with monkeypatch.context() as patch:
        patch.setattr(Path, "read_bytes", lambda path: read(path) + b"#" * (path == source))
        parts._digest.cache_clear()
        npcache("summarise", runs["bvh"].path, "--part", "2/2", *options, "-o", files[1])
        message = "was counted by other sources of nptrace than those of this command"
        assert f"{files[0]} {message}" in refused("combine", *files)
    parts._digest.cache_clear()
    assert f"{files[1]} {message}" in refused("combine", *files)


def test_a_damaged_file_is_one_sentence(runs, tmp_path):
    files = summaries(runs["bvh"], tmp_path, 2, ["--size", "1K"])
    good = files[0].read_bytes()
    for bad in (b"", b"no Arrow", good[: len(good) // 2], good.replace(b'"format_version": 3', b'"format_version": 9')):
        files[0].write_bytes(bad)
        message = refused("combine", *files)
        assert str(files[0]) in message and "make it again" in message
    table = pa.ipc.open_file(pa.py_buffer(good)).read_all()
    data = [bytes([item[0] ^ 1]) + item[1:] if item else item for item in table.column("data").to_pylist()]
    with pa.ipc.new_file(files[0], table.schema) as writer:
        writer.write_table(table.set_column(2, table.schema.field(2), pa.chunked_array([pa.array(data, pa.large_binary())])))
    assert "its checksum is wrong" in refused("combine", *files)
    assert "not a readable summary" in refused("combine", tmp_path / "absent.sum")


@pytest.mark.parametrize("part", ["0/2", "3/2", "1", "a/b", "1/0"])
def test_what_is_no_part(runs, tmp_path, part):
    assert "write 1/8 for the first of eight" in refused(
        "summarise", runs["bvh"].path, "--part", part, "-o", tmp_path / "x.sum"
    )  # fmt: skip


def test_the_script_of_the_page(runs, tmp_path):
    """The loop of docs/scale.md, whose job array is here a loop."""
    text = (ROOT / "docs" / "scale.md").read_text(encoding="utf-8")
    script = re.search(r"```sh\n(#!/bin/bash\n.*?)```", text, re.DOTALL)
    assert script is not None and len(script[1].splitlines()) <= 10
    script = (
        script[1]
        .replace("traces/sponza-bvh", str(runs["bvh"].path))
        .replace("npcache", f"{sys.executable} -P -m nptrace cache")
    )
    (tmp_path / "job.sh").write_text(script)
    (tmp_path / "parts").mkdir()
    n = 2  # the page has more
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "SLURM_ARRAY_TASK_COUNT": str(n)}
    for i in range(1, n + 1):
        task = environment | {"SLURM_ARRAY_TASK_ID": str(i)}
        subprocess.run(["bash", "-eu", "job.sh"], cwd=tmp_path, env=task, check=True, capture_output=True)
    options = re.search(r"--size .*?(?= -o)", script)[0].split()
    found = json.loads(npcache("combine", *(tmp_path / "parts").glob("*.sum"), "--json"))
    assert found == json.loads(npcache("replay", runs["bvh"].path, *options, "--json"))
