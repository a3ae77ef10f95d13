"""Rows of results -> the cases that they are of: what tells the cases apart, as texts for titles, legends and bars."""

from collections.abc import Mapping, Sequence
from typing import Any

from cachesim.clock.parameters import NUMBERS
from cachesim.config import format_bytes
from traces.identity import COLUMNS, RunIdentity, labels

Row = Mapping[str, Any]

#: The facts of a case besides its run, in the order in which a text names them.
FACTS = ("cache", "lines", "policy", "layout", "reads", "flush", "prefetch", "group", "machine", *NUMBERS)

#: What a visit reads and when the caches are emptied, where nobody asks for anything else: rows of most commands lack them.
USUAL = {"reads": "own", "flush": "never"}


#: What the mark of a stand-in means, below a table of the paper's scenes.
STAND_IN_NOTE = (
    "(stand-in): a procedural scene of the same kind and triangle count, not the paper's; its numbers are not comparable."
)


def identity_of(row: Row) -> RunIdentity:
    """Return which run a row is of."""
    facts: dict[str, Any] = {name: row.get(name) for name in COLUMNS}
    return RunIdentity(**facts)


def ways_of(row: Row) -> str:
    """Return the associativity of the row's cache as text."""
    is_full = row["ways"] > 1 and row["ways"] * row["line_bytes"] == row["size_bytes"]
    return "full" if is_full else f"{row['ways']}-way"


def facts_of(row: Row) -> dict[str, str]:
    """Return the facts of a case by ``FACTS``; those that the row does not have are left out."""
    found = {}
    if row.get("ways") is not None and row.get("line_bytes") is not None:
        found["cache"] = f"{format_bytes(row['size_bytes'])} {ways_of(row)}"
    if row.get("line_bytes") is not None:
        found["lines"] = f"{format_bytes(row['line_bytes'])} B lines"
    if row.get("policy"):
        seed = row.get("policy_seed")
        found["policy"] = row["policy"] + (f" seed {seed}" if seed else "")
    found |= {name: str(row[name]) for name in ("layout", "prefetch", "group") if row.get(name)}
    found |= {name: f"{name} {row.get(name) or usual}" for name, usual in USUAL.items()}
    if row.get("clock"):
        found["machine"] = f"machine {row['clock'].partition(',')[0]}"  # what differs from it follows as numbers
        found |= {name: f"{name} {row[name]}" for name in NUMBERS if row.get(name) is not None}
    return {name: found[name] for name in FACTS if name in found}


def texts_of(rows: Sequence[Row], without: Sequence[str] = (), *, is_spelled: bool = False) -> list[str]:
    """Return a text for each row, of all that varies among them apart from ``without``: no two cases have the same.

    ``is_spelled``: as ``prefetch none`` rather than ``none``.
    """
    names = labels(identity_of(row) for row in rows)
    facts = [facts_of(row) for row in rows]
    varying = [name for name in FACTS if name not in without and len({each.get(name) for each in facts}) > 1]
    has_runs = len(names) > 1 and "run" not in without
    found = []
    for row, each in zip(rows, facts, strict=True):
        own = [(name, each[name]) for name in varying if name in each]
        parts = [names[identity_of(row)]] * has_runs + [spelled(*fact) if is_spelled else fact[1] for fact in own]
        found.append(", ".join(parts))
    return found


def shared_text(rows: Sequence[Row]) -> str:
    """Return what all rows have in common: the run, the cache and so on."""
    names = labels(identity_of(row) for row in rows)
    facts = [facts_of(row) for row in rows]
    of_all = {name: text for name, text in facts[0].items() if {each.get(name) for each in facts} == {text}}
    usual = [f"{name} {value}" for name, value in USUAL.items()]
    texts = [spelled(name, text) for name, text in of_all.items() if name not in NUMBERS and text not in usual]
    return ", ".join([*(names.values() if len(names) == 1 else ()), *texts])


def spelled(name: str, text: str) -> str:
    """Return the text of a fact where nothing beside it says what it is of."""
    return f"prefetch {text}" if name == "prefetch" else f"layout {text}" if name == "layout" else text
