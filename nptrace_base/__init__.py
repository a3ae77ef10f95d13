"""What both stages share: compiled kernels, atomic output, text tables, errors. Imports nothing of ours."""

#: Tells this package from another one of its name, see ``nptrace.__main__``.
PART_OF = "nptrace"
