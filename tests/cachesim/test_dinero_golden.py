"""DineroIV release 7 on recorded traces: every printed counter, and the statistics block byte for byte."""

import gzip
import json
from pathlib import Path

import pytest

from cachesim.config import CacheConfig, parse_bytes
from cachesim.replay import replay
from cachesim.report.dinero import dinero_block
from tests.reference.cache import Cache, pieces
from traces.din import DinTrace

GOLDEN = Path(__file__).parent / "golden" / "dinero"
CASES = json.loads((GOLDEN / "cases.json").read_text())
PREFETCHERS = {"d": "traced", "l": "traced", "a": "next-line:always", "m": "next-line:miss", "t": "next-line:tagged"}
COLUMNS = {"Instrn": (2,), "Data": (0, 1, 3), "Read": (0,), "Write": (1,), "Misc": (3,), "Total": (0, 1, 2, 3)}


@pytest.fixture(scope="session")
def din(tmp_path_factory):
    """Folder with the traces; four of the five are one trace with its prefetches labelled b, 0 or 3, or left out."""
    folder = tmp_path_factory.mktemp("dinero")
    (folder / "stream.din").write_bytes(gzip.decompress((GOLDEN / "stream.din.gz").read_bytes()))
    labelled = gzip.decompress((GOLDEN / "bst_pf_label_b.din.gz").read_bytes()).splitlines(keepends=True)
    for name, label in (("bst_pf_label_b", b"b"), ("bst_pf_as_read", b"0"), ("bst_pf_as_misc", b"3"), ("bst", b"")):
        lines = (label + line[1:] if line[:1] == b"b" else line for line in labelled)
        (folder / f"{name}.din").write_bytes(b"".join(line for line in lines if line[:1] != b" "))
    return folder


def config_of(case):
    line, ways = case["line"], case["ways"]
    # DineroIV leaves the rest of a size that is not a whole number of sets unused: 8K as 85 sets of 3 ways is 8160 B.
    size = parse_bytes(case["size"]) // (line * ways) * (line * ways)
    return CacheConfig(size, ways, line, case["policy"])


def printed_rows(text):
    """Return the printed rows: name -> numbers, with the section's first word for names that occur twice."""
    rows = {}
    for line in text.splitlines()[3:]:
        name, *numbers = line.strip().split("\t")
        if not numbers and name:
            name, number = name.rsplit(None, 1)
            numbers = [number]
        if name:
            key = name if name not in rows else f"{name} again"
            rows[key] = [float(number) for number in numbers if number]
    return rows


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["id"])
def test_block_is_the_one_dinero_printed(case, din):
    [result] = replay(
        din / case["trace"], [config_of(case)], prefetch=PREFETCHERS[case["fetch"]], three_c=case["3c"], threads=1
    )  # fmt: skip
    wanted = (GOLDEN / f"{case['id']}.txt").read_text()
    assert dinero_block(result, prefetch_rows=case["fetch"] != "d") == wanted


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["id"])
def test_every_printed_counter(case, din):
    """The same from the result itself, so that a mistake in the printing cannot hide one in the counting."""
    [result] = replay(din / case["trace"], [config_of(case)], prefetch=PREFETCHERS[case["fetch"]], three_c=case["3c"])
    rows = printed_rows((GOLDEN / f"{case['id']}.txt").read_text())

    def columns(counts, mark):
        return [float(sum(counts[mark | label] for label in labels)) for labels in COLUMNS.values()]

    order = ["Instrn", "Data", "Read", "Write", "Misc"]
    assert order == list(COLUMNS)[:5]
    compared = 0
    for name, counts, mark in (
        ("Demand Fetches", result.accesses, 0), ("Prefetch Fetches", result.accesses, 8),
        ("Demand Misses", result.misses, 0), ("Prefetch Misses", result.misses, 8),
        ("Compulsory misses", result.compulsory, 0), ("PF compulsory misses", result.compulsory, 8),
        ("Capacity misses", result.capacity, 0), ("PF capacity misses", result.capacity, 8),
        ("Conflict misses", result.conflict, 0), ("PF conflict misses", result.conflict, 8),
    ):  # fmt: skip
        if name in rows:
            *five, total = columns(counts, mark)
            assert rows[name] == [total, *five], name
            compared += 1
    assert compared == (2 if case["fetch"] == "d" else 4) + (3 if case["3c"] else 0) * (1 if case["fetch"] == "d" else 2)
    if case["fetch"] == "d" and "label_b" not in case["trace"]:  # without prefetches, also by the paths that only count
        assert rows["Demand Misses"][0] == result.demand_misses_without
    assert rows["Bytes From Memory"] == [result.bytes_from_memory]
    assert rows["Demand miss rate"][0] == round(result.demand_miss_rate, 4)
    if "Total miss rate" in rows:
        assert rows["Total miss rate"][0] == round(result.paper_miss_rate, 4)


@pytest.mark.parametrize("case", [CASES[5], CASES[10], CASES[15], CASES[18]], ids=lambda case: case["id"])
def test_the_reference_model_agrees_with_dinero(case, din):
    config = config_of(case)
    [batch] = DinTrace(din / case["trace"]).batches()
    events = [(int(address), 4, int(label)) for address, label in zip(batch[0], batch[2], strict=True)]
    trigger = {"a": "always", "m": "miss", "t": "tagged"}.get(case["fetch"])
    model = Cache(config).replay(pieces(events, config.line_bytes), trigger)
    rows = printed_rows((GOLDEN / f"{case['id']}.txt").read_text())
    assert rows["Demand Misses"][0] == sum(model.counts["misses"][:8])
    if case["3c"]:
        assert rows["Conflict misses"][0] == sum(model.counts["conflict"][:8])
        assert rows["Capacity misses"][0] == sum(model.counts["capacity"][:8])
    if case["fetch"] != "d":
        assert rows["Prefetch Misses"][0] == sum(model.counts["misses"][8:])
