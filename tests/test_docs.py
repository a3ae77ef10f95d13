"""The pages are right: the first query counts what it says, Table I is what the program prints, the frontier is one."""

import csv
import os
import re
from pathlib import Path

import duckdb
import pytest
from click.testing import CliRunner

import cli

ROOT = Path(cli.__file__).resolve().parent


def run(group, *args):
    result = CliRunner().invoke(group, [str(a) for a in args], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


def test_the_first_query_counts_reads_by_level(tmp_path):
    query, *_ = re.findall(r"```sql\n(.*?)```", (ROOT / "docs" / "reading-a-run.md").read_text(), re.DOTALL)
    run(cli.nptrace, "render", "court", "--accel", "bvh", "--pixels", "24x24", "--name", "atrium", "--out", tmp_path)
    rows = duckdb.sql(query.replace("traces/atrium-bvh", str(tmp_path / "atrium-bvh"))).fetchall()
    levels, reads, nodes = zip(*rows, strict=True)
    n_rays = duckdb.sql(f"SELECT count(*) FROM '{tmp_path}/atrium-bvh/rays.parquet'").fetchall()[0][0]
    assert list(levels) == list(range(len(levels)))
    assert (reads[0], nodes[0]) == (n_rays, 1)


@pytest.mark.skipif("NPTRACE_SCENES" not in os.environ, reason="the table is of the real scenes; NPTRACE_SCENES is not set")
def test_the_table_of_the_readme_is_what_the_program_prints(tmp_path):
    run(cli.nptrace, "render", "bunny", "conference", "sibenik", "sponza", "--out", tmp_path)
    printed = list(csv.DictReader(run(cli.npcache, "table1", "--traces", tmp_path, "--format", "csv").splitlines()))
    recorded = list(csv.DictReader((ROOT / "docs" / "data" / "table1.csv").read_text().splitlines()))
    for row in printed + recorded:
        del row["path"]
    assert printed == recorded
    assert len(printed) == 32


def test_the_frontier_of_speed_against_error():
    from tests.bench.speed_error import frontier

    points = {
        ("a", ""): (1.0, 0.0),
        ("b", ""): (2.0, 3.0),
        ("c", ""): (4.0, 2.0),
        ("d", ""): (3.0, 2.5),
        ("e", ""): (9.0, 50.0),
    }
    assert frontier(points) == [("a", ""), ("c", ""), ("e", "")]
