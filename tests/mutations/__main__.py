"""``python -m tests.mutations [WORD] [-o FILE]``."""

from tests.mutations import main

main()
