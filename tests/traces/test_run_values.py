"""Impossible values in a run: one sentence that names file, column, row and rule, from every reader of runs."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

import cli
from cachesim.config import CacheConfig
from cachesim.layout import addresses
from cachesim.replay import replay
from tests.reference.traces import make_trace, write
from traces.format import METADATA_KEY, RunError
from traces.reader import open_run

CONFIG = CacheConfig(256, 2, 32)


@pytest.fixture
def run(tmp_path):
    return write(make_trace("kdtree", 3, n_rays=30, max_level=6), tmp_path / "bunny-kdtree").path


def rewrite(run, table, change):
    """Put a changed table in the place of one of a run's, its footer kept."""
    file = run / f"{table}.parquet"
    with pq.ParquetFile(file) as opened:
        footer, columns = {METADATA_KEY: opened.metadata.metadata[METADATA_KEY]}, opened.read()
    pq.write_table(change(columns).replace_schema_metadata(footer), file)


def with_value(column, row, value, type_=None):
    """Return a change of one value; ``row`` is a number, or a function that finds it in the column's values."""

    def change(table):
        values = table.column(column).to_pylist()
        at = row if isinstance(row, int) else next(i for i, v in enumerate(values) if row(v))
        values[at] = value
        field = pa.field(column, type_ or table.schema.field(column).type)
        return table.set_column(table.column_names.index(column), field, pa.array(values, field.type))

    return change


COMMANDS = [
    (cli.npcache, ["replay", "--size", "8K"]),
    (cli.npcache, ["replay", "--prefetch", "none,stack:tris*2", "--layout", "stored,dfs"]),
    (cli.npcache, ["sweep", "--ways", "1,2", "--threads", "1"]),
    (cli.nptrace, ["export", "-o", "x.din"]),
]


