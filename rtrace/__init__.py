"""Stage 1: scene -> tree -> traced rays -> a run on disk.

The names below are imported when they are used; ``rtrace.render`` is the module, and has the function of that name.
"""

import importlib
from typing import Any

#: Tells this package from another one of its name, see ``nptrace.__main__``.
PART_OF = "nptrace"

#: Public names, and the module each is in. Importing all of them takes a second, which a command's help does not have.
_PLACES = {
    "Camera": "camera",
    "RayUnits": "ray_source",
    "Scene": "scenes.scene",
    "SceneError": "scenes.mesh_file",
    "Shooting": "render",
    "Tree": "trees.tree",
    "build_tree": "trees.tree_cache",
    "cached_tree": "trees.tree_cache",
    "load_mesh": "scenes.scene",
    "load_scene": "scenes.catalog",
    "render_all": "render",
    "scene_from_triangles": "scenes.scene",
    "seen_from": "scenes.scene",
}

__all__ = [
    "Camera",
    "RayUnits",
    "Scene",
    "SceneError",
    "Shooting",
    "Tree",
    "build_tree",
    "cached_tree",
    "load_mesh",
    "load_scene",
    "render_all",
    "scene_from_triangles",
    "seen_from",
]


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_PLACES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
