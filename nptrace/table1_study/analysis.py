"""A study's rows -> what becomes of each row of Table I: ranges, the knob that moves it most, and whether one explains it."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from statistics import median
from typing import Any, NamedTuple

from cachesim.report.cases import Row
from cachesim.report.table1 import SCENES, TREES, paper_table
from nptrace.table1_study.cameras import EDITIONS, own_camera
from nptrace.table1_study.figures import CACHES, cells, implied, is_inside, is_plausible, octaves, setting_of, span_of
from nptrace.table1_study.fit import LABELS
from nptrace.table1_study.knobs import KNOBS, SCENE_KNOBS, Setting

#: What a knob stands for in the causes of a row.
CAUSES = {
    "pixels": "resolution", "order": "order of rays", "batch": "order of rays", "packet": "packets", "shadow": "shadow rays",
    "shadow_order": "shadow rays", "shadow_end": "shadow rays", "builder": "tree", "light": "shadow rays",
    "layout": "conflicts", "reads": "what is read", "prefetch": "prefetch unit", "flush": "flush", "policy": "conflicts",
    "camera": "camera", "version": "edition of the scene",
}  # fmt: skip


class StudyRows:
    """The rows of a study, with their figures, and what differs from the default in each.

    Attributes
    ----------
    rows : list of mapping
        All of them; each has ``changed``, the names of the knobs, of the scene too, that have another value.
    plausible : list of mapping
        Those that count in ranges.
    """

    def __init__(self, rows: Iterable[Row]) -> None:
        given = list(rows)
        sides = {row["pixels"] for row in given}
        self.base = Setting() if Setting().pixels in sides else Setting(pixels=min(sides))
        self.rows: list[Row] = [{**row, "changed": self._changed(row)} for row in given]
        self.plausible = [row for row in self.rows if is_plausible(row)]
        self.is_stand_in = any(row["stand_in"] for row in given)
        self._cells: dict[tuple[str, str, tuple[int, int]], list[Row]] = {cell: [] for cell in cells()}
        for row in self.plausible:
            self._cells[row["tree"], row["scene"], (row["size_bytes"], row["ways"])].append(row)
        self._alone: dict[tuple[Any, ...], list[Row]] = {}
        for cell, rows_of_cell in self._cells.items():
            for row in rows_of_cell:
                if len(row["changed"]) < 2:
                    self._alone.setdefault((*cell, *row["changed"]), []).append(row)

    def _changed(self, row: Row) -> tuple[str, ...]:
        usual = {"version": EDITIONS[row["scene"]][0], "camera": "own" if row["stand_in"] else own_camera(row["scene"])}
        if row["camera"] == "own":
            usual["camera"] = "own"
        names = [each.name for each in KNOBS if row[each.name] != getattr(self.base, each.name)]
        return (*names, *(name for name, value in usual.items() if row[name] != value))

    def alone(self, tree: str, scene: str, cache: tuple[int, int], knob: str = "") -> list[Row]:
        """Return the plausible rows of a row of the table in which ``knob`` alone differs; of "", in which nothing does."""
        return self._alone.get((tree, scene, cache, knob) if knob else (tree, scene, cache), [])

    def of_cell(self, tree: str, scene: str, cache: tuple[int, int], *, single: bool = False) -> list[Row]:
        """Return the plausible rows of a row of the table; of single rays alone if ``single``."""
        rows = self._cells[tree, scene, cache]
        return [row for row in rows if row["packet"] == 1] if single else rows

    def default(self, tree: str, scene: str, cache: tuple[int, int]) -> Row:
        """Return the row of the program's default."""
        return self.alone(tree, scene, cache)[0]


class Range(NamedTuple):
    """The values of one figure of one row of the table over all plausible settings and views."""

    tree: str
    scene: str
    cache: tuple[int, int]
    name: str
    default: float
    low: float
    high: float
    paper: float
    is_inside: bool


