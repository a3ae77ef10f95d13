"""What both stages share: compiled kernels, atomic output, text tables, errors. Imports nothing of ours."""
