"""Numbers of more digits than Python converts: refused in one sentence wherever a text is a number."""

import pytest

from cachesim.config import parse_bytes, parse_ways
from cachesim.grid import parse_sizes, parse_ways_range
from cachesim.layout import parse_layout
from cachesim.prefetch import parse_prefetch
from nptrace.clock_options import parse_number
from nptrace_base.errors import NptraceError
from rtrace.camera import parse_point, parse_size

MANY = "9" * 5000


@pytest.mark.parametrize(
    ("parse", "text"),
    [
        (parse_bytes, "{}"), (parse_bytes, "{}K"), (parse_sizes, "4K..{}"), (parse_ways_range, "1..{}"),
        (lambda text: parse_ways(text, 8192, 32), "{}"), (parse_layout, "treelet:{}"), (parse_layout, "veb+{}"),
        (parse_prefetch, "next-line:miss:{}"), (parse_prefetch, "stack:budget={}"), (parse_prefetch, "treelet:every={}"),
        (parse_number, "{}"), (parse_size, "{}x4"), (parse_point, "{},1,1"),
    ],
)  # fmt: skip
def test_they_are_refused(parse, text):
    with pytest.raises(NptraceError):
        parse(text.format(MANY))
