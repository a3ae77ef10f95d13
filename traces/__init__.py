"""The contract between the stages: what a run on disk is, how it is written and read.

The names below are imported when they are used.
"""

from nptrace_base.lazy import lazy_names

#: Tells this package from another one of its name, see ``nptrace.__main__``.
PART_OF = "nptrace"

#: Public names, and the module that defines each.
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

__all__ = sorted(_PLACES)

__getattr__, __dir__ = lazy_names(__name__, _PLACES)
