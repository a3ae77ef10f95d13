"""The functions that cog runs for study.md, from docs/data/study.parquet."""

from collections import Counter
from statistics import median
from typing import Any

from study_causes import n_named, shares
from study_data import Cell, fits, head, row_name, span, study
from study_figures import cache_text
from study_fit import TO_TARGET, fitted, near_models, placebos

from cachesim.report.table1 import PAPER_N, SCENES, TREES, paper_table
from nptrace.table1_study.analysis import CLOSE, NEAR, SIZED, possible, ranges, tornado
from nptrace.table1_study.cameras import SOURCES
from nptrace.table1_study.figures import CACHES, cells, implied, is_plausible
from nptrace.table1_study.fit import is_within_target, summary
from nptrace.table1_study.knobs import BVH, KD, KNOBS, SCENE_KNOBS


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


def agreement(cog: Any) -> None:
    """Write whether the accesses and p of the four rows agree."""
    found = {(tree, scene): implied(tree, scene) for tree in TREES for scene in SCENES}
    same = sum(each.accesses[0] <= each.accesses[1] for each in found.values())
    apart = [f"{TREES[tree]} {scene} by {each.p_gap:.4f}" for (tree, scene), each in found.items() if each.p_gap]
    cog.outl(
        f"Within rounding, A is the same in the four rows of {same} of {len(found)} scenes and trees, and p in "
        f"{len(found) - len(apart)}; the intervals of p miss each other in {', '.join(apart)}."
    )


def range_table(cog: Any) -> None:
    """Write the range of every cell."""
    head(cog, ["", "A % paper", "ours", "range", "", "B/A % paper", "ours", "range", ""])
    names = ["miss_a", "miss_ratio"]
    found = {(each.tree, each.scene, each.cache, each.name): each for each in ranges(study(), names)}
    by_single = {each[:4] for each in ranges(study(), names, single=True) if each.is_inside}
    for cell in cells():
        line = [row_name(*cell)]
        for name in names:
            each = found[(*cell, name)]
            line += [
                f"{each.paper:.1f}",
                f"{each.default:.1f}",
                f"{each.low:.1f} to {each.high:.1f}",
                ("in" if each[:4] in by_single else "packets") if each.is_inside else "**out**",
            ]
        cog.outl("| " + " | ".join(line) + " |")


_NAMES = {"miss_a": "miss A", "miss_b": "miss B", "miss_ratio": "B/A", "kb_a": "KB A", "kb_b": "KB B", "kb_ratio": "KB B/A",
          "acpr_a": "ACPR A", "acpr_b": "ACPR B", "acpr_ratio": "ACPR B/A"}  # fmt: skip


def inside(cog: Any) -> None:
    """Write how many cells of each column lie inside, and how many rows one setting gives."""
    head(cog, ["cells of 32 inside the range", *_NAMES.values()])
    for title, single in (("all rays", False), ("single rays", True)):
        counts = Counter(each.name for each in ranges(study(), list(_NAMES), single=single) if each.is_inside)
        cog.outl(f"| {title} | " + " | ".join(str(counts[name]) for name in _NAMES) + " |")
    every, alone = possible(study()), possible(study(), single=True)
    cog.outl(
        f"\nA range mixes settings. One setting and view gives A within {100 * CLOSE:.0f} % of its value and B/A within "
        f"{NEAR} points in {every.both} rows ({alone.both} by single rays); in {every.sized} ({alone.sized}) of them the "
        f"demand accesses are within {100 * SIZED:.0f} % of the paper's too. For all four caches at once, one setting and "
        f"view gives A and B/A in {every.four} ({alone.four}) of the {len(TREES) * len(SCENES)} scenes and trees."
    )


