"""Some cycles from the middle of a run in the trace-event format of Perfetto and chrome://tracing, a cycle a microsecond."""

import json
from pathlib import Path
from typing import Any

from cachesim.clock.log import LOG_BOX, LOG_PREFETCH, LOG_READ, LOG_TRIANGLES
from cachesim.clock.parameters import Clock
from cachesim.clock.state import CYCLES
from cachesim.clock.timing import Workshop, timed_policy
from cachesim.config import CacheConfig
from cachesim.prefetch import Prefetch
from cachesim.source import RunSource, Source
from nptrace_base.atomic import whole_file

#: Events kept: some hundred cycles of a few rays.
N_EVENTS = 4000

_READS, _UNIT = 0, 1  # process numbers: what the rays do, and what the prefetch unit asks for


def write_timeline(source: Source, config: CacheConfig, clock: Clock, prefetch: Prefetch, path: Path) -> None:
    """Time a run once more and write ``N_EVENTS`` events from its middle, atomically."""
    assert isinstance(source, RunSource)
    log = Workshop(source, threads=1).log(config, clock, timed_policy(prefetch), N_EVENTS)
    text = json.dumps({"displayTimeUnit": "ns", "traceEvents": [*_names(clock.rays), *map(_event, log)]})
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _names(n_slots: int) -> list[dict[str, Any]]:
    """Return the names of the rows."""
    return [
        {"ph": "M", "name": name, "pid": process, "tid": slot, "args": {"name": text}}
        for process, title in ((_READS, "rays in flight"), (_UNIT, "prefetch unit"))
        for slot in range(n_slots)
        for name, text in (("process_name", title), ("thread_name", f"slot {slot}"))
    ]


def _event(entry: list[int]) -> dict[str, Any]:
    """Return one event of the log: cycle, length, slot, what, and two numbers that belong to it."""
    cycle, length, slot, what, node, number = entry
    event: dict[str, Any] = {"ph": "X", "ts": cycle, "dur": length, "pid": _READS, "tid": slot}
    if what == LOG_PREFETCH:
        return event | {"pid": _UNIT, "name": "prefetch", "args": {"line": node}}
    if what == LOG_READ:
        ray, cause = divmod(number, len(CYCLES))
        return event | {"name": CYCLES[cause], "args": {"node": node, "ray": ray}}
    return event | {
        "name": {int(LOG_BOX): "box test", int(LOG_TRIANGLES): "triangle test"}[what],
        "args": {"node": node, "ray": number},
    }
