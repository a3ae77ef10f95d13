"""``python -m tests.bench.scaling [--quick | SCENE [SIZE...]]``: how cost and memory of both stages grow with the picture.

Renders one scene's BVH at growing sizes and replays each trace through one cache (8K, 2-way), every command as a separate
process whose CPU time and highest memory are read at its end. Writes docs/data/scaling.csv and docs/scaling.svg; ``--quick``
measures one small picture and writes nothing.
"""

import csv
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from traces.reader import open_run

ROOT = Path(__file__).resolve().parents[2]
SIZES = (128, 256, 512, 1024, 2048, 4096)
HEADER = ["scene", "pixels a side", "rays", "accesses", "bytes", "render s", "replay s", "render MB", "replay MB"]

#: Runs a command and prints, as the last line, its CPU seconds without those of its start, and its highest memory in MB.
_MEASURE = """
import resource, sys, time
import cli, nptrace_base.jit, pyarrow.parquet, rtrace.render, cachesim.replay
before = time.process_time()
group, *args = sys.argv[1:]
getattr(cli, group)(args, standalone_mode=False)
used = time.process_time() - before
print(used, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""


def measure(*command: str) -> tuple[float, float]:
    """Run ``nptrace`` or ``npcache`` with arguments; return (CPU s, MB)."""
    done = subprocess.run(
        [sys.executable, "-c", _MEASURE, *command], check=True, capture_output=True, text=True, cwd=ROOT, env=dict(os.environ)
    )
    seconds, megabytes = done.stdout.split()[-2:]
    return float(seconds), float(megabytes)


def rows(scene: str, sizes: tuple[int, ...]) -> list[list[object]]:
    """Return one row per size."""
    found: list[list[object]] = []
    with tempfile.TemporaryDirectory() as name:
        render = ("nptrace", "render", scene, "--accel", "bvh", "--offline", "--name", scene, "--overwrite", "--out", name)
        measure(*render, "--pixels", "16x16")  # builds the tree, compiles
        path = Path(name) / f"{scene}-bvh"
        replay = ("npcache", "replay", str(path), "--size", "8K", "--assoc", "2")
        measure(*replay)
        for size in sizes:
            # The least of several: the small ones are over in less time than the machine's other work takes away at once.
            repeat = max(1, min(5, 1024 // size))
            rendered = min(measure(*render, "--pixels", f"{size}x{size}") for _ in range(repeat))
            replayed = min(measure(*replay) for _ in range(repeat))
            run = open_run(path)
            n_bytes = sum(file.stat().st_size for file in path.iterdir())
            numbers = [rendered[0], replayed[0], rendered[1], replayed[1]]
            found.append([scene, size, run.footer.n_rays, run.n_accesses, n_bytes, *(f"{x:.4g}" for x in numbers)])
            print(*found[-1], sep="\t", flush=True)
    return found


def plot(found: list[list[str]], path: Path) -> None:
    """Draw cost per access and per ray, and memory, over the number of accesses."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    accesses = [int(row[3]) for row in found]
    stages = (("render", 5, 7, "o"), ("replay", 6, 8, "s"))
    with rc_context({"svg.hashsalt": "nptrace", "svg.fonttype": "none", "font.size": 9}):
        figure = Figure(figsize=(9.6, 2.9), layout="constrained")
        panels = figure.subplots(1, 3)
        for name, seconds, megabytes, marker in stages:
            style = {"marker": marker, "markersize": 4, "linewidth": 1.1, "label": name}
            panels[0].plot(accesses, [float(row[seconds]) * 1e9 / int(row[3]) for row in found], **style)
            panels[1].plot(accesses, [float(row[seconds]) * 1e6 / int(row[2]) for row in found], **style)
            panels[2].plot(accesses, [float(row[megabytes]) for row in found], **style)
        for panel, title in zip(panels, ("CPU ns per access", "CPU µs per ray", "highest memory, MB"), strict=True):
            panel.set_xscale("log")
            panel.set_ylim(bottom=0)
            panel.set_title(title, fontsize=9)
            panel.grid(color="0.88", linewidth=0.6)
            panel.spines[["top", "right"]].set_visible(False)
        panels[2].axhline(1024, color="0.4", linestyle=":", linewidth=1)
        panels[0].legend(frameon=False)
        figure.supxlabel("accesses in the trace", fontsize=9)
        figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else {})


def main() -> None:
    """Measure, write and draw."""
    if sys.argv[1:] == ["--quick"]:
        rows("court", (32,))
        return
    scene, *sizes = sys.argv[1:] or ["sponza"]
    found = rows(scene, tuple(map(int, sizes)) or SIZES)
    with open(ROOT / "docs" / "data" / "scaling.csv", "w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([HEADER, *found])
    plot([[str(value) for value in row] for row in found], ROOT / "docs" / "scaling.svg")


if __name__ == "__main__":
    main()
