"""Which rays are traced, and in which order: the values of a picture that are not the scene's, checked."""

from dataclasses import dataclass

from nptrace_base.errors import NptraceError
from rtrace.camera import ORDERS, check_size


@dataclass(frozen=True, slots=True)
class Shooting:
    """Which rays are traced, and in which order.

    Attributes
    ----------
    width, height : int
        Pixels; one primary ray each, through its centre, and a shadow ray where it hits a surface that faces the light.
    order : str
        One of ``camera.ORDERS``.
    batch : int
        Primary rays traced before their shadow rays; 0 means all of them.
    seed : int
        Seed of the random order.
    """

    width: int = 128
    height: int = 128
    order: str = "scanline"
    batch: int = 1
    seed: int = 0

    def __post_init__(self) -> None:
        check_size(self.width, self.height)
        if self.order not in ORDERS:
            raise NptraceError(f"order must be one of {', '.join(ORDERS)}, got {self.order!r}")
        if not 0 <= self.batch < 1 << 32:
            raise NptraceError(f"batch must be 0 (all primary rays first) or up to 2^32 - 1, got {self.batch}; write e.g. 64")
