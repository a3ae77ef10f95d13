"""Models of Table I by name, found by the study's fit on its rows: fits, told as such, and never a default.

A fit shows that numbers are possible. It does not identify the model: exchanged values of the scenes are met too.
"""

from dataclasses import fields
from typing import Any

from nptrace.table1_study.knobs import BVH, KD, Setting

#: What sentences call the trees.
TREES = {KD: "kd-tree", BVH: "BVH"}
_RAYS: dict[str, Any] = {"packet": 4, "shadow_order": "cheaper", "shadow_end": "drain", "prefetch": "stack:budget=2"}

#: The setting of each tree. ``paper2013``: B/A within the target of a preset, on all rows, at each scene's own view
#: (docs/study.md). Packets of 4 rays and Manta's shadow rays, two requests a leaf; kd-tree pairs within a line, read once.
PRESETS = {
    "paper2013": {
        KD: Setting(layout="stored+8", reads="merged", **_RAYS),
        BVH: Setting(builder="min_leaf=4", **_RAYS),
    }
}


def note(name: str) -> str:
    """Return what a preset is, to stand below its rows."""
    usual, trees = Setting(), {}
    for tree, setting in PRESETS[name].items():
        values = {each.name: getattr(setting, each.name) for each in fields(Setting)}
        trees[TREES[tree]] = ", ".join(f"{knob} {value}" for knob, value in values.items() if value != getattr(usual, knob))
    return (
        f"{name} is a fit of B/A, not of A, and not what the paper describes: it shows that such B/A are possible, not how "
        "they were made. " + "; ".join(f"{tree}: {text}" for tree, text in trees.items()) + "."
    )
