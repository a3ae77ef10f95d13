"""Prefetch policies, a file each: a name, options, and a unit whose hooks the replay and the clock call (``hooks``).

A file that defines ``FORM``, ``HELP`` and ``POLICY`` is a policy; nothing else has to know of it. Another package adds one
with an entry point of the group ``nptrace.policies`` that names its ``Policy``.
"""

import ast
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from nptrace_base.errors import NptraceError

if TYPE_CHECKING:
    from traces.rays import TracedRays

GROUP = "nptrace.policies"


@dataclass(frozen=True, slots=True)
class Facts:
    """What a unit may need to know beyond its machine.

    Attributes
    ----------
    node_bytes, line_bytes : int
    n_rows : int
        Demand rows of the trace.
    rays : callable, optional
        Returns the rays of the run, by ``Machine.ray``; a replay without a clock has none.
    """

    node_bytes: int
    line_bytes: int
    n_rows: int
    rays: "Callable[[], TracedRays] | None" = None


@dataclass(frozen=True, slots=True)
class Policy:
    """A prefetch policy.

    Attributes
    ----------
    name : str
        What ``--prefetch`` calls it.
    form : str
        Its name with all its options.
    parse : callable
        Options as written, without the name, -> keyword arguments of ``make_unit``; raises an NptraceError.
    make_unit : callable, optional
        ``make_unit(machine, facts, **options)``: a NamedTuple with hooks. None: the trace or the cache makes its requests.
    scout : callable, optional
        ``scout(machine, facts, **options)``: the unit of a pass before, which ``make_unit`` gets as ``scouted``.
    needs_clock : bool
        Whether its requests depend on time or on hits, so that only the clock can replay it.
    watches_leaves : bool
        Whether it has a hook at leaves.
    shown : callable, optional
        The options' values -> the options as they are printed; None: as they were written.
    is_perfect : bool
        Every demand read hits: no policy, but the bound of all.
    begins_anew : bool
        Its unit keeps nothing from one ray to the next, so that the parts of a run can be replayed apart.
    """

    name: str
    form: str
    parse: Callable[[Sequence[str]], dict[str, Any]]
    make_unit: Callable[..., Any] | None = None
    scout: Callable[..., Any] | None = None
    needs_clock: bool = False
    watches_leaves: bool = False
    shown: Callable[[dict[str, Any]], Sequence[str]] | None = None
    is_perfect: bool = False
    begins_anew: bool = False

    def show(self, values: dict[str, Any], options: Sequence[str]) -> Sequence[str]:
        """Return the options as they are printed."""
        return self.shown(values) if self.shown else options


class Description(NamedTuple):
    """What ``--help`` says of a policy."""

    form: str
    help: str
    needs_clock: bool


def no_options(options: Sequence[str]) -> dict[str, Any]:
    """Return the options of a policy that has none."""
    if options:
        raise NptraceError(f"it has no option {options[0]!r}")
    return {}


def whole(text: str, name: str, low: int, high: int) -> int:
    """Return the whole number of an option such as ``distance=2`` or ``2``."""
    digits = text.removeprefix(f"{name}=")
    if not digits.isascii() or not digits.isdigit() or len(digits) > 18 or not low <= int(digits) <= high:
        raise NptraceError(f"{name} is a whole number from {low} to {high}, not {digits!r}")
    return int(digits)


def own_policy(name: str) -> Policy | None:
    """Return the policy of a name if it is one of this folder, importing no other: a command in a hurry asks for one."""
    file = name.replace("-", "_")
    if not file.isidentifier() or not (Path(__file__).parent / f"{file}.py").exists():
        return None
    policy: Policy | None = getattr(import_module(f"{__name__}.{file}"), "POLICY", None)
    return policy if policy is not None and policy.name == name else None


@cache
def policies() -> dict[str, Policy]:
    """Return all policies by name: the files of this folder, then those of other packages, which cannot take their names."""
    import importlib.metadata

    own = {file.replace("_", "-"): import_module(f"{__name__}.{file}").POLICY for file in described()}
    others = [entry.load() for entry in importlib.metadata.entry_points(group=GROUP)]
    return own | {policy.name: policy for policy in others if policy.name not in own}


@cache
def described() -> dict[str, Description]:
    """Return what the policies of this folder say of themselves, by module, without importing them: help is in a hurry."""
    found: dict[str, Description] = {}
    for path in sorted(Path(__file__).parent.glob("[a-z]*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        values: dict[str, str] = {
            target.id: str(node.value.value)
            for node in tree.body
            if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant)
            for target in node.targets
            if isinstance(target, ast.Name) and isinstance(node.value.value, str)
        }
        if "FORM" in values:
            needs_clock = any(isinstance(node, ast.keyword) and node.arg == "needs_clock" for node in ast.walk(tree))
            found[path.stem] = Description(values["FORM"], values["HELP"], needs_clock)
    return found
