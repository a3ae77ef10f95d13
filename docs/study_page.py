"""The functions that cog runs for study.md, from docs/data/study.parquet."""

from collections import Counter
from collections.abc import Sequence
from statistics import median
from typing import Any

from study_data import fits, head, row_name, study
from study_figures import cache_text
from study_fit import fitted

from cachesim.report.table1 import PAPER_N, SCENES, TREES, paper_table
from nptrace.table1_study.analysis import Cause, causes, ranges, split, tornado
from nptrace.table1_study.cameras import SOURCES
from nptrace.table1_study.figures import CACHES, cells, implied, is_plausible
from nptrace.table1_study.fit import (
    summary,
)
from nptrace.table1_study.knobs import BVH, KD, KNOBS, SCENE_KNOBS


def _span(values: Sequence[float], decimals: int = 1) -> str:
    low, high = f"{min(values):.{decimals}f}", f"{max(values):.{decimals}f}"
    return low if low == high else f"{low} to {high}"


def _values(knob: Any, tree: str) -> str:
    default = getattr(study().base, knob.name)
    texts = [f"`{value}`" if value != "" else "" for value in knob.values[tree]]
    return f"**{default or 'default'}** " + " ".join(texts)


def knobs(cog: Any) -> None:
    """Write the table of knobs."""
    head(
        cog,
        ["knob", "values (default in bold; in brackets those that the text contradicts)", "decided at", "why it is open"],
        4,
    )
    for knob in KNOBS:
        default = getattr(study().base, knob.name)
        values = [f"**{default if default != '' else 'default'}**"]
        for tree in (KD, BVH) if knob.values[KD] != knob.values[BVH] else (KD,):
            shown = [f"[`{value}`]" if value in knob.unlikely else f"`{value}`" for value in knob.values[tree]]
            values.append((f"{TREES[tree]}: " if knob.values[KD] != knob.values[BVH] else "") + " ".join(shown))
        cog.outl(f"| {knob.title} (`{knob.name}`) | {'; '.join(values)} | {knob.decided} | {knob.evidence} |")
    for knob in SCENE_KNOBS:
        cog.outl(f"| {knob.title} | `nptrace/table1_study/cameras.py` | {knob.decided} | {knob.evidence} |")


def measured(cog: Any) -> None:
    """Write what was measured."""
    rows = study().rows
    views = {(row["scene"], row["version"], row["camera"]) for row in rows}
    names = [knob.name for knob in KNOBS]
    settings = {(row["tree"], *(row[name] for name in names)) for row in rows}
    kind = "built-in stand-ins, not of the scenes of the paper" if study().is_stand_in else "the real scenes"
    by_scene = Counter(scene for scene, _, _ in views)
    cog.outl(
        f"{len(rows):,} rows of {kind}: {len(settings)} settings, {len(views)} views "
        f"({', '.join(f'{n} of {scene}' for scene, n in sorted(by_scene.items()))}), four caches. "
        f"{sum(is_plausible(row) for row in rows):,} rows are plausible: no knob has a value that the text contradicts."
    )
    if not study().is_stand_in:
        cog.outl("Cameras: " + "; ".join(f"{letter}, {source}" for letter, source in SOURCES.items()) + ".")


def denominator_share(cog: Any) -> None:
    """Write how much of the printed reductions the denominator makes."""
    shares = []
    for row in paper_table().values():
        parts = split(row["miss_ratio"], row["kb_ratio"])
        shares.append(100 * parts.denominator / (parts.denominator + parts.lines))
    below = sum(share < 90 for share in shares)
    cog.outl(
        f"The denominator makes {median(shares):.0f} % of the printed reduction in the median row, {min(shares):.0f} % in the "
        f"least; in {len(shares) - below} of {len(shares)} rows it makes 90 % or more."
    )


