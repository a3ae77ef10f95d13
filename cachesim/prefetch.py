"""Prefetch policies: rows of a trace (node, kind) -> the events a cache sees (node, label), prefetches among them.

A run records every push, so the node stack can be rebuilt from the demand rows alone, and any policy of the prefetch unit
replayed without rendering again. The unit has the stack's top ``sp`` and a pointer ``pp``. Push: pp = sp. Pop: pp =
min(pp, sp). At a non-empty leaf, before its triangles are tested: while there is budget and pp > 0, pp -= 1 and request
stack[pp]. The pointer stays where it stopped. A ray starts with an empty stack. Where leaves are no nodes in memory
(``traces.node_formats``), entering one is no read, and the pointer passes a leaf on the stack without a request.
"""

import re
from dataclasses import dataclass

import numpy as np

from cachesim.access import MISC, PREFETCH, READ
from cachesim.cache import ALWAYS, NEVER, ON_MISS, TAGGED
from nptrace_base.errors import NptraceError
from nptrace_base.jit import kernel
from traces.format import LEAF as KIND_LEAF
from traces.format import PREFETCH as KIND_PREFETCH
from traces.format import PUSH as KIND_PUSH
from traces.format import READ as KIND_READ
from traces.node_formats import CHILD_BOXES, NO_BOX, OWN_BOX, NodeFormat, stored_slots

#: A request of the prefetch unit as a label: what DineroIV calls type b.
REQUEST = PREFETCH | MISC

UNLIMITED = np.iinfo(np.int64).max

_TRIGGERS = {"always": ALWAYS, "miss": ON_MISS, "tagged": TAGGED}

FORMS = "none, traced, stack[:budget=K|tris*K|unlimited][:once][:empty] or next-line:always|miss|tagged[:DISTANCE]"


@dataclass(frozen=True, slots=True)
class Prefetch:
    """A prefetch policy.

    Attributes
    ----------
    kind : str
        ``"none"``: demand only; ``"traced"``: the requests in the trace; ``"stack"``: those of the prefetch unit, derived
        from the demand rows; ``"next-line"``: a sequential prefetcher in the cache, DineroIV's always, miss and tagged.
    budget : int
        stack: most requests at a leaf, or with ``per_triangle`` per triangle of the leaf.
    once : bool
        stack: an entry is requested at most once while it is on the stack, even if a later push moves the pointer back up.
    empty : bool
        stack: empty leaves trigger requests too.
    trigger, distance : int
        next-line: NEVER, ALWAYS, ON_MISS or TAGGED; and how many lines ahead.
    """

    kind: str
    budget: int = UNLIMITED
    per_triangle: bool = False
    once: bool = False
    empty: bool = False
    trigger: int = NEVER
    distance: int = 0

    def __str__(self) -> str:
        if self.kind == "next-line":
            name = next(name for name, trigger in _TRIGGERS.items() if trigger == self.trigger)
            return f"next-line:{name}" + (f":{self.distance}" if self.distance != 1 else "")
        if self.kind != "stack":
            return self.kind
        budget = "unlimited" if self.budget == UNLIMITED else f"{'tris*' if self.per_triangle else 'budget='}{self.budget}"
        return f"stack:{budget}{':once' if self.once else ''}{':empty' if self.empty else ''}"


def parse_prefetch(text: str) -> Prefetch:
    """Return the policy that a text such as ``traced``, ``stack:tris*2:once`` or ``next-line:tagged:2`` names."""
    kind, *options = text.strip().lower().split(":")
    if kind in ("none", "traced") and not options:
        return Prefetch(kind)
    if kind == "stack":
        return _parse_stack(text, options)
    if kind == "next-line" and 1 <= len(options) <= 2 and options[0] in _TRIGGERS:
        distance = options[1] if len(options) == 2 else "1"
        if re.fullmatch(r"[1-9]\d{0,5}", distance) is None:
            raise NptraceError(f"{text!r}: a distance is a number of lines from 1 to 999999, not {distance!r}")
        return Prefetch(kind, trigger=_TRIGGERS[options[0]], distance=int(distance))
    raise NptraceError(f"{text!r} is not a pre-fetch policy; write {FORMS}")


def _parse_stack(text: str, options: list[str]) -> Prefetch:
    budgets = []
    for option in options:
        match = re.fullmatch(r"(?:budget=)?(unlimited|(tris\*)?(\d{1,9}))", option)
        if match:
            budgets.append((UNLIMITED if match[1] == "unlimited" else int(match[3]), match[2] is not None))
        elif option not in ("once", "empty"):
            raise NptraceError(f"{text!r}: {option!r} is not an option of stack; write {FORMS}")
    if len(budgets) > 1 or len(set(options)) < len(options):
        raise NptraceError(f"{text!r} says something twice; write {FORMS}")
    budget, per_triangle = budgets[0] if budgets else (UNLIMITED, False)
    return Prefetch("stack", budget, per_triangle, "once" in options, "empty" in options)


