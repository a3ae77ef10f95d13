"""Importing any module of ours changes nothing: no folder, no setting of Python, Numba, LLVM or the environment."""

import os
import subprocess
import sys
from pathlib import Path

import cli

ROOT = Path(cli.__file__).resolve().parent
MODULES = sorted(
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    for package in ("nptrace", "nptrace_base", "rtrace", "cachesim", "traces")
    for path in (ROOT / package).rglob("*.py")
    if not path.stem.startswith("__main__")
)
CODE = """
import gc, importlib, os, sys, warnings
import numba, llvmlite.binding as llvm
calls = []
llvm.set_option = lambda *words: calls.append(words)
def state():
    settings = {n: v for n, v in vars(numba.config).items() if n.isupper()}
    return gc.get_threshold(), dict(os.environ), settings, list(warnings.filters)
before = state()
for name in sys.argv[1:]:
    importlib.import_module(name)
    assert state() == before, name
    assert not calls, (name, calls)
"""


def test_importing_changes_nothing(tmp_path):
    environment = {**os.environ, "HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache"), "TMPDIR": str(tmp_path)}
    environment.pop("NUMBA_CACHE_DIR", None)
    environment["PYTHONDONTWRITEBYTECODE"] = "1"
    done = subprocess.run([sys.executable, "-c", CODE, *MODULES], cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert list(tmp_path.iterdir()) == []
    assert len(MODULES) > 50
