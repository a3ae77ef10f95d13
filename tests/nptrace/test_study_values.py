"""Any TOML value at any key of a study is accepted, or refused in one sentence that names its line and its key."""

import datetime
import json

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from nptrace import study
from nptrace.study import SECTIONS, TOP, read_study
from nptrace_base.errors import NptraceError

KEYS = [
    *(("", name) for name in TOP),
    *(("render", name) for name in (*study._defaults("render"), "scenes")),
    *((table, name) for table in SECTIONS for name in study._defaults(table)),
    *(("time", name) for name in study._numbers()),
]
#: Texts that some option takes, and more that look like them.
WORDS = (
    "", "8K", "4K..64K", "1..4", "full", "lru", "none", "stack:tris*2", "veb", "64x64", "0x0", "tile", "eye=1,2,3 at=0,0,0",
    "0,9,0", "nan,0,0", "eye=1e400,0,0 at=0,0,0", "binned,max_leaf=2", "coarse", "ray", "own", "rtx2060", "64..1", "1..99999",
    ",", "a\0b", "s3://x",
)  # fmt: skip
plain = st.one_of(
    st.booleans(), st.integers(-3, 70), st.integers(-(2**63), 2**63 - 1), st.floats(), st.sampled_from(WORDS),
    st.text(st.characters(exclude_categories=["Cs"]), max_size=8), st.dates(datetime.date(1000, 1, 1)), st.times(),
)  # fmt: skip
VALUES = st.recursive(
    plain, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from("ab"), inner, max_size=2), max_leaves=5
)


def toml(value):
    """Return a value as TOML writes it; a list takes several lines."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list):
        return "[" + "".join(f"\n  {toml(each)}," for each in value) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{name} = {toml(each)}" for name, each in value.items()).replace("\n", "") + "}"
    return value.isoformat() if isinstance(value, datetime.date | datetime.time) else str(value)


@pytest.mark.parametrize(("table", "name"), KEYS)
@settings(max_examples=8)
@given(value=VALUES)
@example(value=4)
@example(value=-1)
@example(value=True)
@example(value=0.5)
@example(value="x")
@example(value=[4, "x"])
@example(value={"a": 1})
@example(value=datetime.date(1979, 5, 27))
def test_any_value_at_any_key(tmp_path_factory, table, name, value):
    if isinstance(value, list):
        value = [each for each in value if not isinstance(each, dict)]  # which TOML writes on one line
    written, text = f"{name} = {toml(value)}\n", ""
    for each in dict.fromkeys(("", "render", "replay", table)):
        text += f"[{each}]\n" if each else "# a comment\n\n"
        text += 'scenes = "blob"\n' if each == "render" and name != "scenes" else ""
        text += written if each == table else ""
    path = tmp_path_factory.getbasetemp() / "study.toml"
    path.write_text(text, encoding="utf-8")
    line, of_table = (text.partition(part)[0].count("\n") + 1 for part in (written, f"[{table}]"))
    try:
        read_study(path)
    except NptraceError as e:
        said = str(e)
        assert "\n" not in said
        is_of_key = said.startswith(f"{path}, line {line}: ") and name in said
        # What several options are together, such as a cache, is of their table.
        assert is_of_key or (said.startswith(f"{path}, line {of_table}: ") and ", and not " not in said), said


def test_brackets_without_end_are_one_sentence(tmp_path):
    (tmp_path / "study.toml").write_text("out = " + "[" * 100_000)
    with pytest.raises(NptraceError, match="is not valid TOML: "):
        read_study(tmp_path / "study.toml")
