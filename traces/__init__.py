"""The contract between the stages: what a run on disk is, how it is written and read."""

#: Tells this package from another one of its name, see ``nptrace.__main__``.
PART_OF = "nptrace"
