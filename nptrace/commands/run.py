"""nptrace run: a study in one file -> its runs, and one table of all its rows."""

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from nptrace.following import named
from nptrace.groups import Command
from nptrace.options import threads_option
from nptrace.output import Output, results_options, unused
from nptrace.progress import done
from nptrace.sources import columns_of

if TYPE_CHECKING:
    from nptrace_base.tables import Table


@click.command(cls=Command)
@click.argument("study", type=click.Path(path_type=Path))
@threads_option()
@results_options(default="parquet")
def run(study: Path, threads: int, output: Output) -> None:
    """Do a study: scenes, cameras, orders, trees, caches, policies and layouts from one file, to one table of all rows.

    The same command goes on where it stopped: it keeps the runs and the rows that are finished. The rows go to STUDY.parquet,
    in this folder, unless you give -o or --format.

    \b
    A study:
      out = "traces"
      [render]
      scenes = ["bunny", "model.obj"]
      order = ["scanline", "morton"]
      [replay]
      size = "4K..64K"
      prefetch = ["none", "stack"]
      [time]
      machine = "rtx2060"
    The keys of a table are the options of the command of its name.

    \b
    nptrace run study.toml
    nptrace run study.toml -o rows.csv
    """
    from nptrace.study import read_study, run_study
    from traces.format import printable

    began = time.perf_counter()
    asked = read_study(study)
    if not output.is_asked_for:
        output = replace(output, path=_usual_path(study))
    rows = run_study(asked, threads=threads)
    output.write(rows, lambda: ([table_of(rows)], []))
    n_runs = len({row["path"] for row in rows})
    target = "" if output.path is None or str(output.path) == "-" else f"{printable(str(output.path))}: "
    subject = named([Path(path) for path in dict.fromkeys(row["path"] for row in rows)])
    following = " ".join(filter(None, ["npcache compare", subject])) if all(row["packet"] == 1 for row in rows) else ""
    what = f"{len(rows)} row{'s' * (len(rows) != 1)} of {n_runs} run{'s' * (n_runs != 1)}"
    done(f"{target}{what}", began, following)


def _usual_path(study: Path) -> Path:
    """Return where the rows go that -o sends nowhere; NptraceError if that cannot be written, or holds no rows of a study."""
    from nptrace_base.atomic import check_writable

    path = Path(f"{study.stem}.parquet")
    check_writable(path)
    return path if "section" in columns_of(path) else unused(path)


def table_of(rows: list[dict[str, Any]]) -> "Table":
    """Return a table with a line for each row: what it is of, all in which rows differ, and the rates that it has."""
    from cachesim.clock.parameters import NUMBERS
    from nptrace_base.tables import Table, number, percent

    known = ("line_bytes", "policy", *NUMBERS)
    others = [name for name in known if len({row.get(name) for row in rows} - {None}) > 1]
    header = [
        "run", "section", "prefetch", "layout", "bytes", "ways", *(name.replace("_", "\n") for name in others),
        "demand\nmiss rate %", "traffic\nratio", "speed-up",
    ]  # fmt: skip
    lines = [
        [
            row["run"], row["section"], row["prefetch"], row["layout"], number(row["size_bytes"]), number(row["ways"]),
            *("-" if row.get(name) is None else str(row[name]) for name in others),
            percent(row.get("demand_miss_rate")), number(row.get("traffic_ratio"), 3), number(row.get("speed_up"), 3),
        ]
        for row in rows
    ]  # fmt: skip
    return Table("", header, lines, n_left=4, extra=("traffic\nratio", "layout"))
