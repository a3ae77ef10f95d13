"""What `nptrace check` and `nptrace scenes` print: known differences, limits written out, the exit status, the seed."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

import cli
from rtrace.checks import embree, hard_cases
from rtrace.checks.hard_cases import CaseRow
from rtrace.scenes.shapes import icosphere
from tests.nptrace.test_nptrace import write_obj


def call(*args, code=0):
    result = CliRunner().invoke(cli.nptrace, [str(arg) for arg in args], catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result


@pytest.fixture
def ball(tmp_path):
    write_obj(tmp_path / "ball.obj", icosphere(2))
    return tmp_path / "ball.obj"


class Doctored:
    """Embree, whose answers on random and camera rays are changed in known ways: (lost hits, other triangles, moved by)."""

    def __init__(self, embree, n_lost, n_other, moved):
        self.embree, self.n_lost, self.n_other, self.moved = embree, n_lost, n_other, moved

    def run(self, origin, direction, dists=None, query=None, output=None):
        if query == "OCCLUDED":
            answer = np.asarray(self.embree.run(origin, direction, dists=dists, query=query)).copy()
            answer[: self.n_lost] = np.where(answer[: self.n_lost] == 0, -1, 0)
            return answer
        answer = {name: np.asarray(value).copy() for name, value in self.embree.run(origin, direction, output=output).items()}
        met = np.flatnonzero(answer["primID"] >= 0)
        answer["primID"][met[: self.n_lost]] = -1
        other = met[self.n_lost : self.n_lost + self.n_other]
        answer["primID"][other] ^= 1
        answer["tfar"][other] *= 1.5
        answer["tfar"][met[-1]] *= 1 + self.moved
        return answer


def checked(ball, monkeypatch, doctor, *args, code):
    real = embree.embree_scene
    monkeypatch.setattr(embree, "embree_scene", lambda triangles: Doctored(real(triangles), *doctor))
    rows = json.loads(call("check", ball, "--pixels", "32x32", "--random", 4000, "--json", *args, code=code).stdout)
    table = call("check", ball, "--pixels", "32x32", "--random", 4000, *args, code=code).stdout
    monkeypatch.setattr(embree, "embree_scene", real)
    return rows, table


def test_known_differences_are_the_values_printed(ball, monkeypatch):
    rows, table = checked(ball, monkeypatch, (3, 2, 0.03), code=1)
    values = {(row["tree"], row["rays"], row["what"]): row["value"] for row in rows}
    for tree in ("kdtree", "bvh"):
        assert values[tree, "shadow", "hit/miss differences"] == 3
        for rays in ("primary", "random"):
            assert values[tree, rays, "hit/miss differences"] == 3
            assert values[tree, rays, "other triangle, unequal t"] == 2
            assert values[tree, rays, "largest |dt|/t"] == pytest.approx(0.03, rel=1e-3)
    assert all(values["bvh", rays, "rays unlike the kdtree"] == 0 for rays in ("primary", "shadow", "random"))
    assert {row["n_rays"] for row in rows if row["rays"] != "shadow"} == {1024, 4000}
    assert {row["is_good"] for row in rows if row["value"] == 0} == {True}
    assert {row["is_good"] for row in rows if row["value"] in (2, 3) or row["what"] == "largest |dt|/t"} == {False}
    lines = [line for line in table.splitlines() if line.startswith(" ball ")]
    for row, line in zip(rows, lines, strict=True):
        verdict = "ok" if row["is_good"] else "BEYOND"
        start = f"ball {row['tree']} {row['rays']} {row['n_rays']:,} {row['what']}"
        assert " ".join(line.split()) == f"{start} {row['value']:.3g} {row['limit']:.3g} {verdict}"
    n_bad = sum(not row["is_good"] for row in rows)
    assert table.endswith(f"{len(rows)} comparisons, {n_bad} beyond their limit.\n") and n_bad > 0


def test_t_is_measured_in_kappa(ball, monkeypatch):
    """Of the last hit: t moved by a known share, over its unit from the triangle and the ray."""
    _, seen = checked(ball, monkeypatch, (0, 0, 0.0), code=0), []
    rows, _ = checked(ball, monkeypatch, (0, 0, 0.004), code=1)
    real = embree.kappa
    monkeypatch.setattr(embree, "kappa", lambda *args: seen.append(args) or real(*args))
    call("check", ball, "--pixels", "32x32", "--random", 4000)
    triangles, rays, prims = seen[-1]  # of the random rays: one triangle and one ray, in plain numbers
    a, b, c = triangles[prims[-1]].astype(float)
    origin, along = rays.origin[-1].astype(float), rays.direction[-1].astype(float)
    lean = abs(np.cross(b - a, c - a) @ along)
    unit = 2**-23 * np.abs(np.stack([a, b, c]) - origin).max() * np.linalg.norm(b - a) * np.linalg.norm(c - a) / lean
    t = np.cross(b - a, c - a) @ (a - origin) / (np.cross(b - a, c - a) @ along)
    [value] = [r["value"] for r in rows if (r["tree"], r["rays"], r["what"]) == ("bvh", "random", "largest |dt| in kappa")]
    assert value == pytest.approx(0.004 * t / unit, rel=1e-2)


def test_the_limits_are_written_out(ball):
    rows = json.loads(call("check", ball, "--pixels", "400x250", "--random", 200_000, "--json").stdout)
    limits = {(row["rays"], row["what"]): row["limit"] for row in rows}
    assert limits["primary", "hit/miss differences"] == 1 and limits["random", "hit/miss differences"] == 2  # 1 in 100,000
    assert limits["primary", "other triangle, unequal t"] == 5 and limits["random", "other triangle, unequal t"] == 10
    assert limits["shadow", "hit/miss differences"] == 0  # of fewer than 100,000
    for rays in ("primary", "random"):
        assert (limits[rays, "largest |dt| in kappa"], limits[rays, "largest |dt|/t"]) == (128, 0.01)
    assert {limits[rays, "rays unlike the kdtree"] for rays in ("primary", "shadow", "random")} == {0}
    assert embree.SAME_T == 1e-4


def test_the_seed_chooses_the_random_rays(ball):
    def worst(seed):
        rows = json.loads(call("check", ball, "--pixels", "8x8", "--random", 300, "--seed", seed, "--json").stdout)
        return [row["value"] for row in rows if row["rays"] == "random"]

    assert worst(1) == worst(1) != worst(2)


def test_embree_is_asked_to_be_robust(ball, monkeypatch):
    import embreex.rtcore_scene

    asked, real = [], embreex.rtcore_scene.EmbreeScene
    monkeypatch.setattr(embreex.rtcore_scene, "EmbreeScene", lambda **options: asked.append(options) or real(**options))
    call("check", ball, "--pixels", "8x8", "--random", 10)
    assert asked == [{"robust": True}]


def test_hard_cases_decide_the_exit_status(monkeypatch):
    """Rows that are known; one of them for each way to be bad."""
    good = CaseRow("case", "kdtree", 1234, 0, 0, 0, 1.5, 16.0, 0, 7)
    monkeypatch.setattr(hard_cases, "run_all", lambda is_long, threads: [good])
    assert "1 comparisons, 0 beyond their limit." in call("check", "--hard").stdout
    for bad in ({"lost": 2}, {"invented": 3}, {"wrong": 4}, {"unlike": 5}, {"t_error": 16.5}):
        row = good._replace(**bad)
        monkeypatch.setattr(hard_cases, "run_all", lambda is_long, threads, row=row: [good, row])
        assert json.loads(call("check", "--hard", "--json", code=1).stdout) == [
            {"schema_version": 1, **good._asdict(), "is_good": True}, {"schema_version": 1, **row._asdict(), "is_good": False},
        ]  # fmt: skip
        table = call("check", "--hard", code=1).stdout
        counts = [row.lost, row.invented, row.wrong, row.unlike, 7]
        words = f"case kdtree 1,234 {' '.join(map(str, counts))} {row.t_error:.2g} 16 BEYOND"
        assert [" ".join(line.split()) for line in table.splitlines() if "BEYOND" in line] == [words]
        assert "2 comparisons, 1 beyond their limit." in table


def test_hard_cases_come_in_two_lengths(monkeypatch):
    asked = []
    monkeypatch.setattr(hard_cases, "run_all", lambda is_long, threads: asked.append(is_long) or [])
    call("check", "--hard")
    call("check", "--hard", "--long")
    assert asked == [False, True]


# Name, triangles, stand-in: as the pages say from which the meshes come.
SCENES = [
    ("bunny", 69451, "blob"), ("conference", 331179, "room"), ("conference_repaired", 259499, "room"),
    ("sibenik", 75284, "nave"), ("sponza", 66450, "court"),
]  # fmt: skip


def test_scenes(tmp_path, monkeypatch):
    monkeypatch.setenv("NPTRACE_SCENES", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "sponza.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    rows = json.loads(call("scenes", "--json").stdout)
    assert [(row["name"], row["n_triangles"], row["stand_in"]) for row in rows] == SCENES
    wheres = [str(tmp_path / "sponza.obj") if name == "sponza" else "" for name, *_ in SCENES]
    assert [row["where"] for row in rows] == wheres
    lines = call("scenes").stdout.splitlines()
    for row, (name, n, stand_in), where in zip(rows, SCENES, wheres, strict=True):
        [line] = [" ".join(line.split()) for line in lines if line.split()[:1] == [name]]
        assert line == f"{name} {where or f'stand-in: {stand_in}'} {row['licence']} {n:,}"
        assert row["url"].startswith("http") or not row["url"]
