"""Prefetch policies at replay: a policy's name -> ``Prefetch``; and rows of a trace -> the events that a cache sees.

A run records every push, so the node stack can be rebuilt from the demand rows alone, and every policy that depends on nothing
else replayed without rendering again: its unit (``cachesim.policies``) is asked after each read, and gets all that it wants.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from cachesim.access import MISC, PREFETCH, READ
from cachesim.cache import NEVER
from cachesim.policies import Facts, Policy, hooks, own_policy, policies
from cachesim.policies.machine import NodeColumns, first_waiting, make_machine, stop_waiting
from nptrace_base.errors import NptraceError
from nptrace_base.jit import kernel
from traces.format import LEAF as KIND_LEAF
from traces.format import PREFETCH as KIND_PREFETCH
from traces.format import PUSH as KIND_PUSH
from traces.format import READ as KIND_READ
from traces.node_formats import CHILD_BOXES, NO_BOX, OWN_BOX, NodeFormat, stored_slots

#: A request of a prefetch unit as an access type: what DineroIV calls type b.
REQUEST = PREFETCH | MISC


@dataclass(frozen=True, slots=True)
class Prefetch:
    """A prefetch policy with its options.

    Attributes
    ----------
    policy : Policy
    options : mapping
        Keyword arguments of its units.
    text : str
        As it is printed.
    """

    policy: Policy
    options: Mapping[str, Any]
    text: str

    def __str__(self) -> str:
        return self.text

    @property
    def kind(self) -> str:
        """The policy's name."""
        return self.policy.name

    @property
    def trigger(self) -> int:
        """When the cache itself requests a line: NEVER, ALWAYS, ON_MISS or TAGGED."""
        return int(self.options.get("trigger", NEVER))

    @property
    def distance(self) -> int:
        """How many lines ahead the cache requests."""
        return int(self.options.get("distance", 0))

    @property
    def has_requests(self) -> bool:
        """Whether requests of nodes stand among the events: those of a unit, or of the trace."""
        return self.kind != "none" and not self.trigger

    @property
    def has_unit(self) -> bool:
        """Whether a unit makes the requests during the replay."""
        return self.has_requests and self.policy.make_unit is not None


def parse_prefetch(text: str) -> Prefetch:
    """Return the policy that a text such as ``traced``, ``stack:tris*2:once`` or ``next-line:tagged:2`` names."""
    name, *options = text.strip().lower().split(":")
    policy = own_policy(name) or policies().get(name)
    if policy is None:
        known = ", ".join(policy.form for policy in policies().values())
        raise NptraceError(f"{text!r}: there is no prefetch policy {name!r}; write one of {known}")
    try:
        values = policy.parse(options)
    except NptraceError as e:
        raise NptraceError(f"{text!r}: {e}; write {policy.form}") from None
    return Prefetch(policy, values, ":".join([name, *policy.show(values, options)]))


