"""Runs of several parts: the rows of a run of one, for any cut and any workers; killed workers, and a render that goes on."""

import os
import signal
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pyarrow.parquet as pq
import pytest

import rtrace.part_render as part_render
import rtrace.render as rendering
from nptrace_base.engines import Engine, WorkersLostError, engine_of, processes
from nptrace_base.places import publish
from rtrace.part_render import render_parts, trace_part
from rtrace.ray_file import read_rays
from rtrace.render import Shooting, render
from rtrace.scenes.scene import scene_from_triangles
from rtrace.scenes.shapes import boxes, icosphere
from rtrace.shared_arrays import mapped
from rtrace.trees.tree_cache import build_tree
from traces.format import RunError
from traces.manifest import MANIFEST
from traces.reader import find_runs, open_run

KINDS = ("kdtree", "bvh", "bvh64")
#: Small pieces, so that a small picture has several parts.
SHOOTINGS = [Shooting(50, 41), Shooting(40, 50, "hilbert", 64), Shooting(50, 40, "random", 0, 5)]


@pytest.fixture(scope="module")
def scene():
    return scene_from_triangles(np.concatenate([boxes(), icosphere(3) + np.float32([0, 3, 0])]), "things")


@pytest.fixture(scope="module")
def trees(scene):
    return {kind: build_tree(scene.triangles, kind) for kind in KINDS}


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch):
    monkeypatch.setattr(rendering, "CHUNK", 256)


def rows(run):
    """Every column of every table, and the picture."""
    found = {
        f"{table}.{name}": values for table in ("rays", "nodes", "accesses") for name, values in run.columns(table).items()
    }
    return found | {"image": np.frombuffer(run.image(), np.uint8)}


def assert_same(run, other):
    found, wanted = rows(run), rows(other)
    assert found.keys() == wanted.keys()
    for name, values in found.items():
        assert values.dtype == wanted[name].dtype, name
        np.testing.assert_array_equal(values, wanted[name], err_msg=name)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("shooting", "n_parts"), [*zip(SHOOTINGS, [(9, 3, 1), (8, 3, 1), (16, 6, 1)], strict=True)])
def test_rows_do_not_depend_on_the_cut(tmp_path, scene, trees, kind, shooting, n_parts):
    whole = render(scene, trees[kind], shooting, tmp_path / "whole", threads=1)
    for part, n in zip((1, 700, 1 << 16), n_parts, strict=True):
        path = tmp_path / f"{part}"
        summary = render_parts(scene, trees[kind], shooting, path, threads=2, part=part)
        run = open_run(path)
        assert len(run._parts) == n
        assert_same(run, open_run(tmp_path / "whole"))
        assert summary._replace(identity=None, n_bytes=0) == whole._replace(identity=None, n_bytes=0)
        assert summary.n_bytes == run.n_bytes == sum(file.stat().st_size for file in path.iterdir())
        assert run.footer == open_run(tmp_path / "whole").footer


def test_files_do_not_depend_on_workers(tmp_path, scene, trees):
    render_parts(scene, trees["bvh"], SHOOTINGS[0], tmp_path / "one", part=700)
    with ThreadPoolExecutor(3) as pool, engine_of(pool) as engine:
        render_parts(scene, trees["bvh"], SHOOTINGS[0], tmp_path / "pool", part=700, engine=engine)
    files = {file.name: file.read_bytes() for file in (tmp_path / "one").iterdir()}
    assert files == {file.name: file.read_bytes() for file in (tmp_path / "pool").iterdir()}
    assert len(files) == 3 + 2 * 3


@pytest.mark.parametrize("kind", KINDS)
def test_rows_do_not_depend_on_workers(tmp_path, scene, trees, kind):
    render(scene, trees[kind], SHOOTINGS[1], tmp_path / "whole", threads=1)
    for n, part in ((1, 1), (2, 700), (3, 300), (4, 1)):
        with ThreadPoolExecutor(n) as pool, engine_of(pool) as engine:
            render_parts(scene, trees[kind], SHOOTINGS[1], tmp_path / f"{n}", part=part, engine=engine)
        assert_same(open_run(tmp_path / f"{n}"), open_run(tmp_path / "whole"))


