"""Runs of packets, which no clock can time: their counts are printed, and a note says why they have no cycles."""

import json

import pytest
from click.testing import CliRunner

import cli

WHY = "rays of a packet read nodes together, and on the clock every ray reads for itself."


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """One run of packets, and one of single rays."""
    folder = tmp_path_factory.mktemp("packets")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.delenv("NPTRACE_SCENES", raising=False)
        for options in (["--accel", "kdtree", "--packet", "4", "--name", "packets"], ["--accel", "bvh", "--name", "single"]):
            args = ["render", "bunny", *options, "--pixels", "16x16", "--offline", "--threads", "1"]
            assert CliRunner().invoke(cli.nptrace, args).exit_code == 0
    return folder


@pytest.fixture(autouse=True)
def here(folder, monkeypatch):
    monkeypatch.chdir(folder)


def run(*args):
    result = CliRunner().invoke(cli.npcache, args, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


def test_table_1_has_their_counts():
    rows = json.loads(run("table1", "--json"))
    assert len(rows) == 8
    for row in rows:
        assert row["demand_accesses"] > 0
        assert (row["speed_up"] is None) == (row["cycles_per_ray"] is None) == (row["run"] == "packets-kdtree")
    text = " ".join(run("table1").split())
    assert f"No cycles of packets-kdtree (stand-in): {WHY}" in text
    assert WHY not in " ".join(run("table1", "traces/single-bvh").split())


def test_a_report_has_all_but_their_clock(folder):
    pytest.importorskip("vl_convert")
    for names, n_timed in ((["traces/packets-kdtree", "traces/single-bvh"], 1), (["traces/packets-kdtree"], 0)):
        run("report", *names, "--size", "1K", "--threads", "1", "-o", "page.html")
        page = (folder / "page.html").read_text()
        assert WHY in page and page.count("npcache compare traces/single-bvh --machine") == n_timed
        assert "npcache compare  --machine" not in page and "npcache compare traces/packets-kdtree" not in page
