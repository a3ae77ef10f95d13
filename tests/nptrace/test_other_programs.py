"""Files that another program wrote again: byte order marks, true for True, compressed traces, tables of addresses."""

import gzip
import json
from pathlib import Path

import pytest
from click.testing import CliRunner

import cli
from cachesim.report.result_files import read_rows
from tests.nptrace.test_terminal import inputs

pytest.importorskip("matplotlib")
RUN = "traces/bunny-bvh"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("others")
    inputs(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        run("npcache", "sweep", RUN, "--size", "1K..2K", "-o", "s.csv")
        run("npcache", "sweep", RUN, "--size", "1K..2K", "-o", "s.json")
        for form in ("din", "csv", "parquet"):
            run("nptrace", "export", RUN, "--prefetch-as", "omit", "-o", f"t.{form}")
    return folder


@pytest.fixture(autouse=True)
def here(folder, monkeypatch):
    monkeypatch.chdir(folder)


def run(program, *args, code=0):
    result = CliRunner().invoke(getattr(cli, program), args, catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result


@pytest.mark.parametrize("words", [("True", "False"), ("TRUE", "FALSE"), ("true", "false")])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_results_that_a_spreadsheet_saved_are_the_same_rows(words, mark):
    text = Path("s.csv").read_text().replace("True", words[0]).replace("False", words[1]).replace("\n", "\r\n")
    Path("again.csv").write_bytes((mark + text).encode())
    assert read_rows(Path("again.csv")) == read_rows(Path("s.csv"))
    assert {row["stand_in"] for row in read_rows(Path("again.csv"))} == {True}
    Path("again.json").write_text(mark + Path("s.json").read_text())
    assert read_rows(Path("again.json")) == json.loads(Path("s.json").read_text())
    run("npcache", "plot", "again.csv", "again.json", "-o", "x.png")


@pytest.mark.parametrize("name", ["again.csv", "quoted.csv"])
def test_results_that_a_spreadsheet_saved_are_no_run(name):
    header, *lines = Path("s.csv").read_text().splitlines()
    quoted = "\n".join([",".join(f'"{each}"' for each in header.split(",")), *lines])
    Path("quoted.csv").write_text(quoted)
    Path("again.csv").write_text("\ufeff" + Path("s.csv").read_text())
    assert f"{name} holds results, and no run" in run("npcache", "replay", name, code=2).stderr


def test_every_trace_that_is_replayed_is_drawn():
    Path("t.din.gz").write_bytes(gzip.compress(Path("t.din").read_bytes()))
    Path("t.csv.gz").write_bytes(gzip.compress(Path("t.csv").read_bytes()))
    for name in ("t.din", "t.din.gz", "t.csv", "t.csv.gz", "t.parquet"):
        run("npcache", "plot", name, "--kind", "curves", "--size", "1K", "--ways", "1", "--prefetch", "none", "-o", "x.svg")
        assert name in Path("x.svg").read_text()
    said = run("npcache", "plot", "t.csv", "s.csv", "-o", "x.svg", code=2).stderr
    assert said.startswith("Error: t.csv is a run and s.csv holds results; draw")


def test_a_study_may_begin_with_a_byte_order_mark():
    text = '\ufeff[render]\r\nscenes = ["ball.obj"]\r\naccel = "bvh"\r\npixels = "8x8"\r\n[replay]\r\nsizes = 3\r\n'
    Path("study.toml").write_bytes(text.encode())
    assert run("nptrace", "run", "study.toml", code=2).stderr.startswith("Error: study.toml, line 6: [replay] has no 'sizes'")
