"""Stage 2: a run on disk -> cache counts -> tables and reports.

The names below are imported when they are used; ``replay``, ``sweep`` and ``grid`` are in the modules of these names.
"""

from nptrace_base.lazy import lazy_names

#: Tells this package from another one of its name, see ``nptrace.__main__``.
PART_OF = "nptrace"

#: Public names, and the module that defines each.
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

__all__ = sorted(_PLACES)

__getattr__, __dir__ = lazy_names(__name__, _PLACES)
