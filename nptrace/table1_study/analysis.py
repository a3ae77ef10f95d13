"""A study's rows -> what becomes of each row of Table I: ranges, the knob that moves it most, and the one that explains it."""

from collections.abc import Iterable, Sequence
from statistics import median
from typing import Any, NamedTuple

from cachesim.report.table1 import paper_table
from nptrace.table1_study.cameras import EDITIONS, own_camera
from nptrace.table1_study.figures import CACHES, Row, cells, is_inside, is_plausible, octaves, span_of
from nptrace.table1_study.knobs import KNOBS, SCENE_KNOBS, Setting

#: What a knob stands for in the causes of a row.
CAUSES = {
    "pixels": "resolution", "order": "order of rays", "batch": "order of rays", "packet": "packets", "shadow": "shadow rays",
    "shadow_order": "shadow rays", "shadow_end": "shadow rays", "builder": "tree", "light": "shadow rays",
    "layout": "conflicts", "reads": "what is read", "prefetch": "prefetch unit", "flush": "flush", "policy": "conflicts",
    "camera": "camera", "version": "edition of the scene",
}  # fmt: skip


class Study:
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

    def of_cell(self, tree: str, scene: str, cache: tuple[int, int]) -> list[Row]:
        """Return the plausible rows of a row of the table."""
        return self._cells[tree, scene, cache]

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


def ranges(study: Study, names: Sequence[str]) -> list[Range]:
    """Return the ranges of some figures for all rows of the table."""
    found = []
    for (tree, scene, cache), name in ((cell, name) for cell in cells() for name in names):
        of = study.of_cell(tree, scene, cache)
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


def tornado(study: Study, tree: str, scene: str, name: str) -> list[Swing]:
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


class Cause(NamedTuple):
    """The change of one knob that brings a figure of a row of the table nearest to the paper's.

    Attributes
    ----------
    knob, value : str
        "" if no change does better than the default.
    before, after, paper : float
    """

    tree: str
    scene: str
    cache: tuple[int, int]
    name: str
    knob: str
    value: str
    before: float
    after: float
    paper: float

    @property
    def cause(self) -> str:
        """What the knob stands for."""
        return CAUSES[self.knob] if self.knob else "none"

    @property
    def left(self) -> float:
        """What is left, in points."""
        return self.after - self.paper


#: The default explains what is this near, in points: other settings change the figure by as much without a reason.
NEAR = 0.5


def causes(study: Study, name: str) -> list[Cause]:
    """Return the cause of each row of the table for a figure; none where the default is within ``NEAR``."""
    found = []
    for tree, scene, cache in cells():
        paper, usual = paper_table()[tree, scene, *cache][name], study.default(tree, scene, cache)
        best, knob = usual, ""
        for each in () if abs(usual[name] - paper) <= NEAR else (*KNOBS, *SCENE_KNOBS):
            for row in study.alone(tree, scene, cache, each.name):
                if row[name] is not None and abs(row[name] - paper) < abs(best[name] - paper):
                    best, knob = row, each.name
        value = str(best[knob]) if knob else ""
        found.append(Cause(tree, scene, cache, name, knob, value, usual[name], best[name], paper))
    return found


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
