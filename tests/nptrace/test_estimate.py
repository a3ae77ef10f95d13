"""npcache estimate, and table1 --target-error: what is printed, and one sentence for each bad input."""

import csv
import json

import pytest
from click.testing import CliRunner

import cli
from cachesim.config import CacheConfig
from cachesim.replay import replay
from cachesim.report.table1 import SCENES, caches
from rtrace.scenes.stand_ins import stand_in
from traces.reader import open_run


@pytest.fixture(autouse=True)
def small_scenes(monkeypatch, tmp_path):
    """Coarse stand-ins for every name, and no scene of the user's."""
    built_in = dict(zip(SCENES, ("blob", "room", "nave", "court"), strict=True))

    def load(name, **options):
        return stand_in(built_in.get(name, name), 0.15)._replace(name=name, stand_in=name in built_in)

    monkeypatch.setattr("rtrace.scenes.catalog.load_scene", load)
    monkeypatch.chdir(tmp_path)


def npcache(*args, status=0):
    result = CliRunner().invoke(cli.npcache, [str(arg) for arg in args])
    assert result.exit_code == status, result.output
    return result.stdout if status == 0 else result.stderr


def test_an_exact_run_is_the_rendered_one(tmp_path):
    CliRunner().invoke(cli.nptrace, ["render", "court", "--pixels", "64x48", "--accel", "bvh", "--order", "tile"])
    found = json.loads(
        npcache("estimate", "court", "--pixels", "64x48", "--accel", "bvh", "--order", "tile", "--table1", "--json")
    )
    assert [run["method"] for run in found] == ["exact"]
    exact = replay(open_run(next(tmp_path.glob("traces/*"))), caches())
    for cell, result in zip(found[0]["cells"], exact, strict=True):
        assert (cell["size_bytes"], cell["ways"]) == (result.config.size_bytes, result.config.ways)
        assert cell["demand_miss_rate"] == {"value": result.demand_miss_rate, "half_width": 0.0, "unsettled": 0.0}
    assert not list(tmp_path.glob("*.npz"))


def test_a_sampled_run_reports_its_method(tmp_path):
    args = ["estimate", "court", "--accel", "kdtree", "--pixels", "256x256", "--size", "2K", "--target-error", "10%,0.2pp"]
    args += ["--exact-below", "0", "--resume", "kept.npz"]
    found = json.loads(npcache(*args, "--json"))[0]
    assert found["method"] == "sampled" and found["target"] == "10%,0.2pp" and found["units"] == 256
    assert 0 < found["share_of_rays"] < 1 and found["exact_seconds"] > 0 and (tmp_path / "kept.npz").exists()
    cell = found["cells"][0]
    assert cell["method"] == "sampled"
    for name in ("demand_miss_rate_without", "demand_miss_rate", "paper_miss_rate"):
        assert 0 < cell[name]["half_width"] <= max(0.1 * cell[name]["value"], 0.002)
    printed = npcache(*args)  # from what was kept
    assert "+-" in printed and "2K 1-way 32 B lru" in printed and "sampled" in printed and "about" in printed
    assert f"{100 * cell['paper_miss_rate']['value']:.3f} +-" in printed


def test_the_reason_for_an_exact_run_is_printed():
    assert "was counted exactly: about" in npcache("estimate", "blob", "--pixels", "32x32", "--accel", "bvh")


def test_csv_has_a_row_per_cache_with_half_widths():
    args = ["estimate", "blob", "--pixels", "32x32", "--accel", "bvh", "--size", "1K,2K", "--format", "csv"]
    rows = list(csv.DictReader(npcache(*args).splitlines()))
    assert [(row["run"], row["size_bytes"]) for row in rows] == [("blob-bvh-32x32", "1024"), ("blob-bvh-32x32", "2048")]
    assert all(0 < float(row["paper_miss_rate"]) < 1 and row["paper_miss_rate_half_width"] == "0.0" for row in rows)


@pytest.mark.parametrize("form", ["table", "markdown", "json"])
def test_table1_estimated(form):
    printed = npcache("table1", "--target-error", "2%", "--pixels", "24x24", "--format", form)
    if form == "json":
        rows = json.loads(printed)
        assert [(row["tree"], row["scene"]) for row in rows[:2]] == [("kdtree", "bunny"), ("kdtree", "conference")]
        assert len(rows) == 2 * len(SCENES) and all(len(row["cells"]) == 4 for row in rows)
        return
    assert printed.count("8K(1)") == 8 and printed.count("(stand-in)") >= 8
    assert printed.count("paper") >= 32 and "bunny-standin-bvh-24x24 (stand-in) was counted exactly" in printed.replace(
        "\n", " "
    )


@pytest.mark.parametrize(
    ("args", "sentence"),
    [
        (["estimate", "court", "--target-error", "2"], "'2' is not a target error; write e.g. 2%, 0.05pp"),
        (["estimate", "court", "--target-error", "0%"], "a target error of 0 needs the exact run"),
        (["estimate", "court", "--size", "8K", "--assoc", "3"], "is not a whole number of sets"),
        (["estimate", "court", "--pixels", "big"], "is not WIDTHxHEIGHT"),
        (["estimate", "court", "--resume", "x.npz"], "--resume x.npz keeps the counts of one run"),
        (["table1", "--target-error", "two"], "'two' is not a target error"),
    ],
)
def test_bad_input_is_one_sentence(args, sentence):
    error = npcache(*args, status=2)
    assert sentence in error and error.startswith("Error: ") and error.count("\n") == 1


def test_a_file_of_another_run_is_refused():
    args = ["--accel", "bvh", "--pixels", "256x256", "--size", "2K", "--target-error", "30%,1pp", "--exact-below", "0"]
    npcache("estimate", "court", *args, "--resume", "x.npz")
    assert "another scene, tree, picture or set of caches" in npcache("estimate", "blob", *args, "--resume", "x.npz", status=2)


def test_configs_of_table1():
    assert caches() == [CacheConfig(size << 10, ways, 32) for size in (8, 16) for ways in (1, 2)]
