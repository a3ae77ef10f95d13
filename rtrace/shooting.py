"""Which rays are traced, and in which order: the values of a picture that are not the scene's, checked."""

from dataclasses import dataclass, fields

from nptrace_base.errors import NptraceError
from rtrace.camera import ORDERS, check_size
from traces.node_formats import NODE_FORMATS

#: Rays of a packet: those of a square of pixels.
PACKETS = (1, 4, 16, 64)
#: Which pixels send a shadow ray, which child it searches first, and what is read after its hit.
SHADOWS, SHADOW_ORDERS, SHADOW_ENDS = ("lit", "hit", "all"), ("sign", "cheaper"), ("stop", "drain")


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
    packet : int
        Primary rays traced as one, those of an aligned square of pixels, and then their shadow rays: one of ``PACKETS``. A
        batch is then of whole packets: as many as together have ``batch`` rays or more, in full squares.
    shadow : str
        Which pixels send a shadow ray: ``lit``, with a hit on a surface that faces the light; ``hit``, with a hit; ``all``.
    shadow_order : str
        The child that a shadow ray searches first: by the ``sign`` of its direction, or the ``cheaper`` (``trees.rtsah``).
    shadow_end : str
        What is read after the hit of a shadow ray: nothing (``stop``), or (``drain``) as in Manta's packets, in a BVH all that
        waits on the stack, in a kd-tree all that a search of the closest hit reads.
    """

    width: int = 128
    height: int = 128
    order: str = "scanline"
    batch: int = 1
    seed: int = 0
    packet: int = 1
    shadow: str = "lit"
    shadow_order: str = "sign"
    shadow_end: str = "stop"

    def __post_init__(self) -> None:
        check_size(self.width, self.height)
        if self.order not in ORDERS:
            raise NptraceError(f"order must be one of {', '.join(ORDERS)}, got {self.order!r}")
        if not 0 <= self.batch < 1 << 32:
            raise NptraceError(f"batch must be 0 (all primary rays first) or up to 2^32 - 1, got {self.batch}; write e.g. 64")
        if type(self.seed) is not int or self.seed < 0:
            raise NptraceError(f"seed must be a whole number from 0, got {self.seed!r}")
        if self.packet not in PACKETS:
            raise NptraceError(f"packet must be one of {', '.join(map(str, PACKETS))} rays, got {self.packet}; write e.g. 64")
        for name, known in (("shadow", SHADOWS), ("shadow_order", SHADOW_ORDERS), ("shadow_end", SHADOW_ENDS)):
            if getattr(self, name) not in known:
                raise NptraceError(f"{name} must be one of {', '.join(known)}, got {getattr(self, name)!r}")

    @property
    def n_together(self) -> int:
        """Packets, or single rays, of a batch; 0: all."""
        return -(-self.batch // self.packet)

    def check_format(self, kind: str) -> None:
        """Raise NptraceError if rays cannot be traced so in a tree of a format."""
        for name in ("packet", "shadow_order", "shadow_end"):
            value = getattr(self, name)
            if value != _USUAL[name] and not NODE_FORMATS[kind].takes_packets:
                raise NptraceError(
                    f"{name} {value} is for nodes as Manta has them, of 8 and 32 bytes, and not for {kind}; leave out "
                    f"--bvh-nodes 64, or keep {name} {_USUAL[name]}"
                )


_USUAL = {each.name: each.default for each in fields(Shooting)}
