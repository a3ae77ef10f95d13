"""The rules for every value of a run, checked where it is read: columns of a Parquet file -> plain arrays, or one sentence.

Kernels index with nodes, parents, levels and kinds without checking, so every value is checked here first. A
sentence names the file, the column, the row (from 0) and the rule.
"""

from collections.abc import Mapping

import numpy as np
import pyarrow as pa

from nptrace_base.jit import kernel
from nptrace_base.places import Place
from traces.arrow_arrays import as_array
from traces.footer import Footer, TreeFacts
from traces.format import LEAF, PREFETCH, PUSH, READ, SHADOW, RunError
from traces.node_formats import OWN_BOX, NodeFormat, stored_addresses

#: The axis of a leaf in ``nodes.parquet``.
LEAF_AXIS = 3

_OK, _NUMBER, _ROOT, _PARENT, _PAIR, _TWICE, _LEVEL, _AXIS, _INNER, _ADDRESS = range(10)

_NODE_RULES = {
    _NUMBER: ("node", "a node's number is its row"),
    _ROOT: ("parent", "row 0 is the root, whose parent is -1"),
    _PARENT: ("parent", "a node comes after its parent, and only the root has none"),
    _PAIR: ("parent", "the nodes 1 and 2, 3 and 4, ... are siblings, with one parent"),
    _TWICE: ("parent", "a node has one pair of children, and that parent has a pair already"),
    _LEVEL: ("level", "the root has level 0, any other node its parent's level + 1"),
    _AXIS: ("axis", "a node with children has axis 0, 1 or 2, a leaf 3"),
    _INNER: ("n_prims", "only leaves have triangles"),
}


def bad_value(path: Place, column: str, row: int, found: object, rule: str) -> RunError:
    """Return the error about one value of a file."""
    return RunError(f"{path}, column '{column}', row {row}: {found} breaks the rule that {rule}; render the run again")


def plain(column: pa.ChunkedArray | pa.Array, field: pa.Field, path: Place, first_row: int = 0) -> np.ndarray:
    """Return a column as an array of the contract's type; other types of numbers are taken if no value changes.

    Raises
    ------
    RunError
        A value is missing, or is not one of the contract's type.
    """
    if column.null_count:
        row = first_row + column.is_null().index(True).as_py()
        raise bad_value(path, field.name, row, "null", "every value is there")
    if column.type == field.type:
        return as_array(column)
    converted = _converted(column, field.type)
    if converted is None:
        low, high = 0, len(column)  # the first bad row lies in low ... high - 1
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if _converted(column.slice(low, middle - low), field.type) is None else (middle, high)
        raise bad_value(path, field.name, first_row + low, repr(column[low].as_py()), f"a value is a {field.type}")
    return converted


def is_convertible(type_: pa.DataType, wanted: pa.DataType) -> bool:
    """Return whether values of a type may stand for values of the contract's: numbers, plain or in a dictionary."""
    inner = type_.value_type if pa.types.is_dictionary(type_) else type_
    return inner == wanted or pa.types.is_integer(inner) or pa.types.is_floating(inner)


def _converted(column: pa.ChunkedArray | pa.Array, wanted: pa.DataType) -> np.ndarray | None:
    """Return the values in another type of numbers, None if one of them would change."""
    try:
        if pa.types.is_dictionary(column.type):
            column = column.cast(column.type.value_type)
        cast = column.cast(wanted)
    except pa.ArrowInvalid:
        return None
    values, before = as_array(cast), as_array(column)
    if pa.types.is_floating(wanted) and ((values != before) & ~(np.isnan(values) & np.isnan(before))).any():
        return None
    return values


