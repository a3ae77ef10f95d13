"""No option is silently without effect: each pair of options of which one would be ignored is refused, in every command.

The table has a command, and the options that it refuses to be given beside the others.
"""

import pytest
from click.testing import CliRunner

import cli
from nptrace.groups import Command
from nptrace.ignored import RULES
from tests.nptrace.test_messages import inputs

RUN = "traces/one-bvh"
IGNORED = [
    # RUN and --traces, of every command that reads runs
    *((f"{command} {RUN} --traces traces", "--traces") for command in (
        "nptrace info", "npcache replay", "npcache sweep", "npcache time", "npcache compare", "npcache table1",
        "npcache report -o x.html",
    )),
    # a seed of what is not random
    *((f"{command} --seed 3", "--seed") for command in (
        f"npcache replay {RUN}", f"npcache time {RUN}", f"npcache compare {RUN}", f"npcache report {RUN} -o x.html",
        f"nptrace view {RUN} --heat misses -o x.png", f"npcache replay {RUN} --policy lru,fifo", "nptrace render one.obj",
        "nptrace render one.obj --order morton", "nptrace check one.obj --random 0",
    )),
    # options of a tree that is not built
    *((f"{command} one.obj {given}", option) for command in ("nptrace render", "npcache estimate") for given, option in (
        ("--accel bvh --kd coarse", "--kd"), ("--accel kdtree --bvh binned", "--bvh"),
        ("--accel kdtree --bvh-nodes 64", "--bvh-nodes"),
        ("--accel kdtree --bvh binned --bvh-nodes 64", "--bvh and --bvh-nodes"),
    )),
    # options of a picture, beside rays
    *((f"nptrace render one.obj --rays x.parquet {given}", given.split()[0]) for given in (
        "--pixels 128x128", "--camera eye=1,2,3", "--light 1,2,3", "--order scanline", "--batch 1", "--seed 0", "--packet 1",
        "--shadow lit", "--shadow-order sign", "--shadow-end stop",
    )),
    # options of scenes and rays, beside the cases of --hard
    *((f"nptrace check --hard {given}", given.split()[0]) for given in (
        "--pixels 8x8", "--random 3", "--seed 3", "--strict", "--offline",
    )),
    ("nptrace check one.obj --long", "--long"),
    # options of a cache, a machine or a policy, in pictures that depend on none
    *((f"nptrace view {RUN} {given} -o x.png", given.split()[0]) for given in (
        "--machine ttp", "--size 8K", "--ways 2", "--line 64", "--policy fifo", "--layout veb", "--miss 9", "--rays 4",
        "--prefetch none",
    )),
    (f"nptrace view {RUN} --heat picture --size 8K -o x.png", "--size"),
    (f"nptrace view {RUN} --heat accesses --size 8K --layout veb -o x.png", "--size and --layout"),
    (f"nptrace view {RUN} --heat accesses --prefetch none -o x.png", "--prefetch"),
    (f"nptrace view {RUN} --heat accesses,prefetches --line 64 -o x.png", "--line"),
    (f"nptrace view {RUN} --heat misses,picture --mshrs 4 -o x.png", "--mshrs"),
    # options of runs, beside what has its own; the caches of a kind that shows all
    ("npcache table1 --preset paper2013 --policy lru", "--policy"),
    ("npcache table1 --target-error 2% --traces traces", "--traces"),
    (f"npcache table1 {RUN} --pixels 8x8", "--pixels"),
    ("npcache estimate one.obj --table1 --line 64", "--line"),
    (f"npcache plot {RUN} --kind distances --assoc 2 -o x.png", "--assoc"),
    # forms
    (f"nptrace export {RUN} --format csv --binary", "it"),
    *((f"{command} --wide", "--wide") for command in (
        f"npcache replay {RUN} --json", f"npcache sweep {RUN}", f"nptrace info {RUN} -o x.csv", "nptrace run x.toml",
    )),
    *((f"{command} -q -v", "one") for command in ("nptrace scenes", f"npcache replay {RUN}")),
    ("nptrace scenes --json --format csv", "one"),
]  # fmt: skip
#: What is given and has an effect, or is the value that a run's own command has.
USED = [
    "nptrace render one.obj --accel bvh --pixels 4x4 --order random --seed 3",
    "nptrace render one.obj --accel bvh --pixels 4x4 --order scanline --seed 0",
    "nptrace render one.obj --pixels 4x4 --kd coarse --bvh binned --bvh-nodes 64 --name x",
    "npcache estimate one.obj --seed 3",
    f"npcache replay {RUN} --policy lru,random --seed 3",
    f"npcache compare {RUN} --plot x.png --wide",
    f"nptrace view {RUN} --heat accesses,misses --size 8K --layout veb --prefetch none -o x.png",
    f"nptrace view {RUN} --heat prefetches --prefetch next-line:miss --size 8K -o x.png",
    f"nptrace view {RUN} --heat miss-cycles --mshrs 4 -o x.png",
    "nptrace check one.obj --pixels 4x4 --random 9 --seed 3",
]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    inputs(tmp_path)
    return tmp_path


def run(command):
    program, *words = command.split()
    return CliRunner().invoke(getattr(cli, program), words, catch_exceptions=False)


@pytest.mark.parametrize(("command", "options"), IGNORED)
def test_an_option_without_effect_is_refused(folder, command, options):
    result = run(command)
    assert (result.exit_code, result.stdout) == (2, ""), result.output
    assert (
        f"leave {options} out" in result.stderr or f"leave out {options}" in result.stderr or "leave one out" in result.stderr
    )


@pytest.mark.parametrize("command", USED)
def test_an_option_with_an_effect_is_taken(folder, command):
    result = run(command)
    assert result.exit_code == 0, result.output


def test_the_table_has_every_command_that_a_rule_is_for():
    said = " ".join(command for command, _ in IGNORED)
    for program in ("nptrace", "npcache"):
        commands = getattr(cli, program).commands
        for name in commands:
            command = commands.get(name)
            assert isinstance(command, Command), name
            names = {param.name for param in command.params}
            assert f"{program} {name} " in f"{said} " or not any(names >= {*rule.options, *rule.beside} for rule in RULES), (
                name
            )
