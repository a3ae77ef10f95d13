"""Access types, as DineroIV numbers them (it calls them labels): the low bits say what an access is, PREFETCH is or-ed."""

READ, WRITE, IFETCH, MISC, PREFETCH = 0, 1, 2, 3, 8

N_ACCESS_TYPES = 16
