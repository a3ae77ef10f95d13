"""The hooks of a prefetch policy, which the replay and the clock call; compiled, each call is the method itself.

A policy's unit is a NamedTuple of arrays and numbers with some of the methods below; those that it lacks do nothing. The
first argument of each is the ``Machine``: it shows the tree, the stacks, the cache and the misses in flight. A hook calls
``offer`` when it has nodes to request, and the port asks ``request`` for the next one in a cycle that no demand read takes.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numba.extending import overload

from nptrace_base.jit import IS_PLAIN, inlined

#: Answer of ``request``: nothing.
NOTHING = -1

_OPTIONS: Any = {"_nrt": False, "forceinline": True, "error_model": "numpy"}


@inlined
def as_line(line):
    """Return the request of a line, not of a node; the line, of such a request."""
    return -2 - line


def _hook(default: Callable[..., Any]) -> Callable[..., Any]:
    """Make a function that calls the method of its name of the unit, or does what ``default`` does."""
    name = default.__name__

    def call(self: Any, *arguments: Any) -> Any:
        return getattr(type(self), name, default)(self, *arguments)

    if not IS_PLAIN:
        overload(call, strict=False, jit_options=_OPTIONS)(
            lambda self, *arguments: getattr(self.instance_class, name, default)
        )
    call.__doc__, call.__name__ = default.__doc__, name
    return call


@_hook
def on_start(self, machine, slot):
    """A ray starts in a slot, with an empty stack."""


@_hook
def on_push(self, machine, slot):
    """The entry at the top of the slot's stack has just been pushed; its sibling is read next."""


@_hook
def on_pop(self, machine, slot):
    """Entries have left the stack, the last of them to be read next; ``sp`` is its height now."""


@_hook
def on_visit(self, machine, slot, line, outcome):
    """The cache has looked up a line of a demand read: HIT, FIRST_USE (of a prefetched line) or MISS."""


@_hook
def on_leaf(self, machine, slot, node):
    """The test of a leaf's triangles starts."""


@_hook
def on_leaf_end(self, machine, slot):
    """The test of a leaf's triangles is over."""


@_hook
def on_end(self, machine, slot):
    """The ray of a slot has ended."""


@_hook
def on_finish(self, machine):
    """All rays have ended: what still waits for the port is not requested any more."""


@_hook
def request(self, machine, slot):
    """Return the node to request next for a slot, ``as_line`` of a line, or NOTHING."""
    return np.int64(NOTHING)


@_hook
def requested(self, machine, slot):
    """The last answer of ``request`` has been issued."""
