"""A tree built in parts: large nodes are split one by one, subtrees built by any thread, and all put together depth-first.

The numbers of a subtree's nodes depend on how many nodes stand before it, which is not known while others are built. So each
part counts from its own root, and a last pass moves it to its place: the tree is that of one thread, byte for byte.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from typing import Any, Generic, Protocol, TypeVar

from nptrace_base.pools import thread_pool

#: Subtrees of up to so many triangles are one part; below some ten thousand the parts cost more than they save.
LEAST_PART, PARTS_PER_THREAD = 1 << 14, 8


class _Built(Protocol):
    @property
    def nodes(self) -> Any:
        """The nodes of a subtree, its root first."""


_B = TypeVar("_B", bound=_Built)
_S = TypeVar("_S")


class TreePart(Generic[_B]):
    """A subtree that is built, or a node that was split alone, with the parts of its children."""

    def __init__(self, built: _B) -> None:
        self.built = built
        self.children: list[Future[TreePart[_B]]] = []


def part_limit(n: int, threads: int) -> int:
    """Return how many of n triangles a part may have; n or more if the tree is to be one part."""
    most = max(n // (PARTS_PER_THREAD * threads), LEAST_PART)
    return n if threads == 1 or n <= 2 * most else most


def build_in_parts(
    step: Callable[[_S, bool], tuple[_B, Sequence[_S]]], whole: _S, size: Callable[[_S], int], threads: int
) -> TreePart[_B]:  # fmt: skip
    """Build the tree of ``whole`` in parts, by threads.

    Parameters
    ----------
    step : callable
        Called with what a subtree is built from and whether to split its root alone; returns what is built and, after a split,
        what the lower and the upper child are to be built from.
    size : callable
        Returns the number of triangles of what a subtree is built from.
    """
    most = part_limit(size(whole), threads)
    with thread_pool(threads) as pool:

        def part_of(source: _S) -> TreePart[_B]:
            built, children = step(source, size(source) > most)
            part = TreePart(built)
            part.children = [pool.submit(part_of, child) for child in children]
            return part

        root = pool.submit(part_of, whole)
        del whole  # what it is built from is large, and let go part by part
        waiting = [root]
        while waiting:  # until all are built: a part submits its children before it is done
            waiting += waiting.pop().result().children
        return root.result()


def placed(root: TreePart[_B]) -> Iterator[tuple[TreePart[_B], int, int]]:
    """Yield the parts depth-first, each with the number of its root and that of the first of its other nodes."""
    n, waiting = 1, [(root, 0)]
    while waiting:
        part, at = waiting.pop()
        yield part, at, n
        waiting += [(child.result(), n + k) for k, child in reversed(list(enumerate(part.children)))]
        n += len(part.built.nodes) - 1
