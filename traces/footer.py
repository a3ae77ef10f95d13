"""The footer of a run: everything that decides its bytes, and the sizes of its tables; written by the renderer, read by all.

In the files it is JSON, the same in each; in the code it is a ``Footer``. README.md lists the entries.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from typing import Any

from nptrace_base.places import Place
from traces.format import FORMAT_VERSION, RunError
from traces.frame import Point
from traces.node_formats import NODE_FORMATS, NodeFormat

#: The first version that knows packets, whose accesses are those of their first ray.
PACKET_VERSION = 3

#: Bytes that a node may have: with fewer than 2^32 nodes no address overflows.
MAX_NODE_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class SceneFacts:
    """The triangles of a run; ``name`` is fit for a file, ``label`` is printed, ``sha256`` is that of the triangles."""

    name: str
    label: str
    source: str
    sha256: str
    n_triangles: int
    stand_in: bool


@dataclass(frozen=True, slots=True)
class CameraFacts:
    """The camera of a run, in the units of the scene; ``fov`` is the vertical field of view in degrees."""

    eye: Point
    look_at: Point
    up: Point
    fov: float


@dataclass(frozen=True, slots=True)
class TreeFacts:
    """The tree of a run: the name of its node format, the bytes of a node, and its builder's parameters."""

    kind: str
    node_bytes: int
    params: Mapping[str, Any] = field(default_factory=dict)

    @property
    def node_format(self) -> NodeFormat:
        """The format of the nodes."""
        return NODE_FORMATS[self.kind]


@dataclass(frozen=True, slots=True)
class Footer:
    """The facts about a run that need no reading of its rows.

    Attributes
    ----------
    tool_version, command : str
        The version that wrote it; ``command`` makes it again.
    scene : SceneFacts
    camera : CameraFacts
    light : 3 floats
    width, height : int
        Pixels.
    order : str
        Order of the pixels.
    batch : int
        Primary rays before their shadow rays; 0: all of them.
    seed : int
        Seed of the random order.
    tree : TreeFacts
    layout, prefetch : str and dict
        The layout of the nodes, and the policy of the recorded requests.
    image_sha256 : str or None
        Of ``image.png``; runs of earlier versions lack it.
    packet : int
        Rays that walk the tree as one, at most; 1: each walks alone.
    shadow, shadow_order, shadow_end : str
        Which pixels send a shadow ray; which child it searches first; what is read after its hit (``nptrace render``).
    rays : dict or None
        Of a run of rays from a file, that file and the checksum of its rays; a ray is then a pixel, ``order`` begins with
        ``rays-``, and there is no picture.
    n_accesses, n_rays, n_nodes : int
        Rows of the three tables; the writer counts them.
    """

    tool_version: str
    command: str
    scene: SceneFacts
    camera: CameraFacts
    light: Point
    width: int
    height: int
    order: str
    batch: int
    seed: int
    tree: TreeFacts
    layout: str = "as stored"
    prefetch: Mapping[str, Any] = field(default_factory=lambda: {"policy": "stack", "budget": "unlimited"})
    image_sha256: str | None = None
    rays: Mapping[str, Any] | None = None
    packet: int = 1
    shadow: str = "lit"
    shadow_order: str = "sign"
    shadow_end: str = "stop"
    n_accesses: int = 0
    n_rays: int = 0
    n_nodes: int = 0

    def to_json(self) -> bytes:
        """Return the text in the files."""
        values = asdict(self)
        values["tree"] |= values["tree"].pop("params")
        for name, usual in _OPTIONAL.items():
            if values[name] == usual:
                del values[name]
        version = max(self.tree.node_format.version, PACKET_VERSION if self.packet > 1 else 1)
        return json.dumps({"format_version": version, **values}, sort_keys=True).encode()

    def differences(self, other: "Footer") -> list[str]:
        """Return the entries in which two runs differ; their versions and the places of their meshes do not count."""
        mesh, others = ((footer.scene.sha256, footer.scene.stand_in) for footer in (self, other))
        if mesh != others:
            return ["scene"]  # its camera and light are others too
        return [name for name in _CONTENT if getattr(self, name) != getattr(other, name)]


