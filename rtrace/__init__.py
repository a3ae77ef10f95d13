"""Stage 1: scene -> tree -> traced rays -> a run on disk."""

#: Tells this package from another one of its name, see ``nptrace.__main__``.
PART_OF = "nptrace"