def ranges(study: StudyRows, names: Sequence[str], *, single: bool = False) -> list[Range]:
    """Return the ranges of some figures for all rows of the table; those of single rays alone if ``single``."""
    found = []
    for (tree, scene, cache), name in ((cell, name) for cell in cells() for name in names):
        of = study.of_cell(tree, scene, cache, single=single)
        low, high = span_of(of, name)
        paper = paper_table()[tree, scene, *cache][name]
        default = study.default(tree, scene, cache)[name]
        found.append(Range(tree, scene, cache, name, default, low, high, paper, is_inside(paper, name, low, high)))
    return found


class Swing(NamedTuple):
    """How far one knob alone moves a figure of a scene and tree: the median over the four caches."""

    knob: str
    title: str
    low: float
    high: float

    @property
    def width(self) -> float:
        """From the least to the largest."""
        return self.high - self.low


def tornado(study: StudyRows, tree: str, scene: str, name: str) -> list[Swing]:
    """Return the swings of all knobs, the widest first: of ``miss_a`` in octaves from the default, of others in points."""
    found = []
    for knob in (*KNOBS, *SCENE_KNOBS):
        moves: dict[Any, list[float]] = {}
        for cache in CACHES:
            default = study.default(tree, scene, cache)[name]
            for row in study.alone(tree, scene, cache, knob.name):
                if row[name] is not None:
                    move = octaves(default, row[name]) if name == "miss_a" else row[name] - default
                    moves.setdefault(row[knob.name], []).append(move)
        if moves:
            middle = [0.0, *(median(values) for values in moves.values())]
            found.append(Swing(knob.name, knob.title, min(middle), max(middle)))
    return sorted(found, key=lambda swing: -swing.width)


class Nearest(NamedTuple):
    """The one value of one knob that brings a figure nearest to the paper's in all four caches of a scene and tree at once.

    Attributes
    ----------
    label : str
        The scene whose values the paper's are taken to be: ``scene``, or another as a placebo.
    knob, value : str
        "" if no value does better than the default.
    off, left : dict
        Ours - the paper's in points, by cache: by default, and under the value.
    before, after : float
        The largest distance of the four caches, by default and under the value: of ``miss_a`` in octaves, of others in points.
    """

    tree: str
    scene: str
    name: str
    label: str
    knob: str
    value: str
    off: dict[tuple[int, int], float]
    left: dict[tuple[int, int], float]
    before: float
    after: float

    @property
    def is_near(self) -> bool:
        """Whether the default leaves nothing to explain."""
        return max(map(abs, self.off.values())) <= NEAR


#: The default explains what is this near, in points: other settings change the figure by as much without a reason.
NEAR = 0.5
#: A value explains a scene if it leaves at most this part of the default's distance,
LESS = 0.5
#: and causes are named if fewer than this part of all ways to exchange the scenes' values explains as many.
CHANCE = 0.05


def nearest(study: StudyRows, tree: str, scene: str, name: str, label: str) -> Nearest:
    """Return the value of one knob that brings a figure of a scene nearest to the paper's values of scene ``label``."""
    paper = {cache: paper_table()[tree, label, *cache][name] for cache in CACHES}
    found: dict[tuple[str, str], dict[tuple[int, int], float]] = {}
    for knob in ("", *(each.name for each in (*KNOBS, *SCENE_KNOBS))):
        for cache in CACHES:
            for row in study.alone(tree, scene, cache, knob):
                if row[name] is not None:
                    found.setdefault((knob, str(row[knob]) if knob else ""), {})[cache] = row[name]
    far = {
        key: max(abs(octaves(paper[cache], ours) if name == "miss_a" else ours - paper[cache]) for cache, ours in of.items())
        for key, of in found.items()
        if len(of) == len(CACHES)
    }
    best = min(far, key=lambda key: far[key])
    off, left = ({cache: of[cache] - paper[cache] for cache in CACHES} for of in (found["", ""], found[best]))
    return Nearest(tree, scene, name, label, *best, off, left, far["", ""], far[best])


