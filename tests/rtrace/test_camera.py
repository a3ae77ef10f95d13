"""Cameras, what users type for them, and the orders of pixels."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rtrace.camera import (
    ORDERS,
    Camera,
    fit_camera,
    fit_light,
    format_camera,
    parse_camera,
    parse_point,
    parse_size,
    pixel_order,
)
from rtrace.chunk import primary_rays

number = st.floats(-1e6, 1e6)


def test_the_frame_points_through_pixel_centres():
    eye, corner, du, dv = Camera((0, 0, 5), (0, 0, 0), fov=90).frame(4, 2)
    np.testing.assert_array_equal(eye, [0, 0, 5])
    # At distance 1 a vertical field of 90 degrees is 2 high; two rows, so centres at y = +-0.5, four columns of the same size.
    for (x, y), want in {(0, 0): (-1.5, 0.5, -1), (3, 1): (1.5, -0.5, -1), (1, 0): (-0.5, 0.5, -1)}.items():
        np.testing.assert_allclose(corner + x * du + y * dv, want, atol=1e-12)


@pytest.mark.parametrize(
    ("camera", "words"),
    [
        (dict(eye=(1, 2, 3), look_at=(1, 2, 3)), "same point"),
        (dict(eye=(0, 5, 0), look_at=(0, 0, 0)), "parallel"),
        (dict(eye=(0, 0, 5), look_at=(0, 0, 0), up=(0, 0, 0)), "direction"),
        (dict(eye=(0, 0, 5), look_at=(0, 0, 0), fov=0), "between 0 and 180"),
        (dict(eye=(0, 0, 5), look_at=(0, 0, 0), fov=180), "between 0 and 180"),
        (dict(eye=(0, 0, 5), look_at=(0, 0, 0), fov=math.nan), "between 0 and 180"),
        (dict(eye=(0, 0, 5), look_at=(0, 0, 0), fov=1e-300), "at least 2e-05"),
        (dict(eye=(0, 0, 5), look_at=(0, 0, 0), fov=math.inf), "between 0 and 180"),
        (dict(eye=(0, math.inf, 5), look_at=(0, 0, 0)), "eye"),
        (dict(eye=(0, math.nan, 5), look_at=(0, 0, 0)), "eye"),
        (dict(eye=(0, 0, 5), look_at=(0, math.nan, 0)), "look_at"),
        (dict(eye=(0, 0, 5), look_at=(0, 0, 0), up=(0, math.inf, 0)), "up"),
        (dict(eye=(3.5e38, 1, 1), look_at=(0, 0, 0)), "beyond float32"),
        (dict(eye=(0, -1e300, 1), look_at=(0, 0, 0)), "beyond float32"),
    ],
)
def test_cameras_that_see_nothing_are_refused(camera, words):
    with pytest.raises(ValueError, match=words):
        Camera(**camera)


def test_what_a_camera_may_be():
    """The last eye that float32 holds, the narrowest field: rays are finite, and not one and the same."""
    last = float(np.finfo(np.float32).max)
    for camera in (
        Camera((last, 1, 1), (0, 0, 0)),
        Camera((0, 0, 5), (0, 0, 0), fov=2e-5),
        Camera((0, 0, 5), (0, 0, 0), fov=179.999999),
        Camera((1e-60, 0, 0), (0, 0, 0)),
        Camera((0, 0, 1), (0, 0, -1e300), up=(0, 1e-320, 0)),
    ):
        rays = primary_rays(camera.frame(3, 3), np.arange(9, dtype=np.uint32), 3)
        assert np.isfinite(rays.origin).all() and np.isfinite(rays.direction).all()
        assert len(np.unique(rays.direction, axis=0)) > 3


def test_a_camera_fitted_to_the_largest_scene_stands_in_float32():
    largest = float(np.finfo(np.float32).max)
    for bounds in ([(-largest,) * 3, (largest,) * 3], [(0, 0, 0), (largest, 1, 1)], [(-largest, 0, -largest), (-1e38, 1, 0)]):
        camera = fit_camera(np.array(bounds, np.float32))
        assert np.isfinite(np.float32(camera.eye)).all()
        assert parse_camera(format_camera(camera)) == camera


@pytest.mark.parametrize(
    "bounds",
    [
        [(0, 0, 0), (1, 2, 3)],
        [(-1e-20, 0, 0), (1e-20, 1e-20, 1e-20)],
        [(1e6, 1e6, 1e6), (1e6 + 1, 1e6 + 2, 1e6 + 1)],
        [(0, 0, 0), (1, 0, 1)],
        [(2, 3, 4), (2, 3, 4)],
        [(0, 0, 0), (0, 0, 0)],
        [(-1e30, -1e30, -1e30), (1e30, 1e30, 1e30)],
        [(0, 0, 3e38), (4e37, 4e37, 3.4e38)],  # at the end of float32: from behind
        [(3e38, 3e38, 0), (3.4e38, 3.4e38, 4e37)],  # from the left and below
    ],
)
def test_a_fitted_camera_sees_the_whole_box(bounds):
    bounds = np.array(bounds, np.float32)
    camera = fit_camera(bounds)
    eye, corner, du, dv = camera.frame(100, 100)
    forward = camera.axes()[2]
    for i in range(8):
        point = np.array([bounds[i >> k & 1, k] for k in range(3)], np.float64) - eye
        assert point @ forward > 0
        on_plane = point / (point @ forward) - corner
        x, y = on_plane @ du / (du @ du), on_plane @ dv / (dv @ dv)
        assert -0.5 <= x <= 99.5
        assert -0.5 <= y <= 99.5
    light = np.array(fit_light(camera, bounds))
    assert np.isfinite(light).all()
    assert not np.all((light >= bounds[0]) & (light <= bounds[1])) or (bounds[0] == bounds[1]).all()


def test_a_light_for_a_camera_inside_is_inside():
    bounds = np.array([(0, 0, 0), (10, 4, 8)])
    light = np.array(fit_light(Camera((5, 2, 4), (9, 2, 4)), bounds))
    assert np.all((light > bounds[0]) & (light < bounds[1]))


@given(st.tuples(number, number, number), st.tuples(number, number, number), st.floats(1, 179))
def test_a_camera_survives_being_written_and_read(eye, at, fov):
    try:
        camera = Camera(eye, at, fov=fov)
    except ValueError:
        return
    assert parse_camera(format_camera(camera)) == camera


def test_camera_texts():
    assert parse_camera("eye=1,2,3; at=0,0,0") == Camera((1, 2, 3), (0, 0, 0))
    assert parse_camera("eye=1, 2, 3 dir = 0,0,-1 up=0,0.5,0 fov=60") == Camera((1, 2, 3), (1, 2, 2), (0, 0.5, 0), 60)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "must have eye="),
        ("eye=1,2,3", "must have eye="),
        ("eye=1,2,3 at=0,0,0 dir=1,0,0", "must have eye="),
        ("eye=1,2 at=0,0,0", "1,2"),
        ("eye=1,2,x at=0,0,0", "x"),
        ("eye=1,2,nan at=0,0,0", "nan"),
        ("eye=1,2,3 eye=1,2,3 at=0,0,0", "twice"),
        ("eye=1,2,3 zoom=3 at=0,0,0", "zoom=3"),
    ],
)
def test_bad_camera_texts_are_named(text, words):
    with pytest.raises(ValueError, match=words):
        parse_camera(text)


@given(st.text())
def test_no_text_breaks_the_parsers(text):
    for parse in (parse_camera, parse_point, parse_size):
        try:
            parse(text)
        except ValueError as error:
            assert str(error)


def test_sizes():
    assert parse_size("512x256") == (512, 256)
    for text in ("0x5", "5x0", "65537x1", "50000x50000", "5", "5x", "axb", "-1x4", "1.5x2", "5x5x5"):
        with pytest.raises(ValueError, match="size"):
            parse_size(text)


@given(st.sampled_from(ORDERS), st.integers(1, 150), st.integers(1, 150))
def test_every_order_is_a_permutation(order, width, height):
    pixels = pixel_order(order, width, height, seed=3)
    assert pixels.dtype == np.uint32
    np.testing.assert_array_equal(np.sort(pixels), np.arange(width * height))


def test_orders_are_what_they_say():
    assert pixel_order("scanline", 3, 2).tolist() == [0, 1, 2, 3, 4, 5]
    assert pixel_order("morton", 4, 4)[:6].tolist() == [0, 1, 4, 5, 2, 3]
    tile = pixel_order("tile", 128, 128)
    assert tile[:9].tolist() == [0, 1, 2, 3, 4, 5, 6, 7, 128]
    assert tile[64] == 8  # the next 8x8 square of the row
    assert tile[4096] == 64 * 128  # the next 64x64 tile of the column
    x, y = pixel_order("hilbert", 64, 64) % 64, pixel_order("hilbert", 64, 64) // 64
    steps = np.abs(np.diff(x.astype(int))) + np.abs(np.diff(y.astype(int)))
    assert (steps == 1).all()
    assert (pixel_order("random", 50, 50, 1) != pixel_order("random", 50, 50, 2)).any()
    with pytest.raises(ValueError, match="spiral"):
        pixel_order("spiral", 5, 5)
