"""Tables on terminals of every width: no line is longer, no number is broken or lost unsaid; a pipe gets everything."""

import io
import re

import pytest

from nptrace_base import tables
from nptrace_base.tables import Table, fitted, print_tables

HEADER = ["run", "cache", "demand\naccesses", "demand\nmiss rate %", "KB from\nmemory", "traffic\nratio"]
ROWS = [
    ["traces/sponza-kdtree-morton-512x512", "8K 2-way 32 B lru", "1,804,438,000", "13.74", "8,673", "1.006"],
    ["traces/bunny-standin-bvh (stand-in)", "16K full 64 B random", "7", "100.00", "3,848,120", "0.998"],
]
EXTRA = ("traffic\nratio", "KB from\nmemory")
NOTE = "demand miss rate = demand misses / demand accesses; KB = lines filled x line bytes, and so on and on and on."


def printed(monkeypatch, width, **options):
    monkeypatch.setattr(tables, "width_of", lambda file: width)
    out = io.StringIO()
    print_tables([Table("sponza-bvh, prefetch traced", HEADER, ROWS, n_left=2, extra=EXTRA)], [NOTE], out, **options)
    return out.getvalue()


@pytest.mark.parametrize("width", [*range(34, 60), 80, 100, 120, 200])
def test_no_line_is_longer_than_the_terminal(monkeypatch, width):
    text = printed(monkeypatch, width)
    assert max(map(len, text.splitlines())) <= width
    numbers = set(re.findall(r"[\d,.]+", " ".join(" ".join(row[2:]) for row in ROWS)))
    words = set(text.split())
    assert {"1,804,438,000", "7"} <= words
    shown = {number for number in numbers if number in words}
    for i, name in enumerate(HEADER):
        column = {row[i] for row in ROWS}
        if i > 1:
            assert column <= shown or name.replace("\n", " ") in " ".join(text.split("--wide")[-1].split())


def test_a_wide_terminal_and_a_pipe_get_every_column(monkeypatch):
    for text in (printed(monkeypatch, 160), printed(monkeypatch, None), printed(monkeypatch, 60, is_wide=True)):
        assert "traffic" in text and "--wide" not in text
    assert printed(monkeypatch, None).isascii() and "\u2500" in printed(monkeypatch, 80)


def test_columns_go_in_the_order_of_extra_and_keys_stay():
    table = Table("", HEADER, ROWS, n_left=2, extra=EXTRA)
    left = [len(fitted(table, width)[0].header) for width in range(130, 30, -1)]
    assert left == sorted(left, reverse=True) and left[0] == 6 and left[-1] == 3
    for width in range(130, 30, -1):
        shown = fitted(table, width)[0]
        gone = [name for name in HEADER if name not in shown.header]
        assert set(gone) == set(["traffic\nratio", "KB from\nmemory", "demand\nmiss rate %"][: len(gone)])
        assert shown.header[:2] == HEADER[:2]


def test_notes_are_wrapped(monkeypatch):
    for width, most in ((40, 40), (200, 110), (None, 110)):
        lines = printed(monkeypatch, width).splitlines()
        firsts = ("demand miss rate =", "paper miss rate =", "--wide prints")
        at = next(i for i, line in enumerate(lines) if line.startswith(firsts))
        assert max(map(len, lines[at:])) <= most


def test_latex_prints_what_a_name_has():
    cells = [[r"a~b^c\d{e}$f_g#h%i&j", "-3.7"]]
    text = tables.to_latex([Table("", ["run", "x"], cells)], [])
    name = r"a\textasciitilde{}b\textasciicircum{}c\textbackslash{}d\{e\}\$f\_g\#h\%i\&j"
    assert rf"{name} & $-$3.7 \\" in text.splitlines()
