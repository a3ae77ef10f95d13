"""The built-in scenes: as many triangles as the benchmark scenes, the same bytes everywhere, something to see and shadows."""

import hashlib

import numpy as np
import pytest

from rtrace.chunk import primary_rays
from rtrace.scenes.stand_ins import STAND_INS, stand_in
from rtrace.shading import shadow_rays
from rtrace.traverse import trace
from rtrace.trees.tree_cache import build_tree

#: Triangles of bunny, conference, sibenik, sponza, and the sha256 of the stand-in's: one changed bit changes every result.
WANTED = {
    "blob": (69_451, "698238cc82f87077146ba1d1d89c468a4ad25ad88a598e358d8e57aa1034325f"),
    "room": (331_179, "755b140c0c96284227413c83bd8c2846fab3a0d7ea1b47d5277315d2c55188dd"),
    "nave": (75_284, "51a49b11c2a1fed43db6c7a84af76f8595f5ad4bc36f18451dd4df07716b3d09"),
    "court": (66_450, "8bb02f5ebfe45df5c1876e304d26406c0ec2841497b10b48d91dedc11ef3cde1"),
}


@pytest.fixture(scope="module", params=WANTED)
def made(request):
    return request.param, stand_in(request.param).triangles


def area(triangles):
    a, b, c = np.moveaxis(triangles.astype(np.float64), 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def test_every_benchmark_scene_has_a_stand_in():
    from rtrace.scenes.catalog import CATALOG

    assert {entry.stand_in for entry in CATALOG.values()} == set(STAND_INS) == set(WANTED)


def test_size_type_and_bytes(made):
    name, triangles = made
    wanted, sha256 = WANTED[name]
    assert abs(len(triangles) / wanted - 1) < 0.05
    assert triangles.dtype == np.float32 and triangles.shape[1:] == (3, 3) and np.isfinite(triangles).all()
    assert hashlib.sha256(triangles.astype("<f4").tobytes()).hexdigest() == sha256
    assert triangles.tobytes() == stand_in(name).triangles.tobytes()


def test_triangles_are_no_lines_and_of_many_sizes(made):
    name, triangles = made
    areas = area(triangles)
    assert (areas < 1e-10).mean() < 0.01
    assert len(np.unique(triangles.reshape(-1, 9), axis=0)) > 0.99 * len(triangles)
    if name != "blob":  # real interiors have walls and door handles
        assert np.quantile(areas, 0.9999) > 1e3 * np.quantile(areas, 0.1)


@pytest.mark.parametrize("detail", [1.0, 0.1, 0.001])
def test_the_blob_is_watertight(detail):
    """Each edge belongs to two triangles, which walk it in opposite directions; as many corners as a ball has."""
    corners, faces = np.unique(stand_in("blob", detail).triangles.reshape(-1, 3), axis=0, return_inverse=True)
    faces = faces.reshape(-1, 3)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    there, back = (set(map(tuple, e.tolist())) for e in (edges, edges[:, ::-1]))
    assert len(there) == len(edges) and there == back
    assert len(corners) - len(edges) // 2 + len(faces) == 2


@pytest.mark.parametrize("name", WANTED)
def test_detail_scales_the_number_of_triangles(name):
    sparse, tenth, quarter = (len(stand_in(name, detail).triangles) / WANTED[name][0] for detail in (1e-9, 0.1, 0.25))
    # Boxes stay whole and profiles keep their points: the court, of slender columns, shrinks least.
    assert 0 < sparse < tenth < 0.8 * quarter and 0.04 < tenth < 0.3 and 0.12 < quarter < 0.5


@pytest.mark.parametrize("detail", [0.0, -1.0, 1.1, float("nan"), float("inf")])
@pytest.mark.parametrize("name", WANTED)
def test_a_bad_detail_is_refused(name, detail):
    with pytest.raises(ValueError, match="must be above 0 and at most 1"):
        stand_in(name, detail)


def test_an_unknown_name_is_refused():
    with pytest.raises(ValueError, match="'bunny' is not a built-in scene; choose one of blob, room, nave, court"):
        stand_in("bunny")


@pytest.mark.parametrize("name", WANTED)
def test_the_picture_shows_the_scene_lit_and_in_shadow(name):
    scene = stand_in(name)
    assert (scene.name, scene.source, scene.stand_in, scene.dropped) == (name, name, True, ())
    tree = build_tree(scene.triangles, "bvh")
    primary = primary_rays(scene.camera.frame(96, 96), np.arange(96 * 96, dtype=np.uint32), 96)
    hits = trace(tree, primary)
    share = (hits.prim >= 0).mean()
    rays, owner, _ = shadow_rays(tree, primary, hits, scene.light)
    blocked = (trace(tree, rays, any_hit=True).prim >= 0).mean()
    if name == "blob":  # seen from outside: all of it, with a margin
        picture = (hits.prim >= 0).reshape(96, 96)
        assert 0.25 < share < 0.6 and len(owner) > 1000 and blocked > 0.02
        assert not (picture[0].any() or picture[-1].any() or picture[:, 0].any() or picture[:, -1].any())
    else:
        assert share > 0.94 if name == "court" else share > 0.99  # the court is open to the sky
        assert 0.1 < blocked < 0.9
