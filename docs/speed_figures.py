"""The tables of docs/performance.md, from the files under docs/data/ that the benches write."""

import json

from figures import DATA, rows_of


def machine(cog) -> None:
    """Write the machine, the versions and the scenes of docs/performance.md."""
    facts = json.loads((DATA / "machine.json").read_text(encoding="utf-8"))
    cog.outl("| " + " | ".join(facts) + " |")
    cog.outl("|" + " --- |" * len(facts))
    cog.outl("| " + " | ".join(facts.values()) + " |")


def goals(cog) -> None:
    """Write every figure of ``make bench`` that has a goal, or belongs to one."""
    cog.outl("| | least | median | largest | goal | |")
    cog.outl("| --- |" + " ---: |" * 4 + " --- |")
    for row in rows_of("bench.csv"):
        verdict = "**not met**" if row["verdict"] == "not met" else row["verdict"]
        cog.outl(f"| {row['what']} | {row['least']} | {row['median']} | {row['largest']} | {row['goal']} | {verdict} |")


def spread(cog, name: str) -> None:
    """Write figures without goals: ``savings`` or ``tried``."""
    cog.outl("| | least | median | largest |")
    cog.outl("| --- |" + " ---: |" * 3)
    for row in rows_of(f"{name}.csv"):
        cog.outl(f"| {row['what']} | {row['least']} | {row['median']} | {row['largest']} |")


def scaling(cog) -> None:
    """Write cost and memory by the size of the picture."""
    columns = ("rays", "accesses", "bytes")
    stages = "render, ns/access | replay, ns/access | render, us/ray | memory of render, MB | memory of replay, MB"
    cog.outl(f"| pixels | rays | accesses | trace, MB | {stages} |")
    cog.outl("| ---: |" + " ---: |" * 8)
    for row in rows_of("scaling.csv"):
        rays, accesses, n_bytes = (int(row[name]) for name in columns)
        cells = [f"{row['pixels a side']}²", f"{rays:,}", f"{accesses:,}", f"{n_bytes / 1e6:.0f}"]
        cells += [f"{float(row[stage]) * 1e9 / accesses:.1f}" for stage in ("render s", "replay s")]
        cells += [f"{float(row['render s']) * 1e6 / rays:.2f}"]
        cells += [f"{float(row[stage]):.0f}" for stage in ("render MB", "replay MB")]
        cog.outl("| " + " | ".join(cells) + " |")


#: The builds of large scenes, and what they are called.
BUILDS = {
    "bvh": "BVH", "bvh 2": "BVH, two threads", "kdtree": "kd-tree", "kdtree 2": "kd-tree, two threads", "embree": "Embree"
}  # fmt: skip


def large(cog) -> None:
    """Write time and memory of the builders by the size of the scene, beside Embree's."""
    rows = rows_of("large.csv")
    times = " | ".join(f"{title}, s" for title in BUILDS.values())
    cog.outl(f"| triangles | {times} | BVH, B/triangle | kd-tree, B/triangle |")
    cog.outl("| ---: |" + " ---: |" * (len(BUILDS) + 2))
    for n in dict.fromkeys(row["triangles"] for row in rows):
        of = {row["build"]: row for row in rows if row["triangles"] == n}
        cells = [f"{float(of[build]['wall s']):.3g}" for build in BUILDS]
        for tree in ("bvh", "kdtree"):
            most = max(float(of[build]["bytes per triangle"]) for build in (tree, f"{tree} 2"))
            cells.append(f"{most:.0f}")
        cog.outl(f"| {int(n):,} | {' | '.join(cells)} |")
