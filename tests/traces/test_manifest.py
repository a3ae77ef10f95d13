"""A run of several parts is one run, or one sentence that names what is missing, changed or wrong."""

import json

import numpy as np
import pytest

from nptrace_base.places import publish
from tests.reference.traces import make_footer
from tests.traces.test_format import read_all, tables, write
from traces.format import SPLIT, RunError
from traces.manifest import MANIFEST, Manifest, PartFacts, file_facts, is_of_run
from traces.part_writer import PartWriter, encoded_table
from traces.reader import find_runs, holds_run, open_run
from traces.writer import looks_like_run, node_schema, refuse_other


def write_parts(folder, change=lambda rays, accesses: None):
    """Write the run of ``test_format.tables`` as a part for each ray; ``change`` spoils the second one."""
    data, parts = tables(), []

    def stored(what, content, rows=0):
        file = file_facts(what, [content], rows)
        publish(folder / file.name, content)
        return file

    for ray, rows in ((0, slice(0, 2)), (1, slice(2, 5))):
        rays = {name: values[ray : ray + 1].copy() for name, values in data["rays"].items()}
        accesses = {name: values[rows].copy() for name, values in data["accesses"].items()}
        rays["ray"][:] = rays["first"][:] = accesses["ray"][:] = 0
        if ray:
            change(rays, accesses)
        part = PartWriter()
        part.append(rays, accesses)
        files = part.encoded(lambda n_rays, n_accesses: make_footer(n_rays=n_rays, n_accesses=n_accesses, n_nodes=3))
        parts.append(PartFacts(*(stored(name, *files[name]) for name in ("rays", "accesses"))))
    nodes = stored("nodes", *encoded_table(node_schema(make_footer(), SPLIT), data["nodes"], make_footer(n_nodes=3)))
    image = stored("image", b"png")
    footer = make_footer(n_rays=2, n_accesses=5, n_nodes=3, image_sha256=image.sha256)
    publish(folder / MANIFEST, Manifest(footer, nodes, image, parts).to_json())
    return folder


@pytest.fixture(params=["local", "remote"])
def folder(request, tmp_path, bucket):
    """A run of two parts, and where its files lie on disk."""
    write_parts(tmp_path / "bucket" / "run")
    return (bucket / "run" if request.param == "remote" else tmp_path / "bucket" / "run"), tmp_path / "bucket" / "run"


def test_it_reads_as_the_run_of_four_files(folder, tmp_path):
    write(tmp_path / "whole")
    run, whole = open_run(folder[0]), open_run(tmp_path / "whole")
    for table in ("rays", "nodes", "accesses"):
        found, wanted = run.columns(table), whole.columns(table)
        assert found.keys() == wanted.keys()
        for name in found:
            np.testing.assert_array_equal(found[name], wanted[name], err_msg=name)
            assert found[name].dtype == wanted[name].dtype
    assert run.columns("rays", ["first", "t"]).keys() == {"first", "t"}
    assert [len(nodes) for nodes, _ in run.batches()] == [2, 3]
    assert not any(column.flags.writeable for batch in run.batches(("ray", "node", "kind")) for column in batch)
    assert (run.footer, run.image(), run.name) == (whole.footer, whole.image(), "run")
    assert run.n_bytes == sum(file.stat().st_size for file in folder[1].iterdir())
    assert holds_run(folder[0]) and looks_like_run(folder[0])
    assert find_runs(folder[0].parent) == [folder[0]]


#: What has to be read for a file to be missed.
READS = {
    "rays": lambda run: run.columns("rays", ["t"]), "accesses": read_all, "nodes": lambda run: run.columns("nodes"),
    "image": lambda run: run.image(),
}  # fmt: skip


@pytest.mark.parametrize("what", READS)
def test_a_file_that_is_deleted_or_cut_is_named_when_the_run_is_opened(folder, what):
    file = sorted(folder[1].glob(f"{what}-*"))[-1]
    content = file.read_bytes()
    file.write_bytes(content[:-1])
    with pytest.raises(RunError, match=f"{folder[0] / file.name} has {len(content) - 1} bytes, and the run was written with"):
        open_run(folder[0])
    file.unlink()
    with pytest.raises(RunError, match=f"{folder[0] / file.name} is missing, and the run is made of it; render it again"):
        open_run(folder[0])


@pytest.mark.parametrize("what", READS)
def test_a_file_that_changes_after_the_render_is_named_when_it_is_read(folder, what):
    for file in folder[1].glob(f"{what}-*"):
        content = bytearray(file.read_bytes())
        run = open_run(folder[0])
        content[1] ^= 1
        file.write_bytes(content)
        for each in (run, open_run(folder[0])):
            with pytest.raises(RunError, match=f"{folder[0] / file.name} has been changed since the run was written"):
                READS[what](each)
        file.unlink()
        with pytest.raises(RunError, match=f"{folder[0] / file.name} is missing"):
            READS[what](run)
        content[1] ^= 1
        file.write_bytes(content)
    READS[what](open_run(folder[0]))


