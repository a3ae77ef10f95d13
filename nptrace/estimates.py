"""Estimates of scenes: the work of ``npcache estimate``, of ``nptrace.estimate`` and of Table I for large pictures."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

from cachesim.config import CacheConfig
from nptrace.progress import Progress
from nptrace.scene_options import PictureOptions, Trees, refuse_one_name
from nptrace_base.errors import NptraceError

if TYPE_CHECKING:
    from cachesim.sampling.estimate import Estimated
    from rtrace.scenes.scene import Scene


@dataclass(frozen=True)
class Sampling:
    """How much is sampled: the half-width allowed, the most accesses of a run to count exactly, and where counts are kept."""

    error: str
    exact_below: int = 100_000_000
    threads: int | None = None
    resume: Path | None = None


def estimate_scenes(
    scenes: "Sequence[Scene]", trees: Trees, configs: Sequence[CacheConfig], picture: PictureOptions, sampling: Sampling,
    layouts: Sequence[str] = ("stored",),
) -> "list[tuple[str, Scene, Estimated]]":  # fmt: skip
    """Estimate every scene with every tree and layout; return (tree, scene, result) of each."""
    from cachesim.sampling.estimate import estimate as estimate_source
    from cachesim.sampling.target import parse_target
    from rtrace.ray_source import RayUnits
    from rtrace.run_names import run_name
    from rtrace.trees.tree_cache import cached_tree

    target, params = parse_target(sampling.error), trees.params()
    # The seed is also that of the sample, and must not change a run of another order.
    shooting = (picture if picture.order == "random" else replace(picture, seed=0)).shooting()
    names = [run_name(scene, kind, given, shooting) for scene in scenes for kind, given in params.items()]
    refuse_one_name(names, "estimate")
    n_jobs = len(names) * len(layouts)
    if sampling.resume is not None and n_jobs > 1:
        raise NptraceError(
            f"--resume {sampling.resume} keeps the counts of one run; name one SCENE, one --accel and one --layout"
        )
    found = []
    with Progress(n_jobs) as bar:
        for scene in scenes:
            for (kind, given), layout in product(params.items(), layouts):
                bar.job(f"{scene.label} {kind}")
                bar.phase("build")
                tree = cached_tree(scene, kind, threads=sampling.threads or os.cpu_count() or 1, **given)
                source = RayUnits(scene, tree, shooting)
                result = estimate_source(
                    source, configs, target, layout=layout, seed=picture.seed, threads=sampling.threads,
                    exact_below=sampling.exact_below, resume=sampling.resume, progress=bar.phase("estimate", None),
                )  # fmt: skip
                found.append((kind, scene, result))
    return found
