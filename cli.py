"""The two commands, nptrace and npcache, assembled from ``nptrace.commands``."""

from nptrace.groups import Commands

nptrace = Commands(
    "nptrace",
    {
        "render": "Trace scenes; write one run per scene and tree.",
        "scenes": "List the scenes known by name, and where each is found.",
        "info": "Print what runs hold, and how to make them again.",
        "view": "Show pictures of runs, or counts and misses per pixel.",
        "check": "Compare the traversal with Embree and exact arithmetic.",
        "export": "Write a run as addresses: for DineroIV, CSV or Parquet.",
        "map": "Map where prefetching pays.",
        "run": "Do a study that a TOML file describes.",
        "compile": "Compile all kernels now, not at their first use.",
    },
    help="Stage 1: render scenes and record every node access.",
    epilog="Stage 2, npcache: replay, sweep, summarise, combine, time, compare, estimate, table1, plot, report "
    "(python -m nptrace cache COMMAND).",
)  # fmt: skip
npcache = Commands(
    "npcache",
    {
        "replay": "Count misses of node caches, with and without prefetching.",
        "sweep": "Count misses of every LRU cache in a range, in one pass.",
        "summarise": "Replay a part of a run; write its summary.",
        "combine": "Join the summaries of all parts to the exact result.",
        "time": "Count cycles, with and without prefetching.",
        "compare": "Compare all prefetch policies on a cache and a machine.",
        "estimate": "Estimate miss rates from a sample of the rays.",
        "table1": "Print Table I of the paper beside ours.",
        "plot": "Draw results of the other commands.",
        "report": "Write one page about runs, for any browser.",
    },
    help="Stage 2: replay node accesses through node caches.",
    epilog="Stage 1 is nptrace: render, scenes, info, view, check, export, map, run, compile.",
)  # fmt: skip
nptrace.other, npcache.other = npcache, nptrace
