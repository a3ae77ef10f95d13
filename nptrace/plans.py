"""Options of the caches and machines as Python takes them, texts, numbers or lists -> caches, machines, policies and layouts.

``import nptrace`` reads its arguments with them, and a study its tables.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypedDict, TypeVar, Unpack

from nptrace.values import OptionError
from nptrace_base.errors import NptraceError

if TYPE_CHECKING:
    from cachesim.config import CacheConfig
    from nptrace.clock_options import Machines

#: An option with a value, or several: 8192, "8K", "8K,16K", "4K..64K", ["8K", 16384].
Given = str | int | Sequence[str | int]

_T = TypeVar("_T")


class MachineOptions(TypedDict, total=False):
    """The numbers of a machine, each one or several; those of the machine ``paper`` if left out (``npcache time --help``)."""

    hit: Given
    miss: Given
    rays: Given
    ports: Given
    mshrs: Given
    bandwidth: Given
    box: Given
    triangle: Given
    every: Given
    units: Given


Plan = tuple[list["CacheConfig"], list[str], list[str]]


def replay_plan(
    size: Given, ways: Given, line: Given, policy: Given, seed: int, prefetch: Given, layout: Given
) -> Plan:  # fmt: skip
    """Return the caches, prefetch policies and layouts that the options of ``replay`` name."""
    from cachesim.grid import caches, parse_ways_range

    parsed = sizes(size), listed("ways", ways, parse_ways_range), _lines(line), listed("policy", policy, str.lower)
    return caches(*parsed, seed), _prefetches(prefetch), _layouts(layout)


def sweep_plan(size: Given, ways: Given, line: Given, prefetch: Given, layout: Given) -> Plan:
    """Return the caches, prefetch policies and layouts that the options of ``sweep`` name."""
    from cachesim.grid import grid, parse_range, parse_ways_range

    numbers = [number for named in listed("ways", ways, parse_ways_range) for number in named]
    return grid(listed("size", size, parse_range), numbers, _lines(line)), _prefetches(prefetch), _layouts(layout)


def estimate_plan(
    size: Given, ways: Given, line: Given, policy: Given, layout: Given, *, is_table1: bool = False
) -> Plan:  # fmt: skip
    """Return the caches and layouts that the options of ``estimate`` name, with the prefetches of a run."""
    from cachesim.report.table1 import caches as of_table1
    from cachesim.sampling.cold_start import check_lru

    configs, prefetches, layouts = replay_plan(size, ways, line, policy, 0, "traced", layout)
    if is_table1:
        for name, value, usual in (("size", size, "8K"), ("ways", ways, "1"), ("line", line, "32")):
            if value != usual:
                raise OptionError(name, "is_table1 has the caches of Table I; leave out one of both")
        policies = listed("policy", policy, str.lower)
        configs = [replace(each, policy=one) for one in policies for each in of_table1()]
    check_lru(configs)
    return configs, prefetches, layouts


def time_plan(
    machine: str, size: Given, ways: Given, line: Given, policy: Given, seed: int, prefetch: Given, layout: Given,
    **numbers: Unpack[MachineOptions],
) -> "tuple[Machines, list[str], list[str]]":  # fmt: skip
    """Return the machines, prefetch policies and layouts that the options of ``time`` name."""
    return machines_plan(machine, size, ways, line, policy, seed, numbers), _prefetches(prefetch), _layouts(layout)


def listed(name: str, value: Any, item: Callable[[str], _T]) -> list[_T]:
    """Return the values of an option, each once, as the command reads them from text."""
    values = [value] if isinstance(value, (str, int)) else list(value)
    texts = [text for each in values for text in str(each).split(",")]
    try:
        return list(dict.fromkeys(item(text) for text in texts))
    except NptraceError as e:
        raise OptionError(name, e) from e


def _prefetches(value: Given) -> list[str]:
    from cachesim.prefetch import parse_prefetch

    return listed("prefetch", value, lambda text: str(parse_prefetch(text)))


def _layouts(value: Given) -> list[str]:
    from cachesim.layout import parse_layout

    return listed("layout", value, lambda text: str(parse_layout(text)))


def sizes(value: Given) -> list[int]:
    """Return the sizes in bytes that an option names."""
    from cachesim.grid import parse_sizes

    found = listed("size", value, lambda text: tuple(parse_sizes(text)))
    return list(dict.fromkeys(size for sizes in found for size in sizes))


def _lines(value: Given) -> list[int]:
    from cachesim.config import parse_bytes

    return listed("line", value, parse_bytes)


def machines_plan(
    machine: str, size: Given, ways: Given, line: Given, policy: Given, seed: int, numbers: MachineOptions
) -> "Machines":  # fmt: skip
    """Return every combination of caches and machines; NptraceError for a number that no machine has."""
    from cachesim.clock.parameters import NUMBERS
    from cachesim.grid import parse_ways_range
    from nptrace.clock_options import machines_of, parse_number

    for name in numbers:
        if name not in NUMBERS:
            raise NptraceError(f"a machine has no number {name}; its numbers are {', '.join(NUMBERS)}")
    given: dict[str, Sequence[int]] = {name: listed(name, value, parse_number) for name, value in numbers.items()}
    parsed = sizes(size), listed("ways", ways, parse_ways_range), _lines(line), listed("policy", policy, str.lower)
    return machines_of(machine, given, *parsed, seed)
