"""The effect of float32 on triangles, compared with exact fractions."""

from fractions import Fraction

import numpy as np
import pytest

from rtrace.rays import make_rays
from rtrace.scenes.float32_check import LEAST_STEPS, choice, measure, normalised, notes
from rtrace.scenes.scene import load_mesh, scene_from_triangles
from rtrace.traverse import trace
from rtrace.trees.bvh import build_bvh


def exact_change(triangle):
    """Return the largest change of an edge by rounding, squared, relative to its length squared, as a Fraction."""
    corner = [[Fraction(float(x)) for x in vertex] for vertex in triangle]
    rounded = [[Fraction(float(np.float32(x))) for x in vertex] for vertex in triangle]
    worst = Fraction(0)
    for a in range(3):
        b = (a + 1) % 3
        edge = [corner[b][k] - corner[a][k] for k in range(3)]
        moved = [rounded[b][k] - rounded[a][k] for k in range(3)]
        length = sum(x * x for x in edge)
        if length:
            worst = max(worst, sum((x - y) ** 2 for x, y in zip(edge, moved, strict=True)) / length)
    return worst


@pytest.mark.parametrize("offset", [0.0, 1e2, 1e5, 3e7])
@pytest.mark.parametrize("scale", [1.0, 1e-6, 1e9])
def test_the_bound_holds_in_exact_arithmetic_and_is_no_larger_than_it_must_be(offset, scale):
    rng = np.random.default_rng(int(offset) + 1)
    triangles = scale * (offset + rng.normal(0, 1, (300, 3, 3)))
    shares = []
    for triangle in triangles:
        bound = measure(triangle[None]).bound
        change = exact_change(triangle)
        assert change <= Fraction(bound) ** 2
        shares.append(float(change) ** 0.5 / bound)
    assert max(shares) > 0.25


def test_scenes_that_float32_carries_and_that_it_does_not():
    near = np.random.default_rng(0).normal(0, 1, (50, 3, 3))
    assert measure(near).n_beyond == 0 and notes(measure(near)) == ()
    assert "float64 arithmetic: the shortest edge is" in choice(measure(near))
    far = near + 1e7  # steps of 1
    found = measure(far)
    assert found.n_beyond == 50 and found.least_steps < LEAST_STEPS and found.step == 1.0
    assert any("50 of 50 triangles have an edge of less than 8 steps" in note for note in notes(found))
    assert any("wide but lies 1e+07 from the origin" in note for note in notes(found))
    gone = measure(near * 1e-3 + 1e7 + 0.01)
    assert gone.n_collapsed == 50 and "50 of them have an edge of length 0 after rounding" in notes(gone)[1]
    # After rounding alone, an edge that is left is one step long at least.
    assert measure(far.astype(np.float32)).least_steps >= 1


def test_edges_without_length_are_not_the_scenes_rounding():
    point = np.zeros((1, 3, 3))
    assert measure(point).n_beyond == 0 and "no edge has a length" in choice(measure(point))


def test_a_power_of_two_changes_no_count():
    triangles = np.random.default_rng(1).normal(3, 1, (40, 3, 3)).astype(np.float32)
    for k in (-60, 7, 90):
        assert measure(np.ldexp(triangles, k))._replace(extent=0, reach=0, step=0) == measure(triangles)._replace(
            extent=0, reach=0, step=0
        )


@pytest.mark.parametrize("k", [-100, -3, 0, 60, 120])
def test_normalising_is_exact_and_moves_every_hit_by_the_same_power(k):
    triangles = np.ldexp(np.random.default_rng(2).uniform(-1, 1, (60, 3, 3)), k).astype(np.float32)
    small, power = normalised(triangles)
    assert 0.5 <= np.abs(small).max() < 1
    assert np.array_equal(np.ldexp(small, power), triangles)
    origin = np.ldexp(np.float32([[0.1, 0.2, 3.0]]), k).repeat(200, axis=0)
    direction = np.random.default_rng(3).normal(0, 1, (200, 3)).astype(np.float32)
    direction[:, 2] = -3
    there, here = (
        trace(build_bvh(t), make_rays(o, direction)) for t, o in ((triangles, origin), (small, np.ldexp(origin, -power)))
    )
    assert (here.prim >= 0).any() and np.array_equal(here.prim, there.prim)
    assert np.array_equal(np.ldexp(here.t, power), there.t)


def test_a_scene_knows_and_its_file_is_measured_before_rounding(tmp_path):
    path = tmp_path / "far.obj"
    path.write_text("v 1000000.01 0 0\nv 1000000.02 0 0\nv 1000000.01 5 0\nv 1000000 5 9\nf 1 2 3\nf 2 3 4\n")
    scene = load_mesh(path)
    assert scene.precision.n_beyond == 1 and scene.precision.n_collapsed == 1
    assert any("1 of 2 triangles have an edge of less than 8 steps" in note for note in scene.notes)
    assert scene_from_triangles(np.eye(3)[None], "one").notes == ()
