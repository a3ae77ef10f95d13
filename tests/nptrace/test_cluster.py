"""Rendering on a Dask cluster of two processes, one of which is killed."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest
from click.testing import CliRunner

import cli
import nptrace as nt
import nptrace_base.engines as engines
import rtrace.part_render as part_render
from nptrace_base.engines import WorkersLostError, engine_of
from nptrace_base.errors import NptraceError
from rtrace.part_render import trace_part
from rtrace.scenes.stand_ins import stand_in


@pytest.fixture(scope="module")
def cluster():
    from distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0") as running:
        yield running


def killing(job, number, stretch):
    if number == 1 and not (job.place / "killed").exists():
        (job.place / "killed").mkdir(parents=True)
        os.kill(os.getpid(), signal.SIGKILL)
    return trace_part(job, number, stretch)


@pytest.mark.slow
def test_a_killed_worker_costs_no_row(tmp_path, cluster, monkeypatch):
    scene = stand_in("blob", detail=0.3)
    here = nt.render(scene, accel="bvh", pixels="160x160", out=tmp_path / "a")
    monkeypatch.setattr(part_render, "trace_part", killing)
    usual = part_render.render_parts.__kwdefaults__
    monkeypatch.setattr(part_render.render_parts, "__kwdefaults__", usual | {"part": 1})
    there = nt.render(scene, accel="bvh", pixels="160x160", out=tmp_path / "b", scheduler=cluster.scheduler_address)
    assert (tmp_path / "b" / there.name / "killed").is_dir() and len(there._parts) == 4
    for table in ("rays", "accesses"):
        for name, values in there.columns(table).items():
            assert (values == here.columns(table)[name]).all(), name
    assert there.image() == here.image()


@pytest.mark.slow
def test_a_scheduler_that_is_lost_is_one_sentence():
    from distributed import LocalCluster

    with (
        LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0") as running,
        engine_of(scheduler=running.scheduler_address) as engine,
    ):
        assert list(engine.results(abs, [(-1,)])) == [(0, 1)]
        running.close()
        with pytest.raises(WorkersLostError, match=r"a worker of the cluster was lost \(.*\) with 2 of 2 tasks left"):
            list(engine.results(abs, [(-1,), (-2,)]))


@pytest.mark.slow
@pytest.mark.parametrize("who", ["a worker of the scheduler", "the scheduler"])
def test_a_cluster_without_this_program_is_one_sentence(tmp_path, who):
    """Dask would lose one worker after the other, or wait for a worker that can."""
    (tmp_path / "without.py").write_text("import sys\nsys.modules['nptrace_base'] = None\n")
    environment = {**os.environ, "PYTHONPATH": ""}
    begin = [sys.executable, "-m", "distributed.cli.dask_"]

    def started(what, *arguments, without):
        preload = ["--preload", str(tmp_path / "without.py")] if without else []
        command = [*begin[:2], begin[2] + what, *arguments, *preload]
        return subprocess.Popen(command, env=environment, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    address = tmp_path / "scheduler.json"
    scheduler = started(
        *("scheduler", "--port", "0", "--no-dashboard", "--scheduler-file", str(address)), without=who == "the scheduler"
    )
    worker = started(
        *("worker", "--scheduler-file", str(address), "--no-nanny", "--no-dashboard", "--nthreads", "1"),
        without=who != "the scheduler",
    )
    try:
        for _ in range(300):
            if address.exists() and address.read_text():
                break
            time.sleep(0.1)
        place = json.loads(address.read_text())["address"]
        from distributed import Client

        with Client(place, timeout="30s", set_as_default=False) as client:
            client.wait_for_workers(1, timeout=30)
        sentence = rf"^{who} at {place} cannot run nptrace \(.*nptrace_base.*\); install it there, in the same version$"
        with pytest.raises(NptraceError, match=sentence), engine_of(scheduler=place) as engine:
            list(engine.results(abs, [(-1,)]))
    finally:
        for process in (worker, scheduler):
            process.kill()
            process.wait()


@pytest.mark.parametrize(
    ("args", "sentence"),
    [
        (["--scheduler", "tcp://127.0.0.1:9", "--workers", "2"], "--workers are processes of this machine, and --scheduler"),
        (["--scheduler", "tcp://127.0.0.1:9"], "there is no Dask scheduler at tcp://127.0.0.1:9"),
    ],
)
def test_a_scheduler_that_is_not_there_is_one_sentence(tmp_path, monkeypatch, args, sentence):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(engines, "_PATIENCE", "1s")
    result = CliRunner().invoke(cli.nptrace, ["render", "blob", "--pixels", "8x8", *args])
    assert result.exit_code == 2 and f"Error: {sentence}" in result.stderr
    assert list(tmp_path.iterdir()) == []
