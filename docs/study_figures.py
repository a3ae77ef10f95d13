"""``python docs/study_figures.py STUDY.parquet``: the figures of study.md, as docs/study-*.svg and .png."""

import sys
from pathlib import Path

from cachesim.report.pictures import COLOURS, drawn
from cachesim.report.table1 import SCENES, TREES, paper_table
from nptrace.table1_study.analysis import StudyRows, ranges, tornado
from nptrace.table1_study.figures import read_rows

HERE = Path(__file__).parent
#: Ours, the paper's, and what is neither; they differ in grey too.
OURS, PAPER, QUIET = COLOURS[0], COLOURS[1], "#888888"
MARKS = dict(zip(SCENES, "osD^", strict=True))
_KNOBS = 8  # bars of a panel


def cache_text(cache: tuple[int, int]) -> str:
    """Return a cache as the paper writes it."""
    return f"{cache[0] // 1024}K({cache[1]})"


def draw_ranges(study: StudyRows, path: Path) -> None:
    """Draw, for every row of the table, our range and default, and the paper's value."""
    panels_of = {"miss_a": "miss rate A (%)", "miss_ratio": "miss rate B/A (%)"}
    with drawn(path, 7.2, 6.4) as figure:
        panels = figure.subplots(2, 2, squeeze=False)
        for line, tree in zip(panels, TREES, strict=True):
            for panel, (name, title) in zip(line, panels_of.items(), strict=True):
                found = [each for each in ranges(study, [name]) if each.tree == tree]
                for y, each in enumerate(found):
                    panel.plot([each.low, each.high], [y, y], color=OURS, lw=4, alpha=0.35, solid_capstyle="butt")
                panel.plot([each.default for each in found], range(len(found)), "|", color=OURS, ms=8, mew=2, label="default")
                panel.plot([each.paper for each in found], range(len(found)), "D", color=PAPER, ms=4, label="paper")
                panel.set_yticks(range(len(found)), [f"{each.scene} {cache_text(each.cache)}" for each in found], fontsize=6)
                panel.invert_yaxis()
                if name == "miss_a":
                    panel.set_xscale("log")
                    panel.set_xticks([1, 2, 5, 10, 20, 50], ["1", "2", "5", "10", "20", "50"])
                panel.set_xlabel(title)
                panel.set_title(TREES[tree], loc="left")
        panels[0, 0].legend(frameon=False, loc="lower left", bbox_to_anchor=(0, 1.08), ncols=2)


def draw_tornado(study: StudyRows, path: Path, name: str, unit: str) -> None:
    """Draw, for each scene and tree, how far each knob alone moves a figure."""
    with drawn(path, 7.2, 7.6) as figure:
        panels = figure.subplots(len(SCENES), len(TREES), squeeze=False, sharex=True)
        for line, scene in zip(panels, SCENES, strict=True):
            for panel, tree in zip(line, TREES, strict=True):
                swings = tornado(study, tree, scene, name)[:_KNOBS]
                for y, swing in enumerate(swings):
                    panel.barh(y, swing.width, left=swing.low, color=OURS, height=0.7)
                panel.axvline(0, color="black", lw=0.8)
                panel.set_yticks(range(len(swings)), [swing.title for swing in swings], fontsize=6)
                panel.invert_yaxis()
                panel.set_title(f"{TREES[tree]}, {scene}", loc="left", fontsize=8)
        figure.supxlabel(unit, fontsize=8)


def draw_truth(study: StudyRows, path: Path) -> None:
    """Draw what the paper's metric saves against the demand misses that are saved, for every plausible setting."""
    with drawn(path, 7.2, 4.0) as figure:
        panels = figure.subplots(1, 2, sharex=True, sharey=True)
        for panel, tree in zip(panels, TREES, strict=True):
            rows = [row for row in study.plausible if row["tree"] == tree and row["miss_ratio"] is not None]
            for scene, colour in zip(SCENES, COLOURS, strict=False):
                of = [row for row in rows if row["scene"] == scene]
                x, y = [100 - row["miss_ratio"] for row in of], [row["coverage"] for row in of]
                panel.plot(x, y, MARKS[scene], color=colour, ms=2, alpha=0.25, mew=0, label=scene, rasterized=True)
            printed = [100 - row["miss_ratio"] for key, row in paper_table().items() if key[0] == tree]
            panel.axvspan(min(printed), max(printed), color=PAPER, alpha=0.15, lw=0)
            panel.axline((0, 0), slope=1, color="black", lw=0.8)
            panel.axhline(0, color=QUIET, lw=0.6)
            panel.set_title(TREES[tree])
        figure.supxlabel(
            "reduction of the miss rate as the paper counts it (%); shaded: what the paper prints; line: both alike",
            fontsize=8,
        )
        figure.supylabel("demand misses saved (%)", fontsize=8)
        for mark in panels[0].legend(frameon=False, loc="lower right").legend_handles:
            mark.set(alpha=1, markersize=4)


def main(path: str) -> None:
    """Draw all."""
    study = StudyRows(read_rows(Path(path)))
    in_octaves, in_points = (f"{name} from the default, the median of the four caches" for name in ("octaves", "points"))
    for ending in (".svg", ".png"):
        draw_ranges(study, HERE / f"study-ranges{ending}")
        draw_tornado(study, HERE / f"study-tornado-a{ending}", "miss_a", f"miss rate A: {in_octaves}")
        draw_tornado(study, HERE / f"study-tornado-ba{ending}", "miss_ratio", f"B/A: {in_points}")
        draw_truth(study, HERE / f"study-truth{ending}")


if __name__ == "__main__":
    main(*sys.argv[1:])