@pytest.fixture
def ray_file(tmp_path):
    rng = np.random.default_rng(1)
    n = 20_000
    table = {
        "origin": list(rng.normal(size=(n, 3)) * 9),
        "direction": list(rng.normal(size=(n, 3))),
        "any_hit": rng.random(n) < 0.5,
    }
    import pyarrow as pa

    pq.write_table(pa.table(table), tmp_path / "rays.parquet")
    return read_rays(tmp_path / "rays.parquet")


def test_rays_of_a_file_are_cut_too(tmp_path, scene, trees, ray_file):
    render(scene, trees["kdtree"], ray_file, tmp_path / "whole")
    with ThreadPoolExecutor(2) as pool, engine_of(pool) as engine:
        render_parts(scene, trees["kdtree"], ray_file, tmp_path / "parts", part=1, engine=engine)
    assert len(open_run(tmp_path / "parts")._parts) == 3
    assert_same(open_run(tmp_path / "parts"), open_run(tmp_path / "whole"))


def killing(job, number, stretch):
    """Trace a part; the first worker that comes to part 1 is killed before its record is written."""
    if number == 1 and not (job.place / "killed").exists():
        (job.place / "killed").mkdir(parents=True)
        os.kill(os.getpid(), signal.SIGKILL)
    return trace_part(job, number, stretch)


def always_killing(job, number, stretch):
    if number == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return trace_part(job, number, stretch)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "n"), [("kdtree", 3)])
def test_a_killed_worker_costs_no_row(tmp_path, scene, trees, monkeypatch, kind, n):
    """The workers are processes, which map the tree."""
    render(scene, trees[kind], SHOOTINGS[0], tmp_path / "whole")
    monkeypatch.setattr(part_render, "trace_part", killing)
    render_parts(scene, trees[kind], SHOOTINGS[0], tmp_path / "parts", part=700, engine=processes(n))
    assert (tmp_path / "parts" / "killed").is_dir()
    assert_same(open_run(tmp_path / "parts"), open_run(tmp_path / "whole"))


@pytest.mark.slow
def test_workers_that_are_killed_again_and_again_are_one_sentence_and_a_resume(tmp_path, scene, trees, monkeypatch):
    path = tmp_path / "parts"
    with monkeypatch.context() as patch:
        patch.setattr(part_render, "trace_part", always_killing)
        with pytest.raises(WorkersLostError, match=r"a worker process was lost \(BrokenProcessPool\) with 1 of 2 tasks left;"):
            render_parts(scene, trees["bvh"], SHOOTINGS[0], path, part=1100, engine=processes(2))
    assert find_runs(tmp_path) == []
    with pytest.raises(RunError, match="is not a complete run"):
        open_run(path)
    assert went_on(monkeypatch, scene, trees["bvh"], path, part=1100) == [1]
    render(scene, trees["bvh"], SHOOTINGS[0], tmp_path / "whole")
    assert_same(open_run(path), open_run(tmp_path / "whole"))
    assert len(list(path.iterdir())) == 3 + 2 * 2


def went_on(monkeypatch, scene, tree, path, part=700):
    """Render again, and return the parts that were traced again."""
    traced, real = [], trace_part

    def seen(job, number, *args):
        traced.append(number)
        return real(job, number, *args)

    with monkeypatch.context() as patch:
        patch.setattr(part_render, "trace_part", seen)
        render_parts(scene, tree, SHOOTINGS[0], path, part=part)
    return traced


class Stop(Exception):
    pass


@pytest.fixture
def stopped(tmp_path, scene, trees, monkeypatch):
    """A render that was stopped after two of three parts."""

    def stop(job, number, *args):
        if number == 2:
            raise Stop
        return trace_part(job, number, *args)

    with monkeypatch.context() as patch:
        patch.setattr(part_render, "trace_part", stop)
        with pytest.raises(Stop):
            render_parts(scene, trees["bvh"], SHOOTINGS[0], tmp_path / "parts", part=700)
    assert not (tmp_path / "parts" / MANIFEST).exists()
    return tmp_path / "parts"


def test_a_render_goes_on_from_finished_parts(stopped, scene, trees, monkeypatch):
    assert went_on(monkeypatch, scene, trees["bvh"], stopped) == [2]
    render(scene, trees["bvh"], SHOOTINGS[0], stopped.with_name("whole"))
    assert_same(open_run(stopped), open_run(stopped.with_name("whole")))


