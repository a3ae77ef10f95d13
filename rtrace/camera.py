"""The view of a picture: numbers or a user's text -> a checked Camera, its rays, the order of its pixels."""

import math
import re
from dataclasses import dataclass

import numpy as np

from nptrace_base.errors import NptraceError
from traces.frame import Point, axes, frame, unit
from traces.identity import camera_text
from traces.identity import point_text as _text

#: Pixel orders that ``pixel_order`` knows.
ORDERS = ("scanline", "tile", "morton", "hilbert", "random")

#: Largest side of a picture in pixels, and the most pixels: a pixel number has to fit into int32.
MAX_SIDE, MAX_PIXELS = 65536, 2**31 - 1

#: Vertical field of view in degrees when none is given.
DEFAULT_FOV = 45.0
#: The least: four steps of a float32 direction from the middle of the picture to its border.
MIN_FOV = 2e-5
#: Largest coordinate of the eye, where rays begin: the largest float32.
FARTHEST = float(np.finfo(np.float32).max)

_FIT_DIRECTION = (0.55, 0.45, 0.75)  # from the middle of the box to a fitted camera: front right, a bit above
_FIT_MARGIN = 1.05
_PARALLEL = 1e-6  # sine of the least angle between up and the view; below it the picture's tilt is rounding noise


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole camera; all three vectors in the units of the scene.

    Attributes
    ----------
    eye, look_at : 3 floats
        Position of the camera, which float32 can hold, and a point in the middle of the picture.
    up : 3 floats
        The up direction of the picture; need not have unit length or be perpendicular to the view.
    fov : float
        Vertical field of view in degrees, ``MIN_FOV`` <= fov < 180.

    Raises NptraceError for values that define no picture.
    """

    eye: Point
    look_at: Point
    up: Point = (0.0, 1.0, 0.0)
    fov: float = DEFAULT_FOV

    def __post_init__(self) -> None:
        for name in ("eye", "look_at", "up"):
            object.__setattr__(self, name, _point(getattr(self, name), f"camera {name}"))
        object.__setattr__(self, "fov", float(self.fov))
        if not 0.0 < self.fov < 180.0:
            raise NptraceError(f"camera fov is {self.fov!r} but must be between 0 and 180 degrees; write e.g. fov=45")
        if self.fov < MIN_FOV:
            raise NptraceError(
                f"camera fov is {self.fov!r} but must be at least {MIN_FOV} degrees: directions are float32, and all rays "
                "of a narrower picture would be equal; write e.g. fov=45"
            )
        if max(map(abs, self.eye)) > FARTHEST:
            raise NptraceError(
                f"camera eye {_text(self.eye)} is beyond float32, which holds numbers up to {FARTHEST:.4g}; move it nearer"
            )
        if self.eye == self.look_at:
            raise NptraceError(f"camera eye and look_at are the same point {_text(self.eye)}; move one of them")
        if not all(map(math.isfinite, np.subtract(self.look_at, self.eye))):
            raise NptraceError(f"camera eye {_text(self.eye)} and look_at {_text(self.look_at)} are too far apart for a float")
        if self.up == (0.0, 0.0, 0.0):
            raise NptraceError("camera up is 0,0,0 but must have a direction; write e.g. up=0,1,0")
        view = unit(np.subtract(self.look_at, self.eye))
        if math.hypot(*np.cross(view, unit(self.up))) < _PARALLEL:
            other = "0,0,1" if abs(view[1]) > 0.5 else "0,1,0"
            raise NptraceError(
                f"camera up {_text(self.up)} is parallel to the view from {_text(self.eye)} to {_text(self.look_at)}; "
                f"give another, e.g. up={other}"
            )

    def axes(self) -> np.ndarray:
        """Return (3, 3) float64: the unit vectors to the right, up and forward in the picture, one per row."""
        return axes(self)

    def frame(self, width: int, height: int) -> np.ndarray:
        """Return the vectors that make the rays of a picture of ``width`` x ``height`` pixels: ``traces.frame.frame``."""
        check_size(width, height)
        return frame(self, width, height)


def fit_camera(bounds: np.ndarray) -> Camera:
    """Return a camera outside ``bounds``, (2, 3) lower and upper corner, that shows all of the box in a square picture.

    A three-quarter view from above, with +y up. Flat boxes and single points work too.
    """
    lower, upper = np.asarray(bounds, np.float64)
    middle = lower + (upper - lower) / 2
    corners = np.array([[(lower, upper)[i >> k & 1][k] for k in range(3)] for i in range(8)]) - middle
    right, up, forward = Camera(_FIT_DIRECTION, (0.0, 0.0, 0.0)).axes()
    sideways = np.maximum(np.abs(corners @ right), np.abs(corners @ up))
    distance = np.max(sideways / math.tan(math.radians(DEFAULT_FOV) / 2) - corners @ forward) * _FIT_MARGIN
    # A single point or a tiny scene far from the origin needs a distance that survives the rounding of the eye.
    distance = max(distance, 1e-3 * np.abs(middle).max(), 1e-30) if np.any(upper) or np.any(lower) else 1.0
    # At the end of float32 the camera stands on the other side of the box, or where it does not see all of it.
    eye = middle - distance * forward
    eye = np.clip(np.where(np.abs(eye) > FARTHEST, middle + distance * forward, eye), -FARTHEST, FARTHEST)
    return Camera(_point(eye), _point(middle))


def fit_light(camera: Camera, bounds: np.ndarray) -> Point:
    """Return a point light above and to the left of the camera, so that shadows fall visibly to the right.

    Outside ``bounds`` if the camera is; for a camera inside the box, such as a room, the light is inside too.
    """
    lower, upper = np.asarray(bounds, np.float64)
    eye = np.array(camera.eye)
    right, up, forward = camera.axes()
    if np.all((eye > lower) & (eye < upper)):
        wanted = eye + 0.15 * math.hypot(*(upper - lower)) * (up - right)
        return _point(np.clip(wanted, lower + 0.1 * (eye - lower), upper - 0.1 * (upper - eye)))
    reach = math.hypot(*np.clip((lower + upper) / 2 - eye, -1e300, 1e300)) or 1.0
    light = eye + reach * (0.5 * up - 0.6 * right)
    while np.all((light >= lower) & (light <= upper)):  # a camera close to a face, looking along it
        light = light - reach * forward
    return _point(light)


def parse_camera(text: str) -> Camera:
    """Return the camera of ``text``: ``eye=1,2,3 at=0,0,0 up=0,1,0 fov=45``, separated by blanks or semicolons.

    ``dir=`` may stand for ``at=``; ``up`` and ``fov`` are optional. Raises NptraceError.
    """
    hint = "write e.g. 'eye=1,2,3 at=0,0,0 up=0,1,0 fov=45'"
    fields: dict[str, str] = {}
    for part in re.sub(r"\s*([,=])\s*", r"\1", text).replace(";", " ").split():
        key, equals, value = part.partition("=")
        if not equals or key not in ("eye", "at", "dir", "up", "fov"):
            raise NptraceError(f"camera {text!r}: {part!r} is not eye=, at=, dir=, up= or fov=; {hint}")
        if key in fields:
            raise NptraceError(f"camera {text!r}: {key}= is given twice; {hint}")
        fields[key] = value
    if "eye" not in fields or ("at" in fields) == ("dir" in fields):
        raise NptraceError(f"camera {text!r} must have eye= and one of at= and dir=; {hint}")
    eye = parse_point(fields["eye"])
    at = parse_point(fields["at"]) if "at" in fields else _point(np.add(eye, parse_point(fields["dir"])))
    up = parse_point(fields["up"]) if "up" in fields else (0.0, 1.0, 0.0)
    return Camera(eye, at, up, _number(fields["fov"]) if "fov" in fields else DEFAULT_FOV)


def format_camera(camera: Camera) -> str:
    """Return the text from which ``parse_camera`` makes exactly this camera."""
    return camera_text(camera)


def parse_point(text: str) -> Point:
    """Return the three finite numbers of ``"x,y,z"``."""
    numbers = [_number(word) for word in text.split(",")]
    if len(numbers) != 3:
        raise NptraceError(f"point {text!r} has {len(numbers)} numbers but must have three; write e.g. 1,2.5,-3")
    return _point(numbers)


def parse_size(text: str) -> tuple[int, int]:
    """Return (width, height) of ``"512x512"``, checked."""
    match = re.fullmatch(r"\s*(\d{1,9})\s*[xX]\s*(\d{1,9})\s*", text, re.ASCII)
    if match is None:
        raise NptraceError(f"size {text!r} is not WIDTHxHEIGHT in pixels; write e.g. 512x512")
    width, height = int(match[1]), int(match[2])
    check_size(width, height)
    return width, height


def check_size(width: int, height: int) -> None:
    """Raise NptraceError unless a picture of ``width`` x ``height`` pixels can be rendered."""
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        raise NptraceError(f"size {width}x{height}: each side must be 1 to {MAX_SIDE} pixels; write e.g. 512x512")
    if width * height > MAX_PIXELS:
        raise NptraceError(f"size {width}x{height} is {width * height} pixels, and the most is {MAX_PIXELS}; make it smaller")


def pixel_order(order: str, width: int, height: int, seed: int = 0) -> np.ndarray:
    """Return the pixels of a picture in the order in which their rays are traced.

    Parameters
    ----------
    order : str
        ``scanline``: row by row from the top. ``tile``: as Manta does, tiles of 64x64 pixels column by column, each as 8x8
        squares row by row, each of those row by row. ``morton`` (the Z curve) and ``hilbert``: on the smallest square of
        side 2^k that covers the picture, without the pixels outside. ``random``: a permutation drawn with ``seed``.
    width, height : int

    Returns
    -------
    pixels : (width * height,) uint32
        y * width + x, each once.
    """
    check_size(width, height)
    if order == "scanline":
        return np.arange(width * height, dtype=np.uint32)
    if order == "tile":
        return _tiles(width, height)
    if order == "morton":
        return _curve(((0, 0), (1, 0), (0, 1), (1, 1)), (0, 0, 0, 0), width, height)
    if order == "hilbert":
        # Child 0 is the curve mirrored at the main diagonal, child 3 at the other one: both, and the half turn that is
        # both together, commute, so that a state is two bits (1 = diagonal, 2 = half turn) and a step down an xor.
        return _curve(((0, 0), (0, 1), (1, 1), (1, 0)), (1, 0, 0, 3), width, height)
    if order == "random":
        # Pixel numbers below random bits, sorted: unlike Generator.permutation, these bits never change.
        numbers = np.random.PCG64(seed).random_raw(width * height) & np.uint64(0xFFFFFFFF_00000000)
        return np.sort(numbers | np.arange(width * height, dtype=np.uint64)).astype(np.uint32)
    raise NptraceError(f"pixel order {order!r} is unknown; choose one of {', '.join(ORDERS)}")


def _tiles(width: int, height: int) -> np.ndarray:
    """Return the pixel numbers tile by tile; the tiles at the right and lower border are clipped."""
    tiles_x, tiles_y = -(-width // 64), -(-height // 64)
    x = np.arange(tiles_x * 64, dtype=np.int64)
    y = np.arange(tiles_y * 64, dtype=np.int64)
    number = np.where((y < height)[:, None] & (x < width), y[:, None] * width + x, -1)
    split = number.reshape(tiles_y, 8, 8, tiles_x, 8, 8)  # tile, square, pixel, for y and then x
    flat = split.transpose(3, 0, 1, 4, 2, 5).ravel()
    return flat[flat >= 0].astype(np.uint32)


def _curve(steps: tuple[tuple[int, int], ...], turns: tuple[int, ...], width: int, height: int) -> np.ndarray:
    """Return the pixel numbers along a space-filling curve of 2x2 ``steps`` (x, y), child i being turned by ``turns[i]``.

    Squares are split in four from the covering one down, and those outside the picture are dropped at once: work and memory
    stay within a small factor of the number of pixels, for a picture of 65536x1 too.
    """
    base = np.array(steps, np.int32)
    table = np.array([(base[:, ::-1] if state & 1 else base) ^ (state >> 1) for state in range(4)])
    x = y = np.zeros(1, np.int32)
    state = np.zeros(1, np.uint8)
    for level in reversed(range((max(width, height) - 1).bit_length())):
        x = (2 * x[:, None] + table[:, :, 0][state]).ravel()
        y = (2 * y[:, None] + table[:, :, 1][state]).ravel()
        state = (state[:, None] ^ np.array(turns, np.uint8)).ravel()
        inside = (x <= (width - 1) >> level) & (y <= (height - 1) >> level)
        if not inside.all():
            x, y, state = x[inside], y[inside], state[inside]
    return y.astype(np.uint32) * np.uint32(width) + x.astype(np.uint32)


def _point(values, what: str = "point") -> Point:
    """Return three finite floats, or raise NptraceError."""
    point = tuple(map(float, values))
    if len(point) != 3 or not all(map(math.isfinite, point)):
        raise NptraceError(f"{what} is {_text(point)} but must be three finite numbers; write e.g. 1,2.5,-3")
    return point


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise NptraceError(f"{word!r} is not a number; write e.g. 1, 2.5 or -3e2") from None
