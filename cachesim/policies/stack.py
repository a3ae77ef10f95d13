"""The paper's prefetch unit (Park et al. 2013, section 3), with the knobs that the paper leaves open."""

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from cachesim.policies import Facts, Policy, whole
from cachesim.policies.hooks import NOTHING
from cachesim.policies.machine import Machine, drop, offer, stop_waiting
from nptrace_base.errors import NptraceError
from nptrace_base.jit import inlined

FORM = "stack[:budget=K|tris*K|unlimited][:once][:persist|restart][:empty|pop][:level=L][:live]"
HELP = (
    "the paper's unit: at a leaf the stack from the top down, where a push sets its pointer to the top; persist: only if it "
    "is there already; restart: each leaf sets it there; empty (without a clock): leaves without triangles too; pop: at every "
    "pop, not at leaves; live: only entries that the ray will read"
)

UNLIMITED = np.iinfo(np.int64).max
#: What sets the pointer to the top of the stack: a push; a push while it is there already; a push and each trigger.
TOP, PERSIST, RESTART = range(3)
_RESETS = {"persist": PERSIST, "restart": RESTART}


class Stack(NamedTuple):
    """While a leaf's triangles are tested, request the entries of the ray's stack from the pointer down, one at a time.

    A push sets the pointer to the top, a pop moves it down with the top; it stays where it stopped. With ``pop`` the time for
    requests runs from a pop to the next pop or push instead.

    Attributes
    ----------
    pointer, left, open : (n_slots,) int64
        Entries below the pointer; requests that the leaf in test, or the pop, still allows; and those of them to come.
    asked : (n_slots, depth) uint8
        Whether an entry has been requested since it was pushed.
    wanted : (n_rows,) uint8
        Per demand row: whether the entry pushed there may be requested; empty: all may.
    budget, per_triangle
        Most requests at a leaf, or for each of its triangles.
    once, empty, pop
        Request an entry once only; let leaves without triangles trigger; let pops trigger, and no leaf.
    reset : int
        ``TOP``, ``PERSIST`` or ``RESTART``.
    levels : int
        Deepest level that is requested.
    """

    pointer: np.ndarray
    left: np.ndarray
    open: np.ndarray
    asked: np.ndarray
    wanted: np.ndarray
    budget: int
    per_triangle: bool
    once: bool
    empty: bool
    pop: bool
    reset: int
    levels: int

    def on_start(self, machine, slot):
        self.pointer[slot] = 0
        self.left[slot] = 0
        self.open[slot] = 0

    def on_push(self, machine, slot):
        if self.pop:
            close(self, machine, slot)
        if self.reset != PERSIST or self.pointer[slot] == machine.sp[slot] - 1:
            self.pointer[slot] = machine.sp[slot]
        self.asked[slot, machine.sp[slot] - 1] = 0

    def on_pop(self, machine, slot):
        if self.pop:
            close(self, machine, slot)
        self.pointer[slot] = min(self.pointer[slot], machine.sp[slot])
        if self.pop:
            begin(self, machine, slot, self.budget)

    def on_leaf(self, machine, slot, node):
        n_prims = np.int64(machine.tree.n_prims[node])
        if self.pop or (n_prims == 0 and not self.empty):
            return
        begin(self, machine, slot, self.budget * n_prims if self.per_triangle else self.budget)

    def on_leaf_end(self, machine, slot):
        if not self.pop:
            close(self, machine, slot)

    def on_end(self, machine, slot):
        if self.pop:
            close(self, machine, slot)

    def request(self, machine, slot):
        while self.left[slot] > 0 and self.pointer[slot] > 0:
            entry = self.pointer[slot] - 1
            if may_request(self, machine, slot, entry):
                return machine.stack[slot, entry]
            self.pointer[slot] = entry
        return np.int64(NOTHING)

    def requested(self, machine, slot):
        self.pointer[slot] -= 1
        self.asked[slot, self.pointer[slot]] = 1
        self.left[slot] -= 1
        self.open[slot] -= 1


@inlined
def begin(unit, machine, slot, budget):
    """Offer the entries from the pointer down, ``budget`` of them at most."""
    if unit.reset == RESTART:
        unit.pointer[slot] = machine.sp[slot]
    unit.left[slot] = budget
    unit.open[slot] = n_candidates(unit, machine, slot)
    offer(machine, slot, unit.open[slot])


@inlined
def close(unit, machine, slot):
    """Drop what has not been requested."""
    stop_waiting(machine, slot)
    if unit.open[slot] > 0:
        drop(machine, slot, unit.open[slot])
    unit.open[slot] = 0
    unit.left[slot] = 0