class Causes(NamedTuple):
    """What one knob explains of a figure, in every scene and tree, with the paper's own values and with those of other scenes.

    Attributes
    ----------
    found : dict
        By tree, scene and label.
    """

    found: dict[tuple[str, str, str], Nearest]

    def explains(self, tree: str, scene: str, label: str) -> bool:
        """Return whether a value halves the distance to the values of ``label``, and leaves less than of any other scene's."""
        of = self.found[tree, scene, label]
        others = [self.found[tree, scene, each].after for each in SCENES if each != label]
        return not of.is_near and of.after <= LESS * of.before and of.after < min(others)

    def count(self, labels: Mapping[str, str]) -> int:
        """Return how many scenes and trees are explained if the paper's values of each scene are those of its label."""
        return sum(self.explains(tree, scene, labels[scene]) for tree in TREES for scene in SCENES)

    @property
    def chance(self) -> float:
        """The part of all ways to exchange the scenes' values that explains at least as many as the own ones, among them."""
        counts = [self.count(labels) for labels in LABELS]
        return sum(count >= counts[0] for count in counts) / len(counts)

    def cause(self, tree: str, scene: str) -> str:
        """Return what explains a scene: a cause, "default", or "not identified"."""
        of = self.found[tree, scene, scene]
        if of.is_near:
            return "default"
        is_named = self.chance < CHANCE and self.explains(tree, scene, scene)
        return CAUSES[of.knob] if is_named else "not identified"


def causes(study: StudyRows, name: str) -> Causes:
    """Return what one knob explains of a figure."""
    return Causes(
        {
            (tree, scene, label): nearest(study, tree, scene, name, label)
            for tree, scene, label in product(TREES, SCENES, SCENES)
        }
    )


class Possible(NamedTuple):
    """How many rows of the table a study's settings give: of 32, and of the 8 scenes and trees.

    Attributes
    ----------
    miss_a, miss_ratio : int
        Rows whose value lies inside the range.
    both : int
        Rows that one setting and view gives: A within ``CLOSE`` of its value, and B/A within ``NEAR`` points.
    sized : int
        Those of them whose demand accesses are within ``SIZED`` of what the paper's rows imply too.
    four : int
        Scenes and trees whose four caches one setting and view gives, whatever its accesses.
    """

    miss_a: int
    miss_ratio: int
    both: int
    sized: int
    four: int


#: Parts of a value that A may be off, and the accesses.
CLOSE, SIZED = 0.05, 0.25


def possible(study: StudyRows, *, single: bool = False) -> Possible:
    """Return how many rows of the table are possible, and by single rays alone."""
    found = ranges(study, ["miss_a", "miss_ratio"], single=single)
    inside = Counter(each.name for each in found if each.is_inside)
    both = sized = 0
    settings: dict[tuple[str, str], list[set[tuple[Any, ...]]]] = {}
    for tree, scene, cache in cells():
        paper, accesses = paper_table()[tree, scene, *cache], sum(implied(tree, scene).accesses) / 2
        rows = [
            row
            for row in study.of_cell(tree, scene, cache, single=single)
            if abs(row["miss_a"] / paper["miss_a"] - 1) <= CLOSE and abs(row["miss_ratio"] - paper["miss_ratio"]) <= NEAR
        ]
        both += bool(rows)
        sized += any(abs(row["demand_accesses"] / accesses - 1) <= SIZED for row in rows)
        settings.setdefault((tree, scene), []).append({(setting_of(row), row["version"], row["camera"]) for row in rows})
    four = sum(bool(set.intersection(*of)) for of in settings.values())
    return Possible(inside["miss_a"], inside["miss_ratio"], both, sized, four)


class Split(NamedTuple):
    """Why B/A is below 100 in a row: points that the denominator takes, and points that fewer lines fetched take."""

    denominator: float
    lines: float


def split(miss_ratio: float, lines_ratio: float) -> Split:
    """Return the parts of 100 - B/A, of the miss rates and of the lines fetched, both in per cent.

    The miss rate's is the lines' / (1 + p): the denominator alone would take 100 - 100 / (1 + p).
    """
    alone = 100.0 * miss_ratio / lines_ratio
    return Split(100.0 - alone, alone - miss_ratio)
