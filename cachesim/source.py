"""What can be replayed: a run or a DineroIV trace -> batches of events, and from events and a line size to line numbers."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from cachesim.access import PREFETCH
from cachesim.layout import Layout, addresses, addresses_in_order, parse_layout
from cachesim.lines import AddressLines, Lines, NodeLines, read_only
from cachesim.prefetch import KIND_LEAF, KIND_PREFETCH, REQUEST, Prefetch, UnitReplay
from nptrace_base.errors import NptraceError
from nptrace_base.jit import kernel
from nptrace_base.places import Place, Remote, place
from traces.address_files import AddressFile, is_address_file
from traces.din import DinTrace
from traces.format import printable
from traces.identity import RunIdentity
from traces.reader import Run, open_run
from traces.stream import STDIN, Stream

#: Events per batch: their arrays fit into a core's share of the last-level cache.
BATCH = 1 << 18


class Source(Protocol):
    """Something to replay."""

    identity: RunIdentity
    n_rays: int | None
    n_events: int | None  # None when the trace has to be read to know
    layout: Layout

    def events(self, prefetch: Prefetch) -> Iterator[tuple[Any, np.ndarray]]:
        """Yield batches of (events, access types), the input of ``Lines``."""

    def check_passes(self, n_passes: int) -> None:
        """Raise a StreamError if ``events`` cannot be read that many times."""

    def lines(self, line_bytes: int, ahead: int) -> Lines:
        """Return the lines of this source for one line size; a prefetcher may go ``ahead`` lines beyond an access."""


def open_source(path: Place | str, layout: Layout | str = "stored") -> Source:
    """Open a run, a trace of addresses in CSV or Parquet, or DineroIV's: a file, a pipe, or - for stdin."""
    path = place(path)
    if isinstance(path, Path) and not path.is_dir() and (path == STDIN or path.exists() or path.suffix == ".din"):
        stream = Stream(path)
        return DinSource(AddressFile(stream) if is_address_file(stream) else DinTrace(stream), layout)
    return RunSource(open_run(path), layout)


def as_source(source: "Source | Run | Place | str", layout: Layout | str = "stored") -> Source:
    """Return what can be replayed as a source; ``layout`` is that of a run or path, a source has its own."""
    if isinstance(source, Run):
        return RunSource(source, layout)
    return open_source(source, layout) if isinstance(source, (str, Path, Remote)) else source


class RunSource:
    """A run under a layout. Events are node numbers."""

    def __init__(self, run: Run, layout: Layout | str = "stored") -> None:
        self.layout = parse_layout(layout) if isinstance(layout, str) else layout
        self.run = run
        self.identity = run.identity
        self.n_rays: int | None = run.footer.n_rays
        self.n_events: int | None = run.n_accesses
        self.node_format, self._node_bytes = run.footer.tree.node_format, run.footer.tree.node_bytes
        reads_leaves = self.node_format.reads_leaves
        if self.layout.name == "stored" and reads_leaves:
            self._addresses = addresses_in_order(run.n_nodes, self._node_bytes, self.layout)
        else:
            nodes = run.columns("nodes", ["level", "parent"])
            self._addresses = addresses(nodes, self._node_bytes, self.layout, reads_leaves)

    def events(self, prefetch: Prefetch) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield (node, access type) batches of reads and requests; the reader has checked that the nodes are the tree's."""
        unit = None
        if prefetch.has_unit:
            where = str(self.run.path / "accesses.parquet")
            columns = self.run.columns("nodes", ["n_prims", "level", "parent"])
            unit = UnitReplay(prefetch, self.node_format, **columns, n_rows=self.run.n_accesses, where=where)
            unit.scout(self.run.batches)
        for group_nodes, group_kinds in self.run.batches():
            for start in range(0, group_nodes.size, BATCH):
                nodes, kinds = group_nodes[start : start + BATCH], group_kinds[start : start + BATCH]
                if unit is not None:
                    yield unit.events(nodes, kinds)
                    continue
                if not self.node_format.reads_leaves:  # a leaf that is entered is no access
                    is_access = kinds != KIND_LEAF
                    nodes, kinds = read_only(nodes[is_access]), read_only(kinds[is_access])
                if prefetch.kind == "traced":
                    yield nodes, (kinds == KIND_PREFETCH).view(np.uint8) * np.uint8(REQUEST)
                else:
                    demand = np.empty(nodes.size, np.uint32)
                    demand = demand[: demand_rows(nodes, kinds, demand)]
                    yield demand, np.zeros(demand.size, np.uint8)

    def check_passes(self, n_passes: int) -> None:
        """Do nothing: a run can be read repeatedly."""

    def lines(self, line_bytes: int, ahead: int) -> "NodeLines":
        """Return the lines of the nodes."""
        return NodeLines(self._addresses, self._node_bytes, line_bytes, ahead)


class DinSource:
    """A trace of addresses: DineroIV's, CSV or Parquet. Events are (address, size)."""

    n_rays: int | None = None
    n_events: int | None = None

    def __init__(self, trace: DinTrace | AddressFile, layout: Layout | str = "stored") -> None:
        self.layout = parse_layout(layout) if isinstance(layout, str) else layout
        if self.layout != Layout("stored"):
            raise NptraceError(
                f"{trace.stream.where} has addresses, not nodes, so it cannot use the layout {self.layout}; use stored"
            )
        self.trace = trace
        self.identity = RunIdentity(trace.stream.name, path=printable(trace.stream.where))

    def events(self, prefetch: Prefetch) -> Iterator[tuple[tuple[np.ndarray, np.ndarray | int], np.ndarray]]:
        """Yield ((address, size), access type) batches."""
        if prefetch.has_unit:
            way_out = "time" if prefetch.policy.needs_clock else "replay"
            raise NptraceError(
                f"{self.trace.stream.where} has addresses, not pushes, so no stack can be rebuilt for {prefetch}; "
                f"use traced, none or next-line, or {way_out} the run itself"
            )
        for address, size, access_types in self.trace.batches():
            if prefetch.kind != "traced" and (access_types >= PREFETCH).any():
                is_demand = access_types < PREFETCH
                size = size if isinstance(size, int) else size[is_demand]
                address, access_types = address[is_demand], access_types[is_demand]
            yield (address, size), access_types

    def check_passes(self, n_passes: int) -> None:
        """Raise a StreamError if the trace comes from a pipe and has to be read more than once."""
        self.trace.stream.check_passes(n_passes)

    def lines(self, line_bytes: int, ahead: int) -> "AddressLines":
        """Return the lines of the addresses."""
        return AddressLines(line_bytes, ahead)


def demand_only(values: np.ndarray, access_types: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the (uint32 value, access type) pairs that are not prefetches."""
    kept, kept_types = np.empty(values.size, np.uint32), np.empty(values.size, np.uint8)
    n = keep_demand(values, access_types, kept, kept_types)
    return kept[:n], kept_types[:n]


@kernel
def demand_rows(nodes, kinds, kept):
    """Copy the nodes of the rows that are not prefetches; return how many."""
    n = np.uint64(0)
    for i in range(nodes.size):
        kept[n] = nodes[i]
        n += np.uint64(kinds[i] != KIND_PREFETCH)
    return n


@kernel
def keep_demand(values, access_types, kept, kept_types):
    """Copy the pairs whose access type is not a prefetch; return how many."""
    n = 0
    for i in range(values.size):
        kept[n] = values[i]
        kept_types[n] = access_types[i]
        n += access_types[i] < PREFETCH
    return n