def movers(cog: Any) -> None:
    """Write which knob moves most groups most, with packets and without."""
    for name, title in (("miss_a", "Miss rate A"), ("miss_ratio", "B/A")):
        swings = [tornado(study(), tree, scene, name) for tree in TREES for scene in SCENES]
        first = Counter(of[0].title for of in swings)
        single = Counter(next(each.title for each in of if each.knob != "packet") for of in swings)
        with_packets, without = (", ".join(f"{knob} {n}" for knob, n in of.most_common()) for of in (first, single))
        cog.outl(
            f"- {title} moves most, in {len(swings)} scenes and trees, with {with_packets}; by single rays with {without}."
        )


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
                span([row["miss_ratio"] for row in printed]), span([row["kb_ratio"] for row in printed]),
            ]  # fmt: skip
            cog.outl("| " + " | ".join(line) + " |")


def n_and_ratios(cog: Any) -> None:
    """Write what N can be, and the ratio of the trees' accesses."""
    pooled = []
    for tree in TREES:
        rays = [sum(implied(tree, scene).accesses) / 2 / PAPER_N[tree] for scene in SCENES]
        ours = [study().default(tree, scene, CACHES[0]) for scene in SCENES]
        per_ray = [f"{row['demand_accesses'] / row['rays']:.1f}" for row in ours]
        pooled.append(sum(rays) / len(rays))
        cog.outl(
            f"- N = {PAPER_N[tree]:.2f} ({TREES[tree]}): A / N is {', '.join(f'{each / 1000:.1f}k' for each in rays)} "
            f"rays ({', '.join(SCENES)}), a factor of {max(rays) / min(rays):.1f} apart, where one picture size with one or "
            f"two rays a pixel allows 2: N is not each scene's own mean. Ours, by default: {', '.join(per_ray)}."
        )
    texts = [f"{each / 1000:.1f}k rays a scene ({TREES[tree]})" for tree, each in zip(TREES, pooled, strict=True)]
    parts = [f"{each / (2 * 128 * 128):.2f}" for each in pooled]
    cog.outl(
        f"- As a mean over all four scenes, N gives {' and '.join(texts)}: {' and '.join(parts)} times 2 x 128 x 128. Both "
        f"trees trace the same rays, and these differ by a factor of {max(pooled) / min(pooled):.1f}: at most one N is that."
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


def outside() -> dict[Cell, list[str]]:
    """Return the rows with a figure that no plausible setting gives, and the columns."""
    found: dict[Cell, list[str]] = {}
    for each in ranges(study(), list(_NAMES)):
        if not each.is_inside:
            found.setdefault((each.tree, each.scene, each.cache), []).append(_NAMES[each.name])
    return found


def _outside() -> str:
    groups: dict[tuple[str, str, str], list[str]] = {}
    for (tree, scene, of_cache), names in outside().items():
        groups.setdefault((tree, scene, ", ".join(names)), []).append(cache_text(of_cache))
    texts = [f"{TREES[tree]} {scene} {' '.join(caches)} ({names})" for (tree, scene, names), caches in groups.items()]
    return f"- {len(outside())} rows have a figure that no measured setting gives: {'; '.join(texts)}."


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
    cog.outl(_outside())
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
        return f"{median(values):.0f} ({span(values, 0)})"

    def heights(tree: str, kind: str) -> str:
        values = [
            row[f"{kind}_leaf_entries"] / row[f"{kind}_leaves"]
            for row in rows
            if row["tree"] == tree and row[f"{kind}_leaves"]
        ]
        return f"{median(values):.1f} ({span(values)})"

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
                span([row["coverage"] for row in rows]), span([100 - row["miss_ratio"] for row in rows]),
                f"{median(row['accuracy'] for row in rows if row['accuracy'] is not None):.0f}",
                f"{median(row['kb_ratio'] for row in rows) / 100:.3f}",
            ]  # fmt: skip
        cog.outl("| " + " | ".join(line) + " |")


def _saved(tree: str) -> tuple[list[float], dict[str, float]]:
    """Return the demand misses saved by default, by scene and cache, and the median of these under each value of one knob."""
    usual = [study().default(tree, scene, each) for scene in SCENES for each in CACHES]
    found: dict[str, list[float]] = {}
    for knob in KNOBS:
        for row in (row for scene in SCENES for each in CACHES for row in study().alone(tree, scene, each, knob.name)):
            if row["prefetches"]:
                found.setdefault(f"{knob.name} `{row[knob.name]}`", []).append(row["coverage"])
    return [row["coverage"] for row in usual], {value: median(of) for value, of in found.items()}


