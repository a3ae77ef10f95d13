"""Models of Table I by name, found by ``fit`` on the rows of a study: fits, told as such, and never a default."""

from collections.abc import Callable
from typing import Any

from cachesim.report.table1 import SCENES, TREES, paper_table
from nptrace.table1_study.cameras import views
from nptrace.table1_study.figures import figures_of
from nptrace.table1_study.knobs import BVH, KD, Setting
from nptrace.table1_study.measure import rows_of
from nptrace.table1_study.traced import traced
from nptrace_base.tables import Table, number

_RAYS: dict[str, Any] = {"packet": 4, "shadow_order": "cheaper", "shadow_end": "drain", "prefetch": "stack:budget=2"}

#: The setting of each tree. ``paper2013``: B/A within the target of a preset, on all rows, at each scene's own view
#: (docs/study.md). Packets of 4 rays and Manta's shadow rays, two requests a leaf; kd-tree pairs within a line, read once.
PRESETS = {
    "paper2013": {
        KD: Setting(layout="stored+8", reads="merged", **_RAYS),
        BVH: Setting(builder="min_leaf=4", **_RAYS),
    }
}


def table_of(name: str, threads: int, on_run: Callable[[], object]) -> Table:
    """Return Table I under a preset beside the paper's: miss rate A and B/A in per cent, and p."""
    lines, paper = [], paper_table()
    for tree, setting in PRESETS[name].items():
        for scene in SCENES:
            view = views(scene, only_own=True)[0]
            run = traced(view.seen, tree, setting, threads)
            for row in rows_of(run, [setting], {"scene": scene, "tree": tree}, lambda: None):
                ours, wanted = figures_of(row), paper[tree, scene, row["size_bytes"], row["ways"]]
                cells = [
                    text for each in ("miss_a", "miss_ratio") for text in (number(ours[each], 1), number(wanted[each], 1))
                ]
                cache = f"{row['size_bytes'] // 1024}K({row['ways']})"
                lines.append([TREES[tree], view.seen.label, cache, *cells, number(ours["p"], 3)])
            on_run()
    return Table(name, ["tree", "scene", "cache", "miss A %", "paper", "B/A %", "paper", "p"], lines, n_left=3)
