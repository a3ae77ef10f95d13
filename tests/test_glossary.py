"""The glossary has every column heading and every JSON key that a command prints."""

import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner

import cli
import nptrace_base.tables
from nptrace.commands.replay import BY as REPLAY_BY
from nptrace.commands.time import BY
from rtrace.checks import hard_cases

GLOSSARY = (Path(cli.__file__).resolve().parent / "docs" / "glossary.md").read_text(encoding="utf-8")
SMALL = ["--pixels", "16x16", "--offline"]
CLOCKED = ["--size", "1K", "--assoc", "1", "--prefetch", "stack,push"]
CACHES = ["--size", "1K,2K", "--assoc", "1,2"]


@pytest.fixture(scope="module")
def headings_and_keys(tmp_path_factory):
    """Return the headings and the keys of every command that prints results."""
    traces = tmp_path_factory.mktemp("traces")
    headings, keys = set(), set()
    study = traces / "study.toml"
    study.write_text(f'out = "{traces}/runs"\n[render]\nscenes = "blob"\npixels = "8x8"\n[time]\n')

    def record(tables, notes, file, **options):
        headings.update(name.replace("-\n", "").replace("\n", " ") for table in tables for name in table.header)

    def run(program, *args):
        result = CliRunner().invoke(program, [*map(str, args)], catch_exceptions=False)
        assert result.exit_code == 0, result.output
        return result.stdout

    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("NPTRACE_SCENES", raising=False)
        patch.setattr(nptrace_base.tables, "print_tables", record)
        for form in ([], ["--json"]):
            for program, *args in (
                (cli.nptrace, "render", "bunny", *SMALL, "--out", traces), (cli.nptrace, "scenes"),
                (cli.nptrace, "info", "--traces", traces),
                (cli.nptrace, "check", "blob", *SMALL, "--random", 50), (cli.npcache, "table1", "--traces", traces),
                (cli.npcache, "replay", "--traces", traces, *CACHES, "--3c"),
                *((cli.npcache, "replay", "--traces", traces, "--size", "1K", "--by", by) for by in REPLAY_BY),
                (cli.npcache, "time", traces / "bunny-standin-bvh-16x16", *CLOCKED),
                *((cli.npcache, "time", traces / "bunny-standin-bvh-16x16", *CLOCKED, "--by", by) for by in BY),
                (cli.npcache, "compare", traces / "bunny-standin-bvh-16x16", *CLOCKED),
                (cli.nptrace, "map", "blob", "--quick", *SMALL, "--out", traces / "map"),
                (cli.npcache, "estimate", "blob", *CACHES, "--pixels", "16x16", "--offline"),
                (cli.nptrace, "run", study, *([] if form else ["--format", "table"])),
            ):  # fmt: skip
                printed = run(program, *args, *form)
                keys |= set(_keys(json.loads(printed))) if form else set()
        keys |= set(
            _keys(json.loads(run(cli.npcache, "sweep", "--traces", traces, "--size", "1K", "--ways", "1,2", "--json")))
        )
    (hard_case,) = (each for each in vars(hard_cases).values() if hasattr(each, "is_good"))  # a long run prints it
    return headings, keys | set(hard_case._fields)


def _keys(value):
    if isinstance(value, list):
        for item in value:
            yield from _keys(item)
    elif isinstance(value, dict):
        for name, item in value.items():
            yield name
            yield from _keys(item)


def test_every_heading_is_a_term(headings_and_keys):
    headings, _ = headings_and_keys
    terms = " ".join(re.sub(r"[|`(),:;]", " ", GLOSSARY.lower()).split())
    words = {" ".join(re.sub(r"[(),]", " ", name.lower()).split()).removesuffix(" %") for name in headings if name}
    words = {re.sub(r"^\d+k \d+ ", "acpr ", word) for word in words}  # a cache of Table I
    assert len(words) > 40
    assert sorted(word for word in words if f" {word} " not in f" {terms} ") == []


def test_every_key_is_a_term(headings_and_keys):
    _, keys = headings_and_keys
    known = set(re.findall(r"\w+", GLOSSARY))
    known |= {f"{name}_paper" for name in known}
    assert len(keys) > 60
    assert sorted(keys - known) == []
