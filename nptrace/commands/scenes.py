"""nptrace scenes: the scenes known by name, and where each is found."""

import json
import sys

import click


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def scenes(as_json: bool) -> None:
    """List the scenes known by name: size, where each is found, and licence."""
    from rtrace.scenes.catalog import list_scenes

    rows = list_scenes()
    if as_json:
        click.echo(json.dumps([row._asdict() for row in rows], indent=2, default=str))
        return
    from nptrace_base.tables import Table, number, print_tables

    lines = [[row.name, number(row.n_triangles), row.where or f"stand-in: {row.stand_in}", row.licence] for row in rows]
    header = ["Scene", "Triangles", "Where", "Licence"]
    print_tables([Table("", header, lines)], ["Built in: blob, room, nave, court. Any mesh file is a scene too."], sys.stdout)
