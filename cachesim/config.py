"""The configuration of one cache: sizes as text -> CacheConfig, checked once."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from operator import index
from typing import TYPE_CHECKING, Any

from nptrace_base.errors import NptraceError

POLICIES = ("lru", "fifo", "random", "opt")

_UNITS = {"": 0, "K": 10, "M": 20, "G": 30, "T": 40}
#: Most bytes of a cache or a line: tables of results hold int64.
MOST_BYTES = 1 << 62


def parse_bytes(text: str) -> int:
    """Return a byte size as papers write it: 512, 8K, 64KiB, 1M (powers of two)."""
    match = re.fullmatch(r"\s*(\d{1,40})\s*(?:([KkMmGgTt])(?:i?B)?|B)?\s*", text)
    if match is None:
        raise NptraceError(f"{text!r} is not a size; write e.g. 512, 8K or 64KiB (K = 1024)")
    number, unit = match.groups(default="")
    return int(number) << _UNITS[unit.upper()]


def format_bytes(n: int) -> str:
    """Return a byte size in the largest unit that divides it: 8192 -> 8K."""
    for unit in ("T", "G", "M", "K"):
        if n and n % (1 << _UNITS[unit]) == 0:
            return f"{n >> _UNITS[unit]}{unit}"
    return str(n)


def parse_ways(text: str, size_bytes: int, line_bytes: int) -> int:
    """Return the number of ways; ``full`` means fully associative: as many ways as the cache has lines."""
    if text.strip().lower() == "full":
        return max(size_bytes // max(line_bytes, 1), 1)
    try:
        return int(text)
    except ValueError:
        raise NptraceError(f"{text!r} is not a number of ways; write 1, 2, 4 ... or full") from None


def _number(name: str, value: Any, parse: Callable[[str], int] | None = None) -> int:
    """Return a whole number that is given as one, or as a text that ``parse`` reads."""
    if isinstance(value, str) and parse is not None:
        return parse(value)
    try:
        return index(value)
    except TypeError:
        rule = "no whole number; write e.g. CacheConfig(8192, 2) or CacheConfig('8K', 2)"
        raise NptraceError(f"{name} is {value!r}, and {rule}") from None


@dataclass(frozen=True, slots=True)
class CacheConfig:
    """Geometry and replacement of one cache: size_bytes = n_sets * ways * line_bytes.

    Attributes
    ----------
    size_bytes : int
        Any whole number of sets; the number of sets need not be a power of two (set = line mod n_sets). It may be given as a
        text such as ``"8K"``, as may ``line_bytes`` and ``ways`` (``"full"``).
    ways : int
        1 is direct mapped; ``size_bytes // line_bytes`` is fully associative.
    line_bytes : int
        A power of two.
    policy : str
        ``"lru"``, ``"fifo"``, ``"random"``, or ``"opt"``: the line whose next access is farthest away leaves a full set
        (Belady 1966). No replacement that fills at every miss, as these do, has fewer misses, demand and prefetch together;
        every later access counts, demand or prefetch. A cache that may leave a line out (bypass) could have fewer still.
    seed : int
        Seed of random replacement. Its generator is SplitMix64, so other programs choose other victims.
    """

    size_bytes: int
    ways: int = 1
    line_bytes: int = 32
    policy: str = "lru"
    seed: int = 0

    if TYPE_CHECKING:  # texts are read once, and a cache holds numbers

        def __init__(
            self, size_bytes: int | str, ways: int | str = 1, line_bytes: int | str = 32, policy: str = "lru", seed: int = 0
        ) -> None: ...

    def __post_init__(self) -> None:
        line = _number("line_bytes", self.line_bytes, parse_bytes)
        size = _number("size_bytes", self.size_bytes, parse_bytes)
        ways = _number("ways", self.ways, lambda text: parse_ways(text, size, line))
        for name, value in (("line_bytes", line), ("size_bytes", size), ("ways", ways)):
            object.__setattr__(self, name, value)
        if not isinstance(self.policy, str):
            raise NptraceError(f"policy is {self.policy!r}, and no text; write e.g. lru")
        object.__setattr__(self, "seed", _number("seed", self.seed))
        if line < 1 or line & (line - 1):
            raise NptraceError(f"a line of {line} B is not a power of two; write e.g. 32 or 64")
        if ways < 1:
            raise NptraceError(f"{ways} ways: a cache has at least 1; write 1 for direct mapped, full for fully associative")
        if size > MOST_BYTES or line > MOST_BYTES:
            most = max(size, line)
            raise NptraceError(f"{most} B are beyond the largest address, 2^62; take a smaller cache, or shorter lines")
        set_bytes = ways * line
        if size < 1 or size % set_bytes:
            below, above = size // set_bytes * set_bytes, (max(size, 0) // set_bytes + 1) * set_bytes
            near = f"write e.g. {below} or {above}" if below > 0 else f"write e.g. {above}"
            near = near if above <= MOST_BYTES else "take fewer ways"
            raise NptraceError(
                f"a size of {size} B is not a whole number of sets of {ways} x {line} B = {set_bytes} B; {near}"
            )
        if size // line >= 1 << 31:
            raise NptraceError(
                f"a size of {size} B is {size // line} lines of {line} B; the limit is 2^31 - 1 lines; take a smaller cache, "
                "or longer lines"
            )
        if self.policy not in POLICIES:
            raise NptraceError(f"{self.policy!r} is not a replacement policy; choose one of {', '.join(POLICIES)}")
        if not 0 <= self.seed < 1 << 64:
            raise NptraceError(f"a seed of {self.seed} is out of range; choose one from 0 to 2^64 - 1")

    @property
    def n_sets(self) -> int:
        """Number of sets."""
        return self.size_bytes // (self.ways * self.line_bytes)

    @property
    def n_lines(self) -> int:
        """Number of lines the cache holds."""
        return self.size_bytes // self.line_bytes

    def __str__(self) -> str:
        size, line = format_bytes(self.size_bytes), format_bytes(self.line_bytes)
        ways = "full" if self.n_sets == 1 and self.ways > 1 else f"{self.ways}-way"
        return f"{size} {ways} {line} B {self.policy}"
