"""Published views of the four scenes: a name, its source, and a camera in the coordinates of each edition."""

import os
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rtrace.camera import Camera
from rtrace.scenes.catalog import find_scene
from rtrace.scenes.scene import Scene, load_mesh, seen_from

SOURCES = {
    "A": "Aila and Laine's benchmark (lispbub/simd-ray-traversal, benchmark.cmd), mapped to these meshes",
    "H": "Meister and Bittner (meistdan/hippie, env.py of Comparison and RaySorting)",
    "R": "RichardBruce/RAPTor, regression tests",
    "T": "taqu/BoundingVolumeHierarchy, main.cpp",
}
_FOV = {"A": 73.7398, "H": 45.0, "R": 31.417, "T": 60.0}

#: Name, eye, direction, and up if it is not +y.
_VIEWS = {
    "bunny": "R -0.12,0.29,0.28 0.262497,-0.527678,-0.807869 0.0945048,0.847262,-0.522701",
    "conference": """
        T 1610,356,-322 -1,0,0
        R -575,500,-1000 0.786641,-0.0941067,0.610182 0.0743595,0.995562,0.0576792
        H1 -533.061,213.683,-676.824 1,-0.02,0.02
        H2 1496.395,348.980,-108.577 -0.99,-0.12,0.1
        H3 -208.348,321.921,540.850 0.01,-0.1,-1
        A1 1142.43,338.25,-373.87 -0.78177,-0.31073,0.54063
        A2 1142.43,338.25,-373.87 -0.77079,-0.08552,-0.63132
        A3 532.56,320.33,-635.33 -0.99822,-0.01539,-0.05767
        A4 -150.12,336.89,-284.86 -0.09142,0.03621,0.99515
        A5 88.71,355.81,286.23 0.92055,0.03317,-0.38921""",
    "sibenik": """
        T -15,-5,0 1,-0.2,0
        R -17,-13,1 0.995544,0,-0.0941056
        H1 -12.890,-12.090,-2.857 1,-0.02,0.02
        H2 -10.876,-6.047,0.365 0.93,-0.37,-0.01
        H3 9.668,-2.422,-0.440 -0.87,-0.49,0.01
        H4 -14.099,-12.090,-0.440 0.93,-0.06,0.37
        H5 6.445,3.218,0.365 -0.91,-0.41,0.02
        H6 -6.848,-14.104,1.977 0.88,0.4,-0.27
        A1 -11.5633,-10.6024,1.5030 0.95669,-0.04495,-0.28761
        A2 -2.8591,-11.5244,2.9494 0.83873,0.06446,-0.54071
        A3 8.0211,-10.8125,4.8323 0.16667,0.86687,-0.46986
        A4 11.2669,-9.7690,0.5375 -0.74603,0.08974,-0.65984
        A5 9.6579,-9.6065,0.0597 -0.99345,0.01232,0.11363""",
    "sponza": """
        H1 -11.135,2.227,0.558 1,0,0
        R 15.947,8.04172,-5.92896 -0.942806,-0.0768859,0.324262 -0.0597337,0.996246,0.0625436
        H2 -1.037,12.673,0.210 -0.81,-0.59,-0.02
        H3 0.007,7.798,5.433 0.99,-0.10,-0.02
        H4 14.283,2.924,0.210 -1,0.03,-0.03
        H5 -10.439,13.718,1.603 0.91,-0.4,-0.1
        H6 0.355,1.879,5.781 -0.01,0.05,-1""",
}

#: Editions of each scene, the program's own first.
EDITIONS = {
    "bunny": ("bunny",),
    "conference": ("conference", "conference_repaired"),
    "sibenik": ("sibenik", "sibenik_original"),
    "sponza": ("sponza",),
}


class PublishedView(NamedTuple):
    """A scene seen by a camera: the first view of an edition is the program's own."""

    scene: str
    version: str
    camera: str
    seen: Scene


def own_camera(scene: str) -> str:
    """Return the name of the view that is the program's own."""
    return _VIEWS[scene].split()[0]


def views(scene: str, *, only_own: bool = False) -> list[PublishedView]:
    """Return every published view of every edition that is on this machine; of a stand-in its own view alone."""
    found = []
    for version in EDITIONS[scene]:
        loaded = _edition(version)
        if loaded is None or (loaded.stand_in and version != EDITIONS[scene][0]):
            continue
        if loaded.stand_in or only_own:
            found.append(PublishedView(scene, version, "own", loaded))
            if only_own:
                break
            continue
        for line in _VIEWS[scene].strip().splitlines():
            name, *points = line.split()
            eye, direction, *up = (_point(version, text, is_direction=i > 0) for i, text in enumerate(points))
            top = up[0] if up else _point(version, "0,1,0", is_direction=True)
            camera = Camera(eye, tuple(np.add(eye, direction)), top, _FOV[name[0]])
            found.append(PublishedView(scene, version, name, seen_from(loaded, camera, loaded.light)))
    return found


def _edition(version: str) -> Scene | None:
    """Return an edition of a scene; None if it is one that only a folder of scenes holds, and that is not there."""
    if version != "sibenik_original":
        return find_scene(version, notify=lambda sentence: None)
    path = Path(os.environ.get("NPTRACE_SCENES", "")) / f"{version}.ply"
    if not path.is_file():
        return None
    light = find_scene("sibenik", notify=lambda sentence: None).light
    return load_mesh(path)._replace(light=_point(version, ",".join(map(str, light)), is_direction=False))


def _point(version: str, text: str, *, is_direction: bool) -> tuple[float, float, float]:
    """Return a point or a direction in the coordinates of an edition: Dabrovic's Sibenik has z up, and another origin."""
    x, y, z = map(float, text.split(","))
    if version != "sibenik_original":
        return x, y, z
    return (-x, z, y) if is_direction else (7.6 - x, z, y + 15.3)
