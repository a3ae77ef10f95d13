"""A view and a setting -> a run in memory, which replays as one on disk does."""

from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from cachesim.source import RunSource
from nptrace.scene_options import tree_params
from nptrace.table1_study.knobs import KD, RENDERED, Setting
from rtrace.render import chunks, footer_of
from rtrace.run_names import run_name
from rtrace.scenes.scene import Scene
from rtrace.shooting import Shooting
from rtrace.trees.tree import Tree, node_table
from rtrace.trees.tree_cache import cached_tree
from traces.footer import Footer
from traces.format import PREFETCH
from traces.identity import RunIdentity, identity_of


class TracedRun:
    """The demand rows of a run, and its nodes, in memory: as much of ``traces.reader.Run`` as a replay asks for."""

    def __init__(self, scene: Scene, tree: Tree, shooting: Shooting, threads: int) -> None:
        table = node_table(tree)
        self._nodes = {name: table[name] for name in ("parent", "level", "n_prims")}
        self.path = Path(run_name(scene, tree.kind, tree.params, shooting))
        nodes, kinds, types = [], [], []
        for chunk in chunks(tree, scene, shooting, threads):
            demand = chunk.accesses["kind"] != PREFETCH
            nodes.append(chunk.accesses["node"][demand])
            kinds.append(chunk.accesses["kind"][demand])
            types.append((chunk.rays["type"], chunk.rays["count"] > 0))
        self.rows = np.concatenate(nodes), np.concatenate(kinds)
        self.types, self.has_rows = (np.concatenate([each[i] for each in types]) for i in range(2))
        self.footer: Footer = replace(
            footer_of(scene, tree, shooting, ""), n_rays=self.types.size, n_accesses=self.rows[0].size,
            n_nodes=table["parent"].size,
        )  # fmt: skip

    @property
    def identity(self) -> RunIdentity:
        """Which run it is."""
        return identity_of(self.footer, self.path.name)

    @property
    def n_nodes(self) -> int:
        """Nodes of the tree."""
        return self.footer.n_nodes

    @property
    def n_accesses(self) -> int:
        """Demand rows."""
        return self.footer.n_accesses

    def columns(self, table: str, names: Sequence[str]) -> dict[str, np.ndarray]:
        """Return columns of the nodes, (n_nodes,) arrays of the types in ``nodes.parquet``."""
        return {name: self._nodes[name] for name in names}

    def batches(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield (node, kind) of all rows."""
        yield self.rows

    def source(self, layout: str) -> RunSource:
        """Return the run under a layout."""
        return RunSource(self, layout)  # type: ignore[arg-type]


def traced(scene: Scene, kind: str, setting: Setting, threads: int) -> TracedRun:
    """Return the run of a scene, a kind of tree and the rendered knobs of a setting."""
    kd_text, bvh_text = (setting.builder, "sweep") if kind == KD else ("", setting.builder or "sweep")
    given = tree_params([kind], kd_text, bvh_text, ["32"])[kind]
    if setting.light == "manta":
        low, high = scene.bounds.astype(float)
        scene = scene._replace(light=tuple(high + 0.3 * (high - low)))
    known = {each.name for each in fields(Shooting)}
    values = {name: getattr(setting, name) for name in RENDERED if name in known}
    shooting = Shooting(setting.pixels, setting.pixels, **values)
    return TracedRun(scene, cached_tree(scene, kind, **given), shooting, threads)
