"""Our trees compared with Embree and with each other: rays -> a table of differences, each with its limit.

Embree is a reference for camera, shadow and random rays only: it leaks at vertices and answers differently on rays that lie
in planes, where brute force with our triangle test is the reference (docs/correctness.md). Its float32 arithmetic decides how
close the distances can be: they are compared in units of kappa, the error that rounding the inputs to float32 explains.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from nptrace_base.pools import thread_pool
from rtrace.chunk import primary_rays
from rtrace.rays import Hits, Rays, make_rays
from rtrace.scenes.scene import Scene
from rtrace.shading import shadow_rays
from rtrace.traverse import trace
from rtrace.trees.tree import Tree

#: Share of the rays whose hit/miss answer, and whose triangle at unequal t, may differ from Embree's. Measured on 2 million
#: rays: none and 3e-6 (feasibility study); a ray within float32 rounding of an edge may hit or miss.
HIT_LIMIT, PRIM_LIMIT = 1e-5, 5e-5
#: Largest |dt| in units of kappa; the largest measured was 84.
KAPPA_LIMIT = 128.0
#: Largest |dt|/t: 4e-3 was measured, on a hit at a grazing angle close to its origin.
T_LIMIT = 1e-2
#: Two hits at the same distance, up to this share: coincident or adjacent triangles, either of which may be reported.
SAME_T = 1e-4


class EmbreeComparison(NamedTuple):
    """One comparison: ``value`` must not be above ``limit``."""

    tree: str
    rays: str
    n_rays: int
    what: str
    value: float
    limit: float

    @property
    def is_good(self) -> bool:
        """Whether the value is within its limit."""
        return self.value <= self.limit


def random_rays(scene: Scene, n: int, seed: int) -> Rays:
    """Return rays between random points of the scene's box, grown by half its size on every side."""
    rng = np.random.default_rng(seed)
    lower, upper = scene.bounds.astype(np.float64)
    size = np.maximum(upper - lower, np.abs(upper).max() * 1e-3)
    ends = (lower + size * rng.uniform(-0.5, 1.5, (2, n, 3))).astype(np.float32)
    return make_rays(ends[0], ends[1] - ends[0])


def kappa(triangles: np.ndarray, rays: Rays, prim: np.ndarray) -> np.ndarray:
    """Return the rounding unit of each hit, (n,) float64: 2^-23 max|v - o| |e1| |e2| |d| / |n . d|, in units of t."""
    v = triangles[prim].astype(np.float64)
    d = rays.direction.astype(np.float64)
    e1, e2 = v[:, 1] - v[:, 0], v[:, 2] - v[:, 0]
    reach = np.abs(v - rays.origin[:, None].astype(np.float64)).max(axis=(1, 2))
    lengths = np.linalg.norm(e1, axis=1) * np.linalg.norm(e2, axis=1)
    with np.errstate(divide="ignore"):
        return 2.0**-23 * reach * lengths / np.abs((np.cross(e1, e2) * d).sum(axis=1))


def embree_scene(triangles: np.ndarray):
    """Return an Embree scene of the triangles, in robust mode (not embreex's choice in every version)."""
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    scene = EmbreeScene(robust=True)
    TriangleMesh(scene, np.ascontiguousarray(triangles))
    return scene


def compare(
    trees: list[Tree], scene: Scene, width: int, height: int, n_random: int, seed: int, threads: int = 1
) -> list[EmbreeComparison]:
    """Compare every tree with Embree on the primary and shadow rays of the scene's picture and on random rays.

    Embree and the trees get exactly the same float32 rays; shadow rays are those of the first tree. Beyond the first, a
    tree must give the first one's hits bit by bit. ``threads`` trace the rays; the rows do not depend on them.
    """
    embree = embree_scene(scene.triangles)
    frame = scene.camera.frame(width, height)
    primary = primary_rays(frame, np.arange(width * height, dtype=np.uint32), width)
    shadow = shadow_rays(trees[0], primary, trace(trees[0], primary), scene.light)[0]
    rows = []
    for name, rays in (("primary", primary), ("shadow", shadow), ("random", random_rays(scene, n_random, seed))):
        if not len(rays.t_max):
            continue
        first = None
        for tree in trees:
            hits = _traced(tree, rays, name == "shadow", threads)
            answer = _occlusion_rows(embree, rays, hits) if name == "shadow" else _hit_rows(embree, scene, rays, hits)
            rows += [EmbreeComparison(tree.kind, name, len(rays.t_max), *row) for row in answer]
            if first is not None:
                same = (hits.prim < 0) == (first.prim < 0)
                if name != "shadow":
                    same = (hits.prim == first.prim) & (hits.t == first.t)
                what = f"rays unlike the {trees[0].kind}"
                rows.append(EmbreeComparison(tree.kind, name, len(rays.t_max), what, float((~same).sum()), 0.0))
            first = first or hits
    return rows


def _traced(tree: Tree, rays: Rays, any_hit: bool, threads: int) -> Hits:
    """Trace rays, a piece of them in each thread."""
    cuts = np.linspace(0, len(rays.t_max), threads + 1).astype(int)
    pieces = [Rays(*(values[low:high] for values in rays)) for low, high in pairwise(cuts) if low < high]
    with thread_pool(threads) as pool:
        found = list(pool.map(lambda piece: trace(tree, piece, any_hit=any_hit), pieces))
    return Hits(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


def _allowed(share: float, n: int) -> float:
    return float(int(share * n))


def _occlusion_rows(embree, rays: Rays, hits: Hits) -> list[tuple[str, float, float]]:
    n = len(rays.t_max)
    # embreex writes into the array of distances, so it gets a copy.
    occluded = embree.run(rays.origin, rays.direction, dists=rays.t_max.astype(np.float32), query="OCCLUDED") == 0
    return [("hit/miss differences", float(((hits.prim >= 0) != occluded).sum()), _allowed(HIT_LIMIT, n))]


def _hit_rows(embree, scene: Scene, rays: Rays, hits: Hits) -> list[tuple[str, float, float]]:
    n = len(rays.t_max)
    answer = embree.run(rays.origin, rays.direction, output=1)
    theirs, their_t = np.asarray(answer["primID"]), np.asarray(answer["tfar"], np.float64)
    both = (hits.prim >= 0) & (theirs >= 0)
    relative = np.abs(hits.t[both] - their_t[both]) / np.maximum(hits.t[both], np.finfo(np.float64).tiny)
    other = hits.prim[both] != theirs[both]
    same = both & (hits.prim == theirs)
    chosen = Rays(*(a[same] for a in rays))
    units = np.abs(hits.t[same] - their_t[same]) / kappa(scene.triangles, chosen, hits.prim[same])
    return [
        ("hit/miss differences", float(((hits.prim >= 0) != (theirs >= 0)).sum()), _allowed(HIT_LIMIT, n)),
        ("other triangle, unequal t", float((other & (relative > SAME_T)).sum()), _allowed(PRIM_LIMIT, n)),
        ("largest |dt| in kappa", float(units.max(initial=0.0)), KAPPA_LIMIT),
        ("largest |dt|/t", float(relative[~other].max(initial=0.0)), T_LIMIT),
    ]
