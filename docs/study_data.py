"""The study of docs/study.md as its page reads it, and what its tables share."""

from collections.abc import Sequence
from functools import cache
from typing import Any

from figures import DATA
from study_figures import cache_text

from cachesim.report.table1 import TREES
from nptrace.table1_study.analysis import StudyRows
from nptrace.table1_study.figures import read_rows
from nptrace.table1_study.fit import Fits

Cell = tuple[str, str, tuple[int, int]]
OWN = ("builder", "layout", "reads")


@cache
def study() -> StudyRows:
    """Return the study."""
    return StudyRows(read_rows(DATA / "study.parquet"))


@cache
def fits() -> Fits:
    """Return all models."""
    return Fits(study().plausible, OWN)


def head(cog: Any, names: Sequence[str], n_left: int = 1) -> None:
    """Write the head of a table."""
    cog.outl("| " + " | ".join(names) + " |")
    cog.outl("| " + " | ".join(["---"] * n_left + ["---:"] * (len(names) - n_left)) + " |")


def row_name(tree: str, scene: str, cache: tuple[int, int]) -> str:
    """Return what a row of Table I is called."""
    return f"{TREES[tree]} {scene} {cache_text(cache)}"


def span(values: Sequence[float], decimals: int = 1) -> str:
    """Return the least and the largest of some values, once if they are printed alike."""
    low, high = f"{min(values):.{decimals}f}", f"{max(values):.{decimals}f}"
    return low if low == high else f"{low} to {high}"
