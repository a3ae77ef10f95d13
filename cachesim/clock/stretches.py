"""The demand stream of a run, cut into rays: batches of rows in, stretches that hold every ray in flight out."""

from collections.abc import Iterator

import numpy as np

from cachesim.clock.state import Rows
from cachesim.source import RunSource
from nptrace_base.errors import NptraceError
from nptrace_base.jit import kernel
from traces.format import PREFETCH, PRIMARY

#: ``Rows.waits_for``: the ray waits for nothing; it follows the ray before it in the same slot.
NOTHING, THE_RAY_BEFORE = -1, -2


class Stretches:
    """What the clocks read of a run.

    A ray without accesses takes no time and is left out. A shadow ray that stands right after its primary ray follows it in
    the same slot; any other waits until its primary ray has ended, in a slot of its own.
    """

    def __init__(self, source: RunSource) -> None:
        self._run = source.run
        if source.run.footer.packet > 1:
            raise NptraceError(
                f"{source.run.path} has packets of {source.run.footer.packet} rays, and on the clock every ray reads for "
                "itself; time a run of --packet 1"
            )
        rays = source.run.columns("rays", ["x", "y", "type", "count"])
        self._numbers = np.flatnonzero(rays["count"])  # the rays that take time
        self.n_rays = self._numbers.size
        self._types = rays["type"][self._numbers]
        self._waits_for = shadows_wait(
            rays["x"][self._numbers].astype(np.int64) + rays["y"][self._numbers] * np.int64(source.run.footer.width),
            self._types == PRIMARY,
        )

    def __iter__(self) -> Iterator[Rows]:
        """Yield stretches, each with all rays of its rows; ``keep`` says between two where the next must begin."""
        nodes, kinds = np.empty(0, np.uint32), np.empty(0, np.uint8)
        first, first_row, first_ray, n_seen, last_ray = np.zeros(0, np.int64), 0, 0, 0, -1
        for ray, node, kind in self._run.batches(("ray", "node", "kind")):
            demand = kind != PREFETCH
            ray, node, kind = ray[demand], node[demand], kind[demand]
            if not ray.size:
                continue
            starts = np.flatnonzero(np.diff(ray.astype(np.int64), prepend=last_ray))
            last_ray = int(ray[-1])
            cut, cut_ray = self._cut
            nodes, kinds = np.concatenate([nodes[cut - first_row :], node]), np.concatenate([kinds[cut - first_row :], kind])
            first = np.concatenate([first[cut_ray - first_ray :], n_seen + starts])
            first_row, first_ray, n_seen = cut, cut_ray, n_seen + ray.size
            whole = first.size - 1  # the last may go on in the next batch
            if whole > 0:
                yield self._rows(nodes, kinds, first, whole, first_row, first_ray, is_last=False)
        first = np.append(first, n_seen)
        yield self._rows(nodes, kinds, first, first.size - 1, first_row, first_ray, is_last=True)

    _cut = (0, 0)

    def keep(self, row: int, ray: int) -> None:
        """Let go of all rows and rays before these: no clock needs them any more."""
        self._cut = row, ray

    def _rows(
        self, nodes: np.ndarray, kinds: np.ndarray, first: np.ndarray, n_rays: int, first_row: int, first_ray: int, *,
        is_last: bool
    ) -> Rows:  # fmt: skip
        waits_for = self._waits_for[first_ray : first_ray + n_rays]
        types = self._types[first_ray : first_ray + n_rays]
        return Rows(nodes, kinds, first[: n_rays + 1], types, waits_for, first_row, first_ray, is_last)


@kernel
def shadows_wait(pixels, is_primary):
    """Return, for each ray, what it waits for: NOTHING, THE_RAY_BEFORE, or the number of its primary ray."""
    waits_for = np.full(pixels.size, NOTHING, np.int64)
    primary_of = np.full(pixels.max() + 1 if pixels.size else 0, -1, np.int64)
    for ray in range(pixels.size):
        if is_primary[ray]:
            primary_of[pixels[ray]] = ray
        elif primary_of[pixels[ray]] == ray - 1 and ray > 0:
            waits_for[ray] = THE_RAY_BEFORE
        else:
            waits_for[ray] = primary_of[pixels[ray]]
    return waits_for
