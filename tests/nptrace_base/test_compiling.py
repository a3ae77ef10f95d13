"""Compiling: ahead of the first use, announced when it happens, and never the same kernel twice."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from nptrace_base import compiling
from nptrace_base.jit import cache_folder

ROOT = Path(__file__).resolve().parents[2]

SIGNATURES = """
import sys
from nptrace import precompile
from numba.core.dispatcher import Dispatcher
for part in precompile.PARTS:
    part()
for name, module in sorted(sys.modules.items()):
    if name.split(".")[0] in ("rtrace", "cachesim", "traces"):
        for kernel in vars(module).values():
            if isinstance(kernel, Dispatcher) and kernel.py_func.__module__ == name:
                for signature in kernel.signatures:
                    print(name, kernel.py_func.__name__, *signature, sep="|")
"""

USE = """
import sys, cli
from nptrace_base import compiling
from click.testing import CliRunner
def run(group, *args):
    result = CliRunner().invoke(group, args)
    assert result.exit_code == 0, result.output
one = ["traces/blob-kdtree", "--prefetch", "treelet"]
small = ["--pixels", "8x8", "--offline"]
run(cli.nptrace, "render", "blob", "--name", "blob", *small)
run(cli.nptrace, "render", "court", "--accel", "bvh", "--bvh", "binned", "--batch", "0", *small)
knobs = ["--shadow", "all", "--shadow-order", "cheaper", "--shadow-end", "drain"]
run(cli.nptrace, "render", "court", "--packet", "16", "--out", "packets", *knobs, *small)
run(cli.nptrace, "check", "blob", *small, "--random", "50")
run(cli.nptrace, "export", "traces/blob-bvh")
run(cli.npcache, "replay", "--assoc", "1,2,4", "--policy", "lru,fifo,random", "--line", "16,32,64")
run(cli.npcache, "replay", "--3c", "--layout", "veb,bfs,dfs,treelet:256", "--prefetch", "none,stack:once,next-line:miss")
run(cli.npcache, "replay", "blob-bvh.din", "--line", "8,32")
run(cli.npcache, "sweep", "--ways", "1..24,full", "--prefetch", "traced,stack")
run(cli.npcache, "replay", "--assoc", "1,2,4", "--policy", "opt")
for part in "12":
    run(cli.npcache, "summarise", "traces/blob-bvh", "--part", f"{part}/2", "--assoc", "1,2,4,full", "-o", f"{part}.sum")
    run(cli.npcache, "summarise", "traces/blob-bvh", "--part", f"{part}/2", "--3c", "-o", f"3c-{part}.sum")
run(cli.npcache, "combine", "1.sum", "2.sum")
run(cli.npcache, "combine", "3c-1.sum", "3c-2.sum")
run(cli.npcache, "time", "--size", "1K", "--rays", "4", "--layout", "veb", "--by", "slot", "--timeline", "t.json", *one)
run(cli.npcache, "replay", "--by", "pixel", "--line", "16,32", "--prefetch", "none,traced,stack,next-line:tagged")
run(cli.npcache, "replay", "--by", "level", "--assoc", "2", "--policy", "lru,opt,random", "--3c")
run(cli.nptrace, "view", "traces/blob-kdtree", "traces/blob-bvh", "--heat", "accesses,misses,late-cycles", "-o", "heat.png")
run(cli.npcache, "plot", "traces/blob-bvh", "-o", "distances.png")
run(cli.npcache, "compare", "traces/blob-bvh")
run(cli.nptrace, "map", "blob", "--quick", *small)
run(cli.nptrace, "render", "bunny", "--name", "bunny", "--out", "table", *small)
run(cli.npcache, "table1", "--traces", "table")
run(cli.npcache, "estimate", "blob", "--table1", "--pixels", "32x32", "--offline")
print(compiling.n_compiled)
"""


def python(code, cwd, **environment):
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **environment}
    environment.pop("NPTRACE_SCENES", None)
    return subprocess.run([sys.executable, "-c", code], cwd=cwd, env=environment, capture_output=True, text=True, check=True)


@pytest.mark.slow
def test_no_kernel_is_compiled_twice_and_nothing_after_compile(tmp_path):
    """Read-only and other arrays, int64 and a literal are different types to Numba: each would be a compilation more."""
    seen = set()
    for line in python(SIGNATURES, tmp_path).stdout.splitlines():
        same = re.sub(
            r"Literal\[int\]\(\d+\)", "int64", re.sub(r"nonconst |readonly |Array\((\w+, \d, '\w').*?\)", r"\1", line)
        )
        assert same not in seen, line
        seen.add(same)
    assert len(seen) > 25
    assert python(USE, tmp_path).stdout == "0\n"


REPLAY = """
import sys, cli
from click.testing import CliRunner
assert CliRunner().invoke(cli.npcache, ["replay"]).exit_code == 0
heavy = {"pandas", "matplotlib", "scipy", "trimesh", "numba.np.linalg", "numba.cpython.unicode"}
print(sorted((heavy | {"cachesim.by_group", "cachesim.policies.treelet"}) & set(sys.modules)))
"""


def test_a_warm_start_imports_only_what_it_uses(tmp_path):
    """Neither pandas, which Arrow looks for, nor what Numba can compile, nor what draws, nor other policies."""
    pytest.importorskip("pandas")
    python("import nptrace as nt; nt.replay(nt.render('blob', pixels='8x8', accel='bvh', offline=True))", tmp_path)
    assert python(REPLAY, tmp_path).stdout == "[]\n"


def test_the_first_compilation_is_announced_once(monkeypatch):
    said = []
    monkeypatch.setattr(compiling, "n_compiled", 0)
    monkeypatch.setattr(compiling, "announce", said.append)
    for _ in range(3):
        compiling.started(cache_folder())
    assert len(said) == 1 and str(cache_folder()) in said[0]
    assert compiling.n_compiled == 3


def test_only_a_program_announces_it(tmp_path):
    """On stderr, for a kernel that is really compiled; a warm start says nothing."""
    program = """
import sys, cli
sys.argv = ["nptrace", "--help"]
try:
    cli.nptrace()
except SystemExit:
    from nptrace_base import jit
    jit.kernel(lambda x: x + 1, is_kept=False)(1)
"""
    done = python(program, tmp_path)
    assert done.stderr.startswith("compiling for this machine, once") and done.stderr.count("\n") == 1
    assert python("import cli; from nptrace_base import jit; jit.cache_folder()", tmp_path).stderr == ""
