"""Which one model comes nearest to the paper: shared knobs, and a view for each scene; found on some rows, held to others.

A model is one value of every knob that the four scenes share; those of the two trees may differ where a knob is a tree's own.
The camera and the edition of a scene are unknown too, so every model may choose one view per scene, on the rows that it is
fitted to. The loss of a row is the distance of its B/A in points and, by weight, of its miss rate A in octaves. What such a
search is worth, ``placebo`` tells: it fits the same runs to the paper's values of other scenes.
"""

from collections.abc import Callable, Iterable, Sequence
from itertools import permutations, product
from statistics import median
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cachesim.report.cases import Row
from cachesim.report.table1 import SCENES, TREES, paper_table
from nptrace.table1_study.figures import CACHES, octaves

#: Knobs that are the rays' and the unit's, and so the same for both trees.
SHARED = ("pixels", "order", "batch", "packet", "shadow", "shadow_order", "shadow_end", "light", "prefetch", "flush", "policy")

#: Points of B/A that an octave (a factor of two) of the miss rate A is worth.
WEIGHT = 4.0

#: Every way to give each scene the paper's values of a scene; the first gives each its own.
LABELS = tuple(dict(zip(SCENES, order, strict=True)) for order in permutations(SCENES))

CacheSize = tuple[int, int]
SceneView = tuple[str, str]  # edition, camera
Floats = NDArray[np.float64]


class Residual(NamedTuple):
    """What a model leaves of a row of the table."""

    tree: str
    scene: str
    cache: CacheSize
    ratio: float  # B/A, ours - the paper's, points
    miss: float  # miss rate A, octaves


class Model(NamedTuple):
    """A model, the view of each scene, and what they leave.

    Attributes
    ----------
    number : int
        Its place among the models.
    shared, own : dict
        Values of the knobs; ``own`` by tree.
    views : dict
        Edition and camera by scene, of those that it was fitted to.
    residuals : list of Residual
        Of all rows of these scenes.
    loss : float
        That of the rows that it was fitted to.
    """

    number: int
    shared: dict[str, Any]
    own: dict[str, dict[str, Any]]
    views: dict[str, SceneView]
    residuals: list[Residual]
    loss: float


class RowDistances(NamedTuple):
    """Distances of some rows: of B/A in points, of the miss rate A as a factor."""

    median: float
    worst: float
    factor: float


def summary(residuals: Sequence[Residual]) -> RowDistances:
    """Return the median and the largest distance of B/A, and the median factor of the miss rate A."""
    points = [abs(each.ratio) for each in residuals]
    return RowDistances(median(points), max(points), 2 ** median(abs(each.miss) for each in residuals))


#: How near a preset has to come: points of B/A in the median row, and in the worst.
TARGET = (1.5, 4.0)


def mean_loss(losses: Floats) -> Floats:
    """Return the mean over the last axis."""
    found: Floats = losses.mean(axis=-1)
    return found


def beyond_target(points: Floats) -> Floats:
    """Return how far distances of B/A, along the last axis, are beyond the target: 1 is just within it."""
    found: Floats = np.maximum(np.median(points, axis=-1) / TARGET[0], points.max(axis=-1) / TARGET[1])
    return found


def is_within_target(found: RowDistances) -> bool:
    """Return whether some rows are as near as a preset has to come."""
    return found.median <= TARGET[0] and found.worst <= TARGET[1]


