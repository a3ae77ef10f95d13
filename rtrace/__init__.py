"""Stage 1: scene -> tree -> traced rays -> a run on disk.

The names below are imported when they are used; ``rtrace.render`` is the module, and has the function of that name.
"""

from nptrace_base.lazy import lazy_names

#: Tells this package from another one of its name, see ``nptrace.__main__``.
PART_OF = "nptrace"

#: Public names, and the module that defines each.
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

__all__ = sorted(_PLACES)

__getattr__, __dir__ = lazy_names(__name__, _PLACES)
