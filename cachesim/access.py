"""The types of an access, as DineroIV numbers them: the low bits say what it is, PREFETCH is or-ed."""

#: Labels of accesses, as in a DineroIV trace: the low bits are the type, PREFETCH is or-ed.
READ, WRITE, IFETCH, MISC, PREFETCH = 0, 1, 2, 3, 8


N_LABELS = 16
