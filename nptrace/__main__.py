"""The entry points of both programs and ``python -m nptrace``: packages are imported only once they are known to be ours.

Other distributions have packages of our names (PyPI's pycachesim is imported as ``cachesim``, its traces as ``traces``).
They can hide ours or replace it; a traceback from the middle of a command would not explain that.
"""

import importlib
import importlib.util
import os
import sys
from typing import NoReturn

import nptrace as ours

#: Our other packages and modules at the top of site-packages; ``cli`` last, which imports the others.
PARTS = ("nptrace_base", "traces", "rtrace", "cachesim", "cli")


def check_parts() -> None:
    """Leave with one sentence, exit status 2, if a part is another distribution's."""
    for name in PARTS:
        spec = importlib.util.find_spec(name)
        where = spec and (spec.origin or next(iter(spec.submodule_search_locations or ()), None))
        if not where:
            _leave(f"{name}, a part of nptrace, is missing; install nptrace again")
        beside = os.path.dirname(where) if name == "cli" else os.path.dirname(os.path.dirname(where))
        if beside != os.path.dirname(os.path.dirname(ours.__file__)) or not _is_ours(name):
            _leave(
                f"{name} is imported from {where}, which is not nptrace's: another package of that name hides it; remove that "
                "from PYTHONPATH, or install nptrace into a separate environment"
            )


def _is_ours(name: str) -> bool:
    """Return whether a package in the place of ours is ours; ``cli`` is ours if these are."""
    if name == "cli":
        return True
    try:
        return getattr(importlib.import_module(name), "PART_OF", None) == "nptrace"
    except ImportError:
        return False


def _leave(sentence: str) -> NoReturn:
    print(f"Error: {sentence}", file=sys.stderr)
    raise SystemExit(2)


def nptrace() -> None:
    """Run stage 1."""
    check_parts()
    importlib.import_module("cli").nptrace()


def npcache() -> None:
    """Run stage 2."""
    check_parts()
    importlib.import_module("cli").npcache()


def package() -> None:
    """Run ``python -m nptrace``: stage 1, or stage 2 behind the word ``cache``."""
    if sys.argv[1:2] != ["cache"]:
        return nptrace()
    del sys.argv[1]
    check_parts()
    importlib.import_module("cli").npcache(prog_name="python -m nptrace cache")


if __name__ == "__main__":
    package()
