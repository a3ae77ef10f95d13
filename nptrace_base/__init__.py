"""What both stages stand on: compiled kernels, files written atomically, text tables, errors. Imports nothing of ours."""
