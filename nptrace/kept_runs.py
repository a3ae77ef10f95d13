"""The runs that a study has made before: each is taken as it is, and no run of other content is replaced."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nptrace.progress import Progress
from nptrace_base.errors import NptraceError
from traces.reader import open_run

if TYPE_CHECKING:
    from rtrace.render import Shooting
    from rtrace.scenes.scene import Scene
    from rtrace.trees.tree import Tree


def kept_runs(
    study: Path, out: Path, jobs: "Sequence[tuple[Scene, Shooting, Mapping[str, Mapping[str, Any]]]]"
) -> dict[Path, bool]:  # fmt: skip
    """Return the place of the run of each job, and whether the run is there, whole and of this content.

    NptraceError if two jobs would have one run, or another run is there: before anything is traced.
    """
    from rtrace.run_names import run_name
    from rtrace.trees.tree_cache import cached_tree

    found: dict[Path, bool] = {}
    with Progress(len(jobs)) as bar:
        for scene, shooting, params in jobs:
            [(kind, given)] = params.items()
            path = out / run_name(scene, kind, given, shooting)
            if path in found:
                raise NptraceError(
                    f"{study}: two scenes, or two cameras, would both be {path}; a study calls a run by its scene, so "
                    "rename a file, or write a study for each, with another out"
                )
            found[path] = False
            if path.is_dir():
                bar.job(path.name)
                bar.phase("look for the run")
                found[path] = _is_kept(path, scene, cached_tree(scene, kind, **given), shooting)
    return found


def _is_kept(path: Path, scene: "Scene", tree: "Tree", shooting: "Shooting") -> bool:
    """Return whether a whole run is at ``path``; NptraceError if it is of other content."""
    from rtrace.render import footer_of

    try:
        run = open_run(path)
    except NptraceError:
        return False
    if unlike := run.footer.differences(footer_of(scene, tree, shooting, "")):
        raise NptraceError(
            f"{path} holds another run (of another {', '.join(unlike)}); move it elsewhere, or give the study another out"
        )
    return True