def check_nodes(columns: Mapping[str, np.ndarray], path: Place, tree: TreeFacts) -> None:
    """Check the columns of ``nodes.parquet`` except split and boxes; addresses where they were read."""
    n = columns["node"].size
    if n % 2 == 0:
        raise RunError(
            f"{path} has {n} rows, and a root with pairs of siblings is an odd number of nodes; render the run again"
        )
    has_children = np.zeros(n, np.bool_)
    row, rule = first_bad_node(
        columns["node"], columns["parent"], columns["level"], columns["axis"], columns["n_prims"], has_children
    )
    if rule == _OK and "address" in columns:
        wrong = columns["address"] != stored_addresses(columns["parent"], tree.node_format, tree.node_bytes)
        row, rule = (int(np.argmax(wrong)), _ADDRESS) if wrong.any() else (0, _OK)
    if rule != _OK:
        column, text = ("address", tree.node_format.address_rule) if rule == _ADDRESS else _NODE_RULES[rule]
        raise bad_value(path, column, row, columns[column][row], text)


@kernel
def first_bad_node(node, parent, level, axis, n_prims, has_children):
    """Return (row, rule) of the first node that breaks a rule of trees, (0, _OK) if none does; fill ``has_children``."""
    if parent[0] != -1:
        return np.uint64(0), _ROOT
    if level[0] != 0:
        return np.uint64(0), _LEVEL
    for i in range(np.uint64(1), np.uint64(parent.size), np.uint64(2)):
        up = parent[i]
        if up < 0 or np.uint64(up) >= i:
            return i, _PARENT
        above = np.uint64(up)
        if parent[i + np.uint64(1)] != up:
            return i + np.uint64(1), _PAIR
        if has_children[above]:
            return i, _TWICE
        has_children[above] = True
        wanted = np.int64(level[above]) + 1
        if level[i] != wanted:
            return i, _LEVEL
        if level[i + np.uint64(1)] != wanted:
            return i + np.uint64(1), _LEVEL
    if not is_any_bad(node, axis, n_prims, has_children):
        return np.uint64(0), _OK
    for i in range(np.uint64(parent.size)):
        if node[i] != i:
            return i, _NUMBER
        if axis[i] > LEAF_AXIS or (axis[i] == LEAF_AXIS) == has_children[i]:
            return i, _AXIS
        if has_children[i] and n_prims[i] != 0:
            return i, _INNER
    return np.uint64(0), _OK


@kernel
def is_any_bad(node, axis, n_prims, has_children):
    """Return whether a node breaks a rule about its own values.

    Without a branch, so that it becomes vectors: looking for the first such node took 5 times as long.
    """
    is_bad = False
    for i in range(np.uint64(node.size)):
        is_bad |= node[i] != np.uint32(i)
        is_bad |= (axis[i] > LEAF_AXIS) | ((axis[i] == LEAF_AXIS) == has_children[i])
        is_bad |= has_children[i] & (n_prims[i] != 0)
    return is_bad


#: The kinds that rows of an inner node may have.
INNER_KINDS = READ, PUSH, PREFETCH


def leaf_kinds(node_format: NodeFormat) -> tuple[int, ...]:
    """Return the kinds that rows of a leaf may have: its own box alone can be missed, and it is requested where it is read."""
    missed = (READ,) if node_format.boxes == OWN_BOX else ()
    return (*missed, LEAF, *((PREFETCH,) if node_format.reads_leaves else ()))


def kinds_allowed(axis: np.ndarray, node_format: NodeFormat) -> np.ndarray:
    """Return the kinds that an access of each node may have, (n_nodes,) uint8 with one bit per kind."""
    inner, leaf = (sum(1 << kind for kind in kinds) for kinds in (INNER_KINDS, leaf_kinds(node_format)))
    allowed = np.empty(axis.size, np.uint8)
    fill_allowed(axis, np.uint8(inner), np.uint8(leaf), allowed)
    return allowed


@kernel
def fill_allowed(axis, inner, leaf, allowed):
    """Write ``leaf`` for every leaf and ``inner`` for every other node; NumPy's passes took 20 times as long."""
    for i in range(np.uint64(axis.size)):
        allowed[i] = leaf if axis[i] == LEAF_AXIS else inner