class Fits:
    """All models of a study's rows.

    Parameters
    ----------
    rows : sequence of mapping
        With their figures (``figures.read_rows``); only plausible ones.
    own : sequence of str
        Names of the knobs that a tree has for itself.
    """

    def __init__(self, rows: Iterable[Row], own: Sequence[str]) -> None:
        self._own = tuple(own)
        #: place of a tree's run and replay by shared knobs, tree, the tree's own, scene and view
        places: dict[tuple[Any, ...], dict[str, dict[tuple[Any, ...], dict[tuple[str, SceneView], int]]]] = {}
        figures: list[dict[CacheSize, tuple[float, float]]] = []
        for row in rows:
            shared, mine = (tuple(row[name] for name in names) for names in (SHARED, self._own))
            of = places.setdefault(shared, {}).setdefault(row["tree"], {}).setdefault(mine, {})
            place = of.setdefault((row["scene"], (row["version"], row["camera"])), len(figures))
            if place == len(figures):
                figures.append({})
            figures[place][row["size_bytes"], row["ways"]] = row["miss_ratio"], row["miss_a"]
        self._figures = np.array([[each[cache] for cache in CACHES] for each in figures])  # place, cache, B/A and A
        self._models: list[tuple[tuple[Any, ...], tuple[tuple[Any, ...], ...]]] = []
        candidates: dict[str, list[tuple[int, ...]]] = {scene: [] for scene in SCENES}
        self._views: dict[str, list[SceneView]] = {scene: [] for scene in SCENES}
        for shared, by_tree in places.items():
            for mine in product(*(by_tree.get(tree, {}) for tree in TREES)):
                first, *others = (by_tree[tree][of_tree] for tree, of_tree in zip(TREES, mine, strict=True))
                for (scene, view), place in first.items():
                    if all((scene, view) in each for each in others):
                        candidates[scene].append((len(self._models), place, *(each[scene, view] for each in others)))
                        self._views[scene].append(view)
                self._models.append((shared, mine))
        #: model, and place by tree, of each view of a scene
        self._candidates = {
            scene: np.array(of, dtype=np.int64).reshape(-1, 1 + len(TREES)) for scene, of in candidates.items()
        }

    def __len__(self) -> int:
        """Return the number of models."""
        return len(self._models)

    def best(self, *, labels: dict[str, str] = LABELS[0], **options: Any) -> Model | None:
        """Return the model of the least loss over the rows of some caches and scenes; None without any.

        Each scene has the view of the least mean; ``loss`` is that of all rows together. A scene is held to the paper's values
        of the scene that ``labels`` names.
        """
        total, chosen = self._search(labels, **options)
        number = int(total.argmin()) if total.size else 0
        return self._model(number, total, chosen, labels) if np.isfinite(total).any() else None

    def within(self, most: float, *, labels: dict[str, str] = LABELS[0], **options: Any) -> list[Model]:
        """Return all models whose loss is at most ``most``, as ``best`` computes it."""
        total, chosen = self._search(labels, **options)
        return [self._model(int(number), total, chosen, labels) for number in np.flatnonzero(total <= most)]

    def _search(
        self, labels: dict[str, str], caches: Sequence[CacheSize] = CACHES, scenes: Sequence[str] = SCENES,
        weight: float = WEIGHT, loss: Callable[[Floats], Floats] = mean_loss,
    ) -> tuple[Floats, dict[str, NDArray[np.int64]]]:  # fmt: skip
        """Return the loss of every model, infinite if a scene was not measured, and its candidate for each scene."""
        chosen, losses = {}, []
        for scene in scenes:
            of_view = self._losses(scene, labels[scene], weight)[:, :, [CACHES.index(each) for each in caches]]
            models, by_row = self._candidates[scene][:, 0], of_view.reshape(len(of_view), -1)
            order = np.lexsort((by_row.sum(axis=1), models))
            found, first = np.unique(models[order], return_index=True)
            chosen[scene] = np.full(len(self), -1)
            chosen[scene][found] = order[first]
            of_model = np.full((len(self), by_row.shape[1]), np.inf)
            of_model[found] = by_row[order[first]]
            losses.append(of_model)
        return loss(np.concatenate(losses, axis=1)), chosen

    def _losses(self, scene: str, label: str, weight: float) -> Floats:
        """Return the loss of each view of a scene, by tree and cache, against the paper's values of scene ``label``."""
        ours = self._figures[self._candidates[scene][:, 1:]]
        rows = [[paper_table()[tree, label, *cache] for cache in CACHES] for tree in TREES]
        ratio, miss = (np.array([[row[name] for row in of] for of in rows]) for name in ("miss_ratio", "miss_a"))
        found: Floats = np.abs(ours[..., 0] - ratio) + weight * np.abs(np.log2(ours[..., 1] / miss))
        return found

    def _model(self, number: int, total: Floats, chosen: dict[str, NDArray[np.int64]], labels: dict[str, str]) -> Model:
        shared, mine = self._models[number]
        candidates = {scene: int(of[number]) for scene, of in chosen.items()}
        return Model(
            number=number,
            shared=dict(zip(SHARED, shared, strict=True)),
            own={tree: dict(zip(self._own, own, strict=True)) for tree, own in zip(TREES, mine, strict=True)},
            views={scene: self._views[scene][place] for scene, place in candidates.items()},
            residuals=[each for scene, place in candidates.items() for each in self._residuals(scene, place, labels[scene])],
            loss=float(total[number]),
        )

    def _residuals(self, scene: str, candidate: int, label: str) -> list[Residual]:
        found = []
        for tree, place in zip(TREES, self._candidates[scene][candidate, 1:], strict=True):
            for cache, (ratio, miss) in zip(CACHES, self._figures[place].tolist(), strict=True):
                paper = paper_table()[tree, label, *cache]
                found.append(Residual(tree, scene, cache, ratio - paper["miss_ratio"], octaves(paper["miss_a"], miss)))
        return found

    def under_every_view(self, model: Model, scene: str, labels: dict[str, str] = LABELS[0]) -> list[RowDistances]:
        """Return what a model leaves of a scene's rows, for each of its views."""
        of_model = np.flatnonzero(self._candidates[scene][:, 0] == model.number)
        return [summary(self._residuals(scene, int(each), labels[scene])) for each in of_model]


