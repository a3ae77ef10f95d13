"""npcache summarise: a part of a run through caches, into a file that npcache combine joins with those of the other parts."""

import re
import time
from pathlib import Path

import click

from cachesim.config import parse_bytes
from nptrace.groups import BadInput, Command
from nptrace.options import Caches, gathered, list_option, policy_option, size_option, threads_option, ways_option
from nptrace.output import output_option
from nptrace.progress import Progress, done, size_text
from nptrace.sources import PlaceOf, layouts_option, one_run, prefetch_option, untimed_policies
from nptrace_base.places import Place
from nptrace_base.shell import word


@click.command(cls=Command, lists={"Prefetch policies": untimed_policies})
@click.argument("run", type=PlaceOf())
@click.option("--part", metavar="I/N", required=True, help="Which of how many parts, e.g. 3/8.")
@size_option()
@ways_option()
@list_option("--line", item=parse_bytes, metavar="SIZES", default="32", help="Line sizes in bytes.")
@policy_option("lru", help="Replacement: lru alone can be replayed in parts.")
@prefetch_option("traced")
@layouts_option()
@click.option("--3c", "three_c", is_flag=True, help="Classify misses as compulsory, capacity or conflict.")
@threads_option()
@output_option("-o", "--output", "out", help="The file to write, which is required, e.g. 3.sum.")
@gathered("caches", Caches)
def summarise(
    run: Place, part: str, caches: Caches, prefetch: list[str], layout: list[str], three_c: bool, threads: int,
    out: Path | None,
) -> None:  # fmt: skip
    """Replay a part of a run, and write a summary from which npcache combine makes the exact results of the whole run.

    The options are those of npcache replay, but LRU is the only replacement, and next-line:always the only next-line policy:
    what others do depends on all that went before. Each part can run on another machine, at any time.

    \b
    npcache summarise traces/bunny-bvh --part 1/2 --size 8K --assoc 2 -o 1.sum
    npcache summarise traces/bunny-bvh --part 2/2 --size 8K --assoc 2 -o 2.sum
    npcache combine 1.sum 2.sum
    """
    from cachesim.parts import parse_part
    from nptrace.studies import summarised
    from traces.reader import open_run

    if out is None or str(out) == "-":
        raise BadInput("a summary is not for a terminal; name a file with -o, e.g. -o 1.sum")
    began, configs, chosen = time.perf_counter(), caches.configs(), parse_part(part)
    with Progress(len(layout) * len(prefetch)) as bar:
        n, n_bytes = summarised(
            open_run(one_run(run)), configs, prefetch, layout, chosen, out, bar, three_c=three_c, threads=threads
        )  # fmt: skip
    done(f"part {chosen[0]} of {chosen[1]}, {n:,} accesses, {size_text(n_bytes)}", began, _following(out, chosen[1]))


def _following(out: Path, n_parts: int) -> str:
    """Return the command that joins the parts, once there are as many files like this one as parts."""
    alike = [each for each in out.parent.glob("*") if each.suffix == out.suffix and not each.name.startswith(".")]
    if len(alike) != n_parts or not re.fullmatch(r"\.[\w-]+", out.suffix):
        return ""
    folder = "" if str(out.parent) == "." else f"{word(out.parent)}/"
    return f"npcache combine {folder}*{out.suffix}"