def check_accesses(nodes: np.ndarray, kinds: np.ndarray, allowed: np.ndarray, path: Place, first_row: int) -> None:
    """Check a batch of ``accesses.parquet`` that begins at ``first_row`` against the nodes of its tree."""
    at = int(first_bad_access(nodes, kinds, allowed))
    if at == nodes.size:
        return
    node, kind, row = int(nodes[at]), int(kinds[at]), first_row + at
    if node >= allowed.size:
        raise bad_value(path, "node", row, node, f"a node is one of the tree's, 0 to {allowed.size - 1}")
    if kind > PREFETCH:
        raise bad_value(path, "kind", row, kind, "a kind is 0 (read), 1 (push), 2 (leaf) or 3 (prefetch)")
    what = "a leaf" if allowed[node] >> LEAF & 1 else "a node with children"
    kinds_there = " or ".join(str(k) for k in range(4) if allowed[node] >> k & 1)
    raise bad_value(path, "kind", row, kind, f"{what}, as node {node} is, is accessed with kind {kinds_there}")


@kernel
def first_bad_access(nodes, kinds, allowed):
    """Return the first row with a node outside the tree, or with a kind that its node cannot have; the size if none."""
    if are_all_allowed(nodes, kinds, allowed):
        return np.uint64(nodes.size)
    n = np.uint64(allowed.size)
    for i in range(np.uint64(nodes.size)):
        node = np.uint64(nodes[i])
        if node >= n or kinds[i] > PREFETCH or not (allowed[node] >> kinds[i]) & np.uint8(1):
            return i
    return np.uint64(nodes.size)


@kernel
def are_all_allowed(nodes, kinds, allowed):
    """Return whether every node is one of the tree's and every kind one that its node may have.

    Without a branch, because every access of every replay comes by: looking for the first bad row took 4 times as long.
    """
    last, last_kind = np.uint32(allowed.size - 1), np.uint64(PREFETCH)
    highest, bits_of_kinds, is_allowed = np.uint32(0), np.uint64(0), np.uint64(1)
    for i in range(np.uint64(nodes.size)):
        highest = max(highest, nodes[i])
        bits_of_kinds |= np.uint64(kinds[i])
        is_allowed &= np.uint64(allowed[min(nodes[i], last)]) >> (np.uint64(kinds[i]) & last_kind)
    return highest <= last and bits_of_kinds <= last_kind and (is_allowed & np.uint64(1)) == 1


def check_rays(columns: Mapping[str, np.ndarray], path: Place, footer: Footer) -> None:
    """Check the columns of ``rays.parquet``; ``footer`` has the sizes they must keep to."""
    n, first, count = columns["ray"].size, columns["first"], columns["count"].astype(np.uint64)
    ends = np.cumsum(count, dtype=np.uint64)
    limits = {"x": footer.width, "y": footer.height, "prim": footer.scene.n_triangles}
    rules = [
        ("ray", columns["ray"] != np.arange(n), "a ray's number is its row"),
        ("type", columns["type"] > SHADOW, "a type is 0 (primary) or 1 (shadow)"),
        ("first", first != ends - count, "a ray's accesses begin where those of the ray before end"),
        ("prim", columns["prim"] < -1, "a triangle has a number, and -1 is none"),
        ("t", np.isnan(columns["t"]), "a hit has a distance, and infinity is none"),
    ]
    for name, limit in limits.items():
        rules.append((name, columns[name] >= limit, f"it is below {limit}, the footer's value"))
    for name, wrong, rule in rules:
        if wrong.any():
            row = int(np.argmax(wrong))
            raise bad_value(path, name, row, columns[name][row], rule)
    if n and int(ends[-1]) != footer.n_accesses:
        rule = f"all counts together are the {footer.n_accesses} accesses there are"
        raise bad_value(path, "count", n - 1, columns["count"][-1], rule)


def check_ray_numbers(rays: np.ndarray, ends: np.ndarray, path: Place, first_row: int) -> None:
    """Check the column ``ray`` of a batch of accesses; ``ends`` is the row after the last access of each ray, uint64."""
    wanted = np.searchsorted(ends, np.arange(first_row, first_row + rays.size, dtype=np.uint64), side="right")
    wrong = rays != wanted
    if wrong.any():
        at = int(np.argmax(wrong))
        rule = f"rays.parquet counts this row among the accesses of ray {wanted[at]}"
        raise bad_value(path, "ray", first_row + at, rays[at], rule)