@pytest.mark.parametrize("damage", ["deleted", "cut", "no record", "half a record", "other colours"])
def test_a_part_that_is_not_whole_is_traced_again(stopped, scene, trees, monkeypatch, damage):
    kinds = {"deleted": "accesses-*", "cut": "accesses-*", "other colours": "colours-*"}
    files = sorted(stopped.glob(kinds.get(damage, "part-*")))
    if damage in ("deleted", "no record"):
        files[0].unlink()
    elif damage == "other colours":
        content = bytearray(files[0].read_bytes())
        content[len(content) // 2] ^= 1
        files[0].write_bytes(content)
    else:
        files[0].write_bytes(files[0].read_bytes()[:-7])
    assert len(went_on(monkeypatch, scene, trees["bvh"], stopped)) == 2
    render(scene, trees["bvh"], SHOOTINGS[0], stopped.with_name("whole"))
    assert_same(open_run(stopped), open_run(stopped.with_name("whole")))


def test_parts_of_another_run_are_not_taken(stopped, scene, trees, monkeypatch):
    assert went_on(monkeypatch, scene, trees["bvh64"], stopped) == [0, 1, 2]
    assert open_run(stopped).footer.tree.kind == "bvh64"


def test_what_killed_renders_of_other_runs_left_is_deleted_with_the_next_manifest(stopped, scene, trees):
    """It would stay for good: nobody asks for their records again. What is newer may be of a render that still runs."""
    for name in (".rays-1.99-ab.tmp.parquet", "accesses-0.parquet.0123abcd.upload"):
        (stopped / name).write_bytes(b"")
    left = {file.name for file in stopped.iterdir()}
    for name in left:
        os.utime(stopped / name, (1000, 1000))
    new = f"colours-{'0' * 32}.raw"
    publish(stopped / new, b"")
    os.utime(stopped / new, (1e11, 1e11))
    render_parts(scene, trees["bvh64"], SHOOTINGS[0], stopped, part=700)
    names = {file.name for file in stopped.iterdir()}
    assert not names & left and new in names
    assert len(names) == 1 + 3 + 2 * 3
    render(scene, trees["bvh64"], SHOOTINGS[0], stopped.with_name("whole"))
    assert_same(open_run(stopped), open_run(stopped.with_name("whole")))


def test_either_form_replaces_the_other(tmp_path, scene, trees):
    path = tmp_path / "run"
    for write in (render, render_parts, render_parts, render):
        for kind in ("bvh", "kdtree"):
            write(scene, trees[kind], SHOOTINGS[0], path)
            assert open_run(path).footer.tree.kind == kind
            assert sorted(tmp_path.iterdir()) == [path]
            assert len(list(path.iterdir())) == (4 if write is render else 5)


def test_a_folder_that_is_no_run_is_kept(tmp_path, scene, trees):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(RunError, match="exists and is not a run"):
        render_parts(scene, trees["bvh"], SHOOTINGS[0], tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(RunError, match="exists and is not a run"):
        render_parts(scene, trees["bvh"], SHOOTINGS[0], tmp_path / "file")
    with pytest.raises(RunError, match="cannot write"):
        render_parts(scene, trees["bvh"], SHOOTINGS[0], tmp_path / "file" / "run")
    assert sorted(file.name for file in tmp_path.iterdir()) == ["file", "mine.txt"]


def test_a_part_that_vanishes_before_the_manifest_is_named(stopped, scene, trees, monkeypatch):
    """Another render into the same place may delete it."""
    real = part_render._picture

    def deleting(*args):
        next(stopped.glob("accesses-*")).unlink()
        return real(*args)

    monkeypatch.setattr(part_render, "_picture", deleting)
    with pytest.raises(RunError, match=r"accesses-[0-9a-f]+\.parquet is missing, and the run is made of it"):
        render_parts(scene, trees["bvh"], SHOOTINGS[0], stopped, part=700)
    assert not (stopped / MANIFEST).exists()


@pytest.mark.parametrize("when", ["before its last part", "before the manifest"])
@pytest.mark.parametrize("kind", ["kdtree", "bvh64"])
def test_of_two_equal_renders_the_second_takes_the_run_of_the_first(tmp_path, scene, trees, monkeypatch, kind, when):
    """The first deletes what the second's workers would map, and the colours of its parts."""
    path, done, real = tmp_path / "run", [], trace_part

    def first():
        with monkeypatch.context() as patch:
            patch.setattr(part_render, "trace_part", real)
            done.append(render_parts(scene, trees[kind], SHOOTINGS[0], path, part=700))

    class Second(Engine):
        def __init__(self):
            pass

        def results(self, function, tasks):
            yield 0, real(*tasks[0])
            if when == "before its last part":
                mapped.cache_clear()
                first()
            yield from ((i, real(*tasks[i])) for i in (1, 2))

    on_write = first if when == "before the manifest" else lambda: None
    summary = render_parts(scene, trees[kind], SHOOTINGS[0], path, part=700, engine=Second(), on_write=on_write)
    assert [summary] == done
    render(scene, trees[kind], SHOOTINGS[0], tmp_path / "whole")
    assert_same(open_run(path), open_run(tmp_path / "whole"))
    assert len(list(path.iterdir())) == 3 + 2 * 3


def test_the_run_of_another_render_is_no_excuse(stopped, scene, trees, monkeypatch):
    """Neither for trouble with this one, nor if it is another run."""

    def full(*args):
        raise OSError(28, "No space left on device")

    def other(*args):
        for file in stopped.glob("colours-*"):
            file.unlink()
        raise FileNotFoundError(2, "No such file")

    render_parts(scene, trees["bvh"], SHOOTINGS[0], stopped, part=700)
    monkeypatch.setattr(part_render, "_picture", full)
    with pytest.raises(RunError, match="No space left on device"):
        render_parts(scene, trees["bvh"], SHOOTINGS[0], stopped, part=700)
    monkeypatch.setattr(part_render, "_picture", other)
    with pytest.raises(RunError, match="No such file"):
        render_parts(scene, trees["bvh64"], SHOOTINGS[0], stopped, part=700)


def test_a_worker_refuses_a_tree_that_was_changed(tmp_path, scene, trees):
    class Changing(Engine):
        def __init__(self):
            pass

        def results(self, function, tasks):
            [file] = tmp_path.glob("run/job-*")
            content = bytearray(file.read_bytes())
            content[-100] ^= 1
            file.write_bytes(content)
            yield 0, function(*tasks[0])

    with pytest.raises(RunError, match="has been changed since it was written"):
        render_parts(scene, trees["bvh"], SHOOTINGS[0], tmp_path / "run", engine=Changing())


def test_a_worker_that_does_not_see_the_folder_says_so(tmp_path, scene, trees):
    class Elsewhere(Engine):
        def __init__(self):
            pass

        def results(self, function, tasks):
            for file in tmp_path.glob("run/job-*"):
                file.unlink()
            yield 0, function(*tasks[0])

    with pytest.raises(RunError, match=r"cannot map .*; give an --out that all workers see"):
        render_parts(scene, trees["kdtree"], SHOOTINGS[0], tmp_path / "run", engine=Elsewhere())


def test_a_worker_of_another_version_traces_nothing(tmp_path, scene, trees, monkeypatch):
    class Older(Engine):
        def __init__(self):
            pass

        def results(self, function, tasks):
            with monkeypatch.context() as patch:
                patch.setattr(part_render, "_code", lambda: "older", raising=False)
                yield from ((i, function(*task)) for i, task in enumerate(tasks))

    with pytest.raises(RunError, match="a worker has other sources of nptrace than the command; install the same version"):
        render_parts(scene, trees["bvh"], SHOOTINGS[0], tmp_path / "run", engine=Older())
    assert not [*tmp_path.glob("run/accesses-*"), *tmp_path.glob("run/part-*")]


def test_arrays_are_mapped_as_they_were(tmp_path, scene, trees):
    from rtrace.shared_arrays import laid_out
    from traces.manifest import file_facts

    for tree in trees.values():
        content = laid_out(*part_render._arrays(tree, None))
        file = file_facts("job", content)
        publish(tmp_path / file.name, *content)
        arrays, facts = mapped(tmp_path / file.name, file)
        assert facts["params"] == tree.params
        for name, values in part_render._arrays(tree, None)[0].items():
            np.testing.assert_array_equal(arrays[name], values)
            assert arrays[name].flags.writeable and arrays[name].flags.aligned and type(arrays[name]) is np.ndarray
            arrays[name].reshape(-1)[:1] = 0
        assert (tmp_path / file.name).read_bytes() == b"".join(bytes(piece) for piece in content)