#: The entries that a run may lack, and what they are then: a run has only those that say something.
_OPTIONAL = {
    "image_sha256": None, "rays": None, "packet": 1, "shadow": "lit", "shadow_order": "sign", "shadow_end": "stop"
}  # fmt: skip

#: The entries that decide the bytes of a run, apart from its scene.
_CONTENT = (
    "camera", "light", "width", "height", "order", "batch", "seed", "packet", "shadow", "shadow_order", "shadow_end", "tree",
    "layout", "prefetch",
)  # fmt: skip


def parse_footer(text: bytes, path: Place) -> Footer:
    """Return the footer of the run at ``path``; RunError if it is invalid, of another format version, or incomplete."""
    try:
        values = json.loads(text)
    except (ValueError, RecursionError) as e:
        raise RunError(f"{path} is damaged ({e} in its footer); render it again") from e
    if not isinstance(values, dict):
        raise RunError(f"{path} is damaged (its footer is {str(values)[:40]!r}, not an object); render it again")
    version = _checked(object, values.get("format_version"), "format_version", path)
    if version not in range(1, FORMAT_VERSION + 1) or isinstance(version, bool):
        raise RunError(f"{path} has format version {version}, and this program reads 1 to {FORMAT_VERSION}; render it again")
    footer: Footer = _parsed(Footer, values, "", path)
    tree, known = footer.tree, [name for name, each in NODE_FORMATS.items() if each.version <= version]
    if tree.kind not in known or not 1 <= tree.node_bytes <= MAX_NODE_BYTES:
        raise RunError(
            f"{path} has a tree {tree.kind!r} with {tree.node_bytes}-byte nodes; format version {version} has the kinds "
            f"{', '.join(known)}, with nodes of up to 2^20 B; render it again"
        )
    return footer


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


#: The JSON form of a type, and whether a value has it.
_RULES: dict[object, tuple[str, Callable[[Any], bool]]] = {
    object: ("a value", lambda value: value is not None),
    str: ("a text", lambda value: isinstance(value, str)),
    str | None: ("a text", lambda value: isinstance(value, str)),
    bool: ("true or false", lambda value: isinstance(value, bool)),
    int: ("a whole number from 0", lambda value: type(value) is int and value >= 0),
    float: ("a number", _is_number),
    Point: ("three numbers", lambda value: isinstance(value, list) and len(value) == 3 and all(map(_is_number, value))),
    dict: ("an object", lambda value: isinstance(value, dict)),
    Mapping[str, Any] | None: ("an object", lambda value: isinstance(value, dict)),
    Mapping[str, Any]: ("an object", lambda value: isinstance(value, dict)),
}


def _checked(type_: object, value: Any, entry: str, path: Place) -> Any:
    """Return an entry's value, a tuple for a list; RunError if it is not of the type."""
    if value is None:
        raise RunError(f"{path} has no {entry} in its footer; render it again")
    rule, is_good = _RULES[type_]
    if not is_good(value):
        raise RunError(f"{path} has {str(value)[:40]!r} as {entry} in its footer, not {rule}; render it again")
    return tuple(value) if isinstance(value, list) else value


def _parsed(facts: Any, values: dict[str, Any], of: str, path: Place) -> Any:
    """Return the dataclass ``facts`` with its entries from JSON; ``of`` is the entry that holds it."""
    found = {}
    for each in fields(facts):
        entry, value = f"{of}{each.name}", values.get(each.name)
        if each.name == "params":  # they stand among the entries of the tree
            found[each.name] = {name: value for name, value in values.items() if name not in found}
        elif is_dataclass(each.type):
            found[each.name] = _parsed(each.type, _checked(dict, value, entry, path), f"{entry}.", path)
        elif value is not None or each.name not in _OPTIONAL:
            found[each.name] = _checked(each.type, value, entry, path)
    return facts(**found)
