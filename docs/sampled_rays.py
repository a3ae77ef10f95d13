"""What cog writes into docs/speed-error.md about the clock on a sample of the rays, from docs/data/clock_error.csv."""

import statistics
from collections.abc import Sequence

from figures import rows_of

TREES = {"kdtree": "kd-tree", "bvh": "BVH", "bvh64": "BVH, 64 B"}
PREFETCHES = {"stack": "the paper's unit", "push": "at the push"}

#: The method that the second table and the sentence are about.
METHOD, PARTS = "every piece in", "8"


def _errors(rows: Sequence[dict[str, str]], name: str) -> list[str]:
    """Return median and largest error, bias, half-width, and how often the interval held."""
    middle = statistics.median(float(row[f"{name}_median_error"]) for row in rows)
    worst = max(float(row[f"{name}_worst_error"]) for row in rows)
    bias = statistics.mean(float(row[f"{name}_bias"]) for row in rows)
    half_width = statistics.median(float(row[f"{name}_half_width"]) for row in rows)
    held = sum(int(row[f"{name}_held"]) for row in rows) / sum(int(row["samples"]) for row in rows)
    return [f"{middle:.2f} / {worst:.1f}", f"{bias:+.2f}", f"{half_width:.2f}", f"{100 * held:.1f}"]


def methods(cog) -> None:
    """Write time, errors and intervals of every method."""
    rows = rows_of("clock_error.csv")
    figures = ("error", "bias", "half-width", "held %")
    cog.outl("| sample | of | time | speed-up: " + " | ".join(figures) + " | cycles / ray: " + " | ".join(figures) + " |")
    cog.outl("| --- | ---: |" + " ---: |" * 9)
    for method, parts in dict.fromkeys((row["method"], row["parts"]) for row in rows):
        of = [row for row in rows if (row["method"], row["parts"]) == (method, parts)]
        share = statistics.median(float(row["time_share"]) for row in of)
        cells = [*_errors(of, "speed_up"), *_errors(of, "cycles")]
        cog.outl(f"| {method} | 1/{parts} | {share:.2f} | " + " | ".join(cells) + " |")


def held_out(cog) -> None:
    """Write how often intervals hold where nothing was chosen by what is found."""
    rows = [row for row in rows_of("clock_error_held_out.csv") if row["method"] == METHOD]
    found = []
    for parts in dict.fromkeys(row["parts"] for row in rows):
        of = [row for row in rows if row["parts"] == parts]
        held = sum(int(row["speed_up_held"]) for row in of) / sum(int(row["samples"]) for row in of)
        found.append(f"{100 * held:.1f} % (1/{parts})")
    at_16 = [row for row in rows if row["parts"] == PARTS and row["rays"] == "16"]
    worst = sum(int(row["speed_up_held"]) for row in at_16) / sum(int(row["samples"]) for row in at_16)
    cog.outl(
        f"There the intervals of the speed-up hold in {', '.join(found)} of the samples; with 16 rays in flight in "
        f"{100 * worst:.1f} % (1/{PARTS})."
    )


def cells(cog) -> None:
    """Write errors of the speed-up by tree, policy and rays in flight, for one method."""
    rows = [row for row in rows_of("clock_error.csv") if (row["method"], row["parts"]) == (METHOD, PARTS)]
    counts = list(dict.fromkeys(row["rays"] for row in rows))
    cog.outl("| tree | prefetch | " + " | ".join(f"{n} ray{'s' * (n != '1')}" for n in counts) + " |")
    cog.outl("| --- | --- |" + " ---: |" * len(counts))
    for tree, prefetch in dict.fromkeys((row["tree"], row["prefetch"]) for row in rows):
        of = [row for row in rows if (row["tree"], row["prefetch"]) == (tree, prefetch)]
        texts = []
        for n in counts:
            some = [row for row in of if row["rays"] == n]
            error, _, half_width, held = _errors(some, "speed_up")
            texts.append(f"{error}, {half_width}, {held}")
        cog.outl(f"| {TREES[tree]} | {PREFETCHES[prefetch]} | " + " | ".join(texts) + " |")
