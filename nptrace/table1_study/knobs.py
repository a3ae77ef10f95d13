"""The knobs of Table I: what the paper leaves open, which values it may have, and where each is decided."""

from dataclasses import asdict, dataclass, fields
from typing import Any, NamedTuple

KD, BVH = "kdtree", "bvh"


@dataclass(frozen=True, slots=True)
class Setting:
    """A value of every knob of a replay or a render; each field is a knob, and its default is that of the program.

    Attributes
    ----------
    pixels : int
        Side of the square picture.
    order : str
        Order of the pixels, one of ``rtrace.camera.ORDERS``.
    batch : int
        Primary rays before their shadow rays, 0 for all of them.
    builder : str
        Parameters of the tree's builder, as ``--kd`` or ``--bvh`` takes them.
    packet : int
        Primary rays that walk the tree as one, then their shadow rays.
    shadow, shadow_order, shadow_end : str
        Which pixels send a shadow ray, the child that it searches first, and what is read after its hit (``rtrace.shooting``).
    light : str
        ``"scene"``, or ``"manta"``: beyond the upper corner of the scene's box.
    layout, reads, flush, prefetch : str
        As ``npcache replay`` takes them.
    policy : str
        Replacement.
    """

    pixels: int = 128
    order: str = "scanline"
    batch: int = 1
    packet: int = 1
    shadow: str = "lit"
    shadow_order: str = "sign"
    shadow_end: str = "stop"
    builder: str = ""
    light: str = "scene"
    layout: str = "stored"
    reads: str = "own"
    flush: str = "never"
    prefetch: str = "stack:unlimited"
    policy: str = "lru"

    def columns(self) -> dict[str, Any]:
        """Return the columns of a row."""
        return asdict(self)


#: Knobs that need another run; the others are decided at replay.
RENDERED = ("pixels", "order", "batch", "packet", "shadow", "shadow_order", "shadow_end", "builder", "light")
REPLAYED = tuple(each.name for each in fields(Setting) if each.name not in RENDERED)


class Knob(NamedTuple):
    """One knob.

    Attributes
    ----------
    name : str
        A field of ``Setting``, or ``camera`` or ``version``.
    title : str
    values : mapping
        Its values beside the default, by tree.
    decided : str
        ``"render"`` or ``"replay"``.
    evidence : str
        Why it is open.
    unlikely : tuple of str
        Values that the paper's text contradicts: measured, and no part of a range.
    """

    name: str
    title: str
    values: dict[str, tuple[Any, ...]]
    decided: str
    evidence: str
    unlikely: tuple[Any, ...] = ()


def _both(*values: Any) -> dict[str, tuple[Any, ...]]:
    return {KD: values, BVH: values}


#: pbrt's costs and its limit of depth for these scenes, 8 + 1.3 log2 N.
_PBRT = "c_trav=1,c_isect=80,empty_bonus=0.5,max_level=29"

KNOBS = (
    Knob(
        "pixels", "resolution", _both(64, 96, 192, 256, 512), "render",
        "no size is printed; A / N of the kd-trees is about 2 x 128 x 128 rays a scene, Manta's default is 512 x 512",
    ),
    Knob(
        "order", "order of pixels", _both("tile", "morton", "hilbert", "random"), "render",
        "Manta traces 8x8 squares in 64x64 tiles; hardware may do anything",
        unlikely=("random",),
    ),
    Knob(
        "batch", "primary rays before their shadow rays", _both(64, 0), "render",
        "Manta: 64, then their shadow rays; all primaries first is usual in hardware papers",
    ),
    Knob(
        "packet", "rays of a packet", _both(4, 16, 64), "render",
        "the text has single rays; Manta's default is 64",
    ),
    Knob(
        "shadow", "pixels with a shadow ray", _both("hit", "all"), "render",
        "\"a primary ray and a shadow ray per pixel\"; Manta sends none away from the light",
    ),
    Knob(
        "shadow_order", "child that shadow rays search first", _both("cheaper"), "render",
        "Manta's RTSAH: the cheaper side first",
    ),
    Knob(
        "shadow_end", "reads after a shadow ray's hit", _both("drain"), "render",
        "hardware stops; Manta's recursion enters all that waits",
    ),
    Knob(
        "builder", "builder",
        {
            KD: ("coarse", "max_level=20", "c_trav=15,c_isect=20", "c_trav=1,c_isect=1", "c_trav=10,c_isect=2", _PBRT,
                 "min_leaf=4", "min_leaf=8"),
            BVH: ("binned", "min_leaf=2", "min_leaf=4", "c_trav=2", "max_leaf=1"),
        },
        "render", "Manta's costs are 1.5 and 2 (kd-tree), 1 and 1 (BVH); other programs use other costs and limits",
    ),
    Knob("light", "light", _both("manta"), "render", "Manta's default light lies beyond the upper corner of the box"),
    Knob(
        "layout", "place of the nodes",
        {
            KD: ("stored+8", "stored+16", "stored+24", "bfs", "dfs", "veb", "treelet:64"),
            BVH: ("stored+16", "bfs", "dfs", "veb", "treelet:256"),
        },
        "replay", "nodes of a C++ vector start at a multiple of 16 bytes; Manta stores pairs depth-first",
        unlikely=("bfs", "veb", "treelet:64", "treelet:256"),
    ),
    Knob(
        "reads", "what a visit reads", _both("children", "merged"), "replay",
        "a unit may read both children at their parent, or keep the line read last",
    ),
    Knob(
        "prefetch", "prefetch unit",
        _both(
            "stack:unlimited:once", "stack:unlimited:persist", "stack:unlimited:restart", "stack:unlimited:empty",
            "stack:unlimited:pop", "push", "stack:tris*1", "stack:tris*2", "stack:tris*4", "stack:budget=1", "stack:budget=2",
            "stack:budget=3",
        ),
        "replay", "the paper does not say whether empty leaves count, how long a test lasts, or whether requests repeat",
        unlikely=("push", "stack:unlimited:pop"),
    ),
    Knob("flush", "cache after a ray", _both("ray"), "replay", "one frame from a cold cache is usual", unlikely=("ray",)),
    Knob(
        "policy", "replacement", _both("fifo", "random", "opt"), "replay", "LRU is DineroIV's default",
        unlikely=("random", "opt"),
    ),
)  # fmt: skip

#: Knobs of the scene, whose values ``cameras`` has.
SCENE_KNOBS = (
    Knob("camera", "camera", {}, "render", "Fig. 2 is too small to read a camera from it"),
    Knob("version", "edition of the scene", {}, "render", "papers of 2008 to 2012 used other editions of these meshes"),
)


def knob(name: str) -> Knob:
    """Return a knob by its name."""
    return next(each for each in (*KNOBS, *SCENE_KNOBS) if each.name == name)
