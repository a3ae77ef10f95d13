"""nptrace: node-cache studies in ray tracing, from Python as from the command line.

    >>> import nptrace as nt
    >>> run = nt.render("sponza", accel="bvh")
    >>> nt.replay(run, size="8K,16K", ways=2).to_pandas()

The functions have the names, the options and the defaults of the commands (docs/python.md). They are imported when they are
used, so importing this package costs nothing.
"""

from typing import Any

__version__ = "0.1.0"

#: Public names, and the module that defines each; ``__init__.pyi`` has them for type checkers.
_PLACES = {
    **dict.fromkeys(("compare", "open", "replay", "sweep", "table1", "time"), "nptrace.api"),
    **dict.fromkeys(("estimate", "render"), "nptrace.tracing"),
    **dict.fromkeys(("Picture", "map", "plot", "report", "view"), "nptrace.drawing"),
    **dict.fromkeys(("combine", "summarise"), "nptrace.summaries"),
    "CacheConfig": "cachesim.config",
    "NptraceError": "nptrace_base.errors",
    "Results": "nptrace.results",
    "Run": "traces.reader",
}

__all__ = ["__version__", *sorted(_PLACES)]


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib  # not nptrace_base.lazy: __main__ imports this package before it knows that the others are ours

    return getattr(importlib.import_module(_PLACES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_PLACES})