def range_table(cog: Any) -> None:
    """Write the range of every cell."""
    head(cog, ["", "A % paper", "ours", "range", "", "B/A % paper", "ours", "range", ""])
    found = {(each.tree, each.scene, each.cache, each.name): each for each in ranges(study(), ["miss_a", "miss_ratio"])}
    for cell in cells():
        line = [row_name(*cell)]
        for name in ("miss_a", "miss_ratio"):
            each = found[(*cell, name)]
            line += [
                f"{each.paper:.1f}",
                f"{each.default:.1f}",
                f"{each.low:.1f} to {each.high:.1f}",
                "in" if each.is_inside else "**out**",
            ]
        cog.outl("| " + " | ".join(line) + " |")


_NAMES = {"miss_a": "miss A", "miss_b": "miss B", "miss_ratio": "B/A", "kb_a": "KB A", "kb_b": "KB B", "kb_ratio": "KB B/A",
          "acpr_a": "ACPR A", "acpr_b": "ACPR B", "acpr_ratio": "ACPR B/A"}  # fmt: skip


def inside(cog: Any) -> None:
    """Write how many cells of each column lie inside, and which do not."""
    found = ranges(study(), list(_NAMES))
    texts = []
    for name, title in _NAMES.items():
        of = [each for each in found if each.name == name]
        texts.append(f"{title} {sum(each.is_inside for each in of)}")
    cog.outl(f"Cells of 32 that lie inside the range, by column: {', '.join(texts)}.")


def movers(cog: Any) -> None:
    """Write which knob moves most groups most."""
    for name, title in (("miss_a", "miss rate A"), ("miss_ratio", "B/A")):
        first = Counter(tornado(study(), tree, scene, name)[0].title for tree in TREES for scene in SCENES)
        texts = [f"{knob} in {n}" for knob, n in first.most_common()]
        cog.outl(f"- The {title} moves most with {', '.join(texts)} of the {sum(first.values())} groups.")


def cause_table(cog: Any) -> None:
    """Write the cause of every row."""
    names = {"miss_a": "miss rate A", "miss_ratio": "B/A"}
    found = {name: {(each.tree, each.scene, each.cache): each for each in causes(study(), name)} for name in names}
    head(cog, ["", "denominator %", "A: off by", "cause", "left", "B/A: off by", "cause", "left"])
    for cell in cells():
        tree, scene, of_cache = cell
        paper = paper_table()[tree, scene, *of_cache]
        parts = split(paper["miss_ratio"], paper["kb_ratio"])
        line = [row_name(*cell), f"{100 * parts.denominator / (parts.denominator + parts.lines):.0f}"]
        for each in (found[name][cell] for name in names):
            line += [f"{each.before - each.paper:+.1f}", _cause(each), f"{each.left:+.1f}"]
        cog.outl("| " + " | ".join(line) + " |")
    for name, title in names.items():
        counts = Counter(each.cause for each in found[name].values())
        left = [abs(each.left) for each in found[name].values()]
        cog.outl("")
        cog.outl(
            f"Causes of the {title}, rows: {', '.join(f'{cause} {n}' for cause, n in counts.most_common())}. "
            f"Left over: {median(left):.1f} points in the median row, {max(left):.1f} in the worst."
        )


def _cause(each: Cause) -> str:
    return f"{each.cause} (`{each.value}`)" if each.knob else "none"


def access_table(cog: Any) -> None:
    """Write access counts and p, the paper's and ours, and what p makes of B/A."""
    names = ["", "A paper", "ours", "range", "p paper", "ours", "range", "1 / (1 + p) %", "B/A printed", "bytes B/A printed"]
    head(cog, names)
    for tree in TREES:
        for scene in SCENES:
            of, paper = study().of_cell(tree, scene, CACHES[0]), implied(tree, scene)
            usual = study().default(tree, scene, CACHES[0])
            counts, p = [row["demand_accesses"] / 1000 for row in of], [row["p"] for row in of]
            printed = [paper_table()[tree, scene, *each] for each in CACHES]
            line = [
                f"{TREES[tree]} {scene}", f"{sum(paper.accesses) / 2000:,.0f}k", f"{usual['demand_accesses'] / 1000:,.0f}k",
                f"{min(counts):,.0f}k to {max(counts):,.0f}k", f"{sum(paper.p) / 2:.3f}", f"{usual['p']:.3f}",
                f"{min(p):.3f} to {max(p):.3f}", f"{100 / (1 + sum(paper.p) / 2):.1f}",
                _span([row["miss_ratio"] for row in printed]), _span([row["kb_ratio"] for row in printed]),
            ]  # fmt: skip
            cog.outl("| " + " | ".join(line) + " |")


