"""nptrace compile: compile every kernel ahead of its first use."""

import time

import click

from nptrace.groups import Command
from nptrace.output import Output, results_options
from nptrace.progress import Progress, done
from nptrace_base import compiling


@click.command(name="compile", cls=Command)
@results_options()
def compile_(output: Output) -> None:
    """Compile all kernels now instead of at the first use of each command; they are kept until the program changes."""
    from nptrace.precompile import compile_all
    from nptrace_base.jit import cache_folder
    from nptrace_base.tables import Table, number
    from traces.format import printable

    began = time.perf_counter()
    with Progress() as bar:
        bar.job("compile")
        bar.phase("a minute or two")
        n_compiled = compile_all(bar.on_compiling)
    kept = None if "kernels" in compiling.lost else printable(str(cache_folder()))
    seconds = time.perf_counter() - began
    rows = [[kept or "nowhere: they are compiled again", number(n_compiled), number(seconds, 1)]]
    output.write(
        [{"n_compiled": n_compiled, "seconds": seconds, "folder": kept}],
        lambda: ([Table("", ["all kernels ready in", "compiled", "seconds"], rows)], []),
    )
    done(f"{n_compiled} kernel{'s' * (n_compiled != 1)} compiled", began, "nptrace render sponza")
