"""npcache plot: results of every command and every format, and runs, become pictures; nothing else does."""

from pathlib import Path

import pytest
from click.testing import CliRunner

import cli
from cachesim.report.result_files import read_rows
from nptrace.commands.plot import KINDS, OF_RUNS
from tests.nptrace.test_terminal import inputs

pytest.importorskip("matplotlib")
RUN = "traces/bunny-bvh"
CACHE = ["--size", "1K,2K", "--assoc", "1"]
RESULTS = {
    "curves": ["replay", RUN, "traces/bunny-kdtree", *CACHE, "--policy", "lru,random", "--seed", "3"],
    "curves of a sweep": ["sweep", RUN, "--size", "1K..2K", "--ways", "1,2"],
    "levels": ["replay", RUN, *CACHE, "--by", "level"],
    "levels by ray": ["time", RUN, "--size", "1K", "--assoc", "1", "--by", "ray"],
    "speed-ups": ["time", RUN, *CACHE, "--rays", "1,4"],
    "speed-ups of policies": ["compare", RUN, "--size", "1K", "--assoc", "1", "--no-baselines", "--prefetch", "stack,push"],
    "table1": ["table1"],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two runs, and the results of every command in every format that can be read."""
    folder = tmp_path_factory.mktemp("plot")
    inputs(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for name, args in RESULTS.items():
            for ending in ("csv", "json", "parquet"):
                assert CliRunner().invoke(cli.npcache, [*args, "-o", f"{name}.{ending}"]).exit_code == 0
    return folder


@pytest.fixture(autouse=True)
def here(folder, monkeypatch):
    monkeypatch.chdir(folder)


def plot(*args, code=0):
    result = CliRunner().invoke(cli.npcache, ["plot", *args])
    assert result.exit_code == code, result.output
    return result


@pytest.mark.parametrize("name", RESULTS)
def test_results_are_drawn_as_what_they_are_from_every_format(name, folder):
    pictures = []
    for ending in ("csv", "json", "parquet"):
        result = plot(f"{name}.{ending}", "-o", "x.svg")
        assert KINDS[name.split()[0]] in result.stderr
        pictures.append((folder / "x.svg").read_bytes())
    assert pictures[0].startswith(b"<?xml") and pictures[0] == pictures[1] == pictures[2]


@pytest.mark.parametrize("name", RESULTS)
def test_the_rows_of_every_format_are_the_same(name):
    assert rows_of(f"{name}.csv") == rows_of(f"{name}.parquet") == rows_of(f"{name}.json")


def rows_of(name):
    """Return the rows of a file; an empty text, which these runs have for a builder, is nothing in CSV."""
    return [{k: None if v == "" else v for k, v in row.items() if k != "schema_version"} for row in read_rows(Path(name))]


@pytest.mark.parametrize("kind", OF_RUNS)
def test_runs_are_drawn_as_their_results_would_be(kind, folder):
    caches = [] if kind == "distances" else CACHE
    plot(RUN, "traces/bunny-kdtree", "--kind", kind, *caches, "--layout", "stored,bfs", "-o", "runs.svg")
    text = (folder / "runs.svg").read_text()
    assert "bunny-kdtree" in text and "bunny-bvh (stand-in" in text and "bfs" in text
    if kind in ("curves", "levels"):
        by = ["--by", "level"] if kind == "levels" else []
        args = ["replay", RUN, "traces/bunny-kdtree", *CACHE, "--layout", "stored,bfs", *by, "-o", "same.csv"]
        assert CliRunner().invoke(cli.npcache, args).exit_code == 0
        plot("same.csv", "-o", "same.svg")
        assert (folder / "same.svg").read_bytes() == (folder / "runs.svg").read_bytes()


def test_a_run_alone_shows_its_distances_and_several_files_are_drawn_together(folder):
    assert KINDS["distances"] in plot(RUN, "-o", "x.png").stderr
    assert plot(RUN, "-o", "-").stdout_bytes.startswith(b"\x89PNG")
    assert "of 12 rows" in plot("curves.csv", "curves of a sweep.json", "-o", "x.pdf").stderr
    assert (folder / "x.pdf").read_bytes().startswith(b"%PDF")


def test_a_missing_matplotlib_is_known_before_any_work(monkeypatch):
    def absent(name):
        raise ImportError(name)

    monkeypatch.setattr("cachesim.report.pictures.importlib", type("Imports", (), {"import_module": staticmethod(absent)}))
    monkeypatch.setattr("cachesim.report.result_files.read_rows", lambda path: pytest.fail("work was done"))
    for source in ("curves.csv", RUN):
        said = plot(source, "-o", "y.png", code=2).stderr
        assert said.startswith("Error: a plot needs matplotlib") and "uv tool install" in said and "pipx inject" in said


@pytest.mark.parametrize(
    ("text", "reason"),
    [("{", "cannot be read"), ("[]", "has no rows of results"), ('[{"a": 1}]', "has no rows of results"), ("3", "has no rows"),
     ('[{"run": "x", "scene": "y"}]', "results with the columns run, scene cannot be drawn")],
)  # fmt: skip
def test_what_holds_no_results_is_one_sentence(folder, text, reason):
    (folder / "odd.json").write_text(text)
    assert reason in plot("odd.json", "-o", "x.png", code=2).stderr
    (folder / "odd.parquet").write_text(text)
    assert "odd.parquet cannot be read" in plot("odd.parquet", "-o", "x.png", code=2).stderr