class UnitReplay:
    """A prefetch unit over one trace: batches of rows in, batches of events out; the stack is kept in between.

    Parameters
    ----------
    prefetch : Prefetch
        Of a policy whose requests depend on the demand rows alone.
    node_format : NodeFormat
        Whether the row after a read (kind 0) is the child followed or popped, and which nodes are in memory.
    n_prims, level, parent : (n_nodes,) array
        Columns of ``nodes.parquet``.
    n_rows : int
        Demand rows of the trace, for policies that need two passes.
    where : str
        The file of the rows, for messages.
    """

    def __init__(
        self, prefetch: Prefetch, node_format: NodeFormat, n_prims: np.ndarray, level: np.ndarray, parent: np.ndarray,
        n_rows: int = 0, where: str = "accesses.parquet",
    ) -> None:  # fmt: skip
        if prefetch.policy.needs_clock:
            raise NptraceError(f"what {prefetch} requests depends on time, which a replay does not have; use npcache time")
        self._prefetch, self._where = prefetch, where
        self._boxes = node_format.boxes
        tree = NodeColumns(
            n_prims=np.ascontiguousarray(n_prims, np.uint32),
            level=np.ascontiguousarray(level, np.uint16),
            parent=np.ascontiguousarray(parent, np.int32),
            first_line=np.zeros(0, np.uint32),
            n_lines=(stored_slots(parent, node_format) >= 0).astype(np.uint8),
        )
        self._tree, self._facts = tree, Facts(node_format.node_bytes, node_format.node_bytes, n_rows)
        make_unit = prefetch.policy.make_unit
        assert make_unit is not None
        self._make_unit: Callable[..., Any] = make_unit
        self._start(lambda machine: make_unit(machine, self._facts, **prefetch.options))

    def _start(self, make_unit: Callable[[Any], Any]) -> None:
        """Begin at the first row."""
        self._n_rows = 0
        self._machine = make_machine(self._tree, 1)
        self._unit = make_unit(self._machine)
        self._last = np.array([-1, -1, 0], np.int64)  # kind and node of the last demand row (-1: none yet), rows before it

    def scout(self, rows: Callable[[], Iterator[Any]]) -> None:
        """Go through all rows once before the first ``events``, if the policy needs that."""
        prefetch = self._prefetch
        scout = prefetch.policy.scout
        unit = scout(self._machine, self._facts, **prefetch.options) if scout else None
        if unit is None:
            return
        self._start(lambda machine: unit)
        for nodes, kinds in rows():
            self.events(nodes, kinds)
        self._start(lambda machine: self._make_unit(machine, self._facts, scouted=unit, **prefetch.options))

    def events(self, nodes: np.ndarray, kinds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (nodes, access types) of the demand rows and of the policy's requests; traced requests are dropped.

        Raises
        ------
        NptraceError
            The rows are not a traversal of this tree: a popped node is not on the stack.
        """
        pieces, start, depth = [], 0, self._machine.stack.shape[1]
        while start < nodes.size:
            out = np.empty(nodes.size - start + nodes.size // 4 + 2 * depth + 2, np.uint32)
            types = np.empty(out.size, np.uint8)
            start, n, is_bad = rebuild(
                nodes, kinds, start, self._unit, self._machine, self._boxes, self._last, (out, types)
            )  # fmt: skip
            if n < 0:
                raise NptraceError(
                    f"{self._prefetch} requests more than {2 * depth} nodes at one read; it may request as many at most"
                )
            if is_bad:
                raise NptraceError(
                    f"{self._where}, column 'node', row {self._n_rows + start}: a traversal cannot read node {nodes[start]} "
                    "after the rows before it; render the run again"
                )
            pieces.append((out[:n], types[:n]))
        self._n_rows += nodes.size
        if len(pieces) == 1:
            return pieces[0]
        return np.concatenate([p[0] for p in pieces] or [nodes]), np.concatenate([p[1] for p in pieces] or [kinds])


@kernel(_nrt=False)
def rebuild(nodes, kinds, start, unit, machine, boxes, last, events):
    """Rebuild the stack over rows ``start`` on and write the events, until the rows or the room for events end.

    ``last`` is the kind and the node of the last demand row, and the number of demand rows. Returns (the first row not done,
    events written, whether that row contradicts the rows before it).
    """
    out, types = events
    n_prims, parent, n_lines = machine.tree.n_prims, machine.tree.parent, machine.tree.n_lines
    stack, pushed_at, depth = machine.stack, machine.pushed_at, machine.stack.shape[1]
    sp, last_kind, last_node, n_rows = machine.sp[0], last[0], last[1], last[2]
    slot, n, row, is_bad = np.int64(0), np.int64(0), np.int64(start), False
    while row < nodes.size and n + 2 * depth + 1 < out.size:
        kind = kinds[row]
        node = np.int64(nodes[row])
        if kind == KIND_PREFETCH:
            row += 1
            continue
        if node >= n_prims.size or kind > KIND_PREFETCH:
            is_bad = True
            break
        if last_kind == KIND_LEAF:
            hooks.on_leaf_end(unit, machine, slot)
        if node == 0:
            if last_kind >= 0:
                hooks.on_end(unit, machine, slot)
            machine.sp[0] = sp = np.int64(0)
            hooks.on_start(unit, machine, slot)
        elif last_kind == KIND_PUSH:
            if sp == depth:
                is_bad = True
                break
            stack[0, sp] = ((node - 1) ^ 1) + 1
            pushed_at[0, sp] = n_rows - 1
            sp += 1
            machine.sp[0] = sp
            hooks.on_push(unit, machine, slot)
        elif last_kind == KIND_READ and (boxes == NO_BOX or (boxes == CHILD_BOXES and parent[node] == last_node)):
            pass  # the child followed
        elif last_kind < 0:
            is_bad = True
            break
        else:
            # Entries that begin beyond the nearest hit are popped, but not read; where a node has its own box, all are read.
            while sp > 0 and stack[0, sp - 1] != node:
                sp = np.int64(0) if boxes == OWN_BOX else sp - 1
            if sp == 0:
                is_bad = True
                break
            sp -= 1
            machine.sp[0] = sp
            hooks.on_pop(unit, machine, slot)
        if boxes != CHILD_BOXES or n_lines[node] > 0:  # looking every row up took 5 % of the time
            out[n], types[n] = node, READ
            n += 1
        n = _requests(unit, machine, out, types, n)
        if kind == KIND_LEAF and n >= 0:
            hooks.on_leaf(unit, machine, slot, node)
            n = _requests(unit, machine, out, types, n)
        if n < 0:
            break
        last_kind, last_node = np.int64(kind), node
        n_rows += 1
        row += 1
    last[0], last[1], last[2] = last_kind, last_node, n_rows
    return row, n, is_bad


@kernel(_nrt=False, forceinline=True)
def _requests(unit, machine, out, types, n):
    """Write all that the unit wants to request now; return the number of events, -1 if there is no room for them."""
    while first_waiting(machine) >= 0:
        node = hooks.request(unit, machine, np.int64(0))
        if node < 0:
            stop_waiting(machine, np.int64(0))
        elif n == out.size:
            return np.int64(-1)
        else:
            out[n], types[n] = node, REQUEST
            n += 1
            hooks.requested(unit, machine, np.int64(0))
    return n