def n_and_ratios(cog: Any) -> None:
    """Write what N can be, and the ratio of the trees' accesses."""
    for tree in TREES:
        rays = [sum(implied(tree, scene).accesses) / 2 / PAPER_N[tree] for scene in SCENES]
        ours = [study().default(tree, scene, CACHES[0]) for scene in SCENES]
        per_ray = [f"{row['demand_accesses'] / row['rays']:.1f}" for row in ours]
        cog.outl(
            f"- N = {PAPER_N[tree]:.2f} ({TREES[tree]}): A / N is {', '.join(f'{each / 1000:.1f}k' for each in rays)} "
            f"rays ({', '.join(SCENES)}), a factor of {max(rays) / min(rays):.1f} apart. One picture size with one or two "
            "rays a pixel allows a factor of 2. So N is not the mean of these traces of single rays. Ours, by default: "
            f"{', '.join(per_ray)}."
        )
    texts = []
    for scene in SCENES:
        paper, usual, span = _ratios(scene)
        texts.append(f"{scene} {paper} (ours {usual}, range {span})")
    cog.outl(f"- BVH accesses / kd-tree accesses: {', '.join(texts)}.")


def _ratios(scene: str) -> list[str]:
    """Return the paper's ratio of BVH accesses to those of the kd-tree, ours, and the range over views and rays."""
    paper = [sum(implied(tree, scene).accesses) for tree in (BVH, KD)]
    usual = [study().default(tree, scene, CACHES[0])["demand_accesses"] for tree in (BVH, KD)]
    names = ("version", "camera", "pixels", "order", "batch", "packet", "shadow", "shadow_order", "shadow_end", "light")
    found: dict[tuple[Any, ...], dict[str, set[int]]] = {}
    for tree in (BVH, KD):
        for row in study().of_cell(tree, scene, CACHES[0]):
            found.setdefault(tuple(row[name] for name in names), {}).setdefault(tree, set()).add(row["demand_accesses"])
    both = [of for of in found.values() if len(of) == 2]
    low = min(min(of[BVH]) / max(of[KD]) for of in both)
    high = max(max(of[BVH]) / min(of[KD]) for of in both)
    return [f"{paper[0] / paper[1]:.1f}", f"{usual[0] / usual[1]:.1f}", f"{low:.1f} to {high:.1f}"]


def saving_direct() -> list[tuple[str, str, tuple[int, int]]]:
    """Return the direct-mapped cells that print a saving of lines, whatever their rounding."""
    return [cell for cell in cells() if cell[2][1] == 1 and paper_table()[*cell[:2], *cell[2]]["kb_ratio"] + 0.05 < 100]


