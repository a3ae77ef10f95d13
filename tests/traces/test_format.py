"""The run on disk: what is written is read, complete or not at all, and every kind of damage is reported."""

import json
import os
import subprocess
import sys

import numpy as np
import pyarrow.parquet as pq
import pytest

from tests.reference.traces import make_footer
from traces import format as fmt
from traces import writer
from traces.format import SPLIT, RunError
from traces.reader import find_runs, open_run
from traces.writer import RunWriter


def tables(n_accesses=5):
    rng = np.random.default_rng(3)
    rays = {
        "ray": np.arange(2, dtype=np.uint32),
        "x": np.zeros(2, np.uint16),
        "y": np.zeros(2, np.uint16),
        "type": np.array([0, 1], np.uint8),
        "first": np.array([0, 2], np.uint64),
        "count": np.array([2, n_accesses - 2], np.uint32),
        "prim": np.array([7, -1], np.int32),
        "t": np.array([1.5, np.inf], np.float32),
    }
    visited = rng.integers(0, 3, n_accesses)
    kinds = np.where(visited > 0, rng.choice([2, 3], n_accesses), rng.choice([0, 1, 3], n_accesses))
    accesses = {
        "ray": np.repeat(np.arange(2, dtype=np.uint32), rays["count"]),
        "node": visited.astype(np.uint32),
        "kind": kinds.astype(np.uint8),
    }
    nodes = {
        "node": np.arange(3, dtype=np.uint32),
        "parent": np.array([-1, 0, 0], np.int32),
        "level": np.array([0, 1, 1], np.uint16),
        "axis": np.array([0, 3, 3], np.uint8),
        "n_prims": np.array([0, 2, 0], np.uint32),
        "address": np.array([0, 8, 16], np.uint64),
        "split": np.array([0.5, np.nan, np.nan], np.float32),
    }
    return {"rays": rays, "accesses": accesses, "nodes": nodes}


def write(path, n_accesses=5, pieces=1, **entries):
    data = tables(n_accesses)
    with RunWriter(path, make_footer(**entries), SPLIT) as run:
        run.append("rays", data["rays"])
        run.append("nodes", data["nodes"])
        for piece in np.array_split(np.arange(n_accesses), pieces):
            run.append("accesses", {name: column[piece] for name, column in data["accesses"].items()})
        run.image(b"png")
    return data


def read_all(run, names=("ray", "node", "kind")):
    batches = list(run.batches(names))
    return {name: np.concatenate([b[i] for b in batches]) for i, name in enumerate(names)}


def test_what_is_written_is_read(tmp_path):
    data = write(tmp_path / "a", seed=4)
    run = open_run(tmp_path / "a")
    assert run.footer.seed == 4
    assert run.n_accesses == 5 and run.name == "a"
    for table in ("rays", "nodes"):
        for name, column in run.columns(table).items():
            np.testing.assert_array_equal(column, data[table][name])
            assert column.dtype == data[table][name].dtype
    for name, column in read_all(run).items():
        np.testing.assert_array_equal(column, data["accesses"][name])
        assert column.dtype == data["accesses"][name].dtype


def test_row_groups_and_bytes_do_not_depend_on_the_pieces(tmp_path, monkeypatch):
    monkeypatch.setattr(writer, "ROW_GROUP", 64)
    write(tmp_path / "one", 1000, pieces=1)
    write(tmp_path / "many", 1000, pieces=37)
    for name in fmt.FILES:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "many" / name).read_bytes()
    groups = [len(nodes) for nodes, _ in open_run(tmp_path / "one").batches()]
    assert groups == [64] * 15 + [40]


def test_an_empty_trace_is_a_run(tmp_path):
    data = tables(2)
    with RunWriter(tmp_path / "empty", make_footer(), SPLIT) as run:
        run.append("nodes", data["nodes"])
        run.image(b"")
    assert open_run(tmp_path / "empty").n_accesses == 0
    assert list(open_run(tmp_path / "empty").batches()) == []


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_a_failure_leaves_nothing_and_keeps_the_earlier_run(tmp_path, error):
    write(tmp_path / "run", seed=1)
    with pytest.raises(error), RunWriter(tmp_path / "run", make_footer(seed=2), SPLIT) as run:
        run.append("nodes", tables()["nodes"])
        raise error("stop")
    assert os.listdir(tmp_path) == ["run"]
    assert open_run(tmp_path / "run").footer.seed == 1


