"""Arguments of a function of ``import nptrace`` that would have no effect beside others, which ``nptrace.ignored`` refuses in
a command."""

from collections.abc import Mapping
from typing import Any

from nptrace_base.errors import NptraceError


def _words(value: Any) -> set[str]:
    """Return the words of an option: a text, or a list of texts."""
    texts = [value] if isinstance(value, str) else value
    return {word.strip().lower() for text in texts for word in str(text).split(",")}


def refuse_ignored(given: Mapping[str, Any], defaults: Mapping[str, Any]) -> None:
    """Raise NptraceError if an argument has no effect beside the others.

    ``given`` are the arguments of a call that are not their defaults, ``defaults`` those of the function.
    """
    of = {**defaults, **given}
    accel = _words(of.get("accel", ())) or {"kdtree", "bvh"}
    is_random = "random" in _words(of["order"] if "order" in of else of.get("policy", "random"))
    is_sample = "target_error" in of  # whose seed is that of the sample too
    rules = (
        ("traces", bool(given.get("sources")), "the runs to read are named"),
        ("kd", "kdtree" not in accel, "accel asks for no kd-tree"),
        ("bvh", "bvh" not in accel, "accel asks for no BVH"),
        ("bvh_nodes", "bvh" not in accel, "accel asks for no BVH"),
        ("seed", not is_random and not is_sample, "nothing is random"),
    )
    for name, is_ignored, reason in rules:
        if name in given and is_ignored:
            raise NptraceError(f"{name}: {reason}, so it has no effect; leave it out")
