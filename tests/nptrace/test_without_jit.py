"""NUMBA_DISABLE_JIT=1: every command runs without compiled kernels, without a warning, and writes the same bytes."""

import os
import re
import subprocess
import sys

import numpy as np
import pytest

from cachesim.all_associativity import LANES, SetCounts, _put_first
from cachesim.config import CacheConfig
from rtrace.scenes.shapes import icosphere

_STEPS = """
nptrace render ball.obj --name ball --pixels 12x9 --out runs --batch 5
nptrace render ball.obj --pixels 12x9 --out binned --accel bvh --bvh binned --order hilbert --batch 0
nptrace render stray.obj --pixels 6x6 --out stray --camera eye=2,1,1;at=0,0,0 --light 3,3,3
npcache replay runs/ball-kdtree --size 1K --ways 2 --line 32 --3c --json
npcache replay runs/ball-bvh --size 512 --ways 4 --line 64 --policy opt,fifo,random --prefetch none,stack:tris*2:once --json
npcache replay runs/ball-bvh --size 1K --ways 2 --layout veb,treelet:256 --prefetch next-line:tagged --json
npcache sweep runs/ball-kdtree runs/ball-bvh --size 512..4K --ways 1..16,full --line 32
npcache sweep runs/ball-kdtree --size 512..4K --ways 1..4 --layout bfs --prefetch traced,stack:tris*2
npcache summarise runs/ball-bvh --part 1/2 --size 1K --ways 2,full --prefetch none,stack --3c -o 1.sum
npcache summarise runs/ball-bvh --part 2/2 --size 1K --ways 2,full --prefetch none,stack --3c -o 2.sum
npcache combine 1.sum 2.sum --json
npcache estimate ball.obj --size 1K --ways 2 --pixels 24x16 --json
nptrace check ball.obj --pixels 8x8 --random 50 --json
nptrace export runs/ball-kdtree -o ball.din
npcache replay ball.din --size 1K --ways 2 --format dinero
"""


def _run(folder, plain):
    """Run every step in a process of its own; return what was printed, and every file."""
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1" if plain else "0", "PYTHONWARNINGS": "error::RuntimeWarning"}
    if plain:  # it builds its own trees
        environment["XDG_CACHE_HOME"] = str(folder.parent / "cache")
    printed = []
    for step in filter(None, _STEPS.splitlines()):
        program, *arguments = step.split()
        arguments = [argument.replace(";", " ") for argument in arguments]
        command = [sys.executable, "-c", f"import cli; cli.{program}()", *arguments]
        done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        assert "Warning" not in done.stderr and "Traceback" not in done.stderr
        printed.append(re.sub(r'(seconds\w*": )[^,\n]+', r"\1...", done.stdout))
    return printed, {str(f.relative_to(folder)): f.read_bytes() for f in sorted(folder.rglob("*")) if f.is_file()}


def _mesh(triangles):
    lines = ["v {} {} {}".format(*map(float, v)) for v in triangles.reshape(-1, 3)]
    return "\n".join([*lines, *(f"f {3 * i + 1} {3 * i + 2} {3 * i + 3}" for i in range(len(triangles)))])


@pytest.mark.slow
def test_every_command_prints_and_writes_the_same(tmp_path):
    results = []
    for plain in (True, False):
        folder = tmp_path / str(plain)
        folder.mkdir()
        (folder / "ball.obj").write_text(_mesh(icosphere(1)))
        far = np.float32([[[1e13, 0, 0], [1e13, 1e13, 0], [1e13, 0, 1e13]]])
        (folder / "stray.obj").write_text(_mesh(np.concatenate([icosphere(0), far])))
        results.append(_run(folder, plain))
    assert results[0] == results[1]
    assert len(results[0][1]) > 20


def test_the_twin_of_put_first():
    """Lines newest first: the line found moves out, the one carried comes in; without it the last one drops out."""
    rng = np.random.default_rng(1)
    for _ in range(200):
        lines = rng.permutation(40).astype(np.uint32)[: 2 * LANES]
        before, line = lines.tolist(), int(rng.integers(40))
        group = before[LANES:]
        at = group.index(line) if line in group else LANES
        assert _put_first(lines, np.uint64(LANES), np.uint32(line), np.uint32(99)) == (at, group[-1])
        assert lines.tolist() == before[:LANES] + ([99, *group[:at], *group[at + 1 :]])[:LANES]


@pytest.mark.parametrize("ways", [2, 18, 40])
def test_a_walk_in_python_counts_what_a_compiled_one_counts(ways):
    script = (
        "import numpy as np; from cachesim.config import CacheConfig; from cachesim.all_associativity import SetCounts\n"
        "rng = np.random.default_rng(4); lines = rng.integers(0, 300, 3000).astype(np.uint32)\n"
        f"set_counts = SetCounts([CacheConfig({ways} * 64 * 4, {ways}, 64)])\n"
        "set_counts.step(lines, (lines % 3 == 0).astype(np.uint8))\n"
        "print(set_counts.counts.tolist())"
    )
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True)
    lines = np.random.default_rng(4).integers(0, 300, 3000).astype(np.uint32)
    set_counts = SetCounts([CacheConfig(ways * 64 * 4, ways, 64)])
    set_counts.step(lines, (lines % 3 == 0).astype(np.uint8))
    assert done.stdout.strip() == str(set_counts.counts.tolist())
