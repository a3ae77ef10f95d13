"""Options that would have no effect beside others: they are refused, not ignored, for every command that has them.

A command's own rules are calls of ``refuse``. --threads is a limit, which may stay unused: the results do not depend on it.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from nptrace.typed import given, listing
from nptrace_base.errors import NptraceError

#: The values of a command's parameters, by the names of its function.
Params = Mapping[str, Any]


class Rule(NamedTuple):
    """Which options have no effect, beside which others (by the names of the function), and why; None where they have."""

    options: tuple[str, ...]
    beside: tuple[str, ...]
    reason: Callable[[Params], str | None]


def _folder(of: Params) -> str | None:
    return "the runs to read are named, and --traces names others" if of["sources"] else None


def _seed_of_replacement(of: Params) -> str | None:
    if "random" in of["policy"] or not of["seed"]:
        return None
    return f"--seed is that of --policy random, and the policy is {','.join(of['policy'])}"


def _seed_of_order(of: Params) -> str | None:
    # A seed of 0 is written into the command of every run.
    return (
        f"--seed is that of --order random, and the order is {of['order']}" if of["order"] != "random" and of["seed"] else None
    )


def _kd(of: Params) -> str | None:
    return "--accel asks for no kd-tree" if of["accel"] and "kdtree" not in of["accel"] else None


def _bvh(of: Params) -> str | None:
    return "--accel asks for no BVH" if of["accel"] and "bvh" not in of["accel"] else None


RULES = (
    Rule(("folder",), ("sources",), _folder),
    Rule(("seed",), ("policy", "sources", "size"), _seed_of_replacement),
    Rule(("seed",), ("order", "run_names"), _seed_of_order),  # an estimate's is that of its sample too
    Rule(("kd_text",), ("accel",), _kd),
    Rule(("bvh_text", "bvh_nodes"), ("accel",), _bvh),
)


def check(params: Params) -> None:
    """Raise NptraceError if an option that the running command's user gave has no effect beside the others."""
    for rule in RULES:
        if params.keys() >= {*rule.options, *rule.beside} and (reason := rule.reason(params)):
            refuse(reason, *rule.options)


def refuse(reason: str, *names: str, way: str = "") -> None:
    """Raise NptraceError if the running command's user gave some of these options, by the names of its function."""
    if others := given(*names):
        raise NptraceError(f"{reason}; leave out {listing(others)}{way}")
