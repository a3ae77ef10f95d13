"""What the pages take from the program: worked examples, whose formulas are computed again, lists, pieces of source."""

import contextlib
import json
import os
import re
import shlex
import sys
import tempfile
from fractions import Fraction
from pathlib import Path
from typing import Any

from click.testing import CliRunner

ROOT = Path(__file__).resolve().parent.parent
EXAMPLES = ROOT / "docs" / "examples"
sys.path.insert(0, str(ROOT))

#: Where the examples are and their runs go, by the name of the process.
FOLDER = Path(tempfile.gettempdir()) / f"nptrace-examples-{os.getpid()}"

#: Lines of example.din, A to E.
N_LINES = 5

CAMERA = "eye=0,3,4 at=0,0.5,0"
RENDER = f'nptrace render table.obj --accel bvh --bvh min_leaf=1,max_leaf=1 --pixels 3x2 --camera "{CAMERA}" --name table'
REPLAY = "npcache replay example.din --size 64 --assoc 2 --3c"
BY = "npcache replay traces/table-bvh --size 64 --assoc 2 --by level"
TIME = "npcache time traces/table-bvh --size 64 --assoc 2 --prefetch push"

#: Of a replay: what is counted, and from what it follows.
OF_REPLAY = (
    ("demand_miss_rate", "demand_misses / demand_accesses"),
    ("demand_miss_rate_without", "demand_misses_without / demand_accesses"),
    ("paper_miss_rate", "(demand_misses + prefetch_misses) / (demand_accesses + prefetch_accesses)"),
    ("bytes_from_memory", "(demand_misses + prefetch_misses) * line_bytes"),
    ("traffic_ratio", "(demand_misses + prefetch_misses) / demand_misses_without"),
    ("coverage", "1 - demand_misses / demand_misses_without"),
    ("prefetch_accesses", "redundant + filled"),
    ("filled", "useful + useless + resident"),
    ("accuracy", "useful / filled"),
    ("demand_misses", "compulsory + capacity + conflict"),
)
#: Of the clock.
OF_TIME = (
    ("cycles_per_ray", "cycles / n_rays"),
    ("cycles_per_pixel", "cycles / (width * height)"),
    ("speed_up", "cycles_without / cycles"),
    ("cycles * rays", "spent_box_test + spent_triangle_test + spent_hit + spent_demand_miss + spent_late_prefetch + spent_port"
     " + spent_mshr_full + spent_unit_busy + spent_idle"),
    ("demand_reads", "demand_hits + demand_misses + demand_joined + demand_late"),
    ("demand_miss_rate", "(demand_misses + demand_joined) / demand_reads"),
    ("candidates_offered", "candidates_no_time + candidates_port_busy + candidates_mshr_full + candidates_demanded_first"
     " + candidates_issued"),
    ("requests", "redundant + joined + filled"),
    ("requests_per_read", "requests / demand_reads"),
    ("filled", "timely + late + evicted_before_use + never_used + resident"),
    ("accuracy", "(timely + late) / filled"),
    ("cycles_saved + cycles_waited", "(timely + late) * (miss - hit)"),
    ("bytes_from_memory", "(demand_misses + filled) * line_bytes"),
)  # fmt: skip


def show(cog: Any, name: str) -> None:
    """Write a file of docs/examples as the command that makes it."""
    cog.outl(f"```sh\ncat > {name} <<'END'\n{(EXAMPLES / name).read_text(encoding='utf-8').rstrip()}\nEND\n```")


def run(command: str) -> str:
    """Return what a command prints, in the folder of the examples."""
    import cli

    FOLDER.mkdir(exist_ok=True)
    for path in EXAMPLES.iterdir():
        (FOLDER / path.name).write_bytes(path.read_bytes())
    program, *words = shlex.split(command)
    with contextlib.chdir(FOLDER):
        done = CliRunner().invoke(getattr(cli, program), words, catch_exceptions=False)
    if done.exit_code:
        raise SystemExit(f"{command}: {done.output}")
    return done.stdout


def commands(cog: Any, *lines: str) -> None:
    """Write commands of the examples."""
    cog.outl("\n".join(["```sh", *lines, "```"]))


def overview(cog: Any) -> None:
    """Write a line for each command."""
    import reference

    cog.outl("| command | what it does |\n| --- | --- |")
    for name, text in reference.overview():
        cog.outl(f"| `{name}` | {text} |")


def layouts(cog: Any) -> None:
    """Write the layouts."""
    from cachesim.layout import LAYOUTS

    cog.outl("| layout | |\n| --- | --- |")
    for name, text in LAYOUTS.items():
        cog.outl(f"| `{name}` | {text} |")


def policies(cog: Any) -> None:
    """Write the prefetch policies."""
    from cachesim.policies import described

    cog.outl("| policy | | |\n| --- | --- | --- |")
    for each in sorted(described().values()):
        form = each.form.replace("|", "\\|")
        cog.outl(f"| `{form}` | {each.help} | {'clock' if each.needs_clock else ''} |")


def machines(cog: Any) -> None:
    """Write the machines, and where their numbers come from."""
    from cachesim.clock.parameters import PRESETS

    cog.outl("| machine | |\n| --- | --- |")
    for name, preset in PRESETS.items():
        cog.outl(f"| `{name}` | {preset.source} |")


def source(cog: Any, path: str, begin: str = "", end: str = "") -> None:
    """Write a file of the program, or the part from the line that begins with ``begin`` to the one before ``end``."""
    text = (ROOT / path).read_text(encoding="utf-8")
    first = text.index(begin) if begin else 0
    last = text.index(end, first) if end else len(text)
    cog.outl(f"<!-- not run: it is a part of {path} -->\n```python\n{text[first:last].rstrip()}\n```")


