"""Which one model comes nearest to the paper: shared knobs, and a view for each scene; found on some rows, held to others.

A model is one value of every knob that the four scenes share; those of the two trees may differ where a knob is a tree's own.
The camera and the edition of a scene are unknown too, so every model may choose one view per scene, on the rows that it is
fitted to. The loss of a row is the distance of its B/A in points and, by weight, of its miss rate A in octaves.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product
from statistics import mean, median
from typing import Any, NamedTuple

from cachesim.report.table1 import SCENES, TREES, paper_table
from nptrace.table1_study.figures import CACHES, Row, octaves

#: Knobs that are the rays' and the unit's, and so the same for both trees.
SHARED = ("pixels", "order", "batch", "packet", "shadow", "shadow_order", "shadow_end", "light", "prefetch", "flush", "policy")

#: Points of B/A that an octave (a factor of two) of the miss rate A is worth.
WEIGHT = 4.0

Cell = tuple[str, str, tuple[int, int]]
View = tuple[str, str]  # edition, camera


class Residual(NamedTuple):
    """What a model leaves of a row of the table."""

    tree: str
    scene: str
    cache: tuple[int, int]
    ratio: float  # B/A, ours - the paper's, points
    miss: float  # miss rate A, octaves


class Model(NamedTuple):
    """A model, the view of each scene, and what they leave.

    Attributes
    ----------
    shared, own : dict
        Values of the knobs; ``own`` by tree.
    views : dict
        Edition and camera by scene.
    residuals : list of Residual
        Of all 32 rows.
    """

    shared: dict[str, Any]
    own: dict[str, dict[str, Any]]
    views: dict[str, View]
    residuals: list[Residual]


class Summary(NamedTuple):
    """Distances of some rows: of B/A in points, of the miss rate A as a factor."""

    median: float
    worst: float
    factor: float


def summary(residuals: Sequence[Residual]) -> Summary:
    """Return the median and the largest distance of B/A, and the median factor of the miss rate A."""
    points = [abs(each.ratio) for each in residuals]
    return Summary(median(points), max(points), 2 ** median(abs(each.miss) for each in residuals))


#: How near a preset has to come: points of B/A in the median row, and in the worst.
TARGET = (1.5, 4.0)


def beyond_target(points: Sequence[float]) -> float:
    """Return how far distances of B/A are beyond the target: 1 is just within it."""
    return max(median(points) / TARGET[0], max(points) / TARGET[1])


def is_within_target(found: Summary) -> bool:
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
        paper = paper_table()
        #: residuals by shared knobs, tree, the tree's own, scene, view, cache
        self._cells: dict[tuple[Any, ...], dict[str, dict[tuple[Any, ...], dict[tuple[str, View], dict[Any, Residual]]]]] = {}
        for row in rows:
            cache = row["size_bytes"], row["ways"]
            wanted = paper[row["tree"], row["scene"], *cache]
            shared, mine = (tuple(row[name] for name in names) for names in (SHARED, self._own))
            places = self._cells.setdefault(shared, {}).setdefault(row["tree"], {}).setdefault(mine, {})
            found = Residual(
                row["tree"], row["scene"], cache, row["miss_ratio"] - wanted["miss_ratio"],
                octaves(wanted["miss_a"], row["miss_a"]),
            )  # fmt: skip
            places.setdefault((row["scene"], (row["version"], row["camera"])), {})[cache] = found

    def best(
        self, is_known: Callable[[Residual], bool] = lambda residual: True, weight: float = WEIGHT,
        loss: Callable[[Sequence[float]], float] = mean, scenes: Sequence[str] = SCENES,
    ) -> Model | None:  # fmt: skip
        """Return the model of the least loss over the rows that ``is_known`` accepts, of some scenes; None without any.

        Each scene has the view of the least mean; ``loss`` is that of all rows together.
        """
        best: tuple[float, Any] | None = None
        for shared, by_tree in self._cells.items():
            if set(by_tree) != set(TREES):
                continue
            known = {tree: [(own, _losses(place, is_known, weight)) for own, place in by_tree[tree].items()] for tree in TREES}
            for mine in product(*known.values()):
                chosen = _views([losses for _, losses in mine])
                if not set(scenes) <= set(chosen):
                    continue
                value = loss([each for scene in scenes for _, losses in mine for each in losses[scene, chosen[scene]]])
                if best is None or value < best[0]:
                    best = value, (shared, [own for own, _ in mine], chosen)
        return self._model(*best[1]) if best else None

    def _model(self, shared: tuple[Any, ...], mine: Sequence[tuple[Any, ...]], views: dict[str, View]) -> Model:
        places = [self._cells[shared][tree][own] for tree, own in zip(TREES, mine, strict=True)]
        return Model(
            shared=dict(zip(SHARED, shared, strict=True)),
            own={tree: dict(zip(self._own, own, strict=True)) for tree, own in zip(TREES, mine, strict=True)},
            views=views,
            residuals=[each for place in places for view in views.items() for each in place[view].values()],
        )

    def under_every_view(self, model: Model, scene: str) -> list[Summary]:
        """Return what a model leaves of a scene's rows, for each of its views."""
        by_tree = self._cells[tuple(model.shared[name] for name in SHARED)]
        places = [by_tree[tree][tuple(model.own[tree][name] for name in self._own)] for tree in TREES]
        views = [view for of, view in places[0] if of == scene and all((scene, view) in place for place in places)]
        return [summary([each for place in places for each in place[scene, view].values()]) for view in views]


