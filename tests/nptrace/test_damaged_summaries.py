"""Summary files that were changed: every change is one sentence, none another result."""

import json
import random

import pyarrow as pa
import pytest
from click.testing import CliRunner

import cli
import nptrace as nt
from nptrace.commands import summarise
from tests.reference.traces import make_trace, write


@pytest.fixture
def run(tmp_path):
    return write(make_trace("kdtree", 5, n_rays=30), tmp_path / "traces" / "bunny-kdtree")


def combined(*files):
    result = CliRunner().invoke(cli.npcache, ["combine", *map(str, files), "--json"], catch_exceptions=False)
    return result.exit_code, result.stdout if result.exit_code == 0 else result.stderr


@pytest.mark.parametrize(
    ("entry", "change"),
    [
        ("run", {"n_rays": 29}), ("run", {"n_accesses": 1}), ("run", {"identity": {"run": "other"}}),
        ("asked", [{"layout": "dfs"}]), ("rows", [0, 10]), ("code", ["0"]),
    ],
)  # fmt: skip
def test_what_a_file_says_of_itself_has_a_checksum_too(run, tmp_path, entry, change):
    file = nt.summarise(run, tmp_path / "1.sum", part="1/1", size="1K")
    table = pa.ipc.open_file(file.read_bytes()).read_all()
    values = json.loads(table.schema.metadata[b"nptrace summary"])
    values[entry] = values[entry] | change if isinstance(change, dict) else change
    metadata = table.schema.metadata | {b"nptrace summary": json.dumps(values).encode()}
    with pa.ipc.new_file(file, table.schema.with_metadata(metadata)) as writer:
        writer.write_table(table.replace_schema_metadata(metadata))
    status, message = combined(file)
    assert status == 2 and f"{file} is not a readable summary (the checksum of its metadata is wrong)" in message


def test_flipped_bits_and_cuts_change_no_result(run, tmp_path):
    files = [nt.summarise(run, tmp_path / f"{i}.sum", part=(i, 2), size="1536", ways="3", prefetch="stack") for i in (1, 2)]
    good, (_, expected) = files[0].read_bytes(), combined(*files)
    choice = random.Random(1)
    for _ in range(400):
        changed = bytearray(good)
        bit = choice.randrange(8 * len(good))
        changed[bit // 8] ^= 1 << bit % 8
        files[0].write_bytes(changed)
        status, text = combined(*files)
        assert (status == 2 and text.startswith("Error: ")) or text == expected, bit
    for length in choice.sample(range(len(good)), 50):
        files[0].write_bytes(good[:length])
        status, text = combined(*files)
        assert status == 2 and f"{files[0]} is not a readable summary" in text, length


@pytest.mark.parametrize(("name", "command"), [("2.sum", "npcache combine"), ("2.**", ""), ("2.a b", ""), ("2", "")])
def test_the_command_that_joins_is_named_where_it_can_be(tmp_path, monkeypatch, name, command):
    monkeypatch.chdir(tmp_path)
    for file in (name, name.replace("2", "1"), f".1.{name}"):
        (tmp_path / file).write_text("")
    found = summarise._following(tmp_path / name, 2)
    assert found.startswith(command) and bool(found) == bool(command)
