"""nptrace compile: compile every kernel ahead of its first use."""

import time

import click

from nptrace.progress import Progress, done
from nptrace_base import compiling


@click.command(name="compile")
def compile_() -> None:
    """Compile all kernels now instead of at the first use of each command; they are kept until the program changes."""
    from nptrace.precompile import compile_all
    from nptrace_base.jit import cache_folder

    began = time.perf_counter()
    with Progress(1) as bar:
        bar.job("compile")
        bar.phase("a minute or two")
        n_compiled = compile_all(bar.on_compiling)
    kept = "" if "kernels" in compiling.lost else f", all ready in {cache_folder()}"
    click.echo(f"{n_compiled} kernels compiled{kept}")
    done(f"{n_compiled} kernels", began, "nptrace render sponza")
