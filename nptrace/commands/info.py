"""nptrace info: what runs are, without reading their rows."""

from typing import TYPE_CHECKING, Any

import click

from nptrace.output import Output, results_options
from nptrace.sources import PlaceOf, chosen_sources, traces_option
from nptrace_base.places import Place

if TYPE_CHECKING:
    from nptrace_base.tables import Table


@click.command()
@click.argument("sources", metavar="[RUN]...", nargs=-1, type=PlaceOf())
@traces_option()
@results_options()
def info(sources: tuple[Place, ...], folder: Place, output: Output) -> None:
    """Print what runs hold, and the commands that make them again.

    \b
    nptrace info
    nptrace info traces/bunny-bvh --json
    """
    from traces.reader import open_run

    records = []
    for path in chosen_sources(sources, folder):
        run = open_run(path)
        footer = run.footer
        records.append({
            **run.identity.to_dict(), "n_triangles": footer.scene.n_triangles, "n_nodes": footer.n_nodes,
            "node_bytes": footer.tree.node_bytes, "n_rays": footer.n_rays, "n_events": footer.n_accesses,
            "n_bytes": run.n_bytes, "tool_version": footer.tool_version,
            "source": footer.scene.source, "sha256": footer.scene.sha256, "command": footer.command,
        })  # fmt: skip
    output.write(records, lambda: ([table_of(record) for record in records], []))


def table_of(record: dict[str, Any]) -> "Table":
    """Return the table of a run, a line for each fact."""
    from nptrace_base.tables import Table

    rows = [[name, str(value)] for name, value in record.items() if name != "run" and value is not None]
    return Table(record["run"], ["fact", "value"], rows, n_left=2)