def impossible(cog: Any) -> None:
    """Write the rows that no setting can give, and what the traffic bound leaves."""
    texts = [f"{row_name(*cell)}: {paper_table()[*cell[:2], *cell[2]]['kb_ratio']:.1f} %" for cell in saving_direct()]
    direct = [row for row in study().rows if row["ways"] == 1 and row["policy"] == "lru"]
    least = min(row["kb_ratio"] for row in direct if row["kb_ratio"] is not None)
    cog.outl(
        f"- Direct-mapped rows below 100 %: {'; '.join(texts)}. In the {len(direct):,} direct-mapped rows of the study the "
        f"least is {least:.2f} %."
    )
    two = [row for each in CACHES[1::2] for row in study().of_cell(KD, "bunny", each)]
    lowest = min(two, key=lambda row: row["kb_ratio"])
    cog.outl(
        f"- The two-way rows of kd-tree Bunny print {paper_table()[KD, 'bunny', 8192, 2]['kb_ratio']} and "
        f"{paper_table()[KD, 'bunny', 16384, 2]['kb_ratio']} %. No plausible setting comes below {lowest['kb_ratio']:.1f} %."
    )
    for tree in TREES:
        for scene in SCENES:
            of, most = study().of_cell(tree, scene, CACHES[3]), implied(tree, scene).lines
            over = sum(row["lines_touched"] > most for row in of)
            usual = study().default(tree, scene, CACHES[3])["lines_touched"]
            if over:
                cog.outl(
                    f"- {TREES[tree]} {scene}: the row 16K(2) fetches {most:,} lines, and {100 * over / len(of):.0f} % of the "
                    f"plausible settings touch more than that (default {usual:,})."
                )


def claims(cog: Any) -> None:
    """Write the paper's sentences, measured at the default on every published view."""
    base = study().base
    rows = [
        row for row in study().plausible
        if (row["size_bytes"], row["ways"]) == CACHES[0] and not {*row["changed"]} - {"camera", "version"}
    ]  # fmt: skip

    def share(tree: str, over: str, under: str) -> str:
        values = [100 * row[over] / row[under] for row in rows if row["tree"] == tree and row[under]]
        return f"{median(values):.0f} ({_span(values, 0)})"

    def heights(tree: str, kind: str) -> str:
        values = [
            row[f"{kind}_leaf_entries"] / row[f"{kind}_leaves"]
            for row in rows
            if row["tree"] == tree and row[f"{kind}_leaves"]
        ]
        return f"{median(values):.1f} ({_span(values)})"

    head(cog, ["%, median view (range)", "kd-tree, primary", "kd-tree, shadow", "BVH, primary", "BVH, shadow"])
    pairs = [(tree, kind) for tree in (KD, BVH) for kind in ("primary", "shadow")]
    cog.outl(
        "| leaves entered with at most 3 entries on the stack | "
        + " | ".join(share(t, f"{k}_leaves_few", f"{k}_leaves") for t, k in pairs)
        + " |"
    )
    cog.outl("| entries there, mean | " + " | ".join(heights(t, k) for t, k in pairs) + " |")
    cog.outl(
        "| rays that end with entries left | "
        + " | ".join(share(t, f"{k}_ended_with_entries", f"{k}_ended") for t, k in pairs)
        + " |"
    )
    cog.outl("")
    assert base is not None
    for text in _sentences():
        cog.outl(f"- {text}")


def _sentences() -> list[str]:
    found = []
    views = [row for row in study().plausible if not {*row["changed"]} - {"camera", "version"}]
    for tree in TREES:
        of = [row for row in views if row["tree"] == tree]
        kb = [row["kb_ratio"] - 100 for row in of]
        acpr = [100 - row["acpr_ratio"] for row in of]
        demand = {ways: median(row["coverage"] for row in of if row["ways"] == ways) for ways in (1, 2)}
        ratio = {ways: median(100 - row["miss_ratio"] for row in of if row["ways"] == ways) for ways in (1, 2)}
        found.append(
            f'{TREES[tree]}: "overhead is negligible": bytes from memory change by {min(kb):+.1f} to {max(kb):+.1f} %. '
            f'"ACPR decreases by 6-16 %": {min(acpr):.1f} to {max(acpr):.1f} % by the paper\'s equation. "More suitable for '
            f"set-associative caches\": the paper's reduction is {ratio[1]:.1f} % with one way and {ratio[2]:.1f} % with two, "
            f"demand misses fall by {demand[1]:.1f} and {demand[2]:.1f} %."
        )
    return found


