"""Rays of a file: traced as a picture's are, in their order, into a run that says where they are from."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

import cli
import rtrace.ray_file as ray_file
from nptrace_base.errors import NptraceError
from rtrace.ray_file import read_rays
from rtrace.rays import make_rays
from rtrace.scenes.shapes import icosphere
from rtrace.traverse import trace_all
from tests.nptrace.test_nptrace import write_obj
from traces.reader import open_run


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_obj(tmp_path / "ball.obj", icosphere(2))
    return tmp_path


def render(*args, code=0):
    result = CliRunner().invoke(cli.nptrace, ["render", "ball.obj", *args], catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result


def rays_of(n, seed=0):
    rng = np.random.default_rng(seed)
    origin = rng.uniform(-2, 2, (n, 3)).astype(np.float32)
    direction = (rng.uniform(-1, 1, (n, 3)).astype(np.float32) - origin).astype(np.float32)
    return origin, direction, rng.uniform(0.3, 2, n), rng.random(n) < 0.4


def write(path, origin, direction, **others):
    lists = {name: pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), 3)
             for name, values in (("origin", origin), ("direction", direction))}  # fmt: skip
    pq.write_table(pa.table({**lists, **others}), path)


@pytest.mark.parametrize("kind", ["kdtree", "bvh", "bvh64"])
def test_hits_are_those_of_brute_force(folder, monkeypatch, kind):
    """In the order of the file, over several chunks, both types of rays mixed."""
    monkeypatch.setattr(ray_file, "CHUNK", 100)
    monkeypatch.setattr(ray_file, "WIDTH", 64)
    origin, direction, t_max, any_hit = rays_of(450)
    write("rays.parquet", origin, direction, t_max=t_max, any_hit=any_hit)
    nodes = ["--bvh-nodes", "64"] if kind == "bvh64" else []
    said = render("--rays", "rays.parquet", "--accel", kind.removesuffix("64"), *nodes).stderr
    assert "rays.parquet: 450 rays and no picture, so image.png is one grey pixel" in said
    [path] = (folder / "traces").iterdir()
    run = open_run(path)
    columns, accesses = run.columns("rays"), run.columns("accesses")
    right = trace_all(np.ascontiguousarray(icosphere(2), np.float32), make_rays(origin, direction, 0.0, t_max))
    assert columns["type"].tolist() == any_hit.astype(int).tolist()
    assert ((columns["prim"] >= 0) == (right.prim >= 0)).all() and 50 < (right.prim >= 0).sum() < 400
    closest = ~any_hit
    assert (columns["prim"][closest] == right.prim[closest]).all()
    assert (columns["t"][closest] == right.t[closest].astype(np.float32)).all()
    assert (columns["t"] <= t_max.astype(np.float32)).sum() == (right.prim >= 0).sum()
    assert (np.bincount(accesses["ray"], minlength=450) == columns["count"]).all() and (
        np.diff(accesses["ray"].astype(int)) >= 0
    ).all()
    assert (columns["x"] + 64 * columns["y"].astype(int)).tolist() == list(range(450))


def test_a_pictures_rays_make_the_accesses_of_the_picture(folder):
    """The primary rays of a picture, from a file, visit the nodes that they visit in the picture."""
    from rtrace.chunk import primary_rays
    from rtrace.scenes.scene import load_mesh

    render("--accel", "bvh", "--pixels", "16x16", "--batch", "0")
    frame = load_mesh("ball.obj").camera.frame(16, 16)
    rays = primary_rays(frame, np.arange(256, dtype=np.uint32), 16)
    write("rays.parquet", rays.origin, rays.direction)
    render("--accel", "bvh", "--rays", "rays.parquet")
    picture = open_run("traces/ball-bvh-batch0-16x16")
    [own] = [open_run(path) for path in (folder / "traces").glob("*rays*")]
    for table, names in (("rays", ("prim", "t", "count")), ("accesses", ("ray", "node", "kind"))):
        mine, theirs = own.columns(table), picture.columns(table)
        assert all((mine[name] == theirs[name][: len(mine[name])]).all() for name in names)
    assert own.footer.n_rays == 256


def test_a_run_says_where_its_rays_are_from_and_replays(folder):
    for seed, name in ((0, "a"), (1, "b")):
        origin, direction, _, _ = rays_of(50, seed)
        write(f"{name}.parquet", origin, direction)
        render("--rays", f"{name}.parquet", "--accel", "bvh")
    runs = sorted((folder / "traces").iterdir())
    assert len(runs) == 2
    for path in runs:
        footer = open_run(path).footer
        assert (
            footer.order == f"rays-{footer.rays['sha256'][:12]}" and path.name == f"ball-bvh-rays-{footer.rays['sha256'][:6]}"
        )
        assert f"--rays {footer.rays['source']}" in footer.command and "--pixels" not in footer.command
        assert read_rays(folder / footer.rays["source"]).sha256 == footer.rays["sha256"]
    result = CliRunner().invoke(cli.npcache, ["replay", "--json"], catch_exceptions=False)
    assert [row["order"][:5] for row in json.loads(result.stdout)] == ["rays-", "rays-"]
    origin, direction, _, _ = rays_of(50)
    pq.write_table(pa.table({f"{name}_{axis}": values[:, k] for name, values in (("origin", origin), ("direction", direction))
                             for k, axis in enumerate("xyz")}), "c.parquet")  # fmt: skip
    render("--rays", "c.parquet", "--accel", "bvh")  # the same rays, written otherwise
    footers = [open_run(path).footer for path in (folder / "traces").iterdir()]
    assert sorted(footer.rays["source"] for footer in footers) == ["b.parquet", "c.parquet"]


def test_the_bytes_do_not_depend_on_threads(folder, monkeypatch):
    monkeypatch.setattr(ray_file, "CHUNK", 64)
    origin, direction, t_max, any_hit = rays_of(300)
    write("rays.parquet", origin, direction, t_max=t_max, any_hit=any_hit)
    for threads in ("1", "3"):
        render("--rays", "rays.parquet", "--accel", "kdtree", "--threads", threads, "--out", threads)
    [one], [other] = (list((folder / threads).iterdir()) for threads in ("1", "3"))
    for name in ("accesses.parquet", "rays.parquet", "image.png"):
        assert (one / name).read_bytes() == (other / name).read_bytes()


def test_any_hit_rays_end_early(folder):
    """At the first hit they stop, so some read fewer nodes than as closest-hit rays, and none reads more."""
    origin, direction, _, _ = rays_of(300)
    counts = []
    for any_hit in (False, True):
        write("rays.parquet", origin, direction, any_hit=np.full(300, any_hit))
        render("--rays", "rays.parquet", "--accel", "bvh", "--out", str(any_hit))
        [path] = (folder / str(any_hit)).iterdir()
        counts.append(open_run(path).columns("rays")["count"].astype(int))
    assert (counts[1] <= counts[0]).all() and counts[1].sum() < counts[0].sum()


def test_every_value_is_in_the_checksum(folder):
    origin, direction, t_max, any_hit = rays_of(9)
    found = set()
    for change in range(4):
        values = [origin.copy(), direction.copy(), t_max.copy(), any_hit.copy()]
        values[change].flat[0] = not any_hit[0] if change == 3 else values[change].flat[0] + 1
        write("rays.parquet", values[0], values[1], t_max=values[2], any_hit=values[3])
        found.add(read_rays(folder / "rays.parquet").sha256)
    assert len(found) == 4


def test_shadow_rays_alone_have_no_share_of_hits(folder):
    origin, direction, _, _ = rays_of(9)
    write("rays.parquet", origin, direction, any_hit=np.ones(9, bool))
    render("--rays", "rays.parquet", "--accel", "bvh")


@pytest.mark.parametrize(
    ("columns", "sentence"),
    [
        ({"origin": [[0.0, 0, 0]]}, "has no column 'direction', nor direction_x, direction_y, direction_z"),
        ({"origin": [[0.0, 0]], "direction": [[0.0, 0, 1]]}, "column 'origin' must be lists of three numbers"),
        ({"origin": [None], "direction": [[0.0, 0, 1]]}, "column 'origin' must be lists of three numbers"),
        ({"origin": [[0.0, 0, None]], "direction": [[0.0, 0, 1]]}, "column 'origin' must be a number for every ray"),
        ({"origin": [[0.0, 0, 0]] * 2, "direction": [[0.0, 0, 1], [0.0, 0, 0]]}, "ray 1 has direction"),
        ({"origin": [[0.0, 0, 0]], "direction": [[0.0, 0, np.inf]]}, "ray 0 has direction"),
        ({"origin": [[0.0, 0, 1e39]], "direction": [[0.0, 0, 1]]}, "float32, which does not hold it; scale the rays"),
        ({"origin": [[0.0, 0, 0]], "direction": [[0.0, 0, 1e-50]]}, "float32, which does not hold it; scale the rays"),
        ({"origin": [[0.0, 0, 0]], "direction": [[0.0, 0, 1]], "t_max": ["x"]}, "column 't_max' must be a number"),
        ({"origin": [[0.0, 0, 0]], "direction": [[0.0, 0, 1]], "any_hit": [1]}, "column 'any_hit' must be true or false"),
        ({"origin": pa.array([], pa.list_(pa.float32())), "direction": pa.array([], pa.list_(pa.float32()))}, "has no ray"),
    ],
)
def test_what_is_no_ray_is_one_sentence(folder, columns, sentence):
    pq.write_table(pa.table(columns), "rays.parquet")
    with pytest.raises(NptraceError) as caught:
        read_rays(folder / "rays.parquet")
    assert sentence in str(caught.value) and "\n" not in str(caught.value)


def test_options_of_a_picture_are_refused(folder):
    for option in (["--pixels", "8x8"], ["--order", "morton"], ["--camera", "eye=0,2,5 at=0,0,0"], ["--light", "0,9,0"]):
        assert "brings its own rays" in render("--rays", "rays.parquet", *option, code=2).stderr
    assert "cannot read rays.parquet as Parquet: No such file" in render("--rays", "rays.parquet", code=2).stderr