def worth(cog: Any) -> None:
    """Write whether any plausible setting makes the scheme worth building."""
    for tree in TREES:
        rows = [row for row in study().plausible if row["tree"] == tree and row["prefetches"] and row["coverage"] is not None]
        best = max(rows, key=lambda row: row["coverage"])
        setting = ", ".join(f"{name} `{best[name]}`" for name in best["changed"]) or "default"
        where = f"{best['scene']}, {cache_text((best['size_bytes'], best['ways']))}: {setting}"
        usual, by_value = _saved(tree)
        least, most = min(by_value, key=by_value.__getitem__), max(by_value, key=by_value.__getitem__)
        above = sum(value > 5 for value in by_value.values())
        cog.outl(
            f"- {TREES[tree]}: by default, demand misses fall by {span(usual)} % over scenes and caches, "
            f"{median(usual):.1f} % in the median. With one knob changed this median is {by_value[least]:.1f} % ({least}) to "
            f"{by_value[most]:.1f} % ({most}), above 5 % for {above} of {len(by_value)} values. The best of all plausible "
            f"rows: {best['coverage']:.1f} % ({where})."
        )


def answer(cog: Any) -> None:
    """Write the findings in sentences."""
    found, n_groups = list(shares().values()), len(TREES) * len(SCENES)
    every, single = possible(study()), possible(study(), single=True)
    cog.outl(
        "- **The printed reduction is a change of the denominator.** Prefetches count as accesses; that makes 90 % or more of "
        f"the reduction in {sum(share >= 90 for share in found)} of {len(found)} rows. There, the lines fetched hardly change."
    )
    cog.outl(
        f"- **Rows are possible one by one, not together.** The paper's miss rate A lies inside our range in {every.miss_a} "
        f"of 32 rows, its B/A in {every.miss_ratio}; by single rays, as the text has them, in {single.miss_a} and "
        f"{single.miss_ratio}. One setting gives both in {every.both} ({single.both}), and both for all four caches of a "
        f"scene and tree in {every.four} of {n_groups}."
    )
    names = [row_name(*cell) for cell in saving_direct()]
    others = Counter(f"{TREES[tree]} {scene}" for tree, scene, each in outside() if (tree, scene, each) not in saving_direct())
    cog.outl(
        f"- **{len(names)} rows cannot be, {others.total()} more are given by no measured setting.** {' and '.join(names)} "
        "print a saving of lines, and prefetching cannot save a line in a direct-mapped cache. The others: "
        f"{', '.join(f'{name} {n}' for name, n in others.items())}."
    )
    model = fits().best(**fitted()[TO_TARGET])
    assert model is not None
    at, (_, *exchanges) = summary(model.residuals), placebos(TO_TARGET)
    near = sum(is_within_target(each.found) for each in exchanges)
    cog.outl(
        f"- **No cause and no model is identified.** A cause is named for {n_named()} of {2 * n_groups} groups of rows: one "
        f"knob explains exchanged scenes as often. {len(near_models())} of {len(fits()):,} models come within our target of "
        f"B/A, and models of {near} of {len(exchanges)} exchanges do. The nearest leaves {at.median:.1f} points in the median "
        f"row, {at.worst:.1f} in the worst."
    )
    (kd, kd_by_value), (bvh, bvh_by_value) = (_saved(tree) for tree in (KD, BVH))
    cog.outl(
        f"- **The kd-tree's unit saves little under nearly every reading.** By default it saves {span(kd)} % of the demand "
        f"misses, over scenes and caches; their median is at most {max(kd_by_value.values()):.1f} % whichever one knob is "
        f"changed. A BVH's saves {span(bvh)} %, at most {max(bvh_by_value.values()):.1f} %: a primary ray reads all that "
        "waits on its stack."
    )
