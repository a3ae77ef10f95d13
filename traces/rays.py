"""The rays of a run, found again: its footer and its table of rays in, where each ray starts and where it goes out."""

from contextlib import suppress
from typing import NamedTuple

import numpy as np

from nptrace_base.jit import kernel
from traces.format import PRIMARY, RunError
from traces.frame import frame
from traces.reader import Run
from traces.validation import bad_value


class TracedRays(NamedTuple):
    """The rays of a run that read nodes, in shooting order.

    Primary rays are those that were traced, bit for bit. A shadow ray was traced from a point beside the surface, off it by a
    few units in the last place of float32; here it starts on the surface, which is within 2^-20 of the largest coordinate.

    Attributes
    ----------
    origin, direction : (n, 3) float32
        Primary directions have unit length, shadow directions reach from the surface to the light.
    is_shadow, is_hit : (n,) bool
        Whether it is a shadow ray, and whether it hits a triangle.
    """

    origin: np.ndarray
    direction: np.ndarray
    is_shadow: np.ndarray
    is_hit: np.ndarray


@kernel
def primary_directions(frame, pixels, width, direction):
    """Write unit directions through the centres of pixels ``y * width + x``; ``frame`` is that of ``traces.frame``."""
    for i in range(pixels.size):
        x, y = np.float64(pixels[i] % width), np.float64(pixels[i] // width)
        dx = frame[1, 0] + x * frame[2, 0] + y * frame[3, 0]
        dy = frame[1, 1] + x * frame[2, 1] + y * frame[3, 1]
        dz = frame[1, 2] + x * frame[2, 2] + y * frame[3, 2]
        scale = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
        direction[i, 0], direction[i, 1], direction[i, 2] = dx * scale, dy * scale, dz * scale


def traced_rays(run: Run) -> TracedRays:
    """Return the rays of a run.

    Raises
    ------
    RunError
        The footer's camera shows nothing, or a shadow ray has no primary ray that hits.
    """
    if run.footer.shadow == "all":
        raise RunError(
            f"{run.path} has shadow rays of pixels without a hit, and where those start is not in a run; render it with "
            "--shadow hit or lit"
        )
    footer, rays = run.footer, run.columns("rays", ["x", "y", "type", "count", "prim", "t"])
    of_picture = _frame(run)
    pixels = rays["y"].astype(np.uint32) * np.uint32(footer.width) + rays["x"]
    is_primary = rays["type"] == PRIMARY
    origin = np.broadcast_to(of_picture[0].astype(np.float32), (pixels.size, 3)).copy()
    direction = np.empty((pixels.size, 3), np.float32)
    primary_directions(of_picture, pixels, np.uint32(footer.width), direction)
    shadow = np.flatnonzero(~is_primary)
    start = _hit_points(run, pixels, rays["t"], is_primary, origin, direction, shadow)
    origin[shadow] = start
    direction[shadow] = np.array(footer.light) - origin[shadow]
    read = rays["count"] > 0
    return TracedRays(origin[read], direction[read], ~is_primary[read], rays["prim"][read] >= 0)


def _frame(run: Run) -> np.ndarray:
    """Return the frame of a run's picture; the camera of a foreign run may be anything."""
    facts, found = run.footer, np.full((4, 3), np.nan)
    with np.errstate(all="ignore"), suppress(ArithmeticError, ValueError):
        numbers = [*facts.camera.eye, *facts.camera.look_at, *facts.camera.up, facts.camera.fov, *facts.light]
        if np.isfinite(np.array(numbers, np.float64)).all():
            found = frame(facts.camera, facts.width, facts.height)
    if not np.isfinite(found).all():
        raise RunError(f"{run.path} has a camera or light in its footer that shows nothing; render it again")
    return found


def _hit_points(
    run: Run, pixels: np.ndarray, t: np.ndarray, is_primary: np.ndarray, origin: np.ndarray, direction: np.ndarray,
    shadow: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Return where the primary rays of shadow rays hit, (n, 3) float64; the first arrays are of all rays."""
    primary = np.flatnonzero(is_primary & np.isfinite(t))
    primary = primary[np.argsort(pixels[primary], kind="stable")]
    place = np.searchsorted(pixels[primary], pixels[shadow])
    known = np.append(pixels[primary], np.uint64(1) << np.uint64(63))[place] == pixels[shadow]
    if not known.all():
        row = int(shadow[np.argmin(known)])
        path = run.path / "rays.parquet"
        raise bad_value(path, "type", row, 1, "a shadow ray begins where a primary ray of its pixel has hit")
    of = primary[place]
    return origin[of].astype(np.float64) + t[of, None].astype(np.float64) * direction[of]
