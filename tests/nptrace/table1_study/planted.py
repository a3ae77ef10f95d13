"""Rows of a study whose figures are planted, for tests of its analysis."""

import itertools

from cachesim.report.table1 import paper_table
from nptrace.table1_study.cameras import EDITIONS, own_camera
from nptrace.table1_study.figures import figures_of


def counts(tree, miss_a, miss_ratio, kb_ratio, accesses=1_000_000):
    """Return the counts that give these figures."""
    misses = miss_a / 100 * accesses
    fills = misses * kb_ratio / 100
    prefetches = accesses * (kb_ratio / miss_ratio - 1)
    return {"tree": tree, "demand_accesses": accesses, "prefetches": prefetches, "misses_a": misses, "demand_misses": fills,
            "prefetch_misses": 0, "useful": 0, "useless": 0, "resident": 0, "pollution": 0, "rays": 1000,
            "lines_touched": 1}  # fmt: skip


def planted(off, *, settings, views_of=lambda scene: [(EDITIONS[scene][0], own_camera(scene))], factor=lambda setting: 1):
    """Return rows of these settings and views whose B/A differs from the paper's by ``off(setting, view, key)`` points.

    Their A is the paper's times ``factor(setting)``.
    """
    made = []
    for (tree, scene, size, ways), paper in paper_table().items():
        for setting, view in itertools.product(settings, views_of(scene)):
            by = off(setting, view, (tree, scene, (size, ways)))
            row = counts(tree, paper["miss_a"] * factor(setting), paper["miss_ratio"] + by, paper["kb_ratio"])
            row |= {"scene": scene, "version": view[0], "camera": view[1], "stand_in": False, "size_bytes": size, "ways": ways}
            row |= setting.columns()
            made.append({**row, **figures_of(row)})
    return made
