"""Choices outside the traversal and what they would cost otherwise: the same work done the other way, in the same process."""

import time

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from cachesim import source
from cachesim.filter import DirectFilter
from cachesim.lines import look_up, tally
from cachesim.prefetch import parse_prefetch
from cachesim.replay import replay
from cachesim.source import RunSource
from tests.bench.measure import ratio, times
from tests.bench.stage2 import TABLE1
from traces.format import ACCESSES, ENCODING, ROW_GROUP, column_encoding
from traces.reader import Run


def bench_tried(run: Run, repeat: int) -> dict[str, float]:
    """Return the time of each alternative over that of what we do."""
    return _writing(run, repeat) | _filter(run, repeat) | _batches(run, repeat)


def _writing(run: Run, repeat: int) -> dict[str, float]:
    """Write the accesses as we do, and encoded or compressed otherwise."""
    columns = run.columns("accesses")
    n = min(len(columns["node"]), 32 * ROW_GROUP)
    table = pa.table([pa.array(columns[name][:n]) for name in ACCESSES.names], schema=ACCESSES)
    target = run.path.parent / "written.parquet"
    encodings = column_encoding(ACCESSES)

    def written(encodings=encodings, **options):
        chosen = {"row_group_size": ROW_GROUP, "write_statistics": ["ray"], **ENCODING, "column_encoding": encodings}
        return lambda: pq.write_table(table, target, **{**chosen, **options})

    functions = {
        "accesses with zstd 3": written(compression_level=3),
        "accesses with LZ4": written(compression="lz4", compression_level=None),
        "pages of 20,000 rows": written(max_rows_per_page=20_000, data_page_size=1 << 20),
        "row groups and pages of 2^20 rows": written(row_group_size=1 << 20, max_rows_per_page=1 << 20),
        "values handed over 1024 at a time": written(write_batch_size=1024),
        "`kind` by a dictionary": written(None, use_dictionary=["kind"]),
        "`ray` as differences": written({**encodings, "ray": "DELTA_BINARY_PACKED"}),
        "`node` as differences": written({**encodings, "node": "DELTA_BINARY_PACKED"}),
    }
    taken = times({"ours": written(), **functions}, repeat)
    out = {f"{name}: time": ratio(taken[name], taken["ours"]) for name in functions}
    written()()
    size = target.stat().st_size
    for name, function in functions.items():
        function()
        out[f"{name}: bytes"] = target.stat().st_size / size
    target.unlink()
    return out


def _filter(run: Run, repeat: int) -> dict[str, float]:
    """Replay with and without the exact filter; filter in one pass or in three."""
    events = next(RunSource(run).events(parse_prefetch("traced")))
    lines = RunSource(run).lines(32, 0)
    totals = np.zeros(16, np.int64)

    def one_pass():
        lines.counted(*events, DirectFilter(128, keep_first_use=True), totals)

    def three_passes():
        looked_up = look_up(lines._first, events[0])
        tally(events[1], totals)
        DirectFilter(128, keep_first_use=True).accesses(looked_up, events[1])

    functions = {
        "four caches": lambda: replay(run, TABLE1, threads=1),
        "four caches, no filter": lambda: replay(run, TABLE1, threads=1, is_filtered=False),
        "one cache": lambda: replay(run, TABLE1[1:2], prefetch="none", threads=1),
        "one cache, no filter": lambda: replay(run, TABLE1[1:2], prefetch="none", threads=1, is_filtered=False),
    }
    taken = times(functions, repeat, time.process_time)
    passes = times({"one": one_pass, "three": three_passes}, repeat)
    return {
        "replay of the four caches of Table I, with prefetches, without the exact filter: time": ratio(
            taken["four caches, no filter"], taken["four caches"]
        ),
        "replay of one 2-way cache, demand only, without the exact filter: time": ratio(
            taken["one cache, no filter"], taken["one cache"]
        ),
        "looking up, counting and filtering in three passes: time": ratio(passes["three"], passes["one"]),
    }


def _batches(run: Run, repeat: int) -> dict[str, float]:
    """Replay in batches of other sizes."""

    def replay_with(batch):
        def call():
            source.BATCH, before = batch, source.BATCH
            try:
                replay(run, TABLE1, threads=1)
            finally:
                source.BATCH = before

        return call

    functions = {f"replay in batches of 2^{bits}: time": replay_with(1 << bits) for bits in (14, 16)}
    taken = times({"ours": replay_with(source.BATCH), **functions}, repeat, time.process_time)
    return {name: ratio(taken[name], taken["ours"]) for name in functions}
