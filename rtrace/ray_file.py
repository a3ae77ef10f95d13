"""Rays of another renderer: a Parquet file -> checked rays in the order of the file, and chunks of what they meet in a tree.

Columns: ``origin`` and ``direction``, lists of three numbers (or ``origin_x`` ... ``direction_z``), and, if the file has them,
``t_min`` (0), ``t_max`` (infinity) and ``any_hit`` (false: the closest hit counts). They are traced as float32; a direction
need not have unit length, and t counts in it.
"""

import hashlib
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from nptrace_base.errors import NptraceError
from nptrace_base.pools import thread_pool
from rtrace.chunk import Chunk
from rtrace.rays import Rays, make_rays
from rtrace.traverse import trace_recorded
from rtrace.traversers.common import KIND_BITS
from rtrace.trees.tree import Tree
from traces.arrow_arrays import as_array
from traces.format import LEAF, PREFETCH, PRIMARY, SHADOW, printable

#: Rays of a chunk, and the columns of the grid in which the file's rays stand as pixels: x = ray mod WIDTH.
CHUNK, WIDTH = 8192, 4096
#: Most rays of a file: the rows of their grid are uint16.
MOST_RAYS = WIDTH << 16
_GREY = 128


@dataclass(frozen=True)
class RayFile:
    """The rays of a file, read once and checked.

    Attributes
    ----------
    source : str
        The file.
    sha256 : str
        Of the values: origins and directions in float32, t_min and t_max in float64, any_hit in uint8.
    rays : Rays
    any_hit : (n,) bool
    """

    source: str
    sha256: str
    rays: Rays
    any_hit: np.ndarray

    @property
    def n_rays(self) -> int:
        """Number of rays."""
        return len(self.any_hit)

    @property
    def name(self) -> str:
        """What tells a run of these rays from others: in its order, and shortened in its name."""
        return f"rays-{self.sha256[:12]}"

    def facts(self) -> dict[str, Any]:
        """Return what a run's footer says of them; a ray takes the place of a pixel."""
        width = min(self.n_rays, WIDTH)
        return {
            "width": width, "height": -(-self.n_rays // width), "order": self.name, "batch": 1, "seed": 0,
            "rays": {"source": self.source, "sha256": self.sha256},
        }  # fmt: skip


def read_rays(path: Path) -> RayFile:
    """Read and check rays.

    Raises
    ------
    NptraceError
        The file cannot be read, lacks a column, has no ray, or a ray cannot be traced; the message names the ray, from 0.
    """
    try:
        with path.open("rb") as file:  # by Python: Arrow opens only names that are UTF-8
            table = pq.read_table(file)
    except (pa.ArrowException, OSError) as e:
        reason = getattr(e, "strerror", None) or (str(e) or type(e).__name__).splitlines()[0]
        raise NptraceError(f"cannot read {path} as Parquet: {reason}; give rays with the columns origin and direction") from e
    if not table.num_rows:
        raise NptraceError(f"{path} has no ray; give a file with at least one")
    if table.num_rows > MOST_RAYS:
        raise NptraceError(f"{path} has {table.num_rows:,} rays, and the most is {MOST_RAYS:,}; split it into several files")
    origin, direction = (_points(table, name, path) for name in ("origin", "direction"))
    ends = {
        name: _numbers(table, name, path) if name in table.column_names else np.full(len(origin), usual)
        for name, usual in (("t_min", 0.0), ("t_max", np.inf))
    }
    any_hit = np.zeros(len(origin), bool)
    if "any_hit" in table.column_names:
        column = table.column("any_hit")
        if not pa.types.is_boolean(column.type) or column.null_count:
            raise NptraceError(f"{path}, column 'any_hit' must be true or false for every ray, and is of type {column.type}")
        any_hit = as_array(column.cast(pa.uint8())).view(bool)
    try:
        rays = make_rays(origin, direction, ends["t_min"], ends["t_max"])
    except NptraceError as e:
        raise NptraceError(f"{path}: {e}") from e
    digest = hashlib.sha256()
    for values in (*rays, any_hit.view(np.uint8)):
        digest.update(np.ascontiguousarray(values).data)
    return RayFile(printable(str(path)), digest.hexdigest(), rays, any_hit)


def _points(table: Any, name: str, path: Path) -> np.ndarray:
    parts = [f"{name}_{axis}" for axis in "xyz"]
    if name not in table.column_names:
        if not set(parts) <= set(table.column_names):
            raise NptraceError(f"{path} has no column {name!r}, nor {', '.join(parts)}; write lists of three numbers")
        return _held(np.stack([_numbers(table, part, path) for part in parts], axis=1), name, path)
    column = table.column(name).combine_chunks()
    is_list = pa.types.is_list(column.type) or pa.types.is_large_list(column.type) or pa.types.is_fixed_size_list(column.type)
    values = column.flatten() if is_list and not column.null_count else None
    lengths = as_array(column.value_lengths()) if values is not None else np.zeros(1)
    if values is None or (lengths != 3).any():
        raise NptraceError(f"{path}, column {name!r} must be lists of three numbers, and is of type {column.type}")
    return _held(_numbers(pa.table({name: values}), name, path).reshape(-1, 3), name, path)


def _held(points: np.ndarray, name: str, path: Path) -> np.ndarray:
    """Return points, (n, 3) float64; NptraceError if float32 makes infinity, or no direction, of what is neither."""
    with np.errstate(over="ignore"):
        single = points.astype(np.float32)
    lost = np.isfinite(points).all(axis=1) & ~np.isfinite(single).all(axis=1)
    if name == "direction":
        lost |= points.any(axis=1) & ~single.any(axis=1)
    if lost.any():
        i = int(np.flatnonzero(lost)[0])
        reason = "rays are traced as float32, which does not hold it; scale the rays, and the scene with them"
        raise NptraceError(f"{path}: ray {i} has {name} {points[i]}: {reason}")
    return points


def _numbers(table: Any, name: str, path: Path) -> np.ndarray:
    column = table.column(name)
    if not (pa.types.is_floating(column.type) or pa.types.is_integer(column.type)) or column.null_count:
        raise NptraceError(f"{path}, column {name!r} must be a number for every ray, and is of type {column.type}")
    with np.errstate(over="ignore"):
        return as_array(column).astype(np.float64)


def ray_chunks(tree: Tree, file: RayFile, threads: int, stretch: Iterable[int] | None = None) -> Iterator[Chunk]:
    """Yield the traced rays in the order of the file, chunk by chunk; ``stretch`` are the first rays of some chunks."""
    following = iter(range(0, file.n_rays, CHUNK) if stretch is None else stretch)
    with thread_pool(threads) as pool:
        waiting: deque[Future[Chunk]] = deque(pool.submit(_traced, tree, file, low) for low in islice(following, 2 * threads))
        while waiting:
            yield waiting.popleft().result()
            waiting.extend(pool.submit(_traced, tree, file, low) for low in islice(following, 1))


def _traced(tree: Tree, file: RayFile, low: int) -> Chunk:
    """Return one chunk; its pixels are all the only one of a run without a picture."""
    part = slice(low, low + CHUNK)
    any_hit, rays = file.any_hit[part], Rays(*(values[part] for values in file.rays))
    n = len(any_hit)
    prim, t, count = np.empty(n, np.int32), np.empty(n, np.float32), np.zeros(n, np.uint32)
    found = []
    for kind in (False, True):
        chosen = np.flatnonzero(any_hit == kind)
        if chosen.size:
            hits, count[chosen], events = trace_recorded(tree, Rays(*(values[chosen] for values in rays)), any_hit=kind)
            prim[chosen], t[chosen] = hits.prim, hits.t
            found.append((chosen, events))
    first = np.cumsum(count, dtype=np.int64) - count
    joined = np.empty(int(count.sum(dtype=np.int64)), np.uint32)
    for chosen, events in found:
        own = count[chosen].astype(np.int64)
        joined[np.repeat(first[chosen] - (np.cumsum(own) - own), own) + np.arange(len(events))] = events
    kinds = (joined & np.uint32((1 << KIND_BITS) - 1)).astype(np.uint8)
    number = np.arange(low, low + n)
    accesses = {
        "ray": np.repeat(np.arange(n, dtype=np.uint32), count), "node": joined >> np.uint32(KIND_BITS), "kind": kinds
    }  # fmt: skip
    columns: dict[str, np.ndarray] = {
        "ray": np.arange(n, dtype=np.uint32), "x": (number % WIDTH).astype(np.uint16),
        "y": (number // WIDTH).astype(np.uint16),
        "type": np.where(any_hit, SHADOW, PRIMARY).astype(np.uint8), "first": first.astype(np.uint64), "count": count,
        "prim": prim, "t": t,
    }  # fmt: skip
    met = prim >= 0
    return Chunk(
        columns, accesses, np.zeros(n, np.uint32), np.full((n, 3), _GREY, np.uint8),
        n_prefetches=int((kinds == PREFETCH).sum()), n_leaves=int((kinds == LEAF).sum()), n_hits=int((met & ~any_hit).sum()),
        n_shadow=int(any_hit.sum()), n_shadowed=int((met & any_hit).sum()), is_shaded=True,
    )  # fmt: skip