def test_a_wrong_value_is_named_with_its_part_and_its_row_there(tmp_path):
    def wrong_node(rays, accesses):
        accesses["node"][2] = 3

    def wrong_first(rays, accesses):
        rays["first"][0] = 2

    def wrong_ray(rays, accesses):
        accesses["ray"][1] = 1

    path = write_parts(tmp_path / "node", wrong_node)
    with pytest.raises(RunError, match=r"node/accesses-[0-9a-f]{32}.parquet, column 'node', row 2: 3 breaks the rule"):
        read_all(open_run(path), ("node",))
    path = write_parts(tmp_path / "first", wrong_first)
    with pytest.raises(RunError, match=r"first/rays-[0-9a-f]{32}.parquet, column 'first', row 0: 2 breaks the rule"):
        open_run(path).columns("rays")
    path = write_parts(tmp_path / "ray", wrong_ray)
    with pytest.raises(RunError, match=r"ray/accesses-[0-9a-f]{32}.parquet, column 'ray', row 1: 1 breaks the rule"):
        read_all(open_run(path))


def changed(values, *keys, to):
    """Return a manifest with one entry set."""
    values = json.loads(json.dumps(values))
    at = values
    for key in keys[:-1]:
        at = at[key]
    at[keys[-1]] = to
    return json.dumps(values).encode()


def test_a_manifest_that_is_wrong_is_one_sentence(folder):
    text = (folder[1] / MANIFEST).read_bytes()
    values = json.loads(text)
    spoilt = [
        b"", text[: len(text) // 2], b"[]", b"{}", b"null", b"\xff",
        changed(values, "parts", to=[]), changed(values, "parts", to=None), changed(values, "nodes", "rows", to=4),
        changed(values, "nodes", "rows", to="3"), changed(values, "parts", 1, "first_ray", to=0),
        changed(values, "parts", 1, "first_access", to=3), changed(values, "parts", 1, "accesses", "rows", to=4),
        changed(values, "parts", 0, "rays", "rows", to=2), changed(values, "parts", 0, "rays", "sha256", to="0"),
        changed(values, "image", "file", to="../image.png"), changed(values, "image", "file", to="image.png"),
        changed(values, "run", "n_rays", to=3), changed(values, "run", "scene", to=None), changed(values, "run", to=7),
    ]  # fmt: skip
    for each in spoilt:
        (folder[1] / MANIFEST).write_bytes(each)
        with pytest.raises(RunError, match=f"^{folder[0] / MANIFEST} (is damaged|has )") as found:
            open_run(folder[0])
        assert "\n" not in str(found.value) and "render" in str(found.value)
    (folder[1] / MANIFEST).write_bytes(changed(values, "format_version", to=4))
    with pytest.raises(RunError, match="has format version 4, and this program reads 3"):
        open_run(folder[0])


def test_rows_that_a_file_lacks_are_missed(folder):
    """The sums of a manifest may be right, and its files not those that it tells of."""
    values = json.loads((folder[1] / MANIFEST).read_bytes())
    first, second = (part["accesses"] for part in values["parts"])
    first["rows"], second["rows"], values["parts"][1]["first_access"] = 3, 2, 3
    (folder[1] / MANIFEST).write_text(json.dumps(values))
    with pytest.raises(RunError, match="has 2 rows, and the run was written with 3"):
        read_all(open_run(folder[0]), ("node",))


def test_another_run_is_kept(folder):
    refuse_other(folder[0], make_footer())
    with pytest.raises(RunError, match=r"holds another run \(of another seed\)"):
        refuse_other(folder[0], make_footer(seed=9))
    (folder[1] / MANIFEST).write_bytes(b"{}")
    with pytest.raises(RunError, match="with --overwrite"):
        refuse_other(folder[0], make_footer())


def test_a_run_without_a_manifest_is_none(folder):
    (folder[1] / MANIFEST).unlink()
    assert find_runs(folder[0].parent) == []
    assert looks_like_run(folder[0])  # what is left of one may be written over
    with pytest.raises(RunError, match="is not a complete run"):
        open_run(folder[0])


def test_a_run_of_four_files_is_read_from_a_store(bucket, tmp_path):
    data = write(tmp_path / "bucket" / "run")
    run = open_run("s3://bucket/run")
    for name, column in read_all(run).items():
        np.testing.assert_array_equal(column, data["accesses"][name])
    assert (run.image(), run.identity.path, str(run.path)) == (b"png", "s3://bucket/run", "s3://bucket/run")
    assert run.n_bytes == open_run(tmp_path / "bucket" / "run").n_bytes
    assert find_runs("s3://bucket") == [bucket / "run"]
    (tmp_path / "bucket" / "run" / "rays.parquet").unlink()
    with pytest.raises(RunError, match="rays.parquet missing"):
        open_run("s3://bucket/run")
    with pytest.raises(RunError, match="s3://bucket/other is not a run"):
        open_run("s3://bucket/other")


def test_names_of_runs_files():
    good = [MANIFEST, "image.png", f"rays-{'0a' * 16}.parquet", f"job-{'0' * 32}.raw", f"part-12-{'f' * 16}.json",
            ".rays-0.12-ab.tmp.parquet", f"rays-{'0a' * 16}.parquet.0a0b.upload"]  # fmt: skip
    assert all(map(is_of_run, good))
    assert not any(map(is_of_run, ["mine.txt", "rays-1.parquet", "x.json", "part-1.json", f"rays-{'0' * 32}.png.txt"]))


def test_a_folder_of_runs_may_have_a_picture_and_a_manifest_of_its_own(folder):
    for name in ("image.png", MANIFEST):
        publish(folder[0].parent / name, b"{}")
        assert not holds_run(folder[0].parent)
    assert find_runs(folder[0].parent) == [folder[0]]
    publish(folder[0] / MANIFEST, b"{")
    assert holds_run(folder[0])  # a damaged one
