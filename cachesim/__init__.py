"""Stage 2: a run on disk -> cache counts -> tables and reports.

The names below are imported when they are used; ``replay``, ``sweep`` and ``grid`` are in the modules of these names.
"""

import importlib
from typing import Any

#: Tells this package from another one of its name, see ``nptrace.__main__``.
PART_OF = "nptrace"

#: Public names, and the module each is in. Importing all of them takes a second, which a command's help does not have.
_PLACES = {
    "CacheConfig": "config",
    "Layout": "layout",
    "Prefetch": "prefetch",
    "Result": "result",
    "as_source": "source",
    "open_source": "source",
    "parse_layout": "layout",
    "parse_prefetch": "prefetch",
    "stack_distances": "stack_distance",
}

__all__ = [
    "CacheConfig",
    "Layout",
    "Prefetch",
    "Result",
    "as_source",
    "open_source",
    "parse_layout",
    "parse_prefetch",
    "stack_distances",
]


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_PLACES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