def test_a_full_disk_gives_a_message_and_leaves_nothing(tmp_path, monkeypatch):
    def full(self, *args, **kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pq.ParquetWriter, "write_table", full)
    with pytest.raises(RunError, match="No space left on device; nothing was kept"):
        write(tmp_path / "run")
    assert os.listdir(tmp_path) == []


def test_a_file_that_cannot_be_opened_gives_a_message_and_leaves_nothing(tmp_path, monkeypatch):
    real, n = writer.pa.OSFile, []

    def open_file(*args):
        n.append(1)
        if len(n) == 2:
            raise OSError(24, "Too many open files")
        return real(*args)

    monkeypatch.setattr(writer.pa, "OSFile", open_file)
    with pytest.raises(RunError, match="Too many open files; nothing was kept"):
        write(tmp_path / "run")
    assert os.listdir(tmp_path) == []


def test_a_run_replaces_a_run_but_nothing_else(tmp_path):
    write(tmp_path / "run", seed=1)
    write(tmp_path / "run", seed=2)
    assert open_run(tmp_path / "run").footer.seed == 2
    assert os.listdir(tmp_path) == ["run"]
    other = tmp_path / "letters"
    other.mkdir()
    (other / "love.txt").write_text("dear")
    with pytest.raises(RunError, match="is not a run"):
        write(other)
    assert (other / "love.txt").read_text() == "dear"


@pytest.mark.parametrize("can_exchange", [True, False])
def test_runs_are_replaced_with_and_without_an_exchange_in_one_step(tmp_path, monkeypatch, can_exchange):
    exchanged = []

    def exchange(a, b):
        exchanged.append(can_exchange and real(a, b))
        return exchanged[-1]

    real = writer._exchange
    monkeypatch.setattr(writer, "_exchange", exchange)
    for seed in (1, 2, 3):
        write(tmp_path / "run", seed=seed)
        assert open_run(tmp_path / "run").footer.seed == seed
    assert os.listdir(tmp_path) == ["run"]
    assert exchanged == [can_exchange] * 2


def test_what_a_killed_writer_left_is_swept(tmp_path):
    code = (
        "import os, signal; from pathlib import Path\n"
        "from traces.format import SPLIT; from traces.writer import RunWriter\n"
        "from tests.reference.traces import make_footer\n"
        f"with RunWriter(Path({str(tmp_path / 'run')!r}), make_footer(), SPLIT): os.kill(os.getpid(), signal.SIGKILL)"
    )
    subprocess.run([sys.executable, "-c", code], check=False)
    left = os.listdir(tmp_path)
    assert len(left) == 1 and left[0].startswith(".run.") and find_runs(tmp_path) == []
    write(tmp_path / "run")
    assert os.listdir(tmp_path) == ["run"]


def test_a_run_set_aside_by_a_killed_writer_comes_back(tmp_path):
    write(tmp_path / "run", seed=1)
    code = "from nptrace_base.atomic import new_mark; print(new_mark())"
    gone = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()
    (tmp_path / "run").rename(tmp_path / f".run.{gone}.old")
    with pytest.raises(ValueError, match="stop"), RunWriter(tmp_path / "run", make_footer(), SPLIT):
        raise ValueError("stop")
    assert open_run(tmp_path / "run").footer.seed == 1


def rewrite_footer(path, change):
    table = pq.read_table(path)
    metadata = json.loads(pq.ParquetFile(path).metadata.metadata[b"nptrace"])
    change(metadata)
    pq.write_table(table.replace_schema_metadata({b"nptrace": json.dumps(metadata).encode()}), path)