#: Two halves of the rows of every scene and tree: each has both sizes and both numbers of ways.
HALVES = (CACHES[0], CACHES[3]), (CACHES[1], CACHES[2])


def held_out_by_cache(fits: Fits, **options: Any) -> list[tuple[Model, RowDistances, RowDistances]]:
    """Return, for each half of the rows, the model found on it, what it leaves there, and what it leaves of the other half."""
    found = []
    for half in HALVES:
        model = fits.best(caches=half, **options)
        if model is None:
            continue
        inside = [each for each in model.residuals if each.cache in half]
        outside = [each for each in model.residuals if each.cache not in half]
        found.append((model, summary(inside), summary(outside)))
    return found


def held_out_by_scene(fits: Fits, labels: dict[str, str] = LABELS[0], **options: Any) -> dict[str, list[RowDistances]]:
    """Return, for each scene, what the model found on the other scenes leaves of it, under each of its views."""
    found = {}
    for left_out in SCENES:
        others = [scene for scene in SCENES if scene != left_out]
        model = fits.best(scenes=others, labels=labels, **options)
        if model is not None:
            found[left_out] = fits.under_every_view(model, left_out, labels)
    return found


class Placebo(NamedTuple):
    """What the same search finds when the paper's values are those of other scenes.

    Attributes
    ----------
    labels : dict
        The scene whose values each scene has.
    found : RowDistances
        What the nearest model leaves.
    loss : float
        Its loss.
    held : int
        Scenes of which a model found on the others is within the target under every view of its own.
    """

    labels: dict[str, str]
    found: RowDistances
    loss: float
    held: int


def placebo(fits: Fits, **options: Any) -> list[Placebo]:
    """Return what the search finds with each of ``LABELS``, that with the own values first."""
    made = []
    for labels in LABELS:
        model = fits.best(labels=labels, **options)
        if model is not None:
            left_out = held_out_by_scene(fits, labels, **options)
            held = sum(all(map(is_within_target, of)) for of in left_out.values() if of)
            made.append(Placebo(labels, summary(model.residuals), model.loss, held))
    return made
