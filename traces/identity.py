"""Which run a result is of: a footer -> the columns that every row of every result carries, and a text that tells runs apart.

A new kind of result keeps a ``RunIdentity`` and puts ``**identity.to_dict()`` first into each record; its tables call a run by
``labels``. Nothing else is needed for rows that nobody can mistake.
"""

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, get_type_hints

from traces.footer import Footer

#: What stands in a name and in a label for a scene that is a stand-in.
STAND_IN = "standin"


@dataclass(frozen=True, slots=True)
class RunIdentity:
    """The facts that tell runs apart; None where a trace is no run, or a run is not on disk.

    Attributes
    ----------
    run : str
        Its name: that of its directory or file.
    path : str or None
        Where it is.
    scene : str or None
        Without a mark of a stand-in, which ``stand_in`` is.
    stand_in : bool or None
    tree, builder : str or None
        ``"kdtree"`` or ``"bvh"``; the builder's parameters, as ``name=value`` separated by blanks.
    width, height : int or None
        Pixels.
    order : str or None
        Order of the pixels; ``order_seed`` is its seed, None unless it is random.
    batch : int or None
        Primary rays before their shadow rays; 0: all.
    packet : int or None
        Rays that walk the tree as one, at most.
    shadow, shadow_order, shadow_end : str or None
        Which pixels send a shadow ray, which child it searches first, what is read after its hit.
    camera, light : str or None
        As ``nptrace render`` takes them.
    """

    run: str
    path: str | None = None
    scene: str | None = None
    stand_in: bool | None = None
    tree: str | None = None
    builder: str | None = None
    width: int | None = None
    height: int | None = None
    order: str | None = None
    order_seed: int | None = None
    batch: int | None = None
    packet: int | None = None
    shadow: str | None = None
    shadow_order: str | None = None
    shadow_end: str | None = None
    camera: str | None = None
    light: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the columns of a record, in order."""
        return asdict(self)

    @property
    def pixels(self) -> str | None:
        """The picture's size, ``WxH``."""
        return None if self.width is None else f"{self.width}x{self.height}"

    @property
    def knobs(self) -> list[str]:
        """What of the packets and shadow rays is not as usual, each as a short text."""
        usual = {each.name: each.default for each in fields(Footer)}
        facts, names = _facts(self), ("packet", "shadow", "shadow_order", "shadow_end")
        return [facts[name] for name in names if getattr(self, name) not in (None, usual[name])]


#: Names and types of the columns, in order.
COLUMNS: dict[str, type] = {
    name: next(iter(getattr(type_, "__args__", (type_,)))) for name, type_ in get_type_hints(RunIdentity).items()
}


def identity_of(footer: Footer, run: str, path: str | None = None) -> RunIdentity:
    """Return the identity of the run with this footer, name and place."""
    params = " ".join(f"{name}={value}" for name, value in sorted(footer.tree.params.items()))
    return RunIdentity(
        run=run, path=path, scene=footer.scene.name, stand_in=footer.scene.stand_in, tree=footer.tree.kind, builder=params,
        width=footer.width, height=footer.height, order=footer.order,
        order_seed=footer.seed if footer.order == "random" else None, batch=footer.batch, packet=footer.packet,
        shadow=footer.shadow, shadow_order=footer.shadow_order, shadow_end=footer.shadow_end,
        camera=camera_text(footer.camera), light=point_text(footer.light),
    )  # fmt: skip


def camera_text(camera: Any) -> str:
    """Return the text of a camera, from which ``rtrace.camera.parse_camera`` makes exactly this one."""
    eye, at, up = (point_text(point) for point in (camera.eye, camera.look_at, camera.up))
    return f"eye={eye} at={at} up={up} fov={camera.fov!r}"


def point_text(point: Iterable[float]) -> str:
    """Return the text of a point, of which no digit is lost."""
    return ",".join(map(repr, point))


def short_hash(text: str) -> str:
    """Return six hexadecimal digits for a text that is too long for a name: a camera, a light."""
    return hashlib.sha256(text.encode()).hexdigest()[:6]


#: Facts that differ by nature from one tree or scene to another: they tell only those runs apart where these are the same.
_WITHIN = {"builder": ("tree", "scene"), "camera": ("scene",), "light": ("scene", "camera")}


def labels(identities: Iterable[RunIdentity], *, by_path: bool = False) -> Mapping[RunIdentity, str]:
    """Return a text for each run that no other of them has: its name, its path where names repeat or ``by_path``.

    What varies among them, and is not told by the name, follows in parentheses, and so does that a scene is a stand-in.
    """
    facts = {each: _facts(each) for each in identities}
    groups: dict[tuple[str, ...], set[str]] = {}
    for of in facts.values():
        for name in of:
            groups.setdefault(_group(name, of), set()).add(of[name])
    names = [each.run for each in facts]
    found = {}
    for each, of in facts.items():
        base = (each.path or each.run) if by_path or names.count(each.run) > 1 else each.run
        varying = [of[name] for name in of if len(groups[_group(name, of)]) > 1]
        told = [text for text in varying if text and not _is_in(text, each.run)]
        told = ["stand-in"] * bool(each.stand_in) + told
        found[each] = f"{base} ({', '.join(told)})" if told else base
    return found


def _group(name: str, of: Mapping[str, str]) -> tuple[str, ...]:
    """Return what the runs have in common among which a fact may tell them apart."""
    return (name, *(of[other] for other in _WITHIN.get(name, ())))


def _facts(of: RunIdentity) -> dict[str, str]:
    """Return what tells runs apart, each as a short text, and "" for what is not known."""
    return {
        "scene": of.scene or "",
        "tree": of.tree or "",
        "builder": (of.builder or "").replace("builder=", ""),
        "pixels": of.pixels or "",
        "order": of.order or "",
        "order_seed": "" if of.order_seed is None else f"seed {of.order_seed}",
        "batch": "" if of.batch is None else f"batch {of.batch}",
        "packet": "" if of.packet is None else f"packet {of.packet}",
        "shadow": f"shadow {of.shadow}" if of.shadow else "",
        "shadow_order": f"shadow-order {of.shadow_order}" if of.shadow_order else "",
        "shadow_end": f"shadow-end {of.shadow_end}" if of.shadow_end else "",
        "camera": f"camera {short_hash(of.camera)}" if of.camera else "",
        "light": f"light {short_hash(of.light)}" if of.light else "",
    }


def _is_in(fact: str, name: str) -> bool:
    """Return whether a name tells a fact: ``batch 64`` is told by ``sponza-bvh-batch64`` and by ``sponza-bvh-batch-64``."""
    return any(f"-{fact.replace(' ', gap)}-" in f"-{name}-" for gap in ("", "-"))
