"""The break-even map: scenes, trees, leaf sizes and machines in; where prefetching pays, and where it costs, out.

Each run (scene, tree, leaf size) is traced once and timed on every machine of the grid; its part is one Parquet file,
written when it is complete, so an interrupted map goes on where it stopped.
"""

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import Any

from cachesim.clock import sampled_rays, timing
from cachesim.clock.parameters import PRESETS, Clock
from cachesim.clock.sampled_rays import EstimatedSpeedUp, time_sample
from cachesim.clock.timing import Timing, time_run
from cachesim.config import CacheConfig
from nptrace import __version__
from nptrace_base.atomic import whole_file
from nptrace_base.errors import NptraceError
from nptrace_base.records import write_parquet
from nptrace_base.source_files import digest_of
from rtrace.render import Shooting, render_all
from rtrace.scenes.scene import Scene
from traces.identity import COLUMNS
from traces.reader import Run, open_run

OnPhase = Callable[[str, str, int | None], Callable[[int], object]]

#: Columns of the map: which run, which machine, and what came of it.
COLUMNS_OF_RUN = ("run", "scene", "stand_in", "tree", "leaf", "width", "height", "order")
FIGURES = (
    "cycles", "cycles_without", "speed_up", "cycles_per_ray_without", "demand_reads", "requests", "filled",
    "bytes_from_memory", "traffic_ratio", "accuracy", "demand_miss_rate", "spent_port", "one_in",
    "speed_up_half_width",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Grid:
    """What is varied. Caches are (bytes, ways); the other numbers are those of the machine ``paper``.

    Attributes
    ----------
    leaves : tuple of int
        Most triangles of a leaf; a cell with so many is not split further.
    mshrs : int
        Lines in flight, enough not to be what limits 64 rays.
    """

    trees: tuple[str, ...] = ("kdtree", "bvh", "bvh64")
    leaves: tuple[int, ...] = (1, 2, 4, 8)
    triangles: tuple[int, ...] = (1, 8, 37)
    misses: tuple[int, ...] = (20, 100, 300)
    rays: tuple[int, ...] = (1, 4, 16, 64)
    caches: tuple[tuple[int, int], ...] = ((8192, 1), (8192, 2), (16384, 2))
    prefetches: tuple[str, ...] = ("stack", "push")
    mshrs: int = 64

    def clocks(self) -> list[Clock]:
        """Return every machine."""
        paper = PRESETS["paper"].clock
        return [
            paper.with_numbers(triangle=triangle, miss=miss, rays=rays, mshrs=self.mshrs)
            for triangle, miss, rays in product(self.triangles, self.misses, self.rays)
        ]

    def configs(self, line_bytes: int) -> list[CacheConfig]:
        """Return every cache; a line holds a node at least."""
        return [CacheConfig(size, ways, line_bytes) for size, ways in self.caches]


#: What the rows of a part follow from: another program times its run again.
_CODE = (Path(__file__), *(Path(str(each.__file__)) for each in (timing, sampled_rays)))

QUICK = Grid(leaves=(1, 4), triangles=(8,), misses=(100,), rays=(1, 4), caches=((8192, 2),))


def break_even(
    scenes: Sequence[Scene], shooting: Shooting, grid: Grid, folder: Path, *, threads: int, on_phase: OnPhase, one_in: int = 1,
) -> list[dict[str, Any]]:  # fmt: skip
    """Return the rows of the map; runs and finished runs' rows are kept in ``folder``.

    Parameters
    ----------
    one_in : int
        Time one piece of the rays in so many: rows have the half-width of the speed-up, and None for what a sample does not
        tell.
    on_phase : callable
        Called with the name of a run, a phase (those of a render, and ``time``) and its steps; returns a function to call with
        amounts of them.
    """
    rows: list[dict[str, Any]] = []
    for scene, leaf in product(scenes, grid.leaves):
        params = {tree: {"min_leaf": leaf, "max_leaf": leaf} for tree in grid.trees}
        for summary in render_all(
            [scene], params, shooting, folder, threads=threads, tool_version=__version__, on_phase=on_phase
        ):  # fmt: skip
            run = open_run(str(summary.identity.path))
            rows += _part(run, leaf, grid, one_in, folder, threads, on_phase(run.name, "time", len(grid.caches)))
    return rows


def _part(
    run: Run, leaf: int, grid: Grid, one_in: int, folder: Path, threads: int, advance: Callable[[int], object]
) -> list[dict[str, Any]]:  # fmt: skip
    """Return the rows of one run, from its file if there is one for this grid, of this program."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    asked = json.dumps([run.footer.to_json().decode(), leaf, asdict(grid), one_in, digest_of(_CODE)], sort_keys=True)
    path = folder / f"map-{hashlib.sha256(asked.encode()).hexdigest()[:16]}.parquet"
    if path.exists():
        try:
            return list(pq.read_table(path).to_pylist())
        except pa.ArrowException as e:
            raise NptraceError(f"{path} cannot be read as a part of a map; delete it, and its run is timed again") from e
    rows = list(_rows(run, leaf, grid, one_in, threads, advance))
    with whole_file(path) as temporary:
        write_parquet(rows, temporary, COLUMNS)
    return rows


def _rows(
    run: Run, leaf: int, grid: Grid, one_in: int, threads: int, advance: Callable[[int], object]
) -> Iterator[dict[str, Any]]:  # fmt: skip
    configs, machine = grid.configs(max(32, run.footer.tree.node_bytes)), PRESETS["paper"].clock.to_dict()
    names = (*COLUMNS_OF_RUN, "size_bytes", "ways", "line_bytes", "prefetch", *machine, *FIGURES)
    for config in configs:
        found: Sequence[Timing | EstimatedSpeedUp]
        if one_in > 1:
            found = time_sample(run, [config], grid.clocks(), grid.prefetches, one_in, threads)
        else:
            found = time_run(run, [config], grid.clocks(), grid.prefetches, threads=threads)
        advance(1)
        for each in found:
            figures = each.to_dict() | {"leaf": leaf, "one_in": one_in}
            yield {name: figures.get(name) for name in names}