@inlined
def may_request(unit, machine, slot, entry):
    """Return whether the unit may request an entry of the stack."""
    node = machine.stack[slot, entry]
    if machine.tree.n_lines[node] == 0 or machine.tree.level[node] > unit.levels:
        return False
    if unit.once and unit.asked[slot, entry] != 0:
        return False
    return unit.wanted.size == 0 or unit.wanted[machine.pushed_at[slot, entry]] != 0


@inlined
def n_candidates(unit, machine, slot):
    """Return the number of requests that the unit would make now, had it the port to itself."""
    n, entry = np.int64(0), unit.pointer[slot] - 1
    while entry >= 0 and n < unit.left[slot]:
        n += np.int64(may_request(unit, machine, slot, entry))
        entry -= 1
    return n


class Reads(NamedTuple):
    """A unit that requests nothing and notes which entries are read when they leave the stack.

    Attributes
    ----------
    used : (n_rows,) uint8
        Per demand row: the entry pushed there has been read.
    """

    used: np.ndarray

    def on_pop(self, machine, slot):
        self.used[machine.pushed_at[slot, machine.sp[slot]]] = 1


def parse_unit(options: Sequence[str]) -> dict[str, Any]:
    """Return the options of the unit."""
    values: dict[str, Any] = {}
    for option in options:
        budget = re.fullmatch(r"(?:budget=)?(unlimited|(tris\*)?(\d{1,9}))", option)
        if budget:
            new = {"budget": UNLIMITED if budget[1] == "unlimited" else int(budget[3]), "per_triangle": budget[2] is not None}
        elif option.startswith("level="):
            new = {"levels": whole(option, "level", 0, 1 << 16)}
        elif option in ("once", "empty", "pop"):
            new = {option: True}
        elif option in _RESETS:
            new = {"reset": _RESETS[option]}
        else:
            raise NptraceError(f"{option!r} is not one of its options")
        if values.keys() & new.keys():
            raise NptraceError(f"{option!r} contradicts or repeats an option before it")
        values |= new
    if values.get("pop") and (values.get("empty") or values.get("per_triangle")):
        raise NptraceError("'pop' needs no leaf, and empty and tris*K say something of leaves; leave one out")
    return {"budget": UNLIMITED, "per_triangle": False} | values


def parse(options: Sequence[str]) -> dict[str, Any]:
    """Return the options of the policy."""
    is_live = "live" in options
    if list(options).count("live") > 1:
        raise NptraceError("'live' contradicts or repeats an option before it")
    return parse_unit([option for option in options if option != "live"]) | ({"live": True} if is_live else {})


def shown(values: dict[str, Any]) -> list[str]:
    """Return the options as they are printed."""
    budget = values["budget"]
    text = "unlimited" if budget == UNLIMITED else f"{'tris*' if values['per_triangle'] else 'budget='}{budget}"
    level = [f"level={values['levels']}"] if "levels" in values else []
    words = [name for name in ("once", "empty", "pop", "live") if values.get(name)]
    words[1 if "once" in words else 0 : 0] = [word for word, reset in _RESETS.items() if values.get("reset") == reset]
    return [text, *words, *level]


def scout(machine: Machine, facts: Facts, *, live: bool = False, **options: Any) -> Reads | None:
    """Return the unit of a first pass, which finds the entries that are read; None if it is not asked for."""
    return Reads(np.zeros(facts.n_rows, np.uint8)) if live else None


# Many parameters: one per option of the policy, as ``parse`` names them.
def make_unit(
    machine: Machine, facts: Facts, *, budget: int = UNLIMITED, per_triangle: bool = False, once: bool = False,
    empty: bool = False, pop: bool = False, reset: int = TOP, levels: int = 1 << 16, live: bool = False,
    scouted: Reads | None = None,
) -> Stack:  # fmt: skip
    """Return the unit of a machine."""
    n_slots = machine.sp.size
    return Stack(
        pointer=np.zeros(n_slots, np.int64),
        left=np.zeros(n_slots, np.int64),
        open=np.zeros(n_slots, np.int64),
        asked=np.zeros(machine.stack.shape, np.uint8),
        wanted=np.empty(0, np.uint8) if scouted is None else scouted.used,
        budget=budget, per_triangle=per_triangle, once=once, empty=empty, pop=pop, reset=reset, levels=levels,
    )  # fmt: skip


POLICY = Policy("stack", FORM, parse, make_unit, scout, watches_leaves=True, shown=shown, begins_anew=True)
