"""A long run on several threads: a part for each, of one table of nodes that is checked once, joined in order."""

import threading

import pytest

from cachesim import parts
from cachesim.config import CacheConfig
from cachesim.replay import replay
from rtrace.render import Shooting, render
from rtrace.scenes.stand_ins import stand_in
from rtrace.trees.tree_cache import build_tree
from traces import run as runs
from traces.format import ROW_GROUP
from traces.reader import open_run

CACHES = [CacheConfig(8192, 2), CacheConfig(1024, 1)]


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    scene = stand_in("blob", detail=0.3)
    where = tmp_path_factory.mktemp("long") / "run"
    render(scene, build_tree(scene.triangles, "bvh"), Shooting(96, 96), where)
    return where


def test_every_thread_has_a_part(path, monkeypatch):
    run = open_run(path)
    expected = [result.to_dict() for result in replay(run, CACHES, threads=1)]
    assert run.n_accesses > ROW_GROUP
    made, checked, check = [], [], runs.check_nodes
    monkeypatch.setattr(parts, "LEAST_PART", 1 << 12)
    monkeypatch.setattr(runs, "check_nodes", lambda *args: checked.append(threading.get_ident()) or check(*args))
    whole = parts.pass_through
    monkeypatch.setattr(parts, "pass_through", lambda *args: made.append(args[0].run.rows) or whole(*args))
    assert [result.to_dict() for result in replay(open_run(path), CACHES, threads=2)] == expected
    assert len(made) == 2 and sum(map(len, made)) == run.n_accesses
    assert len(checked) == 1


@pytest.mark.parametrize("end", [0, 1, ROW_GROUP - 1, ROW_GROUP, ROW_GROUP + 1, ROW_GROUP + 1000])
def test_what_follows_the_rows_of_a_part_is_not_decoded(path, monkeypatch, end):
    run = open_run(path)
    nodes = run.columns("accesses")["node"]
    file = run._parts[0].open("accesses")
    decoded = []

    class Counting:
        metadata, num_row_groups = file.metadata, file.num_row_groups

        def iter_batches(self, *args, **kwargs):
            for batch in file.iter_batches(*args, **kwargs):
                decoded.append(batch.num_rows)
                yield batch

    start = max(end - 500, 0)
    found = [batch.column("node").to_pylist() for batch in runs._batches(Counting(), ["node"], path, range(start, end))]
    assert [node for batch in found for node in batch] == nodes[start:end].tolist()
    assert sum(decoded) == (end - start // ROW_GROUP * ROW_GROUP if end else 0)
