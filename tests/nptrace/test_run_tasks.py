"""compare and table1 by workers, which take whole runs: the rows are those of one process."""

import shutil
from concurrent.futures import ThreadPoolExecutor

import pytest
from click.testing import CliRunner

import cli
import nptrace as nt
from nptrace import run_tasks
from tests.nptrace.test_terminal import inputs


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    inputs(tmp_path)
    return tmp_path


def test_rows_are_those_of_one_process(folder):
    runs = sorted(str(path) for path in folder.glob("traces/*-*"))
    with ThreadPoolExecutor(2) as workers:
        compared = nt.compare(runs, prefetch="push", baselines=False, workers=workers)
        table = nt.table1(workers=workers, n="measured", miss=50)
    assert len(compared) >= 2
    assert list(compared) == list(nt.compare(runs, prefetch="push", baselines=False))
    assert list(table) == list(nt.table1(n="measured", miss=50))
    assert [row["run"] for row in compared] != [compared[0]["run"]] * len(compared)


def test_a_worker_of_another_version_is_refused(folder, monkeypatch):
    class Older(ThreadPoolExecutor):
        def submit(self, function, *args):
            monkeypatch.setattr(run_tasks, "_code", lambda: "older", raising=False)
            return super().submit(function, *args)

    with Older(1) as workers, pytest.raises(nt.NptraceError, match="a worker has other sources of nptrace than the command"):
        nt.compare("traces/bunny-bvh", prefetch="push", baselines=False, workers=workers)


@pytest.mark.parametrize("count", ["compare", "table1"])
def test_a_worker_that_finds_another_run_is_refused(folder, count):
    """As on a machine with files of its own under the same path."""

    class Elsewhere(ThreadPoolExecutor):
        def submit(self, function, *args):
            changed = [shutil.copytree(run, run.with_name("other")) for run in folder.glob("traces/bunny-kdtree")]
            shutil.rmtree(folder / "traces/bunny-bvh")
            changed[0].rename(folder / "traces/bunny-bvh")
            return super().submit(function, *args)

    functions = {
        "compare": lambda workers: nt.compare("traces/bunny-bvh", prefetch="push", baselines=False, workers=workers),
        "table1": lambda workers: nt.table1("traces/bunny-bvh", workers=workers),
    }
    with Elsewhere(1) as workers, pytest.raises(nt.NptraceError, match="bunny-bvh is another run where a worker reads it"):
        functions[count](workers)


@pytest.mark.slow
def test_processes_find_the_runs(folder):
    def printed(*more):
        done = CliRunner().invoke(cli.npcache, ["compare", "traces/bunny-bvh", "--prefetch", "push", "--json", *more])
        assert done.exit_code == 0, done.output
        return done.stdout

    assert printed("--no-baselines", "--workers", "1") == printed("--no-baselines")


def test_an_estimated_table_has_no_workers(folder):
    done = CliRunner().invoke(cli.npcache, ["table1", "--target-error", "5%", "--workers", "2"])
    assert done.exit_code == 2
    assert "--target-error has threads alone; leave out --workers, or give runs" in done.stderr
