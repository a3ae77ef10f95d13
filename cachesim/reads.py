"""What one visit of a node reads, decided at replay: a run's source in, a source with other events out.

A run records visits. ``own``: each visit reads the node, as recorded. ``children``: a node that is entered has both its
children read at once, and what has been read with its parent is not read again, as in a BVH whose traversal tests both boxes
at the parent. ``merged``: the traversal unit keeps the line that it read last, so a visit within that line is no access.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from cachesim.lines import NodeLines
from cachesim.prefetch import REQUEST, Prefetch
from cachesim.source import DinSource, RunSource
from nptrace_base.errors import NptraceError
from nptrace_base.jit import kernel

READS = ("own", "children", "merged")

#: What ``merge_reads`` remembers of the last visit: the lowest of its lines, and how many.
_FIRST, _COUNT = range(2)


def reads_of(source: Any, reads: str, line_bytes: int, flush: str = "never") -> Any:
    """Return a source whose visits read what ``reads``, one of ``READS``, says.

    ``line_bytes`` and ``flush`` matter for merged: what empties the cache after a ray empties the unit's line too.
    """
    if reads == "own":
        return source
    if isinstance(source, DinSource):
        raise NptraceError(f"{source.identity.run} has addresses, not visits, so reads must be own, not {reads}")
    if reads == "merged":
        return MergedReads(source, line_bytes, is_emptied=flush == "ray")
    if reads == "children":
        return ChildReads(source)
    raise NptraceError(f"{reads!r} is not what a visit can read; choose one of {', '.join(READS)}")


class _Derived:
    """A source made of another one: the same nodes in the same places, with other events."""

    def __init__(self, source: RunSource) -> None:
        self._source, self.layout, self.identity = source, source.layout, source.identity
        self.n_rays, self.n_events = source.n_rays, source.n_events

    def check_passes(self, n_passes: int) -> None:
        """Do nothing: a run can be read repeatedly."""

    def lines(self, line_bytes: int, ahead: int) -> NodeLines:
        """Return the lines of the nodes."""
        return self._source.lines(line_bytes, ahead)


class ChildReads(_Derived):
    """Both children are read when their parent is entered; a request of a node reads its children, and of a leaf nothing.

    The root alone is read by itself. Boxes are thus known before a node is popped, but which nodes are entered is the same.
    """

    def __init__(self, source: RunSource) -> None:
        super().__init__(source)
        if not source.node_format.reads_leaves:
            raise NptraceError(f"nodes of {source.identity.run} hold both children's boxes already, so reads must be own")
        self._parent = np.ascontiguousarray(source.run.columns("nodes", ["parent"])["parent"], np.int32)
        self._child = np.zeros(self._parent.size, np.int64)
        self._child[self._parent[1::2]] = np.arange(1, self._parent.size, 2)

    def events(self, prefetch: Prefetch) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield (node, access type) batches."""
        last = np.array([-1], np.int64)
        for nodes, access_types in self._source.events(prefetch):
            read, read_types = np.empty(2 * nodes.size, np.uint32), np.empty(2 * nodes.size, np.uint8)
            n = read_children(nodes, access_types, self._parent, self._child, last, read, read_types)
            yield read[:n], read_types[:n]


class MergedReads(_Derived):
    """Visits within the line, or lines, that the last visit read are no accesses; requests are as they were."""

    def __init__(self, source: RunSource, line_bytes: int, *, is_emptied: bool = False) -> None:
        super().__init__(source)
        self._is_emptied = is_emptied
        self._first, self._n_lines = source.lines(line_bytes, 0).of_nodes()
        self._line_bytes = line_bytes

    def events(self, prefetch: Prefetch) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield (node, access type) batches."""
        last = np.array([-1, -1], np.int64)
        for nodes, access_types in self._source.events(prefetch):
            read, read_types = np.empty(nodes.size, np.uint32), np.empty(nodes.size, np.uint8)
            n = merge_reads(nodes, access_types, self._first, self._n_lines, last, self._is_emptied, read, read_types)
            yield read[:n], read_types[:n]

    def lines(self, line_bytes: int, ahead: int) -> NodeLines:
        """Return the lines of the nodes; NptraceError for lines of another size than those in which visits are merged."""
        if line_bytes != self._line_bytes:
            raise NptraceError(
                f"visits are merged in lines of {self._line_bytes} B, and a cache has lines of {line_bytes} B; replay one "
                "size of lines at a time"
            )
        return super().lines(line_bytes, ahead)


@kernel
def read_children(nodes, access_types, parent, child, last, read, read_types):
    """Write the reads of both children for every node entered; ``last`` is the node visited last. Return how many."""
    n = np.uint64(0)
    for i in range(nodes.size):
        node = np.int64(nodes[i])
        if access_types[i] == REQUEST:
            first = child[node]
        else:
            first = ((node - 1) & -2) + 1 if parent[node] == last[0] else np.int64(0)
            last[0] = node
            if node == 0:
                read[n], read_types[n] = 0, access_types[i]
                n += np.uint64(1)
                continue
        if first == 0:
            continue
        for sibling in range(2):
            read[n + np.uint64(sibling)], read_types[n + np.uint64(sibling)] = first + sibling, access_types[i]
        n += np.uint64(2)
    return n


@kernel
def merge_reads(nodes, access_types, first, n_lines, last, is_emptied, read, read_types):
    """Copy the requests, and the visits of other lines than ``last``. Return how many.

    With ``is_emptied`` a ray, which starts at the root, finds no line.
    """
    n = np.uint64(0)
    for i in range(nodes.size):
        node = nodes[i]
        if access_types[i] != REQUEST:
            if node == 0 and is_emptied:
                last[_COUNT] = 0
            line, count = np.int64(first[node]), np.int64(n_lines[node])
            if line >= last[_FIRST] and line + count <= last[_FIRST] + last[_COUNT]:
                continue
            last[_FIRST], last[_COUNT] = line, count
        read[n], read_types[n] = node, access_types[i]
        n += np.uint64(1)
    return n
