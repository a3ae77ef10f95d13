"""Options of trees and node formats: the runs that they name, the command in the footer, and the estimate of such a run."""

import json
import shlex

import pytest
from click.testing import CliRunner

import cli
from traces.reader import open_run


def run(group, *words):
    result = CliRunner().invoke(group, words)
    assert result.exit_code == 0, result.output
    return result.stdout


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_one_run_for_each_format(folder):
    run(cli.nptrace, "render", "blob", "--pixels", "8x8", "--offline", "--bvh-nodes", "64", "--bvh-nodes", "32")
    runs = {path.name: open_run(path) for path in (folder / "traces").iterdir()}
    assert sorted(runs) == ["blob-standin-bvh-8x8", "blob-standin-bvh64-8x8", "blob-standin-kdtree-8x8"]
    assert {name: each.footer.tree.node_bytes for name, each in runs.items()} == {
        "blob-standin-bvh-8x8": 32,
        "blob-standin-bvh64-8x8": 64,
        "blob-standin-kdtree-8x8": 8,
    }
    assert "--bvh-nodes 64" in runs["blob-standin-bvh64-8x8"].footer.command
    assert "--bvh-nodes" not in runs["blob-standin-bvh-8x8"].footer.command
    assert runs["blob-standin-bvh-8x8"].n_nodes == runs["blob-standin-bvh64-8x8"].n_nodes


def test_the_command_in_the_footer_makes_the_run_again(folder):
    """With every knob of a builder, and the other format of nodes."""
    for words in (
        ["--accel", "kdtree", "--kd", "min_leaf=2,max_leaf=3"],
        ["--accel", "bvh", "--bvh", "binned,c_trav=0.5,min_leaf=1,max_leaf=2"],
        ["--accel", "bvh", "--bvh", "max_leaf=1", "--bvh-nodes", "64"],
    ):
        [made] = json.loads(run(cli.nptrace, "render", "blob", "--size", "8x8", "--offline", "--overwrite", "--json", *words))
        before = {path.name: path.read_bytes() for path in (folder / made["path"]).iterdir()}
        command = shlex.split(open_run(folder / made["path"]).footer.command)
        run(cli.nptrace, *command[1:], "--offline")  # without --overwrite: it is the same run
        assert {path.name: path.read_bytes() for path in (folder / made["path"]).iterdir()} == before


def test_an_estimate_of_the_other_format(folder):
    words = ["blob", "--pixels", "16x16", "--accel", "bvh", "--offline", "--line", "64", "--json"]
    [first, second] = json.loads(run(cli.npcache, "estimate", *words, "--bvh-nodes", "32", "--bvh-nodes", "64"))
    assert [each["run"] for each in (first, second)] == ["blob-standin-bvh-16x16", "blob-standin-bvh64-16x16"]
    assert second["accesses_per_ray"]["value"] < first["accesses_per_ray"]["value"]
