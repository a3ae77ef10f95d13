"""Choices outside the traversal and what they would cost otherwise: the same work done the other way, in the same process."""

import time

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from cachesim import source
from cachesim.filter import DirectFilter
from cachesim.replay import replay
from cachesim.source import RunSource, look_up, tally
from tests.bench.measure import ratio, times
from tests.bench.stage2 import TABLE1
from traces import pages
from traces.format import ACCESSES, ROW_GROUP, Run
from traces.pages import CODES, RUNS, Runs, encode
from traces.parquet import ParquetFile, dtype_of


def bench_tried(run: Run, repeat: int) -> dict[str, float]:
    """Return the time of each alternative over that of what we do."""
    return _writing(run, repeat) | _filter(run, repeat) | _batches(run, repeat)


def _writing(run: Run, repeat: int) -> dict[str, float]:
    """Write the accesses as we do, by pyarrow, and compressed otherwise."""
    columns = run.columns("accesses")
    n = min(len(columns["node"]), 8 * ROW_GROUP)
    counts = run.columns("rays", ["count"])["count"]
    hints = {"ray": RUNS, "kind": CODES}
    target = run.path.parent / "written.parquet"

    def ours(hints=hints):
        file = ParquetFile(target, ACCESSES)
        rays = Runs(0, counts)
        for start in range(0, n, ROW_GROUP):
            end = min(start + ROW_GROUP, n)
            pieces = {"ray": rays[start:end], **{name: columns[name][start:end] for name in ("node", "kind")}}
            file.write([encode([pieces[f.name]], dtype_of(f), hints.get(f.name)) for f in ACCESSES])
        file.close({})

    def by_pyarrow():
        options = {"compression": "zstd", "compression_level": 1, "use_dictionary": False, "data_page_size": 1 << 22}
        encoding = {"kind": "BYTE_STREAM_SPLIT"}
        with pq.ParquetWriter(target, ACCESSES, max_rows_per_page=ROW_GROUP, column_encoding=encoding, **options) as file:
            for start in range(0, n, ROW_GROUP):
                arrays = [pa.array(columns[name][start : min(start + ROW_GROUP, n)]) for name in ACCESSES.names]
                file.write_table(pa.Table.from_arrays(arrays, schema=ACCESSES), row_group_size=ROW_GROUP)

    def with_codec(codec):
        def write():
            pages._codec, before = codec, pages._codec
            try:
                ours()
            finally:
                pages._codec = before

        return write

    functions = {
        "accesses written by pyarrow": by_pyarrow,
        "accesses with zstd 3": with_codec(pa.Codec("zstd", 3)),
        "accesses with zstd -5": with_codec(pa.Codec("zstd", -5)),
        "accesses with LZ4": with_codec(pa.Codec("lz4_raw")),
        "`ray` and `kind` plain instead of runs and codes": lambda: ours({}),
    }
    taken = times({"ours": ours, **functions}, repeat)
    out = {f"{name}: time": ratio(taken[name], taken["ours"]) for name in functions}
    ours()
    size = target.stat().st_size
    for name, function in functions.items():
        function()
        out[f"{name}: bytes"] = target.stat().st_size / size
    target.unlink()
    return out


def _filter(run: Run, repeat: int) -> dict[str, float]:
    """Replay with and without the exact filter; filter in one pass or in three."""
    events = next(RunSource(run).events(source.Prefetch("traced")))
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
        "replay of the four caches of Table I, with pre-fetches, without the exact filter: time": ratio(
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

    functions = {f"replay in batches of 2^{bits}: time": replay_with(1 << bits) for bits in (16, 20)}
    taken = times({"ours": replay_with(source.BATCH), **functions}, repeat, time.process_time)
    return {name: ratio(taken[name], taken["ours"]) for name in functions}
