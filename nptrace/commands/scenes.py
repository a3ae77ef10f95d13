"""nptrace scenes: the scenes known by name, and where each is found."""

import click

from nptrace.groups import Command
from nptrace.output import Output, results_options


@click.command(cls=Command)
@results_options()
def scenes(output: Output) -> None:
    """List the scenes known by name: size, where each is found, and licence."""
    from nptrace_base.tables import Table, number
    from rtrace.scenes.catalog import list_scenes

    rows = list_scenes()
    lines = [[row.name, row.where or f"stand-in: {row.stand_in}", row.licence, number(row.n_triangles)] for row in rows]
    table = Table("", ["Scene", "Where", "Licence", "Triangles"], lines, n_left=3)
    notes = ["Built in: blob, room, nave, court. Any mesh file is a scene too."]
    output.write([row._asdict() for row in rows], lambda: ([table], notes))
