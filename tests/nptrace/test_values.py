"""A wrong value of any parameter of ``import nptrace`` is one sentence of ours, before any work; right ones mean the same."""

import datetime
import inspect
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from click.testing import CliRunner

import cli
import nptrace as nt
from nptrace.values import KINDS
from tests.nptrace.test_terminal import inputs

FUNCTIONS = [name for name in nt.__all__ if inspect.isfunction(getattr(nt, name))]
#: What no option takes, and what some do not.
NEVER = (
    object(),
    8.5,
    float("nan"),
    b"8K",
    {"a": 1},
    {1, 2},
    [["8K"]],
    [None],
    1j,
    datetime.date(2026, 1, 1),
    np.zeros((2, 2)),
)
WRONG = {
    **dict.fromkeys(("threads",), (0, -1, True, "x", "2", [1])),
    **dict.fromkeys(("seed", "batch", "exact_below"), (-1, True, "1", None, [1])),
    **dict.fromkeys(("packet",), (0, 8, True, "4", None)),
    **dict.fromkeys(("workers",), (-1, True, "2", None, [1])),
    **dict.fromkeys(("overwrite", "strict", "offline", "three_c", "is_table1", "baselines"), (0, 1, "yes", None, [True])),
    **dict.fromkeys(("pixels",), (16, (16,), (1, 2, 3), (1.5, 2), ("16", "16"), (True, 1), "16", None, "0x0", (-1, 5))),
    "one_in": (0, 17, True, "2", None),
    **dict.fromkeys(("part",), (1, (1,), (1, 2, 3), ("1", "2"), "3", None)),
    **dict.fromkeys(("size", "ways", "line", "bvh_nodes", "hit", "miss", "rays", "n"), (True, [True], "x", 0, -1)),
    **dict.fromkeys(
        ("policy", "prefetch", "layout", "accel", "machine", "target_error", "kd", "bvh"), (3, True, None, "x", [3])
    ),
    **dict.fromkeys(("order", "shadow", "shadow_order", "shadow_end", "reads", "flush"), (3, True, None, "x", ["x"])),
    **dict.fromkeys(("by", "preset"), (3, True, "x", ["x"])),
    **dict.fromkeys(("light", "camera"), (3, (1, 2, 3), "x", True)),
    **dict.fromkeys(("name",), (3, "a/b", None, ["a", "b", "c"])),
    **dict.fromkeys(("scenes", "run", "out", "traces", "path", "resume"), (3, True, "a\0b", ["a"])),
    **dict.fromkeys(("sources", "summaries"), (3, None, "a\0b", [], [3])),
    **dict.fromkeys(("scheduler",), (3, True, ["x"])),
    **dict.fromkeys(("output",), (3, True, "a\0b", ["a.png"], "a.txt")),
    **dict.fromkeys(("kind", "heat"), (3, True, "x", ["x"])),
    **dict.fromkeys(("enlarge",), (0, 65, True, "2", [1])),
    **dict.fromkeys(("difference", "quick"), (0, 1, "yes", None, [True])),
}
#: Arguments without which a function cannot be called.
NEEDED = {
    **{name: ["ball.obj"] for name in ("render", "estimate", "map")},
    **{name: ["traces/bunny-bvh"] for name in ("view", "plot")},
    "summarise": ["traces/bunny-bvh", "1.sum"],
}
OPTIONS = {"summarise": {"part": (1, 2)}, "report": {"output": "report.html"}}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("values")
    inputs(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        yield folder


def calls(function):
    """Yield each parameter of a function, and a call with a value of it."""
    for name, parameter in inspect.signature(getattr(nt, function)).parameters.items():
        if parameter.kind is parameter.VAR_KEYWORD:
            yield from ((each, "options") for each in ("hit", "miss", "rays"))
        else:
            yield name, "first" if parameter.kind in (parameter.VAR_POSITIONAL, parameter.POSITIONAL_ONLY) else "options"


def call(function, name, place, value):
    args = list(NEEDED.get(function, []))
    if place == "first":
        at = 1 if (function, name) == ("summarise", "out") else 0
        args[at : at + 1] = [value]
        options = {}
    else:
        options = {name: value}
    return getattr(nt, function)(*args, **OPTIONS.get(function, {}) | options)


@pytest.mark.parametrize("function", FUNCTIONS)
def test_every_wrong_value_is_one_sentence(folder, function):
    before = sorted(folder.rglob("*"))
    for name, place in calls(function):
        for value in (*NEVER, *WRONG.get(f"{function} {name}", WRONG.get(name, ()))):
            with pytest.raises(nt.NptraceError) as caught:
                call(function, name, place, value)
            said = str(caught.value)
            assert "\n" not in said and len(said) > 25, (name, value)
            if any(value is each for each in NEVER):
                assert said.startswith(f"{name}: ") and "; write e.g. " in said, (name, value, said)
    assert sorted(folder.rglob("*")) == before


def test_every_parameter_has_its_wrong_values():
    for function in FUNCTIONS:
        for name, _ in calls(function):
            assert name in WRONG or name == "rays", (function, name)
    assert len(FUNCTIONS) >= 10 and set(KINDS) <= {*WRONG, "rays"}


@pytest.mark.parametrize(
    ("call", "same"),
    [
        (lambda: nt.render("ball.obj", accel="bvh", pixels=(16, 12)), lambda: nt.open("traces/ball-bvh-16x12")),
        (lambda: nt.render(Path("ball.obj"), accel="bvh", pixels=np.array([16, 12]), threads=np.int64(1)),
         lambda: nt.open(Path("traces") / "ball-bvh-16x12")),
        (lambda: nt.render("ball.obj", accel="bvh", pixels=(16, 12), workers=np.int32(0), strict=np.bool_(True)),
         lambda: nt.open(Path("traces") / "ball-bvh-16x12")),
    ],
)  # fmt: skip
def test_a_picture_may_be_two_numbers(folder, call, same):
    assert call().footer == same().footer


@pytest.mark.parametrize(
    "size", [["1K", 2048], ("1K", "2K"), np.array([1024, 2048]), range(1024, 2049, 1024), (k for k in (1024, "2K")), "1K..2K"]
)
def test_lists_of_any_kind(folder, size):
    rows = nt.replay(Path("traces/bunny-bvh"), size=size, ways=np.int64(1), threads=1)
    assert [row["size_bytes"] for row in rows] == [1024, 2048]


def test_an_empty_list_is_none_of_them(folder):
    with pytest.raises(nt.NptraceError, match="size: it is an empty list; name something, or leave it out"):
        nt.replay("traces/bunny-bvh", size=[])
    assert len(nt.time("traces/bunny-bvh", size=[])) == 1  # those of the machine


def test_paths_wherever_a_path_is_taken(folder):
    whole = nt.replay("traces/bunny-bvh", size="1K")
    assert list(nt.replay([Path("traces/bunny-bvh")], size="1K", workers=0)) == list(whole)
    parts = [nt.summarise(Path("traces/bunny-bvh"), Path(f"{i}.sum"), part=(np.int64(i), 2), size="1K") for i in (1, 2)]
    assert list(nt.combine(parts)) == list(nt.combine(np.array([str(part) for part in parts]))) == list(whole)
    for part in parts:
        part.unlink()
    with ThreadPoolExecutor(1) as pool:
        assert list(nt.replay("traces/bunny-bvh", size="1K", workers=pool)) == list(whole)


def test_the_largest_seed_is_a_column(folder):
    results = nt.replay("traces/bunny-bvh", size="1K", ways=2, policy="random", seed=2**63 - 1)
    assert results.to_arrow()["policy_seed"].type == pa.int64()
    with pytest.raises(nt.NptraceError, match=r"seed: 9223372036854775808 is not a whole number from 0 to 2\^63 - 1"):
        nt.replay("traces/bunny-bvh", seed=2**63)
    too_large = ["replay", "traces/bunny-bvh", "--policy", "random", "--seed", str(2**63)]
    said = CliRunner().invoke(cli.npcache, too_large).stderr
    assert said == "Error: --seed: '9223372036854775808' is not a whole number from 0 to 2^63 - 1; write e.g. --seed 1\n"


@pytest.mark.parametrize(
    "call", [lambda far: nt.open(far), lambda far: nt.replay(traces=far), lambda far: nt.combine([far, "x"])]
)
def test_what_the_machine_refuses_is_one_sentence(folder, call):
    with pytest.raises(nt.NptraceError, match="File name too long"):
        call("x" * 5000)
