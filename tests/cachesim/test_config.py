"""A cache's geometry: sizes as text, and messages with the value, the rule and the way out."""

import re

import pytest

from cachesim.config import CacheConfig, format_bytes, parse_bytes, parse_ways


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("512", 512),
        ("8K", 8192),
        ("8k", 8192),
        ("64KiB", 65536),
        ("16 KB", 16384),
        ("1M", 1 << 20),
        ("32B", 32),
        ("1G", 1 << 30),
        ("3T", 3 << 40),
    ],
)
def test_sizes(text, value):
    assert parse_bytes(text) == value
    assert parse_bytes(format_bytes(value)) == value


@pytest.mark.parametrize("text", ["", "8X", "12xyz", "-8K", "8.5K", "K", "8Ki8", "0x20"])
def test_what_is_not_a_size(text):
    with pytest.raises(ValueError, match=r"is not a size; write e\.g\. 512, 8K"):
        parse_bytes(text)


def test_ways():
    assert parse_ways("full", 8192, 32) == 256
    assert parse_ways("4", 8192, 32) == 4
    with pytest.raises(ValueError, match="'two' is not a number of ways; write 1, 2, 4"):
        parse_ways("two", 8192, 32)


def test_sets():
    assert CacheConfig(8192, 2, 32).n_sets == 128
    assert CacheConfig(8160, 3, 32).n_sets == 85  # any number of sets
    assert CacheConfig(8192, 256, 32).n_sets == 1
    assert str(CacheConfig(8192, 256, 32)) == "8K full 32 B lru"


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ((8192, 3), "8192 B is not a whole number of sets of 3 x 32 B = 96 B; write e.g. 8160 or 8256"),
        ((16, 1), "16 B is not a whole number of sets of 1 x 32 B = 32 B; write e.g. 32"),
        ((0, 1), "0 B is not a whole number of sets"),
        ((8192, 0), "0 ways: a cache has at least 1"),
        ((8192, -2), "-2 ways: a cache has at least 1"),
        ((8192, 1, 24), "a line of 24 B is not a power of two"),
        ((8192, 1, 0), "a line of 0 B is not a power of two"),
        ((1 << 40, 1), "the limit is"),
        ((8192, 1, 32, "mru"), "'mru' is not a replacement policy; choose one of lru, fifo, random"),
        ((8192, 1, 32, "random", -1), "a seed of -1 is out of range"),
    ],
)
def test_what_is_not_a_cache(config, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        CacheConfig(*config)
