"""The two commands, nptrace and npcache, assembled from ``nptrace.commands``."""

from nptrace.groups import Commands

nptrace = Commands(
    "nptrace", ["render", "scenes", "info", "view", "check", "export", "map", "run", "compile"],
    help="Stage 1: render scenes and record every node access.",
    epilog="Stage 2, npcache: replay, sweep, summarise, combine, time, compare, estimate, table1, plot, report "
    "(python -m nptrace cache COMMAND).",
)  # fmt: skip
npcache = Commands(
    "npcache", ["replay", "sweep", "summarise", "combine", "time", "compare", "estimate", "table1", "plot", "report"],
    help="Stage 2: replay node accesses through node caches.",
    epilog="Stage 1 is nptrace: render, scenes, info, view, check, export, map, run, compile.",
)  # fmt: skip