def truth(cog: Any) -> None:
    """Write the honest figures knob by knob, at the own view of each scene."""
    of_tree = ("demand misses saved %", "the paper's metric saves %", "accuracy %", "traffic")
    head(
        cog,
        ["knob", *(f"{TREES[tree]}: {of_tree[0]}" if i == 0 else each for tree in TREES for i, each in enumerate(of_tree))],
    )
    names = [("", "default"), *((knob.name, knob.title) for knob in (*KNOBS, *SCENE_KNOBS))]
    for name, title in names:
        if not any(study().alone(tree, scene, CACHES[0], name) for tree in TREES for scene in SCENES):
            continue
        line = [title]
        for tree in TREES:
            rows = [row for scene in SCENES for each in CACHES for row in study().alone(tree, scene, each, name)]
            rows = [row for row in rows if row["prefetches"]]
            if not rows:
                line += ["-"] * 4
                continue
            line += [
                _span([row["coverage"] for row in rows]), _span([100 - row["miss_ratio"] for row in rows]),
                f"{median(row['accuracy'] for row in rows if row['accuracy'] is not None):.0f}",
                f"{median(row['kb_ratio'] for row in rows) / 100:.3f}",
            ]  # fmt: skip
        cog.outl("| " + " | ".join(line) + " |")


def worth(cog: Any) -> None:
    """Write whether any plausible setting makes the scheme worth building."""
    for tree in TREES:
        rows = [row for row in study().plausible if row["tree"] == tree and row["prefetches"] and row["coverage"] is not None]
        best = max(rows, key=lambda row: row["coverage"])
        saved = [row["coverage"] for row in rows]
        above = sum(value > 5 for value in saved)
        setting = ", ".join(f"{name} `{best[name]}`" for name in best["changed"]) or "default"
        where = f"{best['scene']}, {cache_text((best['size_bytes'], best['ways']))}: {setting}"
        printed = median(100 - row["miss_ratio"] for row in rows)
        cog.outl(
            f"- {TREES[tree]}: demand misses fall by {median(saved):.1f} % in the median of {len(rows):,} plausible rows, by "
            f"{best['coverage']:.1f} % at best ({where}); by more than 5 % in {100 * above / len(rows):.0f} % of them. The "
            f"paper's metric prints {printed:.1f} % in the median."
        )


def answer(cog: Any) -> None:
    """Write the findings in sentences."""
    rows = [row for row in study().plausible if row["tree"] == KD and row["prefetches"]]
    found = ranges(study(), ["miss_a", "miss_ratio"])
    n = {name: sum(each.is_inside for each in found if each.name == name) for name in ("miss_a", "miss_ratio")}
    shares = [split(row["miss_ratio"], row["kb_ratio"]) for row in paper_table().values()]
    part = median(100 * each.denominator / (each.denominator + each.lines) for each in shares)
    model = fits().best(**fitted()["B/A to the target"])
    assert model is not None
    at = summary(model.residuals)
    saved = [row["coverage"] for row in rows]
    cog.outl(
        "- **The printed reduction is a change of the denominator.** Prefetches count as accesses; that alone makes "
        f"{part:.0f} % of the reduction in the median row. The lines fetched hardly change."
    )
    cog.outl(
        "- **Most rows are possible.** The paper's miss rate A lies inside our range in "
        f"{n['miss_a']} of 32 rows, its B/A in {n['miss_ratio']}. One model leaves B/A {at.median:.1f} points off in the "
        f"median row, {at.worst:.1f} in the worst."
    )
    names = [row_name(*cell) for cell in saving_direct()]
    cog.outl(
        f"- **{len(names)} rows are not.** {' and '.join(names)} print a saving of lines, and prefetching cannot save "
        "a line in a direct-mapped cache."
    )
    above = sum(value > 5 for value in saved)
    printed = median(100 - row["miss_ratio"] for row in rows)
    cog.outl(
        f"- **The kd-tree's unit saves little under nearly every reading.** It saves {median(saved):.1f} % of the demand "
        f"misses in the median plausible row, where the paper's metric prints {printed:.1f} %; more than 5 % in "
        f"{100 * above / len(rows):.0f} % of the rows. A BVH's unit saves more, because all that waits on its stack is read."
    )
