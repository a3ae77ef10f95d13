"""The nearest models in docs/study.md: what is fitted, how it holds on other rows, and whether it is a preset."""

from dataclasses import replace
from functools import cache
from typing import Any

from study_data import fits, head, span, study

from cachesim.report.table1 import TREES, paper_table
from nptrace.table1_study.figures import cells, octaves
from nptrace.table1_study.fit import (
    TARGET,
    WEIGHT,
    Model,
    Placebo,
    Residual,
    RowDistances,
    beyond_target,
    held_out_by_cache,
    held_out_by_scene,
    is_within_target,
    placebo,
    summary,
)
from nptrace.table1_study.presets import PRESETS

#: The fit of the preset.
TO_TARGET = "B/A to the target"


def _model(model: Model) -> str:
    base = study().base
    shared = [f"{name} `{value}`" for name, value in model.shared.items() if value != getattr(base, name)]
    own = [
        f"{TREES[tree]} {name} `{value}`"
        for tree in TREES
        for name, value in model.own[tree].items()
        if value != getattr(base, name)
    ]
    views = [f"{version} {camera}" for version, camera in model.views.values()]
    return f"{', '.join([*shared, *own]) or 'every default'}; views {', '.join(views)}"


def _told(found: RowDistances) -> str:
    return f"{found.median:.1f} | {found.worst:.1f} | {found.factor:.2f}"


def default_residuals() -> list[Residual]:
    """Return how far the default is from every row."""
    found = []
    for tree, scene, each in cells():
        row, paper = study().default(tree, scene, each), paper_table()[tree, scene, *each]
        found.append(
            Residual(tree, scene, each, row["miss_ratio"] - paper["miss_ratio"], octaves(paper["miss_a"], row["miss_a"]))
        )
    return found


def fitted() -> dict[str, dict[str, Any]]:
    """Return what is fitted."""
    return {"B/A and A": {"weight": WEIGHT}, TO_TARGET: {"weight": 0.0, "loss": beyond_target}}


@cache
def near_models() -> list[Model]:
    """Return all models within the target of a preset."""
    return fits().within(1.0, **fitted()[TO_TARGET])


@cache
def placebos(title: str) -> list[Placebo]:
    """Return what a fit finds with the paper's values of each scene given to another; the first with the own ones."""
    return placebo(fits(), **fitted()[title])


def _values(models: list[Model]) -> dict[str, set[Any]]:
    """Return the values of each knob in some models, a tree's own under its name."""
    found: dict[str, set[Any]] = {}
    for model in models:
        own = {f"{TREES[tree]} {name}": value for tree in TREES for name, value in model.own[tree].items()}
        for name, value in (model.shared | own).items():
            found.setdefault(name, set()).add(value)
    return found


def fit_table(cog: Any) -> None:
    """Write the nearest models, how they hold on other rows, and what the same search finds when figures are exchanged."""
    names = ["fitted to", "figures", "B/A median", "worst", "A factor", "other half: median", "worst"]
    head(cog, [*names, "left-out scene: median", "worst", "within the target", "scenes held"], 2)
    cog.outl(f"| nothing (default) | own | {_told(summary(default_residuals()))} | | | | | | |")
    for title, options in fitted().items():
        own, *others = placebos(title)
        halves = [other for _, _, other in held_out_by_cache(fits(), **options)]
        left_out = [each for of in held_out_by_scene(fits(), **options).values() for each in of]
        held_out = [f"{span([each.median for each in of])} | {span([each.worst for each in of])}" for of in (halves, left_out)]
        is_near = "yes" if is_within_target(own.found) else "no"
        cog.outl(f"| {title} | own | {_told(own.found)} | {' | '.join(held_out)} | {is_near} | {own.held} |")
        spans = [span([getattr(each.found, name) for each in others]) for name in RowDistances._fields]
        near, held = sum(is_within_target(each.found) for each in others), [each.held for each in others]
        cog.outl(
            f"| {title} | exchanged | {' | '.join(spans)} | | | | | {near} of {len(others)} | {span(held, 0)}, mean "
            f"{sum(held) / len(held):.1f} |"
        )
    texts = []
    for title in fitted():
        own, *others = placebos(title)
        texts.append(f"{1 + sum(each.loss < own.loss for each in others)} of {1 + len(others)} ({title})")
    cog.outl(f"\nBy its loss, the fit to the own figures is number {' and '.join(texts)}.")


def nearest(cog: Any) -> None:
    """Write the nearest models."""
    for title, options in fitted().items():
        model = fits().best(**options)
        assert model is not None
        cog.outl(f"- {title}: {_model(model)}.")


def preset(cog: Any) -> None:
    """Write whether a preset holds, and what that is worth."""
    options = fitted()[TO_TARGET]
    model = fits().best(**options)
    assert model is not None
    halves = [is_within_target(found) and is_within_target(other) for _, found, other in held_out_by_cache(fits(), **options)]
    left_out = held_out_by_scene(fits(), **options)
    texts = [f"{scene} {sum(map(is_within_target, of))} of {len(of)}" for scene, of in left_out.items()]
    on_all = "is" if is_within_target(summary(model.residuals)) else "is not"
    cog.outl(
        f"The target is B/A within {TARGET[0]} points in the median row and {TARGET[1]:.0f} in the worst. It {on_all} met on "
        f"all rows; found on half of them it holds on the other half in {sum(halves)} of {len(halves)} halves. Found without "
        f"a scene, it holds there under so many of its measured views: {', '.join(texts)}."
    )
    near, values = near_models(), _values(near_models())
    differ = [f"{name} ({len(of)} values)" for name, of in values.items() if len(of) > 1]
    cog.outl(
        f"\n{len(near)} of {len(fits()):,} models are within the target. They differ in {', '.join(differ) or 'nothing'}."
    )
    found = {tree: replace(study().base, **model.shared, **model.own[tree]) for tree in TREES}
    named = next((name for name, settings in PRESETS.items() if settings == found), None)
    if named is not None and all(halves):
        cog.outl(
            f"\nThat model is the preset `{named}`: `npcache table1 --preset {named}` prints its 32 rows. It shows that such "
            "B/A are possible, not that the paper's were made so."
        )
