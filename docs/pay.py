"""The functions that cog runs for does-it-pay.md, from docs/data/rays.csv, compare.csv and map.parquet.

``python docs/pay.py MAP.parquet`` keeps the columns of a map that the page needs, as docs/data/map.parquet.
"""

import csv
import sys
from statistics import median

import pyarrow.parquet as pq
from figures import DATA

TREES = {"kdtree": "kd-tree, 8-byte nodes", "bvh": "BVH, 32-byte nodes", "bvh64": "BVH, 64-byte nodes"}
UNIT, PUSH, BOUND = "stack:unlimited", "push", "perfect"
NAMES = {UNIT: "the paper's unit", PUSH: "at the push", "ttp": "TTP's rule", BOUND: "bound"}


def _rows(name: str) -> list[dict[str, str]]:
    with open(DATA / name, encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def _range(values: list[float], decimals: int = 2) -> str:
    """Return the least and the most of some values."""
    low, high = f"{min(values):.{decimals}f}", f"{max(values):.{decimals}f}"
    return low if low == high else f"{low} to {high}"


def _speed_ups(rows: list[dict[str, str]], **wanted: str) -> list[float]:
    return [float(row["speed_up"]) for row in rows if all(row[name] == value for name, value in wanted.items())]


def answer(cog) -> None:
    """Write the finding in sentences."""
    rays, compared = _rows("rays.csv"), _rows("compare.csv")
    for tree, title in TREES.items():
        unit, push = (_range(_speed_ups(rays, tree=tree, prefetch=name, rays="1")) for name in (UNIT, PUSH))
        many = _range(_speed_ups(rays, tree=tree, prefetch=PUSH, rays="64"))
        cheap = [_without_unit(compared, run, 1.1) for run in _runs(compared, tree)]
        text = (
            f"- **{title}.** One ray in flight: the paper's unit gives {unit}x, a request at the push {push}x; with 64 rays "
        )
        text += f"in flight, the push gives {many}x. "
        found = [row for row in cheap if row]
        if found:
            gains = _range([float(row["speed_up"]) for row in found])
            text += (
                f"{_OTHER_MACHINE}a longer line or another layout, the fastest of each scene, gives {gains}x without any unit"
            )
            text += f"; the best single one for all scenes: {one_for_all(tree)}."
        cog.outl(text)


def unit_gives(tree: str) -> str:
    """Return the speed-ups of the paper's unit, one ray in flight, as a range over the scenes."""
    return f"{_range(_speed_ups(_rows('rays.csv'), tree=tree, prefetch=UNIT, rays='1'))}x"


#: rays.csv is of 64 MSHRs, which 64 rays in flight need, and compare.csv of the machine's own.
_OTHER_MACHINE = "In a comparison of its own, with 16 MSHRs and at no more than 1.1 of the bytes, "


def one_for_all(tree: str) -> str:
    """Return the gain of the best single line and layout for all scenes of a tree, at no more than 1.1 of the bytes."""
    cases: dict[tuple[str, str], list[dict[str, str]]] = {}
    rows = _rows("compare.csv")
    for row in rows:
        if (row["tree"], row["group"], row["prefetch"]) == (tree, "baseline", "none") and float(row["traffic_ratio"]) <= 1.1:
            cases.setdefault((row["line_bytes"], row["layout"]), []).append(row)
    whole = {
        case: [float(row["speed_up"]) for row in own] for case, own in cases.items() if len(own) == len(_runs(rows, tree))
    }
    if not whole:
        return "none"
    (line, layout), gains = max(whole.items(), key=lambda each: median(each[1]))
    return f"{_range(gains)}x ({line} B, `{layout}`)"


def most_without_unit(tree: str) -> float:
    """Return the largest speed-up of a scene without a unit, at no more than 1.1 of the bytes."""
    rows = _rows("compare.csv")
    found = [_without_unit(rows, run, 1.1) for run in _runs(rows, tree)]
    return max(float(row["speed_up"]) for row in found if row)


def _runs(rows: list[dict[str, str]], tree: str) -> list[str]:
    return list(dict.fromkeys(row["run"] for row in rows if row["tree"] == tree))


def _without_unit(rows: list[dict[str, str]], run: str, most: float) -> dict[str, str] | None:
    """Return the fastest baseline without prefetches whose traffic is at most ``most`` times that of the reference."""
    found = [
        row for row in rows
        if (row["run"], row["group"], row["prefetch"]) == (run, "baseline", "none") and float(row["traffic_ratio"]) <= most
    ]  # fmt: skip
    return max(found, key=lambda row: float(row["speed_up"]), default=None)


def by_rays(cog) -> None:
    """Write the speed-ups by rays in flight, the range over the four scenes."""
    rows = _rows("rays.csv")
    counts = list(dict.fromkeys(row["rays"] for row in rows))
    cog.outl("| | prefetch | " + " | ".join(f"{n} ray{'s' * (n != '1')}" for n in counts) + " |")
    cog.outl("| --- | --- |" + " ---: |" * len(counts))
    for tree, title in TREES.items():
        for prefetch in dict.fromkeys(row["prefetch"] for row in rows if row["tree"] == tree):
            cells = [_range(_speed_ups(rows, tree=tree, prefetch=prefetch, rays=n)) for n in counts]
            cog.outl(f"| {title} | {NAMES.get(prefetch, f'`{prefetch}`')} | " + " | ".join(cells) + " |")


def policies(cog) -> None:
    """Write all policies, one ray in flight: the median speed-up of each tree, and traffic, accuracy and requests of BVHs."""
    rows = [row for row in _rows("compare.csv") if row["group"] == "policy"]
    cog.outl("| prefetch | " + " | ".join(TREES.values()) + " | traffic | accuracy % | requests / read |")
    cog.outl("| --- |" + " ---: |" * 6)
    names = list(dict.fromkeys(row["prefetch"] for row in rows))
    for name in sorted(names, key=lambda name: -median(_speed_ups(rows, prefetch=name, tree="bvh"))):
        own = [row for row in rows if row["prefetch"] == name and row["tree"] == "bvh"]
        cells = [f"{median(_speed_ups(rows, prefetch=name, tree=tree)):.3f}" for tree in TREES]
        accuracy = [100 * float(row["accuracy"]) for row in own if row["accuracy"]]
        cells += [f"{median(float(row['traffic_ratio']) for row in own):.2f}", f"{median(accuracy):.0f}" if accuracy else "-"]
        cells.append(f"{median(float(row['requests_per_read']) for row in own):.2f}")
        cog.outl(f"| `{name}` | " + " | ".join(cells) + " |")


def baselines(cog) -> None:
    """Write, for each run, the fastest cache and layout that needs no unit, and what the units add to it."""
    rows = _rows("compare.csv")
    cog.outl("| run | most bytes | line, layout | speed-up | bytes | with the paper's unit | with the push |")
    cog.outl("| --- | ---: | --- | ---: | ---: | ---: | ---: |")
    for run in dict.fromkeys(row["run"] for row in rows):
        for most in (1.1, 9.0):
            best = _without_unit(rows, run, most)
            if best is None:
                continue
            same = {"run": run, "group": "baseline", "line_bytes": best["line_bytes"], "layout": best["layout"]}
            added = [_speed_ups(rows, **same, prefetch=name)[0] for name in (UNIT, PUSH)]
            limit = f"{most}" if most < 9 else "any"
            cells = [f"{value:.2f}" for value in (float(best["speed_up"]), float(best["traffic_ratio"]), *added)]
            cog.outl(f"| {run} | {limit} | {best['line_bytes']} B, `{best['layout']}` | " + " | ".join(cells) + " |")


def the_map(cog) -> None:
    """Write the map in short: by tree, policy and rays in flight, and its verdict."""
    from cachesim.report import map_tables
    from nptrace_base.tables import to_markdown

    rows = pq.read_table(DATA / "map.parquet").to_pylist()
    [table], notes = map_tables.tables(rows)
    cog.outl(f"{len(rows):,} cells: " + ", ".join(_extent(rows, name) for name in _VARIED) + ".\n")
    cog.outl(to_markdown([table], []))
    for sentence in notes[len(map_tables.NOTES) :]:
        cog.outl(f"- {sentence}")


_VARIED = {"scene": "scenes", "tree": "trees", "leaf": "leaf sizes", "triangle": "triangle tests", "miss": "miss latencies",
           "rays": "numbers of rays in flight"}  # fmt: skip


def _extent(rows, name: str) -> str:
    return f"{len({row[name] for row in rows})} {_VARIED[name]}"


def replication(cog) -> None:
    """Write the cells of the map that are closest to TTP's replication: a triangle a leaf, test 8, miss 100 and 300."""
    rows = pq.read_table(DATA / "map.parquet").to_pylist()
    for tree in ("bvh", "bvh64"):
        for rays in (1, 4, 16, 64):
            values = [
                row["speed_up"] for row in rows
                if row["tree"] == tree and row["prefetch"] == UNIT and row["rays"] == rays
                and (row["leaf"], row["triangle"]) == (1, 8) and row["miss"] in (100, 300)
            ]  # fmt: skip
            mean = sum(values) / len(values)
            plural = "s" * (rays != 1)
            figures = f"mean {mean:.3f}x, best {max(values):.3f}x, least {min(values):.3f}x"
            cog.outl(f"- {TREES[tree]}, {rays} ray{plural} in flight: {figures}")


def keep(path: str) -> None:
    """Write the columns of a map that are needed here."""
    names = ["scene", "tree", "leaf", "size_bytes", "ways", "prefetch", "triangle", "miss", "rays", "speed_up"]
    pq.write_table(pq.read_table(path, columns=names), DATA / "map.parquet", compression="zstd")


if __name__ == "__main__":
    keep(*sys.argv[1:])
