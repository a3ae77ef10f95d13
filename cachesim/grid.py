"""Ranges of sizes and numbers of ways -> the LRU caches of a sweep."""

from collections.abc import Sequence
from itertools import product

from cachesim.config import CacheConfig, format_bytes, parse_bytes, parse_ways
from nptrace_base.errors import NptraceError

#: Most numbers of ways in one range.
MAX_RANGE = 4096


def parse_range(text: str) -> tuple[int, int]:
    """Return the lowest and highest byte size that a text such as ``4K..64K`` or ``8K`` names."""
    low, dots, high = (part.strip() for part in text.partition(".."))
    sizes = parse_bytes(low), parse_bytes(high if dots else low)
    if sizes[0] > sizes[1]:
        raise NptraceError(f"{text!r} is not a range: {low} is above {high}; write e.g. {high}..{low}")
    return sizes


def parse_sizes(text: str) -> list[int]:
    """Return the byte sizes that a text such as ``4K..64K`` names: its ends and the powers of two between; of ``8K`` that."""
    low, high = parse_range(text)
    return sorted({low, high, *(1 << k for k in range(48) if low < 1 << k < high)})


def parse_ways_range(text: str) -> tuple[str, ...]:
    """Return the numbers of ways that a text such as ``1..16``, ``4`` or ``full`` names, for ``grid``."""
    low, dots, high = (part.strip() for part in text.partition(".."))
    if not dots:
        return (low,)
    try:
        numbers = range(int(low), int(high) + 1)
    except ValueError:
        raise NptraceError(f"{text!r} is not a range of ways; write e.g. 1..16") from None
    if not numbers:
        raise NptraceError(f"{text!r} is not a range: {low} is above {high}; write e.g. {high}..{low}")
    if numbers[-1] - numbers[0] >= MAX_RANGE:
        raise NptraceError(f"{text!r} names more than {MAX_RANGE} numbers of ways; write e.g. 1..16")
    return tuple(map(str, numbers))


def caches(
    sizes: Sequence[int], ways: Sequence[Sequence[str]], lines: Sequence[int], policies: Sequence[str] = ("lru",),
    seed: int = 0,
) -> list[CacheConfig]:  # fmt: skip
    """Return every combination, each once: by line, policy, size and ways, the last fastest.

    Parameters
    ----------
    ways : sequence of sequence of str
        As ``parse_ways_range`` returns them. Of a range, those that divide a size into whole sets; a single number must.

    Raises
    ------
    NptraceError
        A number of ways, or all of a range, does not divide a size.
    """
    configs: list[CacheConfig] = []
    for line, policy, size, named in product(lines, policies, sizes, ways):
        numbers = [parse_ways(way, size, line) for way in named]
        fitting = [n for n in numbers if n > 0 and line > 0 and not size % (n * line)]
        # With none the first is tried, and the cache says why it cannot be.
        configs += [CacheConfig(size, n, line, policy, seed) for n in (fitting if len(numbers) > 1 else ()) or numbers[:1]]
    return list(dict.fromkeys(configs))


def grid(sizes: Sequence[tuple[int, int]], ways: Sequence[str], line_bytes: Sequence[int]) -> list[CacheConfig]:
    """Return every LRU cache with a power of two as its number of sets whose size lies in one of the ranges.

    Sizes follow from the ways: 4K to 64K with 3 ways of 32-byte lines are 6K, 12K, 24K and 48K. ``full`` ways are for every
    power of two in a range, and for its ends.
    """
    configs = []
    for line in line_bytes:
        for way in ways:
            is_full = way.strip().lower() == "full"
            n_ways = parse_ways(way, line, line)
            smallest = CacheConfig(n_ways * line, n_ways, line)
            possible = {smallest.size_bytes << k for k in range(48)}
            if is_full:
                possible |= {end for ends in sizes for end in ends if end and end % line == 0}
            fitting = sorted(size for size in possible if any(low <= size <= high for low, high in sizes))
            configs += [CacheConfig(size, size // line if is_full else n_ways, line) for size in fitting]
    if not configs:
        named = ", ".join(format_bytes(low) + (f"..{format_bytes(high)}" if high > low else "") for low, high in sizes)
        raise NptraceError(
            f"no cache of {named} with {', '.join(ways)} ways has a power of two as its number of sets (size = sets x ways x "
            "line); choose another size, e.g. 4K..64K"
        )
    return list(dict.fromkeys(configs))
