"""Options that choose a machine and its caches, for the commands that count cycles."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import wraps
from itertools import product
from typing import Any

import click

from cachesim.clock.parameters import NUMBERS, PRESETS, Clock, parse_preset
from cachesim.config import CacheConfig, parse_bytes
from cachesim.grid import caches, parse_sizes, parse_ways_range
from nptrace.options import SIZE_HELP, WAYS_HELP, Choice, ListOf, joined, merged, policy_option, seed_option
from nptrace_base.errors import NptraceError


@dataclass(frozen=True)
class Machines:
    """What the options ask for: every cache, and every clock."""

    configs: list[CacheConfig]
    clocks: list[Clock]


def parse_number(text: str) -> int:
    """Return a whole number."""
    if not re.fullmatch("[0-9]{1,40}", text.strip()):
        raise NptraceError(f"{text!r} is not a whole number; write e.g. 100, or a list such as 20,100,300")
    return int(text)


def machine_options(lists: str) -> Any:
    """Return a decorator that adds the options, passed as ``machines``; ``lists`` says what several values mean."""

    def decorate(function: Callable[..., Any]) -> Any:
        return _with_machine_options(function, lists)

    return decorate


def _with_machine_options(function: Callable[..., Any], lists: str) -> Any:
    @wraps(function)
    def command(
        machine: str, size: list[int], ways: list[tuple[str, ...]], line: list[int], policy: list[str], seed: int,
        **kwargs: Any,
    ) -> Any:  # fmt: skip
        numbers = {name: kwargs.pop(name) for name in NUMBERS}
        return function(machines=machines_of(machine, numbers, size, ways, line, policy, seed), **kwargs)

    for name, (meaning, _, _) in reversed(NUMBERS.items()):
        command = _list(f"--{name}", parse_number, "N", f"{meaning[0].upper()}{meaning[1:]}.")(command)
    command = seed_option("Seed of random replacement.")(command)
    command = policy_option("lru", "fifo", "random", help="Replacement: lru, fifo or random.")(command)
    command = _list("--line", parse_bytes, "SIZES", "Line sizes in bytes; that of the machine if left out.")(command)
    command = _list(
        "--ways", parse_ways_range, "WAYS", f"{WAYS_HELP}; that of the machine if left out.", "--assoc",
    )(command)  # fmt: skip
    command = _list("--size", parse_sizes, "SIZES", f"{SIZE_HELP}; that of the machine if left out.", joins=joined)(command)
    return click.option(
        "--machine", default="paper", show_default=True, type=Choice(list(PRESETS)),
        help=f"Where the numbers below come from that are not given; the list is below. {lists}",
    )(command)  # fmt: skip


def _list(name: str, item: Any, metavar: str, help: str, *others: str, joins: Callable[..., Any] = merged) -> Any:
    return click.option(
        name, *others, type=ListOf(metavar, item), metavar=metavar, multiple=True, callback=joins, help=help
    )  # fmt: skip


def machines_of(
    machine: str, numbers: dict[str, Sequence[int]], size: Sequence[int] = (), ways: Sequence[Sequence[str]] = (),
    line: Sequence[int] = (), policy: Sequence[str] = ("lru",), seed: int = 0,
) -> Machines:  # fmt: skip
    """Return every cache and every clock; what is not given is the machine's."""
    usual = parse_preset(machine).cache
    usual_ways = [("full" if usual.n_sets == 1 else str(usual.ways),)]
    configs = caches(size or [usual.size_bytes], ways or usual_ways, line or [usual.line_bytes], policy, seed)
    return Machines(configs, clocks_of(machine, numbers))


def one_machine(machines: Machines) -> tuple[CacheConfig, Clock]:
    """Return the only cache and the only clock; NptraceError if there are several."""
    if len(machines.configs) * len(machines.clocks) > 1:
        raise NptraceError(
            f"compare takes one cache and one machine, and the options ask for {len(machines.configs)} and "
            f"{len(machines.clocks)}; leave the others out, or use npcache time"
        )
    return machines.configs[0], machines.clocks[0]


def clocks_of(machine: str, numbers: dict[str, Sequence[int]]) -> list[Clock]:
    """Return the machine with every combination of the numbers given."""
    given = {name: values for name, values in numbers.items() if values}
    clock = parse_preset(machine).clock
    return [
        clock.with_numbers(**dict(zip(given, values, strict=True))) for values in product(*given.values())
    ]  # fmt: skip


def machine_sources() -> list[tuple[str, str]]:
    """Return the machines, and where their numbers come from."""
    return [(name, f"{preset.source}.") for name, preset in PRESETS.items()]
