"""nptrace info: what runs are, without reading their rows."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from nptrace.groups import Command
from nptrace.output import Output, results_options
from nptrace.sources import PlaceOf, chosen_sources, traces_option
from nptrace_base.errors import NptraceError
from nptrace_base.places import Place

if TYPE_CHECKING:
    from nptrace_base.tables import Table
    from traces.reader import Run


@click.command(cls=Command)
@click.argument("sources", metavar="[RUN]...", nargs=-1, type=PlaceOf())
@traces_option()
@results_options()
def info(sources: tuple[Place, ...], folder: Place, output: Output) -> None:
    """Print what runs hold, and the commands that make them again.

    A run that cannot be read is named after the others, with what is wrong with it, and the exit status is 1.

    \b
    nptrace info
    nptrace info traces/bunny-bvh --json
    """
    from traces.reader import open_run

    records, faults = [], []
    paths: list[Place] = [] if sources else chosen_sources((), folder)
    for source in sources:
        try:
            paths += chosen_sources([source], folder)
        except NptraceError as e:
            faults.append(e)
    for path in dict.fromkeys(paths):
        try:
            records.append(record_of(open_run(path)))
        except NptraceError as e:
            faults.append(e)
    if records:
        output.write(records, lambda: ([table_of(record) for record in records], []))
    for fault in faults:
        click.echo(f"Error: {fault}", err=True)
    if faults:
        raise SystemExit(1 if records else 2)


def record_of(run: "Run") -> dict[str, Any]:
    """Return the facts about a run."""
    footer = run.footer
    return {
        **run.identity.to_dict(), "n_triangles": footer.scene.n_triangles, "n_nodes": footer.n_nodes,
        "node_bytes": footer.tree.node_bytes, "n_rays": footer.n_rays, "n_events": footer.n_accesses,
        "n_bytes": run.n_bytes, "tool_version": footer.tool_version,
        "source": footer.scene.source, "sha256": footer.scene.sha256, "command": command_of(run),
    }  # fmt: skip


def command_of(run: "Run") -> str:
    """Return the command that makes a run again, in its place and with its name."""
    from nptrace_base.shell import word

    path = Path(run.path).absolute() if isinstance(run.path, Path) and run.path.name in ("", "..") else run.path
    name, ending = path.name, f"-{run.footer.tree.kind}"
    named = f" --name {word(name.removesuffix(ending))}" if name.endswith(ending) else ""
    return f"{run.footer.command} --out {word(path.parent)}{named}"


def table_of(record: dict[str, Any]) -> "Table":
    """Return the table of a run, a line for each fact."""
    from nptrace_base.tables import Table

    rows = [[name, str(value)] for name, value in record.items() if name not in ("run", "command") and value is not None]
    return Table(record["run"], ["fact", "value"], rows, n_left=2, command=record["command"])
