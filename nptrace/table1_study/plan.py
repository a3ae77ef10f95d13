"""What is measured: every knob alone at each scene's own view, then the plausible combinations at every published view."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import product
from typing import Any, NamedTuple

from cachesim.report.table1 import SCENES, TREES
from nptrace.table1_study.cameras import PublishedView, views
from nptrace.table1_study.knobs import BVH, KD, KNOBS, RENDERED, REPLAYED, Setting


class StudyJob(NamedTuple):
    """One run, and the settings under which it is replayed; their rendered knobs are the same."""

    view: PublishedView
    tree: str
    settings: tuple[Setting, ...]

    @property
    def of_run(self) -> dict[str, Any]:
        """The columns that say which run it is."""
        view = self.view
        return {
            "scene": view.scene, "version": view.version, "stand_in": view.seen.stand_in, "camera": view.camera,
            "tree": self.tree,
        }  # fmt: skip


class Combination(NamedTuple):
    """Values of several knobs, all of which are combined with each other; a mapping sets several knobs at once.

    Attributes
    ----------
    own_only : bool
        Measured at a scene's own view alone.
    """

    trees: tuple[str, ...]
    own_only: bool
    values: dict[str, tuple[Any, ...]]


#: The unit, with what a reader of the paper may take it for.
_USUAL_UNITS = ("stack:unlimited", "stack:unlimited:once", "stack:unlimited:restart", "stack:tris*1", "stack:tris*2",
                "stack:budget=1", "stack:budget=2")  # fmt: skip
_UNITS = (*_USUAL_UNITS[:5], "stack:tris*4", *_USUAL_UNITS[5:])

_TILES: dict[str, Any] = {"order": "tile", "batch": 64}
#: Pixels, order, batch and packets: single rays; those of Manta's tiles; its packets, in small pictures and in its own.
_RAYS: tuple[dict[str, Any], ...] = (
    {}, _TILES, {"packet": 4}, _TILES | {"packet": 64, "pixels": 256}, _TILES | {"packet": 64, "pixels": 512}
)  # fmt: skip
#: Shadow rays of hardware, and Manta's.
_SHADOWS: tuple[dict[str, Any], ...] = ({}, {"shadow_order": "cheaper", "shadow_end": "drain"})

COMBINATIONS = (
    Combination(
        (KD,), True,
        {
            "rays": _RAYS, "shadows": _SHADOWS, "builder": ("", "coarse", "min_leaf=4"),
            "layout": ("stored", "stored+8", "stored+16"), "reads": ("own", "merged"),
            "prefetch": (*_UNITS, "stack:unlimited:empty"),
        },
    ),
    Combination(
        (BVH,), True,
        {
            "rays": _RAYS, "shadows": _SHADOWS, "builder": ("", "min_leaf=4"), "reads": ("own", "children"),
            "prefetch": _UNITS,
        },
    ),
    Combination(
        (KD,), False,
        {
            "rays": _RAYS[:2], "builder": ("", "coarse"), "layout": ("stored", "stored+8"), "reads": ("own", "merged"),
            "prefetch": (*_USUAL_UNITS, "stack:unlimited:empty"),
        },
    ),
    Combination((BVH,), False, {"rays": _RAYS[:2], "reads": ("own", "children"), "prefetch": _USUAL_UNITS}),
)  # fmt: skip

#: For a test of the whole chain: two scenes, and on one of them the first values of some knobs.
QUICK_SCENES = ("bunny", "sponza")
_QUICK = ("batch", "builder", "layout", "reads", "prefetch", "flush")


def plan(*, quick: bool = False) -> list[StudyJob]:
    """Return the jobs, the most important first."""
    base = Setting(pixels=32) if quick else Setting()
    jobs: list[StudyJob] = []
    for scene in QUICK_SCENES if quick else SCENES:
        own = views(scene, only_own=quick)[0]
        for tree in TREES:
            jobs += _jobs(own, tree, one_at_a_time(base, tree, first_only=quick) if scene == "sponza" or not quick else [base])
    if quick:
        return jobs
    for is_own in (True, False):
        for scene, tree in product(SCENES, TREES):
            of = views(scene)
            for view in of[:1] if is_own else of[1:]:
                jobs += _jobs(view, tree, combined(base, tree, is_own=is_own))
    return _merged(jobs)


def one_at_a_time(base: Setting, tree: str, *, first_only: bool = False) -> Iterator[Setting]:
    """Yield ``base``, and it with another value of one knob."""
    yield base
    for knob in KNOBS:
        if first_only and knob.name not in _QUICK:
            continue
        for value in knob.values[tree][: 1 if first_only else None]:
            yield replace(base, **{knob.name: value})


def combined(base: Setting, tree: str, *, is_own: bool) -> Iterator[Setting]:
    """Yield the plausible combinations for a tree, at a scene's own view or at another."""
    for combination in COMBINATIONS:
        if tree not in combination.trees or (combination.own_only and not is_own):
            continue
        for values in product(*combination.values.values()):
            given: dict[str, Any] = {}
            for name, value in zip(combination.values, values, strict=True):
                given |= value if isinstance(value, dict) else {name: value}
            yield replace(base, **given)


def _jobs(view: PublishedView, tree: str, settings: Iterable[Setting]) -> list[StudyJob]:
    """Return a job for each run that the settings need."""
    runs: dict[tuple[Any, ...], dict[Setting, None]] = {}
    for setting in settings:
        runs.setdefault(tuple(getattr(setting, name) for name in RENDERED), {})[setting] = None
    return [StudyJob(view, tree, tuple(group)) for group in runs.values()]


def _merged(jobs: Iterable[StudyJob]) -> list[StudyJob]:
    """Return the jobs with those of the same run joined, each setting once."""
    found: dict[tuple[Any, ...], StudyJob] = {}
    for job in jobs:
        key = (job.view.version, job.view.camera, job.tree, *(getattr(job.settings[0], name) for name in RENDERED))
        have = found.get(key)
        settings = dict.fromkeys((*(have.settings if have else ()), *job.settings))
        found[key] = StudyJob(job.view, job.tree, tuple(settings))
    return list(found.values())


def varied(setting: Setting, base: Setting) -> tuple[str, ...]:
    """Return the knobs in which two settings differ."""
    return tuple(name for name in (*RENDERED, *REPLAYED) if getattr(setting, name) != getattr(base, name))
