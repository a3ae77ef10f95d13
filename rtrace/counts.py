"""Chunks, one after another -> their rays and rows numbered on, and what they add up to."""

from dataclasses import asdict, dataclass

import numpy as np

from rtrace.chunk import Chunk


@dataclass
class RunCounts:
    """The counts of consecutive chunks: of a run, or of a part of one."""

    n_rays: int = 0
    n_accesses: int = 0  # rows
    n_prefetches: int = 0
    n_leaves: int = 0  # rows of leaves entered
    n_hits: int = 0
    n_shadow: int = 0
    n_shadowed: int = 0

    def add(self, chunk: Chunk) -> None:
        """Count the next chunk, and number its rays and rows after those before it, in place."""
        chunk.rays["ray"] += np.uint32(self.n_rays)
        chunk.rays["first"] += np.uint64(self.n_accesses)
        chunk.accesses["ray"] += np.uint32(self.n_rays)
        self.n_rays += len(chunk.rays["ray"])
        self.n_accesses += len(chunk.accesses["ray"])
        self.n_prefetches += chunk.n_prefetches
        self.n_leaves += chunk.n_leaves
        self.n_hits += chunk.n_hits
        self.n_shadow += chunk.n_shadow
        self.n_shadowed += chunk.n_shadowed

    def __add__(self, other: "RunCounts") -> "RunCounts":
        return RunCounts(**{name: value + getattr(other, name) for name, value in asdict(self).items()})
