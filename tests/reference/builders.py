"""The builders' code run as plain Python: with scratch memory poisoned, or with every step of a kd-tree's checked."""

import contextlib
import itertools
from collections.abc import Iterator
from typing import Any
from unittest.mock import patch

import numba
import numpy as np

from rtrace.trees import binned_sah, bvh, kd_cells
from rtrace.trees.clip import value
from rtrace.trees.kd_events import END, KIND, START, TRIANGLE

_empty, _empty_like = np.empty, np.empty_like
_grow_one, _copy_one = binned_sah.grow, binned_sah.copy


@numba.njit
def _grow(boxes: Any, i: Any, others: Any, j: Any) -> None:
    _grow_one(boxes, i, others, j)


@numba.njit
def _copy(boxes: Any, i: Any, others: Any, j: Any) -> None:
    _copy_one(boxes, i, others, j)


def _in_python() -> contextlib.ExitStack:
    """Let Python run the outer loop of every builder, so that what it calls and allocates can be replaced."""
    stack = contextlib.ExitStack()
    steps = (kd_cells, "_build"), (kd_cells, "_split_cell"), (kd_cells, "_write_leaf")
    for module, name in (*steps, (bvh, "_build"), (binned_sah, "build_binned")):
        stack.enter_context(patch.object(module, name, getattr(module, name).py_func))
    stack.enter_context(patch.multiple(binned_sah, grow=_grow, copy=_copy))
    return stack


@contextlib.contextmanager
def poisoned(byte: int) -> Iterator[None]:
    """Fill with one byte all memory that a builder asks for without setting it."""

    def fill(array: np.ndarray) -> np.ndarray:
        array.reshape(-1).view(np.uint8)[:] = byte
        return array

    def empty(*args: Any, **options: Any) -> np.ndarray:
        return fill(_empty(*args, **options))

    def empty_like(*args: Any, **options: Any) -> np.ndarray:
        return fill(_empty_like(*args, **options))

    # Numba looks NumPy's functions up by themselves, once, at the first compilation: it must not see ours then.
    numba.njit(lambda n: np.empty_like(np.empty(n)))(1)
    with _in_python() as stack:
        stack.enter_context(patch.multiple(np, empty=empty, empty_like=empty_like))
        yield


class _Steps:
    """The kd-tree's kernels, each followed by a check of what it did."""

    def __init__(self) -> None:
        names = ("sweep", "classify", "partition", "list_triangles")
        self._kernels = {name: getattr(kd_cells, name) for name in names}
        self.n_splits = 0
        self._members: set[int] = set()
        self._claimed = (0, 0)

    def sweep(self, events, axis, span, boxes, cell, n, costs, best):  # type: ignore[no-untyped-def]
        """The events are those of n triangles, the same on all axes; the cost found is that of the counts below and above."""
        (begin, end), (trav, empty_bonus) = span, costs
        lo, hi = float(boxes[6 * cell + axis]), float(boxes[6 * cell + 3 + axis])
        listed = events[axis, begin:end].tolist()
        assert all(a < b for a, b in itertools.pairwise(listed)), "events out of order, or twice"
        assert all(lo <= value(event >> 32) <= hi for event in listed), "events outside their cell"
        first = [event & TRIANGLE for event in listed if event & KIND != END]
        last = [event & TRIANGLE for event in listed if event & KIND != START]
        assert len(first) == len(last) == n and set(first) == set(last), "a cell's events are not those of its triangles"
        self._members = set(first) if axis == 0 else self._members
        assert self._members == set(first), "the axes have other triangles"
        found = self._kernels["sweep"](events, axis, span, boxes, cell, n, costs, best)
        if found[0] < best[0]:
            below = [event for event in listed if event < found[1]]
            n_below = sum(event & KIND != END for event in below)
            n_above = n - sum(event & KIND != START for event in below)
            d = [float(boxes[6 * cell + 3 + k] - boxes[6 * cell + k]) for k in ((axis + 1) % 3, (axis + 2) % 3)]
            cap, rim, x = d[0] * d[1], d[0] + d[1], value(found[1] >> 32)
            cost = trav * (cap + (hi - lo) * rim)
            cost += (cap + (x - lo) * rim) * n_below + (cap + (hi - x) * rim) * n_above
            assert cost * (1.0 if n_below and n_above else empty_bonus) == found[0], "a cost that is not its plane's"
        return found

    def classify(self, events, axis, span, plane, n, side):  # type: ignore[no-untyped-def]
        """As many triangles are below and above as it says."""
        claimed = self._kernels["classify"](events, axis, span, plane, n, side)
        sides = [side[triangle] for triangle in self._members]
        assert claimed == (sum(s & 1 for s in sides), sum(s >> 1 for s in sides)), "counts that are not the sides'"
        self._claimed = claimed
        return claimed

    def partition(self, events, axis, span, side, straddlers, n_straddlers, parted):  # type: ignore[no-untyped-def]
        """The children get so many triangles, on each axis."""
        n_straddlers = self._kernels["partition"](events, axis, span, side, straddlers, n_straddlers, parted)
        kept, cut = parted.kept[axis, : parted.n_kept[axis]], parted.cut[axis, : parted.n_cut[axis]]
        parts = kept, events[axis, span[0] : parted.end_above[axis]], cut
        below, above, both = (int((part & KIND != END).sum()) for part in parts)
        assert (below + both, above + both) == self._claimed, "counts that are not the partition's"
        assert both == n_straddlers
        self.n_splits += axis == 2
        return n_straddlers

    def list_triangles(self, events, begin, end, fresh):  # type: ignore[no-untyped-def]
        """What a leaf lists comes from its own events."""
        fresh[:] = -1
        return self._kernels["list_triangles"](events, begin, end, fresh)


@contextlib.contextmanager
def checked() -> Iterator[_Steps]:
    """Check every step of the kd-trees built meanwhile; their trees are the same."""
    steps = _Steps()
    with _in_python() as stack:
        stack.enter_context(patch.multiple(kd_cells, **{name: getattr(steps, name) for name in steps._kernels}))
        yield steps