def _losses(
    place: Mapping[tuple[str, View], dict[Any, Residual]], is_known: Callable[[Residual], bool], weight: float
) -> dict[tuple[str, View], list[float]]:
    """Return the losses of the known rows of every scene and view."""
    return {
        where: [abs(each.ratio) + weight * abs(each.miss) for each in rows.values() if is_known(each)]
        for where, rows in place.items()
    }


def _views(losses: Sequence[Mapping[tuple[str, View], list[float]]]) -> dict[str, View]:
    """Return, for each scene, the view of the least loss among those that all have; any where no row is known."""
    found: dict[str, tuple[float, View]] = {}
    for scene, view in losses[0]:
        if all((scene, view) in each for each in losses):
            total = sum(sum(each[scene, view]) for each in losses)
            if scene not in found or total < found[scene][0]:
                found[scene] = total, view
    return {scene: view for scene, (_, view) in found.items()}


def by_cache(*known: tuple[int, int]) -> Callable[[Residual], bool]:
    """Return what accepts the rows of some caches."""
    return lambda residual: residual.cache in known


#: Two halves of the rows of every scene and tree: each has both sizes and both numbers of ways.
HALVES = (CACHES[0], CACHES[3]), (CACHES[1], CACHES[2])


def held_out_by_cache(fits: Fits, **options: Any) -> list[tuple[Model, Summary, Summary]]:
    """Return, for each half of the rows, the model found on it, what it leaves there, and what it leaves of the other half."""
    found = []
    for half in HALVES:
        model = fits.best(by_cache(*half), **options)
        if model is None:
            continue
        inside = [each for each in model.residuals if each.cache in half]
        outside = [each for each in model.residuals if each.cache not in half]
        found.append((model, summary(inside), summary(outside)))
    return found


def held_out_by_scene(fits: Fits, **options: Any) -> dict[str, list[Summary]]:
    """Return, for each scene, what the model found on the other scenes leaves of it, under each of its views."""
    found = {}
    for left_out in SCENES:
        others = [scene for scene in SCENES if scene != left_out]
        model = fits.best(lambda each, others=others: each.scene in others, scenes=others, **options)  # type: ignore[misc]
        if model is not None:
            found[left_out] = fits.under_every_view(model, left_out)
    return found
