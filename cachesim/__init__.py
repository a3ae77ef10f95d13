"""Stage 2: a run on disk -> cache counts -> tables and reports."""

#: Tells this package from another one of its name, see ``nptrace.__main__``.
PART_OF = "nptrace"
