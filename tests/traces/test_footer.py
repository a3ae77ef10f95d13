"""The footer: what is written is parsed, what is missing or of another type is named; runs that differ are told apart."""

import json
from dataclasses import replace
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.reference.traces import make_footer, make_trace, write
from traces.footer import CameraFacts, SceneFacts, TreeFacts, parse_footer
from traces.format import METADATA_KEY, RunError
from traces.reader import open_run
from traces.writer import refuse_other

HERE = Path("a-bvh")
GOOD = make_footer(tree=TreeFacts("bvh", 32, {"builder": "sweep"}), image_sha256="ab", n_rays=7)


def values(footer=GOOD):
    return json.loads(footer.to_json())


def test_what_is_written_is_parsed():
    assert parse_footer(GOOD.to_json(), HERE) == GOOD
    assert values()["tree"] == {"kind": "bvh", "node_bytes": 32, "builder": "sweep"}
    without = replace(GOOD, image_sha256=None)
    assert parse_footer(without.to_json(), HERE) == without and "image_sha256" not in values(without)
    assert parse_footer(json.dumps(values() | {"of another tool": 1}).encode(), HERE) == GOOD


def test_a_usual_run_has_no_entry_of_packets_and_shadow_rays():
    """So its bytes are those of earlier versions."""
    knobs = {"packet": 4, "shadow": "hit", "shadow_order": "cheaper", "shadow_end": "drain"}
    assert not values().keys() & knobs.keys()
    other = replace(GOOD, **knobs)
    assert values(other).keys() & knobs.keys() == knobs.keys() and parse_footer(other.to_json(), HERE) == other


ENTRIES = [
    *(name for name in values() if name != "image_sha256"),
    *(f"scene.{name}" for name in values()["scene"]),
    *(f"camera.{name}" for name in values()["camera"]),
    "tree.kind",
    "tree.node_bytes",
]


def changed(entry, *value):
    """Return the text of a good footer with another value of an entry, or without it."""
    all_values = values()
    place, (*outer, name) = all_values, entry.split(".")
    for each in outer:
        place = place[each]
    del place[name]
    if value:
        place[name] = value[0]
    return json.dumps(all_values).encode()


@pytest.mark.parametrize("entry", ENTRIES)
def test_a_missing_entry_is_named(entry):
    for text in (changed(entry), changed(entry, None)):
        with pytest.raises(RunError) as error:
            parse_footer(text, HERE)
        assert str(error.value) == f"a-bvh has no {entry} in its footer; render it again"


@pytest.mark.parametrize(
    ("entry", "value", "rule"),
    [
        ("scene", "bunny", "an object"),
        ("scene.name", 5, "a text"),
        ("scene.stand_in", 1, "true or false"),
        ("scene.n_triangles", True, "a whole number from 0"),
        ("camera.eye", [1, 2], "three numbers"),
        ("camera.up", [1, 2, "3"], "three numbers"),
        ("camera.fov", "45", "a number"),
        ("light", {}, "three numbers"),
        ("width", -1, "a whole number from 0"),
        ("n_rays", 7.0, "a whole number from 0"),
        ("tree.kind", [], "a text"),
        ("prefetch", "stack", "an object"),
        ("image_sha256", 5, "a text"),
    ],
)
def test_an_entry_of_another_type_is_named(entry, value, rule):
    with pytest.raises(RunError) as error:
        parse_footer(changed(entry, value), HERE)
    assert str(error.value) == f"a-bvh has {str(value)!r} as {entry} in its footer, not {rule}; render it again"


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (b"", "is damaged ("),
        (b"\xff", "is damaged ("),
        (b"[" * 100_000, "is damaged ("),
        (b"[]", "is damaged (its footer is '[]', not an object)"),
        (b"null", "is damaged (its footer is 'None', not an object)"),
        (b'{"format_version": 9}', "has format version 9, and this program reads 1"),
    ],
)
def test_what_is_no_footer(text, sentence):
    with pytest.raises(RunError, match="; render it again$") as error:
        parse_footer(text, HERE)
    assert str(error.value).startswith(f"a-bvh {sentence}")


