"""What both stages stand on: compiled kernels, files written atomically, text tables, errors. Imports nothing of ours."""

#: Tells this package from another one of its name, see ``nptrace.__main__``.
PART_OF = "nptrace"
