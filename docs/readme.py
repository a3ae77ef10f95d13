"""What cog runs for README.md: commands whose real output stands there, and Table I from the figures under docs/."""

import csv
import os
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
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
    """Write Table I from docs/table1.csv, ours beside the paper's, one row per cache."""
    with open(ROOT / "docs" / "table1.csv", encoding="utf-8") as file:
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
