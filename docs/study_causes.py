"""The causes in docs/study.md: what the denominator makes of every row, and whether one knob explains what is left."""

from collections.abc import Sequence
from functools import cache
from statistics import median
from typing import Any

from study_data import Cell, head, span, study

from cachesim.report.table1 import SCENES, TREES, paper_table
from nptrace.table1_study.analysis import Causes, causes, split
from nptrace.table1_study.figures import CACHES, cells
from nptrace.table1_study.fit import LABELS


def shares() -> dict[Cell, float]:
    """Return how much of the printed reduction the denominator makes, in per cent, by row of the table."""
    found = {}
    for tree, scene, of_cache in cells():
        row = paper_table()[tree, scene, *of_cache]
        parts = split(row["miss_ratio"], row["kb_ratio"])
        found[tree, scene, of_cache] = 100 * parts.denominator / (parts.denominator + parts.lines)
    return found


def denominator_share(cog: Any) -> None:
    """Write how much of the printed reductions the denominator makes."""
    found = list(shares().values())
    below = sum(share < 90 for share in found)
    cog.outl(
        f"The denominator makes {median(found):.0f} % of the printed reduction in the median row, {min(found):.0f} % in the "
        f"least; in {len(found) - below} of {len(found)} rows it makes 90 % or more."
    )


_CAUSES = {"miss_a": "A", "miss_ratio": "B/A"}


@cache
def _causes(name: str) -> Causes:
    return causes(study(), name)


def n_named(names: Sequence[str] = tuple(_CAUSES)) -> int:
    """Return for how many scenes, trees and figures a cause is named."""
    found = [_causes(name).cause(tree, scene) for name in names for tree in TREES for scene in SCENES]
    return sum(each not in ("not identified", "default") for each in found)


def cause_tables(cog: Any) -> None:
    """Write, of each figure, how often one value explains a scene, and the nearest value of each scene and tree."""
    for name, title in _CAUSES.items():
        found, n = _causes(name), len(TREES) * len(SCENES)
        with_own = found.count(LABELS[0])
        with_other = sum(
            found.explains(tree, scene, label) for tree in TREES for scene in SCENES for label in SCENES if label != scene
        )
        cog.outl(
            f"**{title}**: one value explains {with_own} of {n} with the own figures, {with_other} of {n * (len(SCENES) - 1)} "
            f"with those of another scene. {100 * found.chance:.0f} % of the {len(LABELS)} ways explain as many. Causes "
            f"named: {n_named([name])}.\n"
        )
        share = ["denominator %"] if name == "miss_ratio" else []
        head(cog, ["", *share, "off by", "cause: nearest value", "left", "worst", "with others' figures"])
        for tree in TREES:
            for scene in SCENES:
                cog.outl(f"| {TREES[tree]} {scene} | " + " | ".join(_line(found, name, tree, scene)) + " |")
        left = [abs(by) for tree in TREES for scene in SCENES for by in found.found[tree, scene, scene].left.values()]
        cog.outl(f"\nLeft: {median(left):.1f} points in the median row, {max(left):.1f} in the worst.\n")


def _line(found: Causes, name: str, tree: str, scene: str) -> list[str]:
    own = found.found[tree, scene, scene]
    others = [found.found[tree, scene, label].after for label in SCENES if label != scene]
    share = [" ".join(f"{shares()[tree, scene, of_cache]:.0f}" for of_cache in CACHES)] if name == "miss_ratio" else []
    off, left = (" ".join(f"{of[of_cache]:+.1f}" for of_cache in CACHES) for of in (own.off, own.left))
    value = f"{own.knob} `{own.value}`" if own.knob else "default"
    return [*share, off, f"{found.cause(tree, scene)}: {value}", left, f"{own.after:.1f}", span(others)]
