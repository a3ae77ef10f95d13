"""What cog runs for the pages: commands whose real output stands there, and tables from the figures under docs/data/."""

import csv
import json
import os
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT / "docs" / "data"
TREES = {"kdtree": "kd-tree", "bvh": "BVH"}
FOLDER = Path(tempfile.gettempdir()) / f"nptrace-readme-{os.getpid()}"


def have_scenes() -> bool:
    """Whether the real scenes are at hand; without them the recorded output stays as it is."""
    folder = os.environ.get("NPTRACE_SCENES")
    return folder is not None and (Path(folder) / "bunny.ply").exists()


def show(cog, *commands: str) -> None:
    """Write each command and what it prints to stdout, as a terminal session in a fenced block."""
    if not have_scenes():
        print("docs: the real scenes are not at hand (NPTRACE_SCENES); recorded output kept", file=sys.stderr)
        cog.out(cog.previous)
        return
    FOLDER.mkdir(exist_ok=True)
    lines = ["```console"]
    for command in commands:
        words = shlex.split(command)
        words[0] = str(Path(sys.executable).parent / words[0])
        done = subprocess.run(words, cwd=FOLDER, capture_output=True, text=True, check=False)
        if done.returncode:
            raise SystemExit(f"{command}: {done.stderr}")
        lines += [f"$ {command}", *(line.rstrip() for line in done.stdout.strip("\n").splitlines())]
    cog.outl("\n".join([*lines, "```"]))


