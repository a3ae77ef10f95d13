"""A sweep for people: rows of ``cachesim.sweep`` -> a table."""

from collections.abc import Sequence

from cachesim.report.replay_tables import RATES
from cachesim.result import ratio
from cachesim.sweep import SweepRow
from nptrace_base.tables import Table, number, percent
from traces.identity import labels


def tables(rows: Sequence[SweepRow]) -> tuple[list[Table], list[str]]:
    """Return the table, with a key column for all that varies, and the notes below it."""
    names = labels(row.identity for row in rows)
    keys = {
        "run": [names[row.identity] for row in rows],
        "prefetch": [row.prefetch for row in rows],
        "layout": [row.layout for row in rows],
        "cache": [str(row.config) for row in rows],
    }
    shown = [name for name, cells in keys.items() if name in ("run", "cache") or len(set(cells)) > 1]
    header = [*shown, "demand\naccesses", "demand\nmisses", "demand\nmiss rate %", "paper\nmiss rate %", "KB from\nmemory"]
    lines = [
        [
            *(keys[name][i] for name in shown), number(row.demand_accesses), number(row.demand_misses),
            percent(ratio(row.demand_misses, row.demand_accesses)), percent(row.to_dict()["paper_miss_rate"]),
            number(row.to_dict()["bytes_from_memory"] / 1024),
        ]
        for i, row in enumerate(rows)
    ]  # fmt: skip
    extra = ("demand\naccesses", "KB from\nmemory", "demand\nmisses")
    return [Table("", header, lines, n_left=len(shown), extra=extra)], list(RATES)
