"""The contract between the stages: what a run on disk is, how it is written and read.

The names below are imported when they are used.
"""

import importlib
from typing import Any

#: Tells this package from another one of its name, see ``nptrace.__main__``.
PART_OF = "nptrace"

#: Public names, and the module each is in. Importing all of them takes a second, which a command's help does not have.
_PLACES = {
    "DinTrace": "din",
    "Footer": "footer",
    "Run": "reader",
    "RunError": "format",
    "RunWriter": "writer",
    "export_din": "din",
    "find_runs": "reader",
    "open_run": "reader",
}

__all__ = [
    "DinTrace",
    "Footer",
    "Run",
    "RunError",
    "RunWriter",
    "export_din",
    "find_runs",
    "open_run",
]


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_PLACES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
