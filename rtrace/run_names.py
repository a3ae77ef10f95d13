"""A scene, a tree and rays -> the name of their run, which tells it from the runs of other scenes, pictures and trees.

``<scene>-<tree>`` is the run of the scene's own view with every default. What differs follows, in a fixed order:
``sponza-standin-bvh``, ``sponza-kdtree-max_level16``, ``sponza-bvh-binned-morton-batch0-512x512-camera-a1b2c3``,
``sponza-kdtree-tile-packet64-shadow-hit``.
"""

import inspect
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from rtrace.ray_file import RayFile
from rtrace.scenes.scene import Scene
from rtrace.shooting import Shooting
from rtrace.trees.bvh import build_bvh
from rtrace.trees.kdtree import build_kdtree
from traces.identity import STAND_IN, RunIdentity, camera_text, point_text
from traces.node_formats import NODE_FORMATS


def run_name(scene: Scene, kind: str, params: Mapping[str, Any], shooting: Shooting | RayFile) -> str:
    """Return the name of a run; of ``params``, those of the tree's builder, only other values than its defaults count."""
    parts = [scene.name, *([STAND_IN] if scene.stand_in else []), kind, *_builder_parts(kind, params)]
    if isinstance(shooting, RayFile):
        return "-".join([*parts, shooting.name[: len("rays-") + 6]])
    usual = {each.name: each.default for each in fields(shooting)}
    if shooting.order != usual["order"]:
        parts.append(shooting.order)
    if shooting.order == "random" and shooting.seed != usual["seed"]:
        parts.append(f"seed{shooting.seed}")
    if shooting.batch != usual["batch"]:
        parts.append(f"batch{shooting.batch}")
    if shooting.packet != usual["packet"]:
        parts.append(f"packet{shooting.packet}")
    for name in ("shadow", "shadow_order", "shadow_end"):
        if getattr(shooting, name) != usual[name]:
            parts.append(f"{name.replace('_', '-')}-{getattr(shooting, name)}")
    if (shooting.width, shooting.height) != (usual["width"], usual["height"]):
        parts.append(f"{shooting.width}x{shooting.height}")
    return "-".join([*parts, *([scene.view] if scene.view else [])])


def unusual(of: RunIdentity) -> list[str]:
    """Return what a run differs in from that of its scene's own view with every default, each as a short text.

    The own view of a stand-in, and of a scene that is not in the catalogue, is fitted to its mesh, and is not known here.
    """
    from rtrace.scenes.catalog import CATALOG

    usual = Shooting()
    given = dict(each.split("=", 1) for each in (of.builder or "").split())
    found = _builder_parts(str(of.tree), {name: _value(text) for name, text in given.items()})
    if (of.width, of.height) != (usual.width, usual.height):
        found.append(f"{of.pixels} pixels")
    if of.order != usual.order:
        found.append(f"order {of.order}")
    if of.batch not in (None, usual.batch):
        found.append(f"batch {of.batch}")
    found += of.knobs
    entry = None if of.stand_in else CATALOG.get((of.scene or "").lower())
    if entry is not None:
        found += ["another camera"] if of.camera != camera_text(entry.camera) else []
        found += ["another light"] if of.light != point_text(entry.light) else []
    return found


def _value(text: str) -> Any:
    """Return the number that a text is, or the text."""
    try:
        return float(text)
    except ValueError:
        return text


def _builder_parts(kind: str, params: Mapping[str, Any]) -> list[str]:
    """Return what the builder's parameters add: all but its defaults and ``max_refs``, which follows from the triangles."""
    signature = inspect.signature(build_kdtree if NODE_FORMATS[kind].tree == "kdtree" else build_bvh)
    usual = {"builder": "sah"} | {name: each.default for name, each in signature.parameters.items()}
    return [
        str(value) if name == "builder" else f"{name}{value!r}".removesuffix(".0")
        for name, value in sorted(params.items())
        if name != "max_refs" and value != usual.get(name)
    ]
