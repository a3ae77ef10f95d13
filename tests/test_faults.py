"""Faults from outside: killed at any moment, a disk that is full, two writers at once, no memory. Whole runs or none."""

import os
import random
import resource
import subprocess
import sys
import time
from pathlib import Path

import pytest

import cli
from rtrace.shapes import soup
from traces.format import FILES, find_runs, open_run

ROOT = Path(cli.__file__).resolve().parent


@pytest.fixture
def folder(tmp_path):
    lines = ["v {} {} {}".format(*map(float, corner)) for corner in soup(3000, seed=1).reshape(-1, 3)]
    lines += [f"f {3 * i + 1} {3 * i + 2} {3 * i + 3}" for i in range(3000)]
    (tmp_path / "soup.obj").write_text("\n".join(lines))
    return tmp_path


def start(folder, *args, limit=None, program="nptrace"):
    command = [sys.executable, "-c", f"import cli; cli.{program}()", *map(str, args)]
    return subprocess.Popen(
        command, cwd=folder, env={**os.environ, "PYTHONPATH": str(ROOT)}, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True, preexec_fn=limit,
    )  # fmt: skip


def render(folder, size, **options):
    return start(folder, "render", "soup.obj", "--accel", "bvh", "--size", size, **options)


def finish(process):
    """Wait for a process and return (exit status, stderr)."""
    _, stderr = process.communicate()
    return process.returncode, stderr


def read_all(run):
    return sum(len(node) for node, _ in run.batches()) + len(run.columns("rays")["t"]) + len(run.columns("nodes")["level"])


def test_killed_at_any_moment_a_run_is_whole_or_the_one_before(folder):
    assert finish(render(folder, "64x64"))[0] == 0
    before = (folder / "traces" / "soup-bvh" / "accesses.parquet").read_bytes()
    began = time.perf_counter()
    process = render(folder, "200x200")
    process.communicate()
    whole = time.perf_counter() - began
    after = (folder / "traces" / "soup-bvh" / "accesses.parquet").read_bytes()
    chance = random.Random(4)
    for _ in range(12):
        process = render(folder, chance.choice(["64x64", "200x200"]))
        time.sleep(chance.uniform(0.3, 1.1) * whole)
        process.kill()
        process.communicate()
        (path,) = find_runs(folder / "traces")
        assert read_all(open_run(path)) > 0
        assert (path / "accesses.parquet").read_bytes() in (before, after)
    process = render(folder, "64x64")
    process.communicate()
    assert process.returncode == 0
    assert os.listdir(folder / "traces") == ["soup-bvh"]  # what the killed ones left is swept
    assert (folder / "traces" / "soup-bvh" / "accesses.parquet").read_bytes() == before


def test_a_disk_that_fills_up_is_said_and_leaves_nothing(folder):
    process = render(folder, "400x400", limit=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000)))
    _, stderr = process.communicate()
    assert process.returncode == 2
    assert "cannot write" in stderr
    assert "nothing was kept" in stderr
    assert "Traceback" not in stderr
    assert os.listdir(folder / "traces") == []


def test_two_renders_into_one_run_leave_one_whole_run(folder):
    assert finish(render(folder, "64x64"))[0] == 0
    for _ in range(3):
        processes = [render(folder, "100x100") for _ in range(3)]
        for process in processes:
            _, stderr = process.communicate()
            assert process.returncode == 0, stderr
        assert os.listdir(folder / "traces") == ["soup-bvh"]
        run = open_run(folder / "traces" / "soup-bvh")
        assert run.metadata["width"] == 100
        assert read_all(run) > 0


def test_a_killed_replay_leaves_no_output(folder):
    assert finish(render(folder, "300x300"))[0] == 0
    names = sorted(os.listdir(folder))
    for wait in (0.2, 0.5, 0.8):
        process = start(folder, "replay", "--size", "8K", "--3c", "--json", program="npcache")
        time.sleep(wait)
        process.kill()
        process.communicate()
        assert sorted(os.listdir(folder)) == names
        assert sorted(os.listdir(folder / "traces" / "soup-bvh")) == sorted(FILES)


def test_too_little_memory_is_one_sentence_and_leaves_nothing(folder):
    """60,000 x 30,000 pixels need 7 GB for their order alone; with 4 GB of address space there is a message, not a crash."""
    process = render(folder, "60000x30000", limit=lambda: resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30)))
    _, stderr = process.communicate()
    assert process.returncode == 2
    assert "Traceback" not in stderr
    assert "memory" in stderr.lower() or "allocate" in stderr.lower()
    assert not (folder / "traces").exists() or os.listdir(folder / "traces") == []
