"""The nearest models in docs/study.md: what is fitted, how it holds on other rows, and whether it is a preset."""

from dataclasses import replace
from statistics import median
from typing import Any

from study_data import fits, head, study

from cachesim.report.table1 import TREES, paper_table
from nptrace.table1_study.figures import cells, octaves
from nptrace.table1_study.fit import (
    TARGET,
    WEIGHT,
    Model,
    Residual,
    Summary,
    beyond_target,
    held_out_by_cache,
    held_out_by_scene,
    is_within_target,
    summary,
)
from nptrace.table1_study.presets import PRESETS


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


def _told(found: Summary) -> str:
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
    return {"B/A and A": {"weight": WEIGHT}, "B/A to the target": {"weight": 0.0, "loss": beyond_target}}


def fit_table(cog: Any) -> None:
    """Write the nearest models, and how they hold on other rows."""
    head(cog, ["fitted to", "rows", "B/A median", "worst", "A factor", "on other rows: median", "worst", "A factor"], 2)
    cog.outl(f"| nothing (default) | - | {_told(summary(default_residuals()))} | - | - | - |")
    for title, options in fitted().items():
        model = fits().best(**options)
        assert model is not None
        cog.outl(f"| {title} | all | {_told(summary(model.residuals))} | - | - | - |")
        for _, found, other in held_out_by_cache(fits(), **options):
            cog.outl(f"| {title} | half | {_told(found)} | {_told(other)} |")
        for scene, left_out in held_out_by_scene(fits(), **options).items():
            middle = Summary(*(median(getattr(each, name) for each in left_out) for name in Summary._fields))
            cog.outl(f"| {title} | without {scene} | | | | {_told(middle)} |")


def nearest(cog: Any) -> None:
    """Write the nearest models."""
    for title, options in fitted().items():
        model = fits().best(**options)
        assert model is not None
        cog.outl(f"- {title}: {_model(model)}.")


def preset(cog: Any) -> None:
    """Write whether a preset holds."""
    options = fitted()["B/A to the target"]
    model = fits().best(**options)
    assert model is not None
    halves = [is_within_target(found) and is_within_target(other) for _, found, other in held_out_by_cache(fits(), **options)]
    left_out = held_out_by_scene(fits(), **options)
    some = {scene: sum(is_within_target(each) for each in of) for scene, of in left_out.items()}
    texts = [f"{scene} {some[scene]} of {len(of)}" for scene, of in left_out.items()]
    on_all = "is" if is_within_target(summary(model.residuals)) else "is not"
    cog.outl(
        f"The target is B/A within {TARGET[0]} points in the median row and {TARGET[1]:.0f} in the worst. It {on_all} met on "
        f"all rows; found on half of them it holds on the other half in {sum(halves)} of {len(halves)} halves. Found without "
        f"a scene, it holds there under so many of its measured views: {', '.join(texts)}."
    )
    found = {tree: replace(study().base, **model.shared, **model.own[tree]) for tree in TREES}
    named = next((name for name, settings in PRESETS.items() if settings == found), None)
    if named is not None and all(halves):
        cog.outl(f"\nThat model is the preset `{named}`: `npcache table1 --preset {named}` prints its 32 rows.")