@pytest.mark.parametrize("name", ["accesses", "rays", "nodes"])
def test_other_versions_mixed_runs_and_wrong_counts_are_refused(tmp_path, name):
    write(tmp_path / "run")
    file = tmp_path / "run" / f"{name}.parquet"
    whole = file.read_bytes()
    rewrite_footer(file, lambda metadata: metadata.update(seed=99))
    with pytest.raises(RunError, match="mixes the files of different runs"):
        open_run(tmp_path / "run")
    file.write_bytes(whole)
    for each in ("accesses", "rays", "nodes"):
        rewrite_footer(tmp_path / "run" / f"{each}.parquet", lambda m: m.update({f"n_{name}": 77}))
    with pytest.raises(RunError, match="its footer says 77"):
        open_run(tmp_path / "run")
    for each in ("accesses", "rays", "nodes"):
        rewrite_footer(tmp_path / "run" / f"{each}.parquet", lambda m: m.update(format_version=9))
    with pytest.raises(RunError, match="format version 9, and this program reads 1"):
        open_run(tmp_path / "run")


def test_foreign_parquet_is_refused(tmp_path):
    write(tmp_path / "run")
    for name in ("accesses", "rays", "nodes"):
        file = tmp_path / "run" / f"{name}.parquet"
        pq.write_table(pq.read_table(file).replace_schema_metadata(None), file)
    with pytest.raises(RunError, match="not written by nptrace"):
        open_run(tmp_path / "run")


@pytest.mark.parametrize("name", fmt.FILES)
def test_a_missing_file_is_named(tmp_path, name):
    write(tmp_path / "run")
    (tmp_path / "run" / name).unlink()
    with pytest.raises(RunError, match=f"{name} missing"):
        open_run(tmp_path / "run")
    with pytest.raises(RunError, match="not a run directory"):
        open_run(tmp_path / "nowhere")


@pytest.mark.parametrize("name", ["accesses", "rays", "nodes"])
def test_cut_and_flipped_files_are_refused(tmp_path, name):
    """Cut anywhere, or with any one bit flipped, a file is refused, or reads as it was (the flip hit nothing that counts)."""
    data = write(tmp_path / "run", 4000)
    file = tmp_path / "run" / f"{name}.parquet"
    whole = file.read_bytes()
    rng = np.random.default_rng(1)
    for keep in rng.integers(0, len(whole), 20):
        file.write_bytes(whole[:keep])
        with pytest.raises(RunError, match="damaged"):
            open_run(tmp_path / "run")
    refused = 0
    for bit in rng.integers(0, 8 * len(whole), 200):
        broken = bytearray(whole)
        broken[bit // 8] ^= 1 << bit % 8
        file.write_bytes(broken)
        try:
            run = open_run(tmp_path / "run")
            columns = read_all(run) if name == "accesses" else run.columns(name)
        except RunError:
            refused += 1
            continue
        for column, values in data[name].items():
            if column in columns:  # the name of a column beyond the contract's own (split) is not guarded
                np.testing.assert_array_equal(columns[column], values)
    assert refused > 50


@pytest.mark.parametrize("name", ["accesses", "rays", "nodes"])
def test_a_file_that_lost_its_first_bytes_is_refused(tmp_path, name):
    """Its footer is whole, but no page is where the footer says; the reader of Parquet may end without an error."""
    write(tmp_path / "run", 4000)
    file = tmp_path / "run" / f"{name}.parquet"
    whole = file.read_bytes()
    for cut in (1, 2, 3, 4, 9):
        file.write_bytes(whole[cut:])
        with pytest.raises(RunError, match="damaged"):
            run = open_run(tmp_path / "run")
            list(run.batches()) if name == "accesses" else run.columns(name)


def test_runs_are_found_by_name(tmp_path):
    for name in ("b", "a"):
        write(tmp_path / name)
    (tmp_path / "notes").mkdir()
    (tmp_path / ".a.1-2.tmp").mkdir()
    assert [p.name for p in find_runs(tmp_path)] == ["a", "b"]
    assert find_runs(tmp_path / "nowhere") == []


def test_the_digest_is_that_of_the_files_that_are_open(tmp_path):
    """Another run may have taken their place, whose digest must not stand beside counts of the first one."""
    write(tmp_path / "run")
    run = open_run(tmp_path / "run")
    digest = open_run(tmp_path / "run").digest
    file = tmp_path / "run" / "rays.parquet"
    table = pq.read_table(file).replace_schema_metadata(pq.read_metadata(file).metadata)
    file.unlink()
    pq.write_table(table, file, compression="none")
    other = open_run(tmp_path / "run")
    assert other.footer == run.footer and other.digest != digest
    assert run.digest == digest
    with pytest.raises(RunError, match="has changed while it was read; start again"):
        run.part(1, 2)
