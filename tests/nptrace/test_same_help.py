"""An option is described alike in every command that has it, takes its words in any case, and is called as it was typed."""

import re
from collections import defaultdict
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

import cli
from nptrace.options import SIZE_HELP, WAYS_HELP
from tests.nptrace.test_messages import inputs

RUN = "traces/one-bvh"
COMMANDS = {name: getattr(cli, program).commands.get(name) for program in ("nptrace", "npcache")
            for name in getattr(cli, program).commands}  # fmt: skip
#: Options that are another thing in some commands, by what these are.
OTHERS = {
    "--size": {"sweep": "every size"},
    "--seed": {"check": "rays", "table1": "sample", "estimate": "sample", "render": "order"},
    "--rays": {"render": "a file"}, "--out": {"map": "parts"}, "--format": {"export": "addresses"},
    "--output": dict.fromkeys(("view", "export", "summarise", "plot", "report"), "no rows"), "--by": {"time": "of the clock"},
    "--hit": {"table1": "equation"}, "--miss": {"table1": "equation"}, "--pixels": {"table1": "of an estimate"},
    "--target-error": {"table1": "asks for an estimate"}, "--machine": {},
    "--policy": dict.fromkeys(("estimate", "table1", "summarise"), "lru alone, or one"),
}  # fmt: skip


def described():
    """Return option -> text without what a command may add -> commands."""
    found = defaultdict(lambda: defaultdict(list))
    for name, command in COMMANDS.items():
        for option in command.params:
            if isinstance(option, click.Option) and option.help:
                long = max(option.opts, key=len)
                text = re.sub(r"^Of runs: (.)", lambda match: match[1].upper(), option.help)
                text = re.sub(r"; that of the machine if left out| all: the usual ones\.", "", text)
                text = re.sub(r"Lists make every.*|One cache and one.*|One machine;.*", "", text)
                text = text.replace("Prefetch policies, e.g. none,stack", "Prefetch policy, e.g. stack")
                text = text.replace("fifo or random.", "fifo, random.").replace("fifo, random, opt (Belady).", "fifo, random.")
                text = text.replace("; one at a time", "")
                if name not in OTHERS.get(long, {}):
                    found[long][text].append(name)
    return found


def test_the_same_option_has_the_same_help():
    assert {option: dict(texts) for option, texts in described().items() if len(texts) > 1} == {}
    assert len(described()) > 60


def test_names_of_an_option_come_in_one_order():
    orders = defaultdict(set)
    for command in COMMANDS.values():
        for option in command.params:
            if isinstance(option, click.Option):
                orders[max(option.opts, key=len)].add(tuple(option.opts))
    assert {name for name, found in orders.items() if len(found) > 1} == set()


def test_ranges_are_described_as_they_are():
    from cachesim.grid import parse_sizes, parse_ways_range

    assert "ends" in SIZE_HELP and parse_sizes("5K..9K") == [5 << 10, 8 << 10, 9 << 10]
    assert "1..16" in WAYS_HELP and parse_ways_range("1..16")[-1] == "16"


def test_help_names_no_file_that_an_installed_program_lacks():
    for command in COMMANDS.values():
        assert "docs/" not in command.get_help(click.Context(command)), command.name
    packages = ("nptrace", "rtrace", "cachesim", "traces", "nptrace_base")
    root = Path(cli.__file__).parent
    for file in (each for name in packages for each in (root / name).rglob("*.py")):
        code = re.sub(r'"""(?!Return\b).*?"""|#.*', "", file.read_text(encoding="utf-8"), flags=re.DOTALL)
        assert "docs/" not in code, file


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    inputs(tmp_path)
    return tmp_path


def run(command):
    program, *words = command.split()
    return CliRunner().invoke(getattr(cli, program), words, catch_exceptions=False)


@pytest.mark.parametrize(
    "command",
    [
        "nptrace render one.obj --pixels 4x4 --accel BVH,KdTree --order MORTON --shadow Hit --shadow-order SIGN --name x",
        "nptrace render one.obj --pixels 4x4 --accel bvh --bvh-nodes 32,64 --name x",
        f"npcache replay {RUN} --policy LRU --reads Own --flush NEVER --format CSV",
        f"npcache replay {RUN} --by Level",
        f"npcache replay {RUN} --by ray-type",
        f"npcache time {RUN} --machine PAPER --by Ray-Type",
        f"npcache plot {RUN} --kind LEVELS --ways 1..2 -o x.png",
        f"nptrace view {RUN} --heat Picture,ACCESSES -o x.png",
        f"nptrace export {RUN} --format DIN --prefetch-as Read",
    ],
)
def test_words_are_taken_in_any_case_and_as_lists(folder, command):
    result = run(command)
    assert result.exit_code == 0, result.output


def test_an_old_name_of_a_tally_says_the_new_one(folder):
    result = run(f"npcache time {RUN} --by ray --json")
    assert "--by ray is now --by ray-type" in result.stderr and '"by": "ray-type"' in result.stdout


def test_an_old_name_of_an_option_says_the_new_one(folder):
    result = run("nptrace map one.obj --part 17")
    assert "--part is now --one-in" in result.stderr and "'--one-in': 17" in result.stderr


def test_messages_call_an_option_as_it_was_typed(folder):
    for name in ("--ways", "--assoc"):
        assert f"leave out {name}," in run(f"npcache plot {RUN} {name} 2 -o x.png").stderr
        assert f"leave out {name}," in run(f"npcache estimate one.obj --table1 {name}=2").stderr
