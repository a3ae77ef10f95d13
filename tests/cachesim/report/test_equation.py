"""The numbers of the paper's equation 1, other than its own."""

import pytest

from cachesim.report.table1 import PAPER_N, Equation, acpr, parse_n
from nptrace_base.errors import NptraceError


def test_the_equation_by_hand():
    """N = 20, a quarter of the accesses misses: 20 (3/4 x 2 + 1/4 x 40) = 230 cycles."""
    assert Equation(hit=2, miss=40).acpr(20, 0.25) == 230
    assert Equation().acpr(27.0, 0.5) == acpr(27.0, 0.5) == 27 * 50.5
    assert Equation().acpr(None, 0.5) is None
    assert Equation().acpr(27.0, None) is None


def test_n_is_the_papers_the_measured_or_two_numbers():
    assert parse_n("paper") == PAPER_N
    assert parse_n("measured") == {}
    assert parse_n("10,20.5") == {"kdtree": 10, "bvh": 20.5}
    for text in ("", "10", "10,x", "10,-1", "10,inf", "nan,1"):
        with pytest.raises(NptraceError, match="is not N"):
            parse_n(text)