class StackReplay:
    """The prefetch unit over one trace: batches of rows in, batches of events out, its stack kept in between.

    Parameters
    ----------
    policy : Prefetch
        Of kind ``stack``.
    node_format : NodeFormat
        Whether the row after a read (kind 0) is the child followed or popped, and which nodes are in memory.
    n_prims, level, parent : (n_nodes,) array
        Columns of ``nodes.parquet``.
    where : str
        What the rows are read from, for errors.
    """

    def __init__(
        self, policy: Prefetch, node_format: NodeFormat, n_prims: np.ndarray, level: np.ndarray, parent: np.ndarray,
        where: str = "accesses.parquet",
    ) -> None:  # fmt: skip
        self._where, self._n_rows = where, 0
        self._policy = policy
        self._boxes = node_format.boxes
        self._parent = np.ascontiguousarray(parent, np.int32)
        # Not looked at where all nodes are in memory: looking up every row took 5 % of the time.
        self._in_memory = np.empty(0, np.bool_) if node_format.reads_leaves else stored_slots(parent, node_format) >= 0
        self._n_prims = np.ascontiguousarray(n_prims, np.uint32)
        self._stack = np.zeros(max(int(level.max()), 1), np.int64)  # at most one entry per level above
        self._asked = np.zeros(self._stack.size, np.uint8)
        self._state = np.array([0, 0, -1, -1], np.int64)  # sp, pp, kind and node of the last demand row (-1: none yet)

    def events(self, nodes: np.ndarray, kinds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (nodes, labels) of the demand rows and of the requests that this policy makes; traced requests are dropped.

        Raises
        ------
        ValueError
            The rows are not a traversal of this tree: a popped node is not on the stack.
        """
        policy, pieces, start = self._policy, [], 0
        while start < nodes.size:
            out = np.empty(nodes.size - start + nodes.size // 4 + self._stack.size + 1, np.uint32)
            labels = np.empty(out.size, np.uint8)
            start, n, is_bad = rebuild(
                nodes, kinds, start, self._n_prims, self._parent, self._in_memory, self._boxes,
                policy.budget, policy.per_triangle, policy.once,
                policy.empty, self._stack, self._asked, self._state, out, labels,
            )  # fmt: skip
            if is_bad:
                raise NptraceError(
                    f"{self._where}, column 'node', row {self._n_rows + start}: {nodes[start]} does not follow from the rows "
                    "before it, as a node of a traversal does; render the run again"
                )
            pieces.append((out[:n], labels[:n]))
        self._n_rows += nodes.size
        if len(pieces) == 1:
            return pieces[0]
        return np.concatenate([p[0] for p in pieces] or [nodes]), np.concatenate([p[1] for p in pieces] or [kinds])


@kernel
def rebuild(
    nodes, kinds, start, n_prims, parent, in_memory, boxes, budget, per_triangle, once, empty, stack, asked, state, out, labels
):  # fmt: skip
    """Rebuild the stack over rows ``start`` on and write the events, until the rows or the room for events end.

    ``state`` is sp, pp, the kind and the node of the last demand row. Returns (the first row not done, events written,
    whether that row contradicts the rows before it).
    """
    sp, pp, last_kind, last_node = state[0], state[1], state[2], state[3]
    n = 0
    is_bad = False
    row = start
    while row < nodes.size and n + stack.size < out.size:
        kind = kinds[row]
        node = np.int64(nodes[row])
        if kind == KIND_PREFETCH:
            row += 1
            continue
        if node >= n_prims.size or kind > KIND_PREFETCH:
            is_bad = True
            break
        if node == 0:
            sp = pp = np.int64(0)
        elif last_kind == KIND_PUSH:
            if sp == stack.size:
                is_bad = True
                break
            stack[sp] = ((node - 1) ^ 1) + 1
            asked[sp] = 0
            sp += 1
            pp = sp
        elif last_kind == KIND_READ and (boxes == NO_BOX or (boxes == CHILD_BOXES and parent[node] == last_node)):
            pass  # the child followed
        elif last_kind < 0:
            is_bad = True
            break
        else:
            # Entries that begin beyond the nearest hit are popped, but not read; where a node has its own box, all are read.
            while sp > 0 and stack[sp - 1] != node:
                sp = np.int64(0) if boxes == OWN_BOX else sp - 1
            if sp == 0:
                is_bad = True
                break
            sp -= 1
            pp = min(pp, sp)
        if boxes != CHILD_BOXES or in_memory[node]:
            out[n] = node
            labels[n] = READ
            n += 1
        if kind == KIND_LEAF and (empty or n_prims[node] > 0):
            left = budget
            if per_triangle:
                left = budget * np.int64(n_prims[node])
            while left > 0 and pp > 0:
                pp -= 1
                if (once and asked[pp]) or (boxes == CHILD_BOXES and not in_memory[stack[pp]]):
                    continue
                asked[pp] = 1
                out[n] = stack[pp]
                labels[n] = REQUEST
                n += 1
                left -= 1
        last_kind, last_node = np.int64(kind), node
        row += 1
    state[0], state[1], state[2], state[3] = sp, pp, last_kind, last_node
    return row, n, is_bad