@pytest.mark.parametrize(
    ("entry", "value"),
    [("tree.kind", "x"), ("tree.node_bytes", 0), ("tree.node_bytes", 1 << 40), ("tree.kind", "bvh64")],
    ids=["kind", "no byte", "too large", "of a later version"],
)
def test_only_known_trees_are_read(entry, value):
    with pytest.raises(RunError, match="format version 1 has the kinds kdtree, bvh, with nodes of up to 2\\^20 B"):
        parse_footer(changed(entry, value), HERE)


def test_a_run_has_the_oldest_version_that_describes_it():
    assert values()["format_version"] == 1
    newer = replace(GOOD, tree=TreeFacts("bvh64", 64))
    assert values(newer)["format_version"] == 2
    assert parse_footer(newer.to_json(), HERE) == newer
    assert newer.differences(GOOD) == ["tree"]
    packets = replace(GOOD, packet=64)
    assert values(packets)["format_version"] == values(replace(newer, packet=4))["format_version"] == 3
    assert parse_footer(packets.to_json(), HERE) == packets
    for version in (0, 4, True, "2", 1.5):
        with pytest.raises(RunError, match=f"has format version {version}, and this program reads 1 to 3"):
            parse_footer(changed("format_version", version), HERE)


@pytest.mark.parametrize(
    ("change", "unlike"),
    [
        ({}, []),
        ({"tool_version": "9", "command": "other", "image_sha256": "cd", "n_rays": 9, "n_nodes": 1, "n_accesses": 5}, []),
        ({"scene": replace(GOOD.scene, name="x", label="X", source="y.obj")}, []),
        ({"scene": replace(GOOD.scene, sha256="other"), "light": (1.0, 2.0, 3.0)}, ["scene"]),
        ({"scene": replace(GOOD.scene, stand_in=True)}, ["scene"]),
        ({"light": (1.0, 2.0, 3.0), "seed": 1}, ["light", "seed"]),
        ({"camera": replace(GOOD.camera, fov=46.0)}, ["camera"]),
        ({"tree": replace(GOOD.tree, params={"builder": "binned"})}, ["tree"]),
        *(({name: 77}, [name]) for name in ("width", "height", "batch", "packet")),
        *(({name: "other"}, [name]) for name in ("order", "layout", "shadow", "shadow_order", "shadow_end")),
        ({"prefetch": {"policy": "none"}}, ["prefetch"]),
    ],
)
def test_runs_that_are_not_the_same(change, unlike):
    assert GOOD.differences(replace(GOOD, **change)) == unlike
    assert parse_footer(replace(GOOD, **change).to_json(), HERE).differences(GOOD) == unlike


def test_a_run_whose_footer_lacks_something_is_not_replaced_unasked(tmp_path):
    run = write(make_trace("bvh", 1, n_rays=3), tmp_path / "a-bvh")
    refuse_other(run.path, run.footer)
    for name in ("accesses", "rays", "nodes"):
        file = run.path / f"{name}.parquet"
        entries = json.loads(run.footer.to_json())
        del entries["seed"]
        pq.write_table(pq.read_table(file).replace_schema_metadata({METADATA_KEY: json.dumps(entries).encode()}), file)
    with pytest.raises(RunError, match="has no seed in its footer; render it again, with --overwrite"):
        refuse_other(run.path, run.footer)
    with pytest.raises(RunError, match="has no seed in its footer; render it again$"):
        open_run(run.path)


def test_facts_are_what_the_page_says():
    text = (Path(__file__).parents[2] / "traces" / "README.md").read_text(encoding="utf-8")
    page = text[text.index("## Footer") : text.index("## What is checked")]
    for entry in (*values(), *SceneFacts.__dataclass_fields__, *CameraFacts.__dataclass_fields__, "kind", "node_bytes"):
        assert f"`{entry}`" in page, entry