def steps(cog: Any) -> None:
    """Write the accesses of example.din one by one, from the slow model of the cache that the tests use."""
    from tests.reference.cache import PREFETCH, Contents

    cache, unused = Contents(1, 2, "lru"), set()
    cog.outl("| | access | line | | the cache then, last used first |")
    cog.outl("| ---: | --- | --- | --- | --- |")
    for i, text in enumerate((EXAMPLES / "example.din").read_text(encoding="utf-8").splitlines(), 1):
        label, address = (int(word, 16) for word in text.split())
        line, is_prefetch = address // 32, label >= PREFETCH
        is_hit, victim = cache.access(line)
        what = [("redundant" if is_hit else "filled") if is_prefetch else ("hit" if is_hit else "miss")]
        if is_hit and not is_prefetch and line in unused:
            what.append("so that prefetch was useful")
            unused.discard(line)
        if victim is not None:
            what.append(f"{_letter(victim)} leaves" + (", useless" if victim in unused else ""))
            unused.discard(victim)
        if is_prefetch and not is_hit:
            unused.add(line)
        held = " ".join(_letter(each) for each in reversed(cache.sets[0]))
        cog.outl(f"| {i} | {'prefetch' if is_prefetch else 'read'} | {_letter(line)} | {'; '.join(what)} | {held} |")


def _letter(line: int) -> str:
    return "ABCDE"[line]


def of_replay(cog: Any) -> None:
    """Write the metrics of a replay of example.din."""
    (with_,) = json.loads(run(f"{REPLAY} --json"))
    with_["demand_miss_rate_without"] = with_["demand_misses_without"] / with_["demand_accesses"]
    _table(cog, with_, OF_REPLAY)


def of_time(cog: Any) -> None:
    """Write the metrics of the clock on the run of table.obj."""
    run(f"{RENDER} --overwrite")
    *_, row = json.loads(run(f"{TIME} --json"))
    (about,) = json.loads(run("nptrace info traces/table-bvh --json"))
    _table(cog, {**row, "n_rays": about["n_rays"]}, OF_TIME)


def by_level(cog: Any) -> None:
    """Write where the misses of the run of table.obj fall, by level."""
    run(f"{RENDER} --overwrite")
    rows = json.loads(run(f"{BY} --json"))
    misses = sum(row["demand_misses"] for row in rows)
    cog.outl("| level | demand miss rate | share of misses | coverage |")
    cog.outl("| ---: | --- | --- | --- |")
    for row in rows:
        n, without = row["demand_misses"], row["demand_misses_without"]
        if abs(row["demand_miss_rate"] - n / row["demand_accesses"]) + abs(row["coverage"] - (1 - n / without)) > 1e-12:
            raise SystemExit(f"the rates of level {row['level']} do not follow from its counts")
        rate = f"{n} / {row['demand_accesses']} = {_number(row['demand_miss_rate'])}"
        share, coverage = f"{n} / {misses} = {_number(n / misses)}", f"1 - {n} / {without} = {_number(row['coverage'])}"
        cog.outl(f"| {row['level']} | {rate} | {share} | {coverage} |")


def acpr(cog: Any) -> None:
    """Write the paper's equation for the miss rates of example.din."""
    from cachesim.report.table1 import PAPER_N
    from cachesim.report.table1 import acpr as of_paper

    (row,) = json.loads(run(f"{REPLAY} --json"))
    n, rate = PAPER_N["bvh"], row["paper_miss_rate"]
    value = of_paper(n, rate)
    assert value is not None and abs(value - n * ((1 - rate) + rate * 100)) < 1e-9
    cog.outl(f"With N = {n:.2f}, the paper's for BVHs, and R = {_number(rate)}: "
             f"{n:.2f} × ((1 - {_number(rate)}) × 1 + {_number(rate)} × 100) = {_number(value)} cycles per ray.")  # fmt: skip


def distances(cog: Any) -> None:
    """Write the stack distances of example.din's reads, and the misses of every fully associative cache that they give."""
    from cachesim import stack_distances

    _, demand = stack_distances(EXAMPLES / "example.din")
    counts = demand.counts[: N_LINES + 1, 0]
    assert counts.sum() == demand.counts[:, 0].sum()
    lines = range(1, N_LINES + 1)
    cog.outl("| stack distance | first access | " + " | ".join(map(str, lines)) + " |")
    cog.outl("| --- |" + " ---: |" * (N_LINES + 1))
    cog.outl("| accesses | " + " | ".join(map(str, counts)) + " |")
    cog.outl("| misses of a cache of so many lines | | " + " | ".join(str(demand.misses(n)[0]) for n in lines) + " |")


def _table(cog: Any, row: dict[str, Any], formulas: tuple[tuple[str, str], ...]) -> None:
    """Write formulas with the numbers put in; each must give what the program prints."""
    cog.outl("| | formula | here |")
    cog.outl("| --- | --- | --- |")
    for left, right in formulas:
        values = [eval(side, {}, {name: _exact(row[name]) for name in _names(side)}) for side in (left, right)]
        if abs(values[0] - values[1]) > 1e-12:
            raise SystemExit(f"{left} is {float(values[0])}, but {right} is {float(values[1])}")
        sides = [re.sub(r"[a-z_]+", lambda name: f"{row[name[0]]:,}", right), _number(float(values[1]))]
        cog.outl(f"| `{left}` | `{right}` | {' = '.join(sides)} |".replace("*", "×"))


def _names(formula: str) -> set[str]:
    return set(re.findall(r"[a-z_]+", formula))


def _exact(value: float) -> Fraction:
    return Fraction(value)


def _number(value: float) -> str:
    return f"{value:,.0f}" if value == int(value) else f"{value:.4g}"
