"""One way to break the program on purpose."""

from typing import NamedTuple


class Mutation(NamedTuple):
    """``old`` stands once (or in every place meant) in ``file``; ``tests`` are the files that should notice."""

    what: str
    file: str
    old: str
    new: str
    tests: str
