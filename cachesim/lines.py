"""Events of a source and a line size -> line numbers: looked up for nodes, divided for addresses."""

from typing import Any, Protocol

import numpy as np

from cachesim.filter import DirectFilter
from cachesim.line_ids import DenseIds
from nptrace_base.errors import NptraceError
from nptrace_base.jit import kernel


class Lines(Protocol):
    """The lines of a source for one line size: events in, the accesses of the cache out.

    An event that crosses a line boundary is one access to each line.
    """

    def accesses(self, events: Any, access_types: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (line uint32, access type uint8) of every access of a batch of events."""

    def counted(
        self, events: Any, access_types: np.ndarray, direct: DirectFilter | None, totals: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Add the accesses of a batch to ``totals`` (per access type); return those that the filter, if any, keeps."""

    def ids(self, lines: np.ndarray) -> np.ndarray:
        """Return the dense id (uint32) of every line."""

    @property
    def n_ids(self) -> int:
        """Number of ids that may occur so far."""


class NodeLines:
    """The lines of every node, by node number. A layout packs the nodes, so line numbers serve as dense ids.

    A leaf that is no node in memory has the address -1, and no event names it.
    """

    def __init__(self, address: np.ndarray, node_bytes: int, line_bytes: int, ahead: int) -> None:
        if address.min() < 0:
            address = np.where(address < 0, address.max(), address)
        shift = line_bytes.bit_length() - 1  # a line is a power of two, and a division took ten times as long
        first, last = address >> shift, (address + (node_bytes - 1)) >> shift
        lowest = int(first.min())  # numbering from it only permutes the sets, which changes no count
        self.n_ids = int(last.max()) - lowest + 1 + ahead
        if self.n_ids >= 1 << 31:
            raise NptraceError(f"the tree spans {self.n_ids} lines of {line_bytes} B; the limit is 2^31 - 1; use longer lines")
        self._first = (first - lowest).astype(np.uint32)
        self._last = (last - lowest).astype(np.uint32) if (last != first).any() else None

    def of_nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the lowest line and the number of lines of every node, both uint32."""
        last = self._first if self._last is None else self._last
        return self._first, last - self._first + np.uint32(1)

    def n_of(self, events: np.ndarray) -> np.ndarray | None:
        """Return the number of accesses of each node read; None if it is one for all nodes."""
        return None if self._last is None else self._last[events] - self._first[events] + np.uint32(1)

    def accesses(self, events: np.ndarray, access_types: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the accesses of node reads."""
        events = read_only(events)
        first = look_up(self._first, events)
        return (first, access_types) if self._last is None else split(first, look_up(self._last, events), access_types)

    def counted(
        self, events: np.ndarray, access_types: np.ndarray, direct: DirectFilter | None, totals: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the accesses of node reads that are kept."""
        if direct is not None and self._last is None:
            return direct.looked_up(self._first, read_only(events), access_types, totals)
        return count_and_keep(*self.accesses(events, access_types), direct, totals)

    def ids(self, lines: np.ndarray) -> np.ndarray:
        """Return the lines themselves."""
        return lines


class AddressLines:
    """The lines of addresses below 2^32, numbered as they appear."""

    def __init__(self, line_bytes: int, ahead: int) -> None:
        self._shift = np.uint32(min(line_bytes.bit_length() - 1, 32))  # a line of 2^32 B or more holds all addresses
        if (1 << 32 >> int(self._shift)) + ahead > 1 << 32:
            raise NptraceError(
                f"addresses below 2^32 have 2^32 lines of {line_bytes} B, and a prefetcher that goes {ahead} further would "
                "need more; use longer lines"
            )
        self._dense = DenseIds()

    @property
    def n_ids(self) -> int:
        """Number of different lines so far."""
        return self._dense.n_ids

    def accesses(self, events: tuple[np.ndarray, np.ndarray | int], access_types: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the accesses of reads at addresses."""
        address, size = events
        first = address >> self._shift
        last = (address + (np.asarray(size, np.uint32) - np.uint32(1))) >> self._shift  # below 2^32, checked
        return (first, access_types) if np.array_equal(first, last) else split(first, last, access_types)

    def counted(
        self,
        events: tuple[np.ndarray, np.ndarray | int],
        access_types: np.ndarray,
        direct: DirectFilter | None,
        totals: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the accesses of reads that are kept."""
        return count_and_keep(*self.accesses(events, access_types), direct, totals)

    def ids(self, lines: np.ndarray) -> np.ndarray:
        """Return the id of each line; a new line gets the next number."""
        return self._dense.ids(lines)


def count_and_keep(
    lines: np.ndarray, access_types: np.ndarray, direct: DirectFilter | None, totals: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Add accesses to ``totals`` (per access type); return those that the filter, if any, keeps."""
    tally(access_types, totals)
    return (lines, access_types) if direct is None else direct.accesses(lines, access_types)


@kernel
def tally(access_types, totals):
    """Count the access types into totals."""
    for access_type in access_types:
        totals[access_type] += 1


def read_only(array: np.ndarray) -> np.ndarray:
    """Return a read-only view. Arrow's arrays are read-only, and Numba compiles a kernel anew for that type."""
    view = array.view()
    view.flags.writeable = False
    return view


def look_up(table: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return table[rows] as uint32; the caller has checked that the rows are in the table."""
    values = np.empty(rows.size, np.uint32)
    gather(table, rows, values)
    return values


@kernel
def gather(table, rows, values):
    """Copy table[rows[i]] to values[i]."""
    for i in range(rows.size):
        values[i] = table[rows[i]]


def split(first: np.ndarray, last: np.ndarray, access_types: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return one access for every line that an event touches, in ascending order, each with the event's access type."""
    n = first.size + int((last - first).sum(dtype=np.int64))
    lines, out_types = np.empty(n, np.uint32), np.empty(n, np.uint8)
    fill_pieces(first, last, access_types, lines, out_types)
    return lines, out_types


@kernel
def fill_pieces(first, last, access_types, lines, out_types):
    """Write the lines first[i] ... last[i] of every event i, each with the event's access type."""
    n = 0
    for i in range(first.size):
        for line in range(np.int64(first[i]), np.int64(last[i]) + 1):
            lines[n] = line
            out_types[n] = access_types[i]
            n += 1
