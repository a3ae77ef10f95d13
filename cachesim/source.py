"""What can be replayed: a run or a DineroIV trace -> batches of events, and from events and a line size to line numbers."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from cachesim.dense import DenseIds
from cachesim.exact import PREFETCH
from cachesim.filter import DirectFilter
from cachesim.layout import Layout, addresses, parse_layout, stored_addresses
from cachesim.prefetch import KIND_PREFETCH, REQUEST, Prefetch, StackReplay
from jit import kernel
from traces.din import DinTrace
from traces.errors import NptraceError
from traces.reader import Run, open_run
from traces.stream import STDIN

#: Events handed on at a time: their arrays stay in a core's share of the last-level cache.
BATCH = 1 << 18


class Lines(Protocol):
    """The lines of a source for one line size: events in, the accesses of the cache out.

    An event over a line boundary is one access to each line.
    """

    def accesses(self, events: Any, labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (line uint32, label uint8) of every access of a batch of events."""

    def counted(
        self, events: Any, labels: np.ndarray, direct: DirectFilter | None, totals: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Add the accesses of a batch to ``totals`` (per label); return those that the filter, if any, keeps."""

    def ids(self, lines: np.ndarray) -> np.ndarray:
        """Return the dense id (uint32) of every line."""

    @property
    def n_ids(self) -> int:
        """Number of ids that may occur so far."""


class Source(Protocol):
    """Something to replay."""

    name: str
    n_rays: int | None
    n_events: int | None  # None when only reading the trace tells
    layout: Layout

    def events(self, prefetch: Prefetch) -> Iterator[tuple[Any, np.ndarray]]:
        """Yield batches of (events, labels): what ``Lines`` takes."""

    def check_passes(self, n_passes: int) -> None:
        """Raise a ValueError if ``events`` cannot be asked for so many times."""

    def lines(self, line_bytes: int, ahead: int) -> Lines:
        """Return the lines of this source for one line size; a pre-fetcher may go ``ahead`` lines beyond an access."""


def open_source(path: Path | str, layout: Layout | str = "stored") -> Source:
    """Open a run's directory, or a DineroIV trace: a file, a pipe, or - for stdin."""
    path = Path(path)
    if not path.is_dir() and (path == STDIN or path.exists() or path.suffix == ".din"):
        return DinSource(DinTrace(path), layout)
    return RunSource(open_run(path), layout)


class Footer(NamedTuple):
    """What a replay needs from a run's metadata."""

    tree: str
    node_bytes: int
    scene: str
    is_stand_in: bool


def read_footer(run: Run) -> Footer:
    """Return a run's tree and scene; a ValueError when its footer lacks one of them."""
    kind, node_bytes = run.tree
    try:
        scene = run.metadata["scene"]
        return Footer(kind, node_bytes, str(scene["name"]).lower(), bool(scene["stand_in"]))
    except (KeyError, TypeError, ValueError) as e:
        raise NptraceError(f"{run.path} says too little about its scene ({e} in its footer); render it again") from e


class RunSource:
    """A run under a layout. Events are node numbers."""

    def __init__(self, run: Run, layout: Layout | str = "stored") -> None:
        self.layout = parse_layout(layout) if isinstance(layout, str) else layout
        facts = read_footer(run)
        self.run = run
        self.name = run.name + (" (stand-in)" if facts.is_stand_in else "")
        self.n_rays: int | None = int(run.metadata["n_rays"])
        self.n_events: int | None = run.n_accesses
        self._is_kd, self._node_bytes = facts.tree == "kdtree", facts.node_bytes
        if self.layout.name == "stored":
            self._addresses = stored_addresses(run.n_nodes, self._node_bytes, self.layout)
        else:
            self._addresses = addresses(run.columns("nodes", ["level", "parent"]), self._node_bytes, self.layout)

    def events(self, prefetch: Prefetch) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield (node, label) batches; the reader has checked that the nodes are the tree's."""
        unit = None
        if prefetch.kind == "stack":
            where = str(self.run.path / "accesses.parquet")
            unit = StackReplay(prefetch, self._is_kd, **self.run.columns("nodes", ["n_prims", "level"]), where=where)
        for group_nodes, group_kinds in self.run.batches():
            for start in range(0, group_nodes.size, BATCH):
                nodes, kinds = group_nodes[start : start + BATCH], group_kinds[start : start + BATCH]
                if unit is not None:
                    yield unit.events(nodes, kinds)
                elif prefetch.kind == "traced":
                    yield nodes, (kinds == KIND_PREFETCH).view(np.uint8) * np.uint8(REQUEST)
                else:
                    demand = np.empty(nodes.size, np.uint32)
                    demand = demand[: demand_rows(nodes, kinds, demand)]
                    yield demand, np.zeros(demand.size, np.uint8)

    def check_passes(self, n_passes: int) -> None:
        """Do nothing: a run can be read again and again."""

    def lines(self, line_bytes: int, ahead: int) -> "NodeLines":
        """Return the lines of the nodes."""
        return NodeLines(self._addresses, self._node_bytes, line_bytes, ahead)


class NodeLines:
    """The lines of every node, looked up by its number. A layout packs the nodes, so the lines are their own dense ids."""

    def __init__(self, address: np.ndarray, node_bytes: int, line_bytes: int, ahead: int) -> None:
        shift = line_bytes.bit_length() - 1  # lines are powers of two, and a division took ten times as long
        first, last = address >> shift, (address + (node_bytes - 1)) >> shift
        lowest = int(first.min())  # numbering from it turns the sets round and changes no count
        self.n_ids = int(last.max()) - lowest + 1 + ahead
        if self.n_ids >= 1 << 31:
            raise NptraceError(f"the tree spans {self.n_ids} lines of {line_bytes} B; the limit is 2^31 - 1, use longer lines")
        self._first = (first - lowest).astype(np.uint32)
        self._last = (last - lowest).astype(np.uint32) if (last != first).any() else None

    def accesses(self, events: np.ndarray, labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the accesses of node reads."""
        events = read_only(events)
        first = look_up(self._first, events)
        return (first, labels) if self._last is None else split(first, look_up(self._last, events), labels)

    def counted(
        self, events: np.ndarray, labels: np.ndarray, direct: DirectFilter | None, totals: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the accesses of node reads that are kept."""
        if direct is not None and self._last is None:
            return direct.looked_up(self._first, read_only(events), labels, totals)
        return count_and_keep(*self.accesses(events, labels), direct, totals)

    def ids(self, lines: np.ndarray) -> np.ndarray:
        """Return the lines themselves."""
        return lines


class DinSource:
    """A DineroIV trace. Events are (address, size)."""

    n_rays: int | None = None
    n_events: int | None = None

    def __init__(self, trace: DinTrace, layout: Layout | str = "stored") -> None:
        self.layout = parse_layout(layout) if isinstance(layout, str) else layout
        if self.layout != Layout("stored"):
            raise NptraceError(
                f"{trace.stream.where} has addresses, not nodes, so it cannot be laid out as {self.layout}; use stored"
            )
        self.trace = trace
        self.name = trace.stream.name

    def events(self, prefetch: Prefetch) -> Iterator[tuple[tuple[np.ndarray, np.ndarray | int], np.ndarray]]:
        """Yield ((address, size), label) batches."""
        if prefetch.kind == "stack":
            raise NptraceError(
                f"{self.trace.stream.where} has addresses, not pushes, so no stack can be rebuilt for {prefetch}; "
                "use traced, none or next-line, or replay the run itself"
            )
        for address, size, labels in self.trace.batches():
            if prefetch.kind != "traced" and (labels >= PREFETCH).any():
                is_demand = labels < PREFETCH
                size = size if isinstance(size, int) else size[is_demand]
                address, labels = address[is_demand], labels[is_demand]
            yield (address, size), labels

    def check_passes(self, n_passes: int) -> None:
        """Raise a StreamError if the trace comes from a pipe and is to be read more than once."""
        self.trace.stream.check_passes(n_passes)

    def lines(self, line_bytes: int, ahead: int) -> "AddressLines":
        """Return the lines of the addresses."""
        return AddressLines(line_bytes)


class AddressLines:
    """The lines of addresses below 2^32, numbered as they appear."""

    def __init__(self, line_bytes: int) -> None:
        self._line_bytes = line_bytes
        self._dense = DenseIds()

    @property
    def n_ids(self) -> int:
        """Number of different lines so far."""
        return self._dense.n_ids

    def accesses(self, events: tuple[np.ndarray, np.ndarray | int], labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the accesses of reads at addresses."""
        address, size = events
        first = address // np.uint32(self._line_bytes)
        last = (address + (np.asarray(size, np.uint32) - np.uint32(1))) // np.uint32(self._line_bytes)  # below 2^32, checked
        return (first, labels) if np.array_equal(first, last) else split(first, last, labels)

    def counted(
        self, events: tuple[np.ndarray, np.ndarray | int], labels: np.ndarray, direct: DirectFilter | None, totals: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the accesses of reads that are kept."""
        return count_and_keep(*self.accesses(events, labels), direct, totals)

    def ids(self, lines: np.ndarray) -> np.ndarray:
        """Return the id of each line, numbering those not seen before."""
        return self._dense.ids(lines)


def count_and_keep(
    lines: np.ndarray, labels: np.ndarray, direct: DirectFilter | None, totals: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Add accesses to ``totals`` (per label); return those that the filter, if any, keeps."""
    tally(labels, totals)
    return (lines, labels) if direct is None else direct.accesses(lines, labels)


@kernel
def tally(labels, totals):
    """Count the labels into totals."""
    for label in labels:
        totals[label] += 1


def demand_only(values: np.ndarray, labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the (uint32 value, label) pairs that are not pre-fetches."""
    kept, kept_labels = np.empty(values.size, np.uint32), np.empty(values.size, np.uint8)
    n = keep_demand(values, labels, kept, kept_labels)
    return kept[:n], kept_labels[:n]


@kernel
def demand_rows(nodes, kinds, kept):
    """Copy the nodes of the rows that are no pre-fetches; return how many."""
    n = np.uint64(0)
    for i in range(nodes.size):
        kept[n] = nodes[i]
        n += np.uint64(kinds[i] != KIND_PREFETCH)
    return n


@kernel
def keep_demand(values, labels, kept, kept_labels):
    """Copy the pairs whose label is not a pre-fetch; return how many."""
    n = 0
    for i in range(values.size):
        kept[n] = values[i]
        kept_labels[n] = labels[i]
        n += labels[i] < PREFETCH
    return n


def read_only(array: np.ndarray) -> np.ndarray:
    """Return a view that cannot be written to, as Arrow's arrays cannot: to Numba that is another type, compiled apart."""
    view = array.view()
    view.flags.writeable = False
    return view


def look_up(table: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return table[rows] as uint32; the rows were checked to be in the table."""
    values = np.empty(rows.size, np.uint32)
    gather(table, rows, values)
    return values


@kernel
def gather(table, rows, values):
    """Copy table[rows[i]] to values[i]."""
    for i in range(rows.size):
        values[i] = table[rows[i]]


def split(first: np.ndarray, last: np.ndarray, labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return one access for every line that an event touches, in ascending order, each with the event's label."""
    n = first.size + int((last - first).sum(dtype=np.int64))
    lines, out_labels = np.empty(n, np.uint32), np.empty(n, np.uint8)
    fill_pieces(first, last, labels, lines, out_labels)
    return lines, out_labels


@kernel
def fill_pieces(first, last, labels, lines, out_labels):
    """Write the lines first[i] ... last[i] of every event i, and its label with each."""
    n = 0
    for i in range(first.size):
        for line in range(np.int64(first[i]), np.int64(last[i]) + 1):
            lines[n] = line
            out_labels[n] = labels[i]
            n += 1