@pytest.mark.parametrize(
    ("table", "change", "said"),
    [
        ("accesses", with_value("kind", 700, None), "column 'kind', row 700: null breaks the rule that every value is"),
        ("accesses", with_value("kind", 700, 7), "column 'kind', row 700: 7 breaks the rule that a kind is 0 (read)"),
        ("accesses", with_value("node", -1, None), "column 'node', row 1061: null breaks"),
        ("accesses", with_value("node", -1, 4_000_000_000), "column 'node', row 1061: 4000000000 breaks the rule that a node"),
        ("accesses", with_value("kind", 0, 2), "column 'kind', row 0: 2 breaks the rule that a node with children, as"),
        ("accesses", with_value("kind", lambda v: v == 2, 0), "0 breaks the rule that a leaf, as node"),
        ("accesses", with_value("kind", lambda v: v == 2, 1), "1 breaks the rule that a leaf, as node"),
        ("accesses", with_value("node", 3, -1, pa.int64()), "column 'node', row 3: -1 breaks the rule that a value is a"),
        ("nodes", with_value("level", 3, 0), "column 'level', row 3: 0 breaks the rule that the root has level 0, any other"),
        ("nodes", with_value("level", 4, 9), "column 'level', row 4: 9 breaks"),
        ("nodes", with_value("level", 0, 1), "column 'level', row 0: 1 breaks"),
        ("nodes", with_value("parent", 0, 0), "column 'parent', row 0: 0 breaks the rule that row 0 is the root"),
        ("nodes", with_value("parent", 3, 3), "column 'parent', row 3: 3 breaks the rule that a node comes after its parent"),
        ("nodes", with_value("parent", 3, -1), "column 'parent', row 3: -1 breaks the rule that a node comes after"),
        ("nodes", with_value("parent", 4, 0), "column 'parent', row 4: 0 breaks the rule that the nodes 1 and 2"),
        ("nodes", with_value("axis", 0, 3), "column 'axis', row 0: 3 breaks the rule that a node with children has axis 0"),
        ("nodes", with_value("axis", lambda v: v == 3, 4), "4 breaks the rule that a node with children has axis 0"),
        ("nodes", with_value("n_prims", 0, 1), "column 'n_prims', row 0: 1 breaks the rule that only leaves have triangles"),
        ("nodes", with_value("node", 2, 3), "column 'node', row 2: 3 breaks the rule that a node's number is its row"),
        ("nodes", with_value("level", 2, None), "column 'level', row 2: null breaks"),
        ("nodes", lambda t: t.set_column(
            t.column_names.index("level"), "level", t.column("level").cast(pa.string())), "column 'level' is of type string"),
        ("nodes", lambda t: t.drop_columns(["axis"]), "has no columns 'axis', and a run has one"),
        ("accesses", lambda t: t.append_column("kind", t.column("kind")), "has 2 columns 'kind', and a run has one"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_by_all_that_read_runs(run, table, change, said, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    rewrite(run, table, change)
    for command, (name, *options) in COMMANDS:
        result = CliRunner().invoke(command, [name, str(run), *options])
        assert result.exit_code == 2, (name, result.output)
        assert f"{table}.parquet" in result.stderr and said in result.stderr
        assert result.stderr.startswith("Error: ") and result.stderr.count("\n") == 1
    assert not (tmp_path / "x.din").exists()


def test_two_pairs_of_one_parent(run):
    def change(table):
        parents = np.array(table.column("parent").to_pylist())
        levels = np.array(table.column("level").to_pylist())
        pair = next(i for i in range(3, len(parents), 2) if levels[i] == 2 and parents[i] == 2)
        parents[pair : pair + 2] = 1
        return table.set_column(table.column_names.index("parent"), "parent", pa.array(parents, pa.int32()))

    rewrite(run, "nodes", change)
    with pytest.raises(RunError, match="1 breaks the rule that a node has one pair of children"):
        replay(run, [CONFIG], threads=1)


@pytest.mark.parametrize(
    ("column", "row", "value", "said"),
    [
        ("ray", 2, 3, "3 breaks the rule that a ray's number is its row"),
        ("x", 1, 1, "column 'x', row 1: 1 breaks the rule that it is below 1, the footer's value"),
        ("y", 1, 30, "column 'y', row 1: 30 breaks the rule that it is below 30"),
        ("type", 4, 2, "2 breaks the rule that a type is 0 (primary) or 1 (shadow)"),
        ("first", 4, 0, "column 'first', row 4: 0 breaks the rule that a ray's accesses begin where those of the ray before"),
        ("count", 29, 1, "column 'count', row 29: 1 breaks the rule that all counts together are the 1062 accesses"),
        ("prim", 0, -2, "-2 breaks the rule that a triangle has a number"),
        ("t", 5, float("nan"), "column 't', row 5: nan breaks the rule that a hit has a distance"),
        ("t", 5, None, "column 't', row 5: null breaks"),
    ],
)
def test_rays_that_cannot_be(run, column, row, value, said):
    rewrite(run, "rays", with_value(column, row, value))
    with pytest.raises(RunError) as error:
        open_run(run).columns("rays", ["t"])
    assert said in str(error.value)


def test_the_rays_of_accesses_are_those_that_rays_count(run):
    rewrite(run, "accesses", with_value("ray", 40, 1))
    assert replay(run, [CONFIG], threads=1)  # the column is not read
    with pytest.raises(RunError, match="column 'ray', row 40: 1 breaks the rule that rays.parquet counts this row among"):
        open_run(run).columns("accesses")


def test_an_address_is_checked_where_it_is_read(run):
    rewrite(run, "nodes", with_value("address", 3, 16))
    assert replay(run, [CONFIG], threads=1)
    with pytest.raises(
        RunError, match="column 'address', row 3: 16 breaks the rule that an address is node number x node size"
    ):
        open_run(run).columns("nodes")


def test_a_wrong_row_is_numbered_from_the_start_of_the_file(run):
    rewrite(run, "accesses", with_value("kind", 300, 9))
    file = run / "accesses.parquet"
    with pq.ParquetFile(file) as opened:
        table, footer = opened.read(), opened.metadata.metadata[METADATA_KEY]
    pq.write_table(table.replace_schema_metadata({METADATA_KEY: footer}), file, row_group_size=64)
    with pytest.raises(RunError, match="column 'kind', row 300: 9"):
        replay(run, [CONFIG], threads=1)


def test_a_walk_that_is_none_names_its_row(run):
    rows = open_run(run).columns("accesses")
    leaf = int(np.flatnonzero((rows["kind"] == 2) & (np.roll(rows["node"], -1) > 0) & (np.roll(rows["kind"], -1) == 0))[0])
    other = next(n for n in range(len(open_run(run).columns("nodes")["axis"]))
                 if n > 0 and open_run(run).columns("nodes")["axis"][n] < 3 and n not in rows["node"][:leaf])  # fmt: skip
    rewrite(run, "accesses", with_value("node", leaf + 1, other))
    with pytest.raises(ValueError, match=rf"accesses.parquet, column 'node', row {leaf + 1}: {other} does not follow"):
        replay(run, [CONFIG], prefetch="stack", threads=1)


@pytest.mark.parametrize("type_", [pa.int64(), pa.float64(), pa.dictionary(pa.int32(), pa.int64()), pa.uint16()])
def test_other_types_of_the_same_numbers_and_other_orders_of_columns_read_the_same(run, type_):
    wanted = [r.to_dict() for p in ("traced", "stack:budget=2") for r in replay(run, [CONFIG], prefetch=p, layout="veb")]

    def cast(table):
        inner = type_.value_type if pa.types.is_dictionary(type_) else type_
        for i, name in enumerate(table.column_names):
            if name not in ("parent", "split", "prim", "t"):
                column = table.column(i).cast(inner)
                table = table.set_column(i, name, column.dictionary_encode() if inner is not type_ else column)
        return table.select(table.column_names[::-1]).append_column("note", pa.array(["x"] * len(table)))

    for table in ("accesses", "rays", "nodes"):
        rewrite(run, table, cast)
    assert wanted == [
        r.to_dict() for p in ("traced", "stack:budget=2") for r in replay(run, [CONFIG], prefetch=p, layout="veb")
    ]
    assert set(open_run(run).columns("rays")) == {"ray", "x", "y", "type", "first", "count", "prim", "t"}


def test_layouts_take_only_trees():
    nodes = {"parent": np.array([-1, 0, 0, 0, 0]), "level": np.array([0, 1, 1, 1, 1])}
    for layout in ("dfs", "veb", "treelet:64"):
        with pytest.raises(ValueError, match="each of one parent"):
            addresses(nodes, 32, layout)
