"""The picture of a run compared with its tables: colours, shadows, every order and batch; shadow offsets."""

import io

import numpy as np
import pytest
from PIL import Image

from rtrace import render as rendering
from rtrace.camera import ORDERS, Camera
from rtrace.chunk import primary_rays
from rtrace.render import Shooting, render
from rtrace.scenes.scene import scene_from_triangles
from rtrace.scenes.shapes import boxes, icosphere
from rtrace.shading import shadow_rays
from rtrace.traverse import trace
from rtrace.trees.tree_cache import build_tree
from traces.reader import open_run

WIDTH, HEIGHT = 75, 60


@pytest.fixture(scope="module")
def scene():
    floor = np.float32([[[-9, -1, -9], [-9, -1, 9], [9, -1, 9]], [[-9, -1, -9], [9, -1, 9], [9, -1, -9]]])
    scene = scene_from_triangles(np.concatenate([boxes(), icosphere(3) + np.float32([0, 3, 0]), floor]), "things")
    return scene._replace(camera=Camera((6, 7, 9), (0, 0, 0), fov=50), light=(-5.3, 9.1, 6.2))


@pytest.fixture(scope="module")
def picture(scene, tmp_path_factory):
    """Return (path of a run, its picture) as every other order and batch must give it."""
    path = tmp_path_factory.mktemp("pictures") / "run"
    render(scene, build_tree(scene.triangles, "kdtree"), Shooting(WIDTH, HEIGHT), path)
    return path, pixels_of(path)


def pixels_of(path):
    image = Image.open(io.BytesIO((path / "image.png").read_bytes()))
    assert (image.mode, image.size) == ("RGB", (WIDTH, HEIGHT))
    return np.asarray(image)


def test_every_pixel_is_shaded_by_what_its_rays_met(scene, picture):
    """From rays.parquet, in float64: background, light by the angles to viewer and light, none of the latter in shadow."""
    path, pixels = picture
    rays = open_run(path).columns("rays")
    columns = (rays[name].tolist() for name in ("x", "y", "type", "prim", "t"))
    hit, shadow = {}, {}
    for x, y, type_, prim, t in zip(*columns, strict=True):
        if type_ == 0:
            hit[x, y] = prim, t
        else:
            shadow[x, y] = prim >= 0
    eye, corner, du, dv = scene.camera.frame(WIDTH, HEIGHT)
    n_lit = n_dark = n_away = n_missed = 0
    for (x, y), (prim, t) in hit.items():
        if prim < 0:
            n_missed += 1
            assert pixels[y, x].tolist() == [34, 38, 46]
            continue
        along = corner + x * du + y * dv
        along /= np.linalg.norm(along)
        a, b, c = scene.triangles[prim].astype(float)
        normal = np.cross(b - a, c - a)
        normal *= -np.sign(normal @ along) / np.linalg.norm(normal)
        to_light = np.array(scene.light) - (eye + t * along)
        to_light /= np.linalg.norm(to_light)
        is_facing = normal @ to_light > 0
        assert is_facing == ((x, y) in shadow)
        is_lit = is_facing and not shadow[x, y]
        n_lit, n_dark, n_away = n_lit + is_lit, n_dark + (is_facing and not is_lit), n_away + (not is_facing)
        light = 0.1 + 0.16 * abs(normal @ along) + (0.74 * (normal @ to_light) if is_lit else 0)
        want = 255 * np.sqrt(np.minimum(light * (0.8 + 0.2 * normal), 1))
        assert np.abs(pixels[y, x] - want).max() <= 1.01, (x, y)
    assert min(n_lit, n_dark, n_away, n_missed) > 50


@pytest.mark.parametrize("kind", ["kdtree", "bvh"])
@pytest.mark.parametrize("batch", [1, 7, 0])
@pytest.mark.parametrize("order", ORDERS)
def test_every_order_and_batch_shows_the_same(scene, picture, tmp_path, order, batch, kind):
    render(scene, build_tree(scene.triangles, kind), Shooting(WIDTH, HEIGHT, order, batch, 3), tmp_path / "run")
    np.testing.assert_array_equal(pixels_of(tmp_path / "run"), picture[1])


@pytest.mark.parametrize("batch", [2000, 0])
def test_batches_beyond_a_chunk_show_the_same(scene, picture, tmp_path, monkeypatch, batch):
    """Their pixels are traced twice, and drawn with the shadow rays."""
    monkeypatch.setattr(rendering, "CHUNK", 500)
    render(scene, build_tree(scene.triangles, "bvh"), Shooting(WIDTH, HEIGHT, batch=batch), tmp_path / "run")
    np.testing.assert_array_equal(pixels_of(tmp_path / "run"), picture[1])


@pytest.mark.parametrize("kind", ["kdtree", "bvh"])
@pytest.mark.parametrize("scale", [2.0**-20, 1.0, 2.0**30])
def test_shadow_rays_start_and_end_four_units_away(kind, scale):
    """A floor at height 1 whose hits have no larger coordinate: 4 units of 2^-23 above it, as much before the light."""
    floor = np.float32(scale) * np.float32([[[-1, 1, -1], [-1, 1, 1], [1, 1, 1]], [[-1, 1, -1], [1, 1, 1], [1, 1, -1]]])
    camera = Camera((0.25 * scale, 1.5 * scale, 0.25 * scale), (0, scale, 0), up=(0, 0, 1), fov=60)
    tree = build_tree(floor, kind)
    primary = primary_rays(camera.frame(16, 16), np.arange(256, dtype=np.uint32), 16)
    hits = trace(tree, primary)
    rays, owner, _ = shadow_rays(tree, primary, hits, (0.0, 2.0 * scale, 0.0))
    assert len(owner) > 200
    np.testing.assert_array_equal(rays.origin[:, 1].astype(float), scale * (1 + 4 * 2.0**-23))
    reach = np.abs(rays.direction.astype(float)).max(axis=1)
    np.testing.assert_allclose((1 - rays.t_max) * reach, scale * 2 * 4 * 2.0**-23, rtol=1e-6)  # the light is at height 2


@pytest.mark.parametrize("kind", ["kdtree", "bvh"])
def test_what_lies_sixteen_units_before_a_surface_shadows_it(kind):
    """A sheet nearly on the ceiling: an offset that jumps over it would leak light."""
    ceiling = np.float32([[[-1, 1, -1], [-1, 1, 1], [1, 1, 1]], [[-1, 1, -1], [1, 1, 1], [1, 1, -1]]])
    sheet = ceiling - np.float32([0, 16 * 2.0**-23, 0])
    camera = Camera((0.25, 0.5, 0.25), (0, 1, 0), up=(0, 0, 1), fov=60)
    primary = primary_rays(camera.frame(16, 16), np.arange(256, dtype=np.uint32), 16)
    both = build_tree(np.concatenate([ceiling, sheet]), kind)
    assert (trace(both, primary).prim >= 2).any()
    hits = trace(build_tree(ceiling, kind), primary)  # on the ceiling, as if the sheet were not there
    rays, owner, _ = shadow_rays(both, primary, hits, (0.0, 0.25, 0.0))
    assert len(owner) > 100
    assert (trace(both, rays, any_hit=True).prim >= 0).all()