def table1(cog) -> None:
    """Write Table I from table1.csv, ours beside the paper's, one row per cache."""
    with open(DATA / "table1.csv", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    cog.outl("| | | miss A % | paper | miss B % | paper | B/A % | paper | KB B/A % | paper | *demand* A % | *demand* B/A % |")
    cog.outl("| --- | --- |" + " ---: |" * 10)
    for tree, scene in dict.fromkeys((row["tree"], row["scene"]) for row in rows):
        for row in rows:
            if (row["tree"], row["scene"]) != (tree, scene):
                continue
            cells = [
                float(row[f"{name}{of}"]) for name in ("miss_a", "miss_b", "miss_ratio", "kb_ratio") for of in ("", "_paper")
            ]
            cells += [float(row["demand_miss_a"]), float(row["demand_ratio"])]
            cache = f"{int(row['size_bytes']) // 1024}K({row['ways']})"
            cog.outl(f"| {TREES[tree]} {scene.capitalize()} | {cache} | " + " | ".join(f"{cell:.1f}" for cell in cells) + " |")


def hard_cases(cog) -> None:
    """Write what ``nptrace check --hard --json`` found, one line per case: the worst of its structures."""
    rows = json.loads((DATA / "hard_cases.json").read_text(encoding="utf-8"))
    cog.outl("| case | structures | rays | lost | invented | wrong | unlike | ambiguous | t error | bound |")
    cog.outl("| --- |" + " ---: |" * 9)
    for case in dict.fromkeys(row["case"] for row in rows):
        of = [row for row in rows if row["case"] == case]
        sums = " | ".join(str(max(row[name] for row in of)) for name in ("lost", "invented", "wrong", "unlike", "ambiguous"))
        error = max(row["t_error"] for row in of)
        cog.outl(f"| {case} | {len(of)} | {of[0]['n_rays']:,} | {sums} | {error:.2g} | {of[0]['bound']:g} |")


def embree(cog) -> None:
    """Write what ``nptrace check --json`` found, one line per kind of rays and comparison: the worst over scenes and trees."""
    rows = json.loads((DATA / "embree.json").read_text(encoding="utf-8"))
    cog.outl("| rays | compared | comparisons | rays in all | largest | limit |")
    cog.outl("| --- | --- |" + " ---: |" * 4)
    for rays, what in dict.fromkeys((row["rays"], row["what"]) for row in rows):
        of = [row for row in rows if (row["rays"], row["what"]) == (rays, what)]
        worst = max(of, key=lambda row: row["value"])
        n_rays = sum(row["n_rays"] for row in of)
        cog.outl(f"| {rays} | {what} | {len(of)} | {n_rays:,} | {worst['value']:.3g} | {worst['limit']:.3g} |")


def checks(cog) -> None:
    """Write what ``python -m tests.checks`` counted: all tests, a line per file and below it one per check."""
    sys.path.insert(0, str(ROOT))
    from tests.checks import what_files_check

    rows = {row["check"]: row for row in json.loads((DATA / "checks.json").read_text(encoding="utf-8"))}
    n_tests, n_cases = (sum(row[name] for row in rows.values()) for name in ("tests", "cases"))
    failed, skipped, expected = (
        sum(row[name] for row in rows.values()) for name in ("failed", "skipped", "expected failures")
    )
    cog.outl(f"{len(rows)} checks, {n_tests:,} tests, {n_cases:,} cases: {failed} failed, {skipped} skipped, "
             f"{expected} known to fail.\n")  # fmt: skip
    cog.outl("| check | tests | cases | largest error | result |")
    cog.outl("| --- | ---: | ---: | ---: | --- |")
    for file, what in what_files_check().items():
        of = [row for name, row in rows.items() if name.split("::")[0] == file]
        if not of:
            continue
        cog.outl(f"| **{file}**: {_cell(what)} | **{sum(row['tests'] for row in of):,}** | "
                 f"**{sum(row['cases'] for row in of):,}** | | |")  # fmt: skip
        for row in of:
            name = row["check"].split("::test_")[1].replace("_", " ")
            error = "" if row["largest error"] is None else f"{row['largest error']:.2g}"
            cog.outl(f"| {_cell(name)} | {row['tests']:,} | {row['cases']:,} | {error} | {_result(row)} |")


def _result(row) -> str:
    parts = [f"{row[name]} {name}" for name in ("failed", "skipped", "expected failures") if row[name]]
    return ", ".join(parts) or "passed"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("``", "`")


def open_list(cog) -> None:
    """Write which tests and hard cases cover each entry of the open list."""
    sys.path.insert(0, str(ROOT))
    from tests.open_list import OPEN_LIST

    cog.outl("| | hard case | covered by |")
    cog.outl("| --- | --- | --- |")
    for entry in OPEN_LIST:
        cog.outl(f"| {entry.name} | {entry.what} | {', '.join(entry.covered_by) or '**nothing yet**'} |".replace("::", ": "))


def fuzz(cog) -> None:
    """Write how many inputs ``make fuzz`` tried."""
    data = json.loads((DATA / "fuzz.json").read_text(encoding="utf-8"))
    total = sum(row["tried"] for row in data["rows"])
    cog.outl(f"{total:,} inputs were tried, and each was accepted or refused as it should be.\n")
    cog.outl("| inputs | tried | accepted | refused |")
    cog.outl("| --- |" + " ---: |" * 3)
    for row in data["rows"]:
        cog.outl(f"| {row['inputs']} | {row['tried']:,} | {row['accepted']:,} | {row['refused']:,} |")


def mutations(cog) -> None:
    """Write which test noticed each mutation."""
    with open(DATA / "mutations.csv", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    sys.path.insert(0, str(ROOT))
    from tests.mutations import MUTATIONS

    survived = sum(not row["noticed by"] for row in rows)
    cog.outl(f"{len(rows)} of the {len(MUTATIONS)} mutations on the list were tried, {survived} survived.\n")
    cog.outl("| mutation | file | noticed by |")
    cog.outl("| --- | --- | --- |")
    for row in rows:
        test = row["noticed by"].split("[")[0].replace(".py::", ": ")
        what = row["mutation"].replace("|", "\\|")
        cog.outl(f"| {what} | {row['file']} | {test or '**survived**'} |")
