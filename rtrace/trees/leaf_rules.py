"""When a builder makes a leaf: options -> the costs it weighs and the least and most triangles of a leaf, checked."""

import math
from typing import Any, NamedTuple

from nptrace_base.errors import NptraceError

#: No limit to the triangles of a leaf.
UNLIMITED = 2**31 - 1


class LeafRules(NamedTuple):
    """What a builder asks at every node, as its kernels take it.

    Attributes
    ----------
    trav : float
        Cost of visiting an inner node, in tests of a triangle.
    min_leaf : int
        A node with up to so many triangles is a leaf.
    max_leaf : int
        A node with more is split, whatever that costs.
    """

    trav: float
    min_leaf: int
    max_leaf: int


def leaf_rules(c_trav: float, c_isect: float, min_leaf: int, max_leaf: int | None) -> LeafRules:
    """Return the rules; NptraceError for a cost or a limit that cannot be. ``max_leaf`` None is no limit."""
    most = UNLIMITED if max_leaf is None else max_leaf
    rules: tuple[tuple[str, Any, bool, str], ...] = (
        ("c_trav", c_trav, 0 <= c_trav < math.inf, "finite and not negative, e.g. 1.5"),
        ("c_isect", c_isect, 0 < c_isect < math.inf, "finite and positive, e.g. 2"),
        ("max_leaf", max_leaf, 1 <= most <= UNLIMITED, "1 to 2**31 - 1, e.g. 4"),
        ("min_leaf", min_leaf, 0 <= min_leaf <= most, f"0 to max_leaf, {most}"),
    )
    for name, given, is_kept, rule in rules:
        if not is_kept:
            raise NptraceError(f"{name} must be {rule}; got {given}")
    return LeafRules(float(c_trav) / float(c_isect), int(min_leaf), int(most))


def limits_given(min_leaf: int, max_leaf: int | None) -> dict[str, int]:
    """Return the limits that a builder was given, for a tree's parameters: a tree without limits has none."""
    given = {"min_leaf": int(min_leaf)} if min_leaf else {}
    return given if max_leaf is None else given | {"max_leaf": int(max_leaf)}
